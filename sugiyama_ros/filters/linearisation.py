"""One period of the model for a whole chain, linearised. The batch filter and the online filter both use it."""

import math

from sugiyama_ros.driver.advance import advance
from sugiyama_ros.driver.lanes import Lanes, consider, decide
from sugiyama_ros.driver.parameters import RHO, SIGMA_A, SIGMA_V, SIGMA_X
from sugiyama_ros.effects.control import has_components, noise_factor, remembers
from sugiyama_ros.filters.expectation import expected_action, value_components
from sugiyama_ros.filters.past import note_recalled, recalled_at, shift
from sugiyama_ros.filters.points import ALONE, FEELING, RECALLING, aim, view_of
from sugiyama_ros.filters.state import (
    MOVING,
    STATE,
    Drivers,
    Linearised,
    Moment,
    Scene,
    State,
    Workspace,
    is_last,
)
from sugiyama_ros.jit import kernel

# The noise of a driver is at least this part of their sigma_a: a filter that is too sure could not be corrected.
_LEAST_FACTOR = 0.02


@kernel(allocates=False)
def linearise(
    state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace, lanes: Lanes, out: Linearised
) -> float:
    """Linearise one period of Eq. ssm_form for a whole chain.

    workspace: of ``workspace_for`` this chain; overwritten; lanes: of ``lanes_for`` the points of this chain and the
    scene's period; overwritten. Returns what the own driver means to do [m/s^2].
    """
    used = aim_all(state, drivers, moment, scene, workspace, lanes, 0)
    consider(used, scene.period_s, scene.horizon, lanes)
    changed = add_all_components(state, drivers, moment, scene, workspace, lanes)
    decide(used, lanes, changed)
    clear(out)
    return conclude(state, drivers, moment, scene, workspace, lanes, out)


@kernel(allocates=False)
def aim_all(
    state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace, lanes: Lanes, free: int
) -> int:
    """Call ``aim`` for all drivers of a chain; returns the first lane that is free then."""
    for m in range(len(state.known) - 1):
        if state.known[m] == MOVING and not is_last(m, state.known):
            free = aim(m, state, drivers, moment, scene, workspace, lanes, free)
    return free


@kernel(allocates=False)
def add_all_components(
    state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace, lanes: Lanes
) -> bool:
    """Call ``value_components`` for the drivers of a chain who have such effects; returns whether there are any."""
    found = False
    for m in range(len(state.known) - 1):
        if state.known[m] == MOVING and not is_last(m, state.known) and has_components(drivers.parameters[m]):
            value_components(m, state, drivers, moment, scene, workspace, lanes)
            found = True
    return found


@kernel(allocates=False)
def clear(out: Linearised) -> None:
    """Make the Jacobian and the process noise 0."""
    out.jacobian[:] = 0.0
    out.noise[:] = 0.0


@kernel(allocates=False)
def conclude(
    state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace, lanes: Lanes, out: Linearised
) -> float:
    """Linearise the period, after all drivers of the chain have decided; arguments and result as of ``linearise``.

    The Jacobian and the process noise in ``out`` are 0 before.
    """
    mean, known, parameters = state.mean, state.known, drivers.parameters
    next_mean, jacobian, noise = out.next_mean, out.jacobian, out.noise
    vehicles, adapted = len(known), len(drivers.adapted)
    period = scene.period_s
    own_action = 0.0
    for k in range(adapted):
        p = STATE * vehicles + k
        next_mean[p] = drivers.prior_mean[k] + scene.memory * (mean[p] - drivers.prior_mean[k])
        jacobian[p, p] = scene.memory
        noise[p, p] = drivers.prior_var[k] * (1.0 - scene.memory**2)
        out.columns[p, 0], out.counts[p] = p, 1
    for m in range(vehicles):
        x, v, n, b = STATE * m, STATE * m + 1, STATE * m + 2, STATE * m + 3
        jacobian[x, x] = jacobian[v, v] = 1.0
        if known[m] != MOVING:
            for k in range(x, x + STATE):
                next_mean[k] = mean[k]
                out.columns[k, 0], out.counts[k] = k, 1
            continue
        jacobian[x, v] = jacobian[v, n] = period
        noise[x, x], noise[v, v] = parameters[m, SIGMA_X] ** 2, parameters[m, SIGMA_V] ** 2
        _note_columns(m, state, drivers, out)
        if is_last(m, known):
            action, rho, shock_std = 0.0, scene.last_rho, scene.last_shock_std
            next_mean[b] = 0.0
        else:
            expected = expected_action(m, state, drivers, moment, scene, workspace, lanes)
            action = expected.action
            noise[v, v] += period * period * expected.action_var
            noise[b, b] = expected.held_var
            noise[v, b] = noise[b, v] = period * math.sqrt(expected.action_var * expected.held_var)
            next_mean[b] = expected.held
            for c in range(out.counts[v]):
                k = out.columns[v, c]
                jacobian[v, k] += period * workspace.slope[k]
                jacobian[b, k] = workspace.held_slope[k]
            if m == 0:
                own_action = expected.held
            rho = parameters[m, RHO]
            shock_std = parameters[m, SIGMA_A] * max(noise_factor(mean[v], parameters[m]), _LEAST_FACTOR)
        next_mean[x], next_mean[v] = advance(mean[x], mean[v], action + mean[n], period)
        next_mean[n] = rho * mean[n]
        jacobian[n, n] = rho
        noise[n, n] = shock_std**2
    shift(state, drivers, out)
    return own_action


@kernel(allocates=False)
def _note_columns(m: int, state: State, drivers: Drivers, out: Linearised) -> None:
    """Note which entries of the rows of a moving vehicle in F may differ from 0."""
    x, v, n, b = STATE * m, STATE * m + 1, STATE * m + 2, STATE * m + 3
    known, columns, counts = state.known, out.columns, out.counts
    columns[x, 0], columns[x, 1], counts[x] = x, v, 2
    columns[n, 0], counts[n] = n, 1
    columns[v, 0], columns[v, 1], columns[v, 2], counts[v], counts[b] = x, v, n, 3, 0
    if is_last(m, known):
        return
    view = view_of(m, state, drivers)
    if view == RECALLING:
        note_recalled(recalled_at(m, state, drivers), v, out)
    elif view != ALONE:
        columns[v, 3], columns[v, 4], counts[v] = x + STATE, v + STATE, 5
        if view == FEELING:
            columns[v, 5], counts[v] = n + STATE, 6
    if remembers(drivers.parameters[m]):
        columns[v, counts[v]] = b
        counts[v] += 1
    if m == 0:
        for k in range(len(drivers.adapted)):
            columns[v, counts[v]] = STATE * len(known) + k
            counts[v] += 1
    # the held acceleration depends on the same entries
    for c in range(counts[v]):
        columns[b, c] = columns[v, c]
    counts[b] = counts[v]
