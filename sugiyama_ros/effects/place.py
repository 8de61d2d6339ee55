"""A part of the road: what road_grade and slow_patch have in common."""

import math
from collections.abc import Callable

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import Recording, Seen, Values
from sugiyama_ros.jit import kernel

#: Where the part of the road is.
PLACE = (
    Parameter("centre", "x_c", "m", 0.0, -1e6, 1e6, "position of its middle", "place"),
    Parameter("width", "w", "m", 0.0, 1.0, 1e5, "length of road from end to end"),
)
#: Places at which a search begins, and the widths it begins with as shares of the road.
_CENTRES, _WIDTHS = 12, (0.35,)


@kernel
def bump(seen: Seen, centre: float, width: float) -> float:
    """Raised cosine: 1 in the middle, falling smoothly to 0 half a width away."""
    off = seen.position - centre
    if seen.circumference > 0.0:
        off -= seen.circumference * math.floor(off / seen.circumference + 0.5)
    if abs(off) >= 0.5 * width:
        return 0.0
    return 0.5 + 0.5 * math.cos(2.0 * math.pi * off / width)


def around(strength: Values) -> Callable[[Recording], tuple[Values, ...]]:
    """Starts of a search at places all along the road."""

    def starts(recording: Recording) -> tuple[Values, ...]:
        first = 0.0 if recording.circumference_m else recording.first_m
        extent = recording.circumference_m or recording.last_m - recording.first_m
        return tuple(
            {**strength, "centre": first + (k + 0.5) / _CENTRES * extent, "width": share * extent}
            for k in range(_CENTRES)
            for share in _WIDTHS
        )

    return starts
