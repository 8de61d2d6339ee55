"""Drivers judge their speed over the whole look-ahead, not after one period."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.driver.utility import Preferences, forward_reward
from sugiyama_ros.effects.effect import UTILITY, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel(vectorised=True)
def _component(seen: Seen, action: float, period: float, horizon: int, p: Array, driver: Preferences) -> float:
    """Compute the mean reward of the speed over the look-ahead, less the reward after one period."""
    total = first = forward_reward(seen.speed + period * action, driver[0], driver[2])
    for tau in range(2, horizon + 1):
        total += forward_reward(seen.speed + tau * period * action, driver[0], driver[2])
    return float(p[0] * (total / horizon - first))


EFFECT = Effect(
    name="averaged_reward",
    stage=UTILITY,
    title="speed judged over the look-ahead",
    summary="a share of the reward of the desired speed is its mean over the look-ahead",
    term="utility + share (mean reward of the speed over the look-ahead - reward after one period)",
    source="paper, section 3.2: the average of a component over the look-ahead",
    parameters=(Parameter("share", "w_a", "1", 0.0, 0.0, 1.0, "share of the mean over the look-ahead"),),
    starts=at({"share": 0.2}, {"share": 0.8}),
    function=_component,
)
