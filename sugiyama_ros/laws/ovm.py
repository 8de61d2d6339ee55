"""Optimal velocity model."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law, bounded


@kernel
def _ovm(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Compute the acceleration [m/s^2] of the optimal velocity model, p = kappa, V, c, g.

    The optimal velocity V (tanh(c (gap - g)) + tanh(c g)) is 0 at contact. The source chooses units in which V and c
    are 1.
    """
    highest = math.tanh(p[2] * p[3])
    if gap == math.inf:
        return bounded(p[0] * (p[1] * (1.0 + highest) - speed))
    return bounded(p[0] * (p[1] * (math.tanh(p[2] * (gap - p[3])) + highest) - speed))


LAW = Law(
    name="ovm",
    title="OVM",
    summary="optimal velocity model: relaxation to an optimal velocity of the gap",
    source="Bando, Hasebe, Nakayama, Shibata and Sugiyama, Phys. Rev. E 51 (1995) 1035",
    parameters=(
        Parameter("kappa", "a", "1/s", 1.0, 0.01, 10.0, "sensitivity"),
        Parameter("V", "V", "m/s", 5.0, 0.1, 60.0, "scale of the optimal velocity"),
        Parameter("c", "c", "1/m", 0.2, 0.005, 5.0, "steepness of the optimal velocity"),
        Parameter("g", "g", "m", 5.0, 0.0, 100.0, "gap at the turning point"),
    ),
    function=_ovm,
)
