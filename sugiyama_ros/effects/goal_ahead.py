"""A driver who wants to leave the road, or whose lane ends, slows down before the place."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PREFERENCE, Effect, Seen
from sugiyama_ros.jit import kernel


@kernel
def _prefer(v_star: float, kappa_v: float, seen: Seen, p: Array) -> tuple[float, float]:
    """Limit the desired speed [m/s] to the speed from which the wanted speed at the place is reached comfortably."""
    way = p[1] - seen.position
    if way < 0.0:
        return v_star, kappa_v
    # the driver model needs a desired speed above 0
    return min(v_star, math.sqrt(max(p[2] * p[2] + 2.0 * p[0] * way, 0.25))), kappa_v


EFFECT = Effect(
    name="goal_ahead",
    stage=PREFERENCE,
    title="goal ahead",
    summary="the driver slows down for an exit or the end of the lane",
    term="v* -> min(v*, sqrt(speed^2 + 2 deceleration (place - x))) before the place",
    source="paper, section 7: intentions that are not realised cannot be observed; the form is this package's",
    parameters=(
        Parameter("deceleration", "b", "m/s^2", 0.0, 0.0, 10.0, "comfortable deceleration before the place"),
        Parameter("place", "x_g", "m", 0.0, -1e6, 1e6, "position of the exit or of the end of the lane", "place"),
        Parameter("speed", "v_g", "m/s", 0.0, 0.0, 80.0, "wanted speed at the place; 0 where the lane ends"),
    ),
    function=_prefer,
)
