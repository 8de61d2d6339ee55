"""Drivers dislike changes of the acceleration."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import UTILITY, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel(vectorised=True)
def _component(seen: Seen, action: float, period: float, horizon: int, p: Array) -> float:
    """Compute the cost of an action that differs from the acceleration of the last period, in units of 4 m/s^2."""
    change = action - seen.acceleration
    return float(-p[0] * change * change / 16.0)


EFFECT = Effect(
    name="roughness",
    stage=UTILITY,
    title="dislike of a rough ride",
    summary="a component of the utility: -w (a - a of the last period)²/16",
    term="utility - weight (a - a of the last period)²/16",
    source="Naumann, Sun, Zhan and Tomizuka, ICRA (2020), as the paper proposes in section 3.2",
    parameters=(Parameter("weight", "w_r", "1", 0.0, 0.0, 100.0, "weight beside the reward of the desired speed"),),
    starts=at({"weight": 0.01}, {"weight": 0.1}),
    function=_component,
    sees_accelerations=True,
)
