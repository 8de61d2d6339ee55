"""Drivers keep up with the car ahead: its speed attracts them, besides their own desired speed."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.driver.utility import FAR
from sugiyama_ros.effects.effect import UTILITY, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel(vectorised=True)
def _component(seen: Seen, action: float, period: float, horizon: int, p: Array) -> float:
    """Compute the cost of a speed at the end of the look-ahead that is not the leader's, in units of 4 m/s."""
    off = seen.speed + horizon * period * action - seen.leader_speed
    return float(-p[0] * math.exp(-min(seen.gap, FAR) / p[1]) * off * off / 16.0)


EFFECT = Effect(
    name="keeping_up",
    stage=UTILITY,
    title="keeping up with the car ahead",
    summary="a component of the utility: -w (v after the look-ahead - v of the leader)²/16, less the larger the gap",
    term="utility - weight exp(-gap / range) (v after the look-ahead - v_leader)²/16",
    source="the response to the leader's speed of Helly (1959) and of Jiang, Wu and Zhu, Phys. Rev. E 64 (2001) 017101",
    parameters=(
        Parameter("weight", "w_k", "1", 0.0, 0.0, 100.0, "weight beside the reward of the desired speed"),
        Parameter("range", "R", "m", 0.0, 1.0, 1000.0, "gap at which the attraction is 1/e"),
    ),
    starts=at({"weight": 0.01, "range": 50.0}, {"weight": 0.1, "range": 50.0}),
    function=_component,
    fixed=("range",),
)
