"""Drivers look past their leader."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PERCEPTION, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def perceive(seen: Seen, p: Array) -> tuple[float, float, float]:
    """Compute the gap and the leader's speed as weighted means over the two vehicles ahead.

    The gap to the second vehicle counts as half the sum of both gaps.
    """
    if math.isinf(seen.second_gap):
        return seen.gap, seen.speed, seen.leader_speed
    weight = p[0]
    gap = (1.0 - weight) * seen.gap + weight * 0.5 * (seen.gap + seen.second_gap)
    return gap, seen.speed, (1.0 - weight) * seen.leader_speed + weight * seen.second_speed


EFFECT = Effect(
    name="second_leader",
    stage=PERCEPTION,
    title="look past the leader",
    summary="drivers also react to the second vehicle ahead",
    source="Lenz, Wagner and Sollacher, Eur. Phys. J. B 7 (1999) 331",
    parameters=(Parameter("weight", "w_2", "1", 0.0, 0.0, 1.0, "share of attention for the second vehicle ahead"),),
    starts=at({"weight": 0.1}, {"weight": 0.4}),
    function=perceive,
    reach=2,
    bank={"weight": 0.15},
    benchmark=({"weight": 0.28}, {"weight": 0.09}),
)
