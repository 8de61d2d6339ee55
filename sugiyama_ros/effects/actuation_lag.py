"""The car follows what the driver means only gradually."""

import math

from numba import njit

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, Effect, at
from sugiyama_ros.road import Array


@njit(cache=True)
def share(period: float, p: Array) -> float:
    """Of the way from the acceleration held to the one meant, the share that a first-order lag covers in a period."""
    return 1.0 - math.exp(-period / p[0])


EFFECT = Effect(
    name="actuation_lag",
    stage=ACTUATION,
    summary="the acceleration follows the one meant with a first-order lag",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 12.3",
    parameters=(Parameter("time_constant", "T_l", "s", 0.0, 0.0, 5.0, "time constant"),),
    starts=at({"time_constant": 0.1}, {"time_constant": 0.4}),
)
