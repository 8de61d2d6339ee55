"""A step of the model over any time: the period stays the unit of the noises, and the horizon stays as it is.

The driver of the model decides once in a period. Between two samples that are not a period apart, the driver's action
holds for the time that passes. The correlations become powers of the correlations over a period, and the noises keep
what they add up to: the acceleration noise its stationary variance, the others their variance per second.
"""

from sugiyama_ros.driver.lanes import Lanes
from sugiyama_ros.driver.parameters import RHO, SIGMA_V
from sugiyama_ros.filters.linearisation import clear, conclude
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

#: Times between samples [s] that differ from whole periods by less than this count as whole periods.
EXACT_S = 1e-6


def steps_between(elapsed_s: float, period_s: float) -> tuple[int, float]:
    """Return in how many steps a filter goes over a time, and how many periods each of them takes.

    elapsed_s: time [s] from one sample to the next, above 0; period_s: period of the model [s].
    """
    steps = max(1, round(elapsed_s / period_s))
    exact = abs(elapsed_s - steps * period_s) < EXACT_S
    return steps, 1.0 if exact else elapsed_s / (steps * period_s)


@kernel(allocates=False)
def conclude_for(
    periods: float,
    state: State,
    drivers: Drivers,
    moment: Moment,
    scene: Scene,
    workspace: Workspace,
    lanes: Lanes,
    out: Linearised,
) -> None:
    """Linearise a step of any length, after ``linearise`` has linearised a period from the same state.

    state, drivers, moment, scene, workspace, lanes, out: as ``linearise`` took them; what it left in the workspace and
    the lanes is used again.
    """
    length_s, memory = periods * scene.period_s, scene.memory**periods
    step = Scene(length_s, scene.horizon, scene.circumference_m, scene.last_rho, scene.last_shock_std, memory)
    clear(out)
    conclude(state, drivers, moment, step, workspace, lanes, out)
    vehicles = len(state.known)
    for m in range(vehicles):
        if state.known[m] != MOVING:
            continue
        x, v, n = STATE * m, STATE * m + 1, STATE * m + 2
        row = drivers.parameters[m]
        out.noise[x, x] *= periods
        out.noise[v, v] += (periods - 1.0) * row[SIGMA_V] ** 2
        rho = scene.last_rho if is_last(m, state.known) else row[RHO]
        over = rho**periods
        out.next_mean[n] = over * state.mean[n]
        out.jacobian[n, n] = over
        out.noise[n, n] *= (1.0 - over * over) / (1.0 - rho * rho)
