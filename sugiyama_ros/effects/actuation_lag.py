"""The acceleration of the car follows the driver's intention with a lag."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, Effect, Memory, at
from sugiyama_ros.jit import kernel


@kernel
def _share(period: float, p: Array) -> float:
    """Compute the share of a wanted change that a first-order lag carries out in a period [s]."""
    return 1.0 - math.exp(-period / p[0])


@kernel
def _change(wanted: float, period: float, p: Array) -> float:
    """Compute the change [m/s^2] that the car carries out in a period [s]."""
    return wanted * _share(period, p)


@kernel
def _expected_change(wanted: float, variance: float, period: float, p: Array) -> tuple[float, float, float]:
    """Compute the moments of the change that the car carries out; the lag is linear, so no variance is left."""
    part = _share(period, p)
    return part * wanted, part, 0.0


EFFECT = Effect(
    name="actuation_lag",
    stage=ACTUATION,
    title="slow response of the car",
    summary="the acceleration follows the intended acceleration with a first-order lag",
    term="da/dt = (abar - a) / time_constant",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 12.3",
    parameters=(Parameter("time_constant", "T_l", "s", 0.0, 0.0, 5.0, "time constant"),),
    starts=at({"time_constant": 0.1}, {"time_constant": 0.4}),
    memory=Memory(_change, _expected_change),
    bank={"time_constant": 0.2},
    benchmark=({"time_constant": 0.4}, {"time_constant": 0.22}),
    advice={"reaction_delay": "record accelerations, or positions at 10 Hz and more"},
)
