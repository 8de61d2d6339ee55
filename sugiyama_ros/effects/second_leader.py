"""Drivers look past their leader."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.driver.utility import Preferences, risk_ahead
from sugiyama_ros.effects.effect import PERCEPTION, UTILITY, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def _perceive(seen: Seen, p: Array) -> tuple[float, float, float]:
    """Compute the gap and the leader's speed as weighted means over the two vehicles ahead.

    The gap to the second vehicle counts as half the sum of both gaps.
    """
    if math.isinf(seen.second_gap):
        return seen.gap, seen.speed, seen.leader_speed
    weight = p[0]
    gap = (1.0 - weight) * seen.gap + weight * 0.5 * (seen.gap + seen.second_gap)
    return gap, seen.speed, (1.0 - weight) * seen.leader_speed + weight * seen.second_speed


@kernel(vectorised=True)
def _component(seen: Seen, action: float, period: float, horizon: int, p: Array, driver: Preferences) -> float:
    """Compute the risk of the second vehicle ahead, at the share ``p[1]`` of the sum of both gaps."""
    if math.isinf(seen.second_gap):
        return 0.0
    gap = float(p[1]) * (seen.gap + seen.second_gap)
    return float(p[0] * driver[5] * risk_ahead(gap, seen.speed, seen.second_speed, action, period, horizon, driver))


_UTILITY = Effect(
    name="second_leader_utility",
    stage=UTILITY,
    title="fear of the second vehicle ahead",
    summary="a component of the utility: the risk of the second vehicle ahead",
    term="utility + weight risk(share (gap + gap_2), v_2)",
    source="the paper's phi2, for the second vehicle ahead",
    parameters=(
        Parameter("weight", "w_2", "1", 0.0, 0.0, 10.0, "weight beside the risk of the leader"),
        Parameter("share", "s_2", "1", 0.0, 0.2, 1.0, "share of the sum of both gaps that counts as the gap"),
    ),
    starts=at({"weight": 0.01, "share": 0.5}, {"weight": 0.1, "share": 0.5}, {"weight": 0.1, "share": 0.9}),
    function=_component,
    reach=2,
)
EFFECT = Effect(
    name="second_leader",
    stage=PERCEPTION,
    title="look past the leader",
    summary="drivers also react to the second vehicle ahead",
    term="gap, v_lead -> (1 - weight) (gap, v_lead) + weight ((gap + gap_2) / 2, v_2)",
    source="Lenz, Wagner and Sollacher, Eur. Phys. J. B 7 (1999) 331",
    parameters=(Parameter("weight", "w_2", "1", 0.0, 0.0, 1.0, "share of attention for the second vehicle ahead"),),
    starts=at({"weight": 0.1}, {"weight": 0.4}),
    function=_perceive,
    reach=2,
    bank={"weight": 0.15},
    benchmark=({"weight": 0.28}, {"weight": 0.09}),
    forms=(_UTILITY,),
)
