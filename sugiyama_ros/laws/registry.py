"""Rival car-following models: a driver's acceleration as a function of what he sees. Compiled, pure, finite.

The last one, constant speed, has no acceleration but noise: what a model must beat to be worth anything.
"""

import math
from dataclasses import dataclass

from numba import njit

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.road import Array

_STRONGEST, _HARDEST = 4.0, -6.0


@dataclass(frozen=True)
class Law:
    """A rival: its name and its parameters, in the order in which its function takes them."""

    name: str
    parameters: tuple[Parameter, ...]


_IDM = "Treiber, Hennecke and Helbing, Phys. Rev. E 62 (2000) 1805"
_FVDM = "Jiang, Wu and Zhu, Phys. Rev. E 64 (2001) 017101"
#: The order gives the number of a law in a driver's row, from 1.
LAWS: tuple[Law, ...] = (
    Law(
        "idm",
        (
            Parameter("v0", "v_0", "m/s", 10.0, 1.0, 80.0, f"desired speed; {_IDM}"),
            Parameter("T", "T", "s", 0.8, 0.05, 5.0, f"desired time gap; {_IDM}"),
            Parameter("s0", "s_0", "m", 1.5, 0.0, 20.0, f"gap at standstill; {_IDM}"),
            Parameter("a", "a", "m/s^2", 1.5, 0.05, 10.0, f"maximum acceleration; {_IDM}"),
            Parameter("b", "b", "m/s^2", 2.0, 0.05, 20.0, f"comfortable braking; {_IDM}"),
        ),
    ),
    Law(
        "fvdm",
        (
            Parameter("kappa", "κ", "1/s", 0.5, 0.01, 10.0, f"sensitivity to the optimal velocity; {_FVDM}"),
            Parameter("lambda", "λ", "1/s", 0.5, 0.0, 10.0, f"sensitivity to the relative speed; {_FVDM}"),
            Parameter("V1", "V_1", "m/s", 5.0, -20.0, 60.0, f"optimal velocity: mid value; {_FVDM}"),
            Parameter("V2", "V_2", "m/s", 5.0, 0.1, 60.0, f"optimal velocity: half range; {_FVDM}"),
            Parameter("C1", "C_1", "1/m", 0.2, 0.005, 5.0, f"optimal velocity: steepness; {_FVDM}"),
            Parameter("C2", "C_2", "1", 1.0, -5.0, 10.0, f"optimal velocity: place of the turning point; {_FVDM}"),
        ),
    ),
    Law("constant_speed", ()),
)


@njit(cache=True)
def _bounded(acceleration: float) -> float:
    """Within what the drivers of the paper choose from."""
    return min(max(acceleration, _HARDEST), _STRONGEST)


@njit(cache=True)
def idm(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Acceleration [m/s^2] of the intelligent driver model, p = v0, T, s0, a, b.

    gap [m], infinite without a leader; speeds [m/s]. Brakes as hard as possible from contact on. The moving part of the
    wanted gap is kept at or above 0, so that a leader who is much faster does not slow the driver down.
    """
    if gap <= 0.0:
        return _HARDEST
    free = 1.0 - (max(speed, 0.0) / p[0]) ** 4
    if gap == math.inf:
        return _bounded(p[3] * free)
    wanted = p[2] + max(0.0, speed * p[1] + speed * (speed - leader_speed) / (2.0 * math.sqrt(p[3] * p[4])))
    ratio = wanted / gap
    return _bounded(p[3] * (free - ratio * ratio))


@njit(cache=True)
def fvdm(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Acceleration [m/s^2] of the full velocity difference model, p = kappa, lambda, V1, V2, C1, C2.

    gap [m], infinite without a leader; speeds [m/s]. The optimal velocity is Helbing and Tilch's, which the model's
    paper takes over.
    """
    if gap == math.inf:
        return _bounded(p[0] * (p[2] + p[3] - speed))
    optimal = p[2] + p[3] * math.tanh(p[4] * gap - p[5])
    return _bounded(p[0] * (optimal - speed) + p[1] * (leader_speed - speed))
