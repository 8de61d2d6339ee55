"""Constant speed: the vehicle holds a speed that somebody chooses."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.controllers.controller import Controller, acceleration_to
from sugiyama_ros.controllers.shared import TARGET, safely


def _constant_speed(gap: float, speed: float, leader_speed: float, memory: Array, period: float, p: Array) -> float:
    """Hold the speed p = target, or the safe speed where it is lower."""
    return acceleration_to(safely(p[0], gap, speed, leader_speed, period), speed, period)


CONTROLLER = Controller(
    name="constant_speed",
    title="constant speed",
    summary="a chosen speed, or the speed from which the vehicle can still stop behind the leader",
    source="the simplest controller; the safe speed is that of Gipps, Transp. Res. B 15 (1981) 105",
    parameters=(TARGET,),
    function=_constant_speed,
)
