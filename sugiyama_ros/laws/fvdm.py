"""Full velocity difference model."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law, bounded


@kernel
def _fvdm(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Compute the acceleration [m/s^2] of the full velocity difference model, p = kappa, lambda, V1, V2, C1, C2.

    The optimal velocity is the function of Helbing and Tilch, as in the model's paper.
    """
    if gap == math.inf:
        return bounded(p[0] * (p[2] + p[3] - speed))
    optimal = p[2] + p[3] * math.tanh(p[4] * gap - p[5])
    return bounded(p[0] * (optimal - speed) + p[1] * (leader_speed - speed))


LAW = Law(
    name="fvdm",
    title="FVDM",
    summary="full velocity difference model: an optimal velocity of the gap, plus a term in the relative speed",
    source="Jiang, Wu and Zhu, Phys. Rev. E 64 (2001) 017101",
    parameters=(
        Parameter("kappa", "κ", "1/s", 0.5, 0.01, 10.0, "sensitivity to the optimal velocity"),
        Parameter("lambda", "λ", "1/s", 0.5, 0.0, 10.0, "sensitivity to the relative speed"),
        Parameter("V1", "V_1", "m/s", 5.0, -20.0, 60.0, "optimal velocity: mid value"),
        Parameter("V2", "V_2", "m/s", 5.0, 0.1, 60.0, "optimal velocity: half range"),
        Parameter("C1", "C_1", "1/m", 0.2, 0.005, 5.0, "optimal velocity: steepness"),
        Parameter("C2", "C_2", "1", 1.0, -5.0, 10.0, "optimal velocity: place of the turning point"),
    ),
    function=_fvdm,
)
