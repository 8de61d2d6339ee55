"""What a filter takes in of a sample: the driver, the vehicles ahead, and the vehicle behind."""

from collections.abc import Sequence
from math import nan

from sugiyama_ros.filters.online import NOBODY
from sugiyama_ros.nodes.base.cdr_messages import Sample


def sight(
    sample: Sample, vehicle: int, chain: Sequence[int]
) -> tuple[list[float], list[float], tuple[float, int, float]]:
    """Find positions [m] and lengths [m] of a chain of vehicles, and the vehicle behind the first one.

    Returns position_m, length_m: naN and 0 for a vehicle that is not in the sample; behind: position [m], number and
    length [m] of the vehicle behind, as ``OnlineFilter.step`` takes them.
    """
    places = [sample.place.get(v) for v in chain]
    position = [nan if p is None else sample.position_m[p] for p in places]
    length = [0.0 if p is None else sample.known_length_m(p) for p in places]
    rear = sample.behind(vehicle)
    if rear < 0:
        return position, length, NOBODY
    p = sample.place[rear]
    return position, length, (sample.position_m[p], rear, sample.known_length_m(p))
