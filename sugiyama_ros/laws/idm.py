"""Intelligent driver model."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law, bounded, hardest_braking


@kernel
def idm(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Compute the acceleration [m/s^2] of the intelligent driver model, p = v0, T, s0, a, b.

    At contact the driver brakes as hard as possible. The dynamic part of the wanted gap is never below 0, so that a
    much faster leader does not slow the driver down.
    """
    if gap <= 0.0:
        return hardest_braking()
    free = 1.0 - (max(speed, 0.0) / p[0]) ** 4
    if gap == math.inf:
        return bounded(p[3] * free)
    wanted = p[2] + max(0.0, speed * p[1] + speed * (speed - leader_speed) / (2.0 * math.sqrt(p[3] * p[4])))
    ratio = wanted / gap
    return bounded(p[3] * (free - ratio * ratio))


LAW = Law(
    name="idm",
    title="IDM",
    summary="intelligent driver model: free acceleration, less the wanted gap over the gap, squared",
    source="Treiber, Hennecke and Helbing, Phys. Rev. E 62 (2000) 1805",
    parameters=(
        Parameter("v0", "v_0", "m/s", 10.0, 1.0, 80.0, "desired speed"),
        Parameter("T", "T", "s", 0.8, 0.05, 5.0, "desired time gap"),
        Parameter("s0", "s_0", "m", 1.5, 0.0, 20.0, "gap at standstill"),
        Parameter("a", "a", "m/s^2", 1.5, 0.05, 10.0, "maximum acceleration"),
        Parameter("b", "b", "m/s^2", 2.0, 0.05, 20.0, "comfortable braking"),
    ),
    function=idm,
)
