"""Constant speed: what every model must predict better than."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law


@kernel
def constant_speed(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Acceleration 0, whatever there is to see."""
    return 0.0


LAW = Law(
    name="constant_speed",
    title="constant speed",
    summary="no acceleration but noise",
    source="the plainest reference there is",
    parameters=(),
    function=constant_speed,
)
