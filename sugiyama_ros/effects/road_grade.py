"""A hill on part of the road."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ENVIRONMENT, Effect, Seen
from sugiyama_ros.effects.shared import PLACE, around, bump
from sugiyama_ros.jit import kernel

# Acceleration of gravity [m/s^2].
_GRAVITY = 9.81


@kernel
def _push(seen: Seen, p: Array) -> float:
    """Compute -g times the slope [m/s^2]; the slope rises and falls smoothly along the road."""
    return float(-_GRAVITY * p[0] * bump(seen, p[1], p[2]))


EFFECT = Effect(
    name="road_grade",
    stage=ENVIRONMENT,
    title="hill",
    summary="gravity on a slope along part of the road",
    term="- g grade bump(x - centre, width)",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 21.2",
    parameters=(Parameter("grade", "s", "1", 0.0, -0.3, 0.3, "slope in the middle, positive uphill"), *PLACE),
    starts=around({"grade": 0.01}, {"grade": 0.03}),
    function=_push,
    bank={"grade": 0.02},
    benchmark=({"grade": 0.05, "width": 80.0}, {"grade": 0.02, "width": 80.0}),
)
