"""Drivers slow down for curves, so that the lateral acceleration stays comfortable."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import CURVES, PREFERENCE, Effect, Extent, Seen, Values
from sugiyama_ros.jit import kernel


@kernel
def _prefer(v_star: float, kappa_v: float, seen: Seen, p: Array) -> tuple[float, float]:
    """Limit the desired speed [m/s] to the speed at which the lateral acceleration is at its limit."""
    if seen.curvature * v_star * v_star > p[0]:
        return math.sqrt(p[0] / seen.curvature), kappa_v
    return v_star, kappa_v


def _starts(recording: Extent) -> tuple[Values, ...]:
    """Search only where there are curves."""
    return ({"lateral": 1.5}, {"lateral": 3.0}) if recording.has_curves else ()


EFFECT = Effect(
    name="curve_speed",
    stage=PREFERENCE,
    title="slower in curves",
    summary="the desired speed is limited by the lateral acceleration in curves",
    term="v* -> min(v*, sqrt(lateral / |curvature|))",
    source="Reymond, Kemeny, Droulez and Berthoz, Human Factors 43 (2001) 483",
    parameters=(Parameter("lateral", "a_lat", "m/s^2", 0.0, 0.2, 10.0, "lateral acceleration; 0 for no limit"),),
    needs=(CURVES,),
    starts=_starts,
    is_limit=True,
    function=_prefer,
)
