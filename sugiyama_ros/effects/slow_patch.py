"""All drivers want to drive slower (or faster) on part of the road."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PREFERENCE, Effect, Seen
from sugiyama_ros.effects.shared import PLACE, around, bump
from sugiyama_ros.jit import kernel


@kernel
def _prefer(v_star: float, kappa_v: float, seen: Seen, p: Array) -> tuple[float, float]:
    """Reduce the desired speed [m/s] by a share that is largest in the middle of the patch."""
    return v_star * max(1.0 - p[0] * bump(seen, p[1], p[2]), 0.05), kappa_v


EFFECT = Effect(
    name="slow_patch",
    stage=PREFERENCE,
    title="slower stretch of road",
    summary="a lower desired speed on part of the road",
    term="v* -> v* (1 - reduction bump(x - centre, width))",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 11.5 (flow-conserving bottlenecks)",
    parameters=(
        Parameter("reduction", "r", "1", 0.0, -1.0, 0.95, "share taken off v* in the middle of the patch"),
        *PLACE,
    ),
    starts=around({"reduction": 0.1}, {"reduction": 0.4}),
    function=_prefer,
    bank={"reduction": 0.05},
    benchmark=({"reduction": 0.07, "width": 80.0}, {"reduction": 0.03, "width": 80.0}),
    advice={"road_grade": "survey the road, or record standing starts all along the road"},
)
