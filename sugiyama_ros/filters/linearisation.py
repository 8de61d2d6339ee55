"""One period of the model for a whole chain, linearised. The batch filter and the online filter both use it."""

import math

from sugiyama_ros.driver.advance import advance
from sugiyama_ros.driver.parameters import RHO, SIGMA_A, SIGMA_V, SIGMA_X
from sugiyama_ros.effects.control import noise_factor
from sugiyama_ros.filters.expectation import expected_action
from sugiyama_ros.filters.state import MOVING, STATE, Drivers, Linearised, Moment, Scene, State, Workspace
from sugiyama_ros.jit import kernel


@kernel(allocates=False)
def linearise(
    state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace, out: Linearised
) -> float:
    """Linearise one period of Eq. ssm_form for a whole chain.

    Parameters
    ----------
    state
        The chain after the update with the latest sample.
    drivers
        Their parameters and priors; M rows.
    moment, scene
        Lengths, the vehicle behind and the time; period and road.
    workspace
        Of ``workspace_for`` this chain; overwritten.
    out
        Overwritten with the next mean, the Jacobian and the process noise.

    Returns
    -------
    float
        What the own driver means to do [m/s^2].
    """
    mean, known, parameters = state.mean, state.known, drivers.parameters
    next_mean, jacobian, noise = out.next_mean, out.jacobian, out.noise
    vehicles = len(known)
    period = scene.period_s
    own_action = 0.0
    for k in range(len(mean)):
        next_mean[k] = mean[k]
    jacobian[:] = 0.0
    noise[:] = 0.0
    for k in range(len(drivers.adapted)):
        p = STATE * vehicles + k
        next_mean[p] = drivers.prior_mean[k] + scene.memory * (mean[p] - drivers.prior_mean[k])
        jacobian[p, p] = scene.memory
        noise[p, p] = drivers.prior_var[k] * (1.0 - scene.memory**2)
    for m in range(vehicles):
        x, v, n, b = STATE * m, STATE * m + 1, STATE * m + 2, STATE * m + 3
        jacobian[x, x] = jacobian[v, v] = 1.0
        if known[m] != MOVING:
            continue
        jacobian[x, v] = jacobian[v, n] = period
        noise[x, x], noise[v, v] = parameters[m, SIGMA_X] ** 2, parameters[m, SIGMA_V] ** 2
        if m == vehicles - 1:
            action, rho, shock_std = 0.0, scene.last_rho, scene.last_shock_std
            next_mean[b] = 0.0
        else:
            expected = expected_action(m, state, drivers, moment, scene, workspace)
            action = expected.action
            noise[v, v] += period * period * expected.action_var
            noise[b, b] = expected.held_var
            noise[v, b] = noise[b, v] = period * math.sqrt(expected.action_var * expected.held_var)
            next_mean[b] = expected.held
            for k in range(len(mean)):
                jacobian[v, k] += period * workspace.slope[k]
                jacobian[b, k] = workspace.held_slope[k]
            if m == 0:
                own_action = expected.held
            rho = parameters[m, RHO]
            shock_std = parameters[m, SIGMA_A] * noise_factor(mean[v], parameters[m])
        next_mean[x], next_mean[v] = advance(mean[x], mean[v], action + mean[n], period)
        next_mean[n] = rho * mean[n]
        jacobian[n, n] = rho
        noise[n, n] = shock_std**2
    return own_action
