"""Helly's linear follower."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law, bounded


@kernel
def _helly(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Compute the acceleration [m/s^2] of Helly's law, p = c_v, c_s, d, T.

    The acceleration is linear in the relative speed and in the difference between the gap and the wanted gap d + T v.
    The law says nothing about a driver without a leader; here such a driver keeps their speed.
    """
    if gap == math.inf:
        return 0.0
    return bounded(p[0] * (leader_speed - speed) + p[1] * (gap - p[2] - p[3] * speed))


LAW = Law(
    name="helly",
    title="Helly",
    summary="linear in the relative speed and in the difference to a wanted gap",
    source="Helly, Simulation of bottlenecks in single-lane traffic flow (1959)",
    parameters=(
        Parameter("c_v", "C_1", "1/s", 0.5, 0.0, 10.0, "sensitivity to the relative speed"),
        Parameter("c_s", "C_2", "1/s^2", 0.15, 0.001, 5.0, "sensitivity to the gap"),
        Parameter("d", "α", "m", 1.5, 0.0, 20.0, "gap at standstill"),
        Parameter("T", "β", "s", 0.8, 0.0, 5.0, "wanted time gap"),
    ),
    function=_helly,
)
