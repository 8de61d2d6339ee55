"""The car follows what the driver means only gradually."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, Effect, Memory, at
from sugiyama_ros.jit import kernel


@kernel
def share(period: float, p: Array) -> float:
    """Share of a wanted change that a first-order lag carries out in a period."""
    return 1.0 - math.exp(-period / p[0])


@kernel
def change(wanted: float, period: float, p: Array) -> float:
    """Change [m/s^2] that is carried out in a period [s]."""
    return wanted * share(period, p)


@kernel
def expected_change(wanted: float, variance: float, period: float, p: Array) -> tuple[float, float, float]:
    """Moments of the change that is carried out; the lag is linear, so that nothing is left over."""
    part = share(period, p)
    return part * wanted, part, 0.0


EFFECT = Effect(
    name="actuation_lag",
    stage=ACTUATION,
    title="slow response of the car",
    summary="the acceleration follows the one meant with a first-order lag",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 12.3",
    parameters=(Parameter("time_constant", "T_l", "s", 0.0, 0.0, 5.0, "time constant"),),
    starts=at({"time_constant": 0.1}, {"time_constant": 0.4}),
    memory=Memory(change, expected_change),
    bank={"time_constant": 0.2},
    benchmark=({"time_constant": 0.4}, {"time_constant": 0.22}),
    advice={"reaction_delay": "record accelerations, or positions at 10 Hz and more"},
)
