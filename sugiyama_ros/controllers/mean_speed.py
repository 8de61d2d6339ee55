"""Mean speed: the vehicle holds the mean of its own speed in the last seconds."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.controllers.controller import Controller, acceleration_to
from sugiyama_ros.controllers.shared import CATCH_UP, WINDOW, catching_up, mean_of_last, safely, samples_in


def _mean_speed(gap: float, speed: float, leader_speed: float, memory: Array, period: float, p: Array) -> float:
    """Hold the mean speed of the last seconds, and a little more where the gap is long; p = window, catch_up.

    A vehicle that only held its mean speed would never start, and each time that it brakes it would be slower for good.
    """
    wanted = mean_of_last(memory, speed) + catching_up(gap, p[1])
    return acceleration_to(safely(wanted, gap, speed, leader_speed, period), speed, period)


def _entries(p: Array, period: float) -> int:
    return 1 + samples_in(p[0], period)


CONTROLLER = Controller(
    name="mean_speed",
    title="mean speed",
    summary="the mean of the vehicle's own speed in the last seconds, and up to catch_up more where the gap is long",
    source="target of the PI controller of Stern et al., Transp. Res. C 89 (2018) 205, held as constant_speed does",
    parameters=(WINDOW, CATCH_UP),
    function=_mean_speed,
    memory=_entries,
)
