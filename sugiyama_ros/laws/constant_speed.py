"""Constant speed: every useful model predicts better than this law."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law


@kernel
def _constant_speed(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Return the acceleration 0 [m/s^2]."""
    return 0.0


LAW = Law(
    name="constant_speed",
    title="constant speed",
    summary="no acceleration except noise",
    source="the simplest possible reference",
    parameters=(),
    function=_constant_speed,
)
