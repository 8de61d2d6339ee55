"""Accelerating and braking are softened alike."""

import math

from numba import njit

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, Effect, Seen, at
from sugiyama_ros.road import Array


@njit(cache=True)
def actuate(acceleration: float, seen: Seen, p: Array) -> float:
    """A tanh(a / A): one smooth saturation."""
    return float(p[0]) * math.tanh(acceleration / p[0])


EFFECT = Effect(
    name="comfort_limits",
    stage=ACTUATION,
    summary="a smooth saturation of acceleration and braking alike",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 11.3",
    parameters=(Parameter("limit", "A", "m/s^2", 0.0, 0.1, 50.0, "acceleration never reached; 0 for no limit"),),
    starts=at({"limit": 1.5}, {"limit": 3.0}, {"limit": 6.0}),
    function=actuate,
)
