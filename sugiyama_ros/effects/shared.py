"""What effects share with each other, or with filters: a part of the road, and a noise with outliers."""

import math
from collections.abc import Callable

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import Extent, Seen, Values
from sugiyama_ros.jit import kernel

#: Parameters of the part of the road.
PLACE = (
    Parameter("centre", "x_c", "m", 0.0, -1e6, 1e6, "position of the middle of the part of the road", "place"),
    Parameter("width", "w", "m", 0.0, 1.0, 1e5, "length of the part of the road"),
)
# Widths as shares of the road, and numbers of centres, at which a search begins: a wide and a narrow part.
_WIDE, _NARROW = (0.35, 12), (0.1, 24)


@kernel
def bump(seen: Seen, centre: float, width: float) -> float:
    """Compute a raised cosine: 1 in the middle [m], and smoothly down to 0 at half a width [m] from the middle."""
    off = seen.position - centre
    if seen.circumference > 0.0:
        off -= seen.circumference * math.floor(off / seen.circumference + 0.5)
    if abs(off) >= 0.5 * width:
        return 0.0
    return 0.5 + 0.5 * math.cos(2.0 * math.pi * off / width)


def around(weak: Values, strong: Values) -> Callable[[Extent], tuple[Values, ...]]:
    """Make the starts of a search at places all along the road.

    weak, strong: values of the other parameters on a wide and on a narrow part of the road.
    """

    def starts(recording: Extent) -> tuple[Values, ...]:
        first = 0.0 if recording.circumference_m else recording.first_m
        extent = recording.circumference_m or recording.last_m - recording.first_m
        return tuple(
            {**strength, "centre": first + (k + 0.5) / centres * extent, "width": share * extent}
            for strength, (share, centres) in ((weak, _WIDE), (strong, _NARROW))
            for k in range(centres)
        )

    return starts


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
