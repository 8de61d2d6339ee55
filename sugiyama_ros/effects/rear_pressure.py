"""A car close behind makes drivers hurry."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.driver.utility import Preferences, risk_behind
from sugiyama_ros.effects.effect import ACTUATION, UTILITY, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def _actuate(acceleration: float, seen: Seen, p: Array) -> float:
    """Add to the intended acceleration [m/s^2] a push that falls exponentially with the gap behind."""
    if math.isinf(seen.rear_gap):
        return acceleration
    return acceleration + float(p[0]) * math.exp(-max(seen.rear_gap, 0.0) / p[1])


@kernel(vectorised=True)
def _component(seen: Seen, action: float, period: float, horizon: int, p: Array, driver: Preferences) -> float:
    """Compute the risk that the follower runs into the car, as the driver judges the risk of the leader."""
    if math.isinf(seen.rear_gap):
        return 0.0
    risk = risk_behind(seen.rear_gap, seen.speed, seen.rear_speed, action, period, horizon, driver)
    return float(p[0] * driver[5] * risk)


_UTILITY = Effect(
    name="rear_pressure_utility",
    stage=UTILITY,
    title="fear of the car behind",
    summary="a component of the utility: the risk that the car behind runs into the driver's car",
    term="utility + weight risk(rear_gap, v_rear)",
    source="the paper's phi2, for the car behind",
    parameters=(Parameter("weight", "w_r", "1", 0.0, 0.0, 10.0, "weight beside the risk of the leader"),),
    starts=at({"weight": 0.003}, {"weight": 0.03}),
    sees_rear=True,
    function=_component,
)
EFFECT = Effect(
    name="rear_pressure",
    stage=ACTUATION,
    title="pressure from behind",
    summary="drivers accelerate away from a car close behind",
    term="+ strength exp(-rear_gap / distance)",
    source="Nakayama, Sugiyama and Hasebe, Phys. Rev. E 65 (2001) 016112 (backward looking)",
    parameters=(
        Parameter("strength", "f_r", "m/s^2", 0.0, -10.0, 20.0, "push at contact"),
        Parameter("distance", "d_r", "m", 0.0, 0.3, 100.0, "gap over which the push falls by a factor e"),
    ),
    starts=at({"strength": 0.3, "distance": 2.0}, {"strength": 0.3, "distance": 6.0}),
    least={"strength": 0.0},
    sees_rear=True,
    function=_actuate,
    bank={"strength": 1.0, "distance": 3.0},
    benchmark=({"strength": 1.5, "distance": 2.5}, {"strength": 0.6, "distance": 2.5}),
    forms=(_UTILITY,),
    advice={"reaction_delay": "record cars without a follower too"},
)
