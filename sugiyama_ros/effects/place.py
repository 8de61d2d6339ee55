"""A part of the road, for effects that act at a place."""

import math
from collections.abc import Callable

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import RecordingExtent, Seen, Values
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
    """Compute a raised cosine: 1 in the middle, and smoothly down to 0 at half a width from the middle.

    Parameters
    ----------
    seen : Seen
        Where the vehicle is.
    centre, width : float
        Middle and length [m] of the part of the road.

    Returns
    -------
    float
        From 0 to 1.
    """
    off = seen.position - centre
    if seen.circumference > 0.0:
        off -= seen.circumference * math.floor(off / seen.circumference + 0.5)
    if abs(off) >= 0.5 * width:
        return 0.0
    return 0.5 + 0.5 * math.cos(2.0 * math.pi * off / width)


def around(strength: Values) -> Callable[[RecordingExtent], tuple[Values, ...]]:
    """Make the starts of a search at places all along the road.

    Parameters
    ----------
    strength : mapping of str to float
        Values of the other parameters of the effect.

    Returns
    -------
    callable
        RecordingExtent -> starts, for ``Effect.starts``.
    """

    def starts(recording: RecordingExtent) -> tuple[Values, ...]:
        first = 0.0 if recording.circumference_m else recording.first_m
        extent = recording.circumference_m or recording.last_m - recording.first_m
        return tuple(
            {**strength, "centre": first + (k + 0.5) / _CENTRES * extent, "width": share * extent}
            for k in range(_CENTRES)
            for share in _WIDTHS
        )

    return starts
