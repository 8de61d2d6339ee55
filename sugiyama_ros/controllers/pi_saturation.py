"""PI with saturation: the vehicle finds the mean speed of the traffic by itself."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.controllers.controller import Controller, acceleration_to
from sugiyama_ros.controllers.shared import CATCH_UP, WINDOW, catching_up, mean_of_last, samples_in

# Time [s] and least gap [m] of the gap from which on the target counts, and length [m] of the transition.
_TIME_S, _LEAST_M, _TRANSITION_M = 2.0, 4.0, 2.0


def _pi_saturation(gap: float, speed: float, leader_speed: float, memory: Array, period: float, p: Array) -> float:
    """Follow the commanded speed of the PI controller with saturation, p = window, catch_up.

    memory: last commanded speed [m/s], and what `mean_of_last` keeps. The command starts from the vehicle's own speed.
    """
    before = memory[0] if memory[1] > 0.0 else speed
    target = mean_of_last(memory[1:], speed) + catching_up(gap, p[1])
    safe_m = max(_TIME_S * (leader_speed - speed), _LEAST_M)
    alpha = min(max((gap - safe_m) / _TRANSITION_M, 0.0), 1.0)
    beta = 1.0 - 0.5 * alpha
    memory[0] = beta * (alpha * target + (1.0 - alpha) * leader_speed) + (1.0 - beta) * before
    return acceleration_to(memory[0], speed, period)


def _entries(p: Array, period: float) -> int:
    return 2 + samples_in(p[0], period)


CONTROLLER = Controller(
    name="pi_saturation",
    title="PI with saturation",
    summary="the vehicle's mean speed, a little more where the gap is long; the leader's speed where it is short",
    source="Stern et al., Transp. Res. C 89 (2018) 205",
    parameters=(WINDOW, CATCH_UP),
    function=_pi_saturation,
    memory=_entries,
)
