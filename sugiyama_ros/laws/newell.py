"""Newell's simplified law, with a relaxation time."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law, bounded


@kernel
def _newell(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Compute the acceleration [m/s^2] of Newell's law, p = v0, tau, d, T.

    A driver repeats the leader's trajectory a time tau later and a distance d behind. So the driver wants the speed
    (gap - d) / tau, at most v0. The speed relaxes to the wanted speed in the time T. The source has no relaxation time.
    """
    wanted = p[0] if gap == math.inf else min(max((gap - p[2]) / p[1], 0.0), p[0])
    return bounded((wanted - speed) / p[3])


LAW = Law(
    name="newell",
    title="Newell",
    summary="the leader's trajectory a fixed time later and a fixed distance behind, with a relaxation time",
    source="Newell, Transp. Res. B 36 (2002) 195",
    parameters=(
        Parameter("v0", "v_f", "m/s", 10.0, 1.0, 80.0, "free speed"),
        Parameter("tau", "τ", "s", 1.0, 0.1, 5.0, "time shift"),
        Parameter("d", "d", "m", 1.5, 0.0, 20.0, "gap at standstill"),
        Parameter("T", "T", "s", 1.0, 0.1, 20.0, "relaxation time of the speed; added here"),
    ),
    function=_newell,
)
