"""What several effects share: a part of the road, the risk of other vehicles, and a noise with outliers."""

import math
from collections.abc import Callable

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.driver.utility import Preferences, anticipate, collision_penalty, gap_and_scale, gap_scale
from sugiyama_ros.effects.effect import Extent, Seen, Values
from sugiyama_ros.jit import kernel

#: Parameters of the part of the road.
PLACE = (
    Parameter("centre", "x_c", "m", 0.0, -1e6, 1e6, "position of the middle of the part of the road", "place"),
    Parameter("width", "w", "m", 0.0, 1.0, 1e5, "length of the part of the road"),
)
# Number of centres, and widths as shares of the road, at which a search begins.
_CENTRES, _WIDTHS = 12, (0.35,)


@kernel
def bump(seen: Seen, centre: float, width: float) -> float:
    """Compute a raised cosine: 1 in the middle [m], and smoothly down to 0 at half a width [m] from the middle."""
    off = seen.position - centre
    if seen.circumference > 0.0:
        off -= seen.circumference * math.floor(off / seen.circumference + 0.5)
    if abs(off) >= 0.5 * width:
        return 0.0
    return 0.5 + 0.5 * math.cos(2.0 * math.pi * off / width)


def around(strength: Values) -> Callable[[Extent], tuple[Values, ...]]:
    """Make the starts of a search at places all along the road; strength: values of the other parameters."""

    def starts(recording: Extent) -> tuple[Values, ...]:
        first = 0.0 if recording.circumference_m else recording.first_m
        extent = recording.circumference_m or recording.last_m - recording.first_m
        return tuple(
            {**strength, "centre": first + (k + 0.5) / _CENTRES * extent, "width": share * extent}
            for k in range(_CENTRES)
            for share in _WIDTHS
        )

    return starts


@kernel(vectorised=True)
def risk_ahead(
    gap: float, speed: float, other_speed: float, action: float, period: float, horizon: int, driver: Preferences
) -> float:
    """Compute the largest risk, from 0 to 1, of a vehicle ahead in the look-ahead, as phi2 of the paper does."""
    near, wide = gap_and_scale(action, 1, gap, speed, other_speed, driver, period)
    for tau in range(2, horizon + 1):
        gap_then, wide_then = gap_and_scale(action, tau, gap, speed, other_speed, driver, period)
        if gap_then * wide < near * wide_then:
            near, wide = gap_then, wide_then
    return collision_penalty(near / wide)


@kernel(vectorised=True)
def risk_behind(
    gap: float, speed: float, other_speed: float, action: float, period: float, horizon: int, driver: Preferences
) -> float:
    """Compute the largest risk of a vehicle behind, which keeps its speed; arguments as for ``risk_ahead``."""
    near, wide = _gap_behind(action, 1, gap, speed, other_speed, period, driver)
    for tau in range(2, horizon + 1):
        gap_then, wide_then = _gap_behind(action, tau, gap, speed, other_speed, period, driver)
        if gap_then * wide < near * wide_then:
            near, wide = gap_then, wide_then
    return collision_penalty(near / wide)


@kernel(vectorised=True)
def _gap_behind(
    action: float, tau: int, gap: float, speed: float, other_speed: float, period: float, driver: Preferences
) -> tuple[float, float]:
    """Compute the gap [m] to the vehicle behind, and its scale [m], ``tau`` periods ahead."""
    gap_ahead, _ = anticipate(-action, tau, gap, other_speed, speed, period)
    return gap_ahead, gap_scale(other_speed, speed + tau * period * action, driver[3], driver[1], driver[4])


@kernel
def contaminated_normal(
    innovation: float, variance: float, noise_var: float, share: float, factor: float
) -> tuple[float, float, float]:
    """Weigh a sample from a mixture of good and bad measurements.

    variance, noise_var: variances [m^2] of the innovation and of the noise of a good measurement. Returns the
    probability that the sample is bad, the variance [m^2] of the innovation of a bad sample, and the log-likelihood of
    the sample.

    References
    ----------
    Tukey, in Contributions to Probability and Statistics (1960) 448.
    """
    wide = variance + (factor * factor - 1.0) * noise_var
    good = (1.0 - share) * math.exp(-0.5 * innovation * innovation / variance) / math.sqrt(variance)
    bad = share * math.exp(-0.5 * innovation * innovation / wide) / math.sqrt(wide) + 1e-300
    return bad / (good + bad), wide, math.log(good + bad)
