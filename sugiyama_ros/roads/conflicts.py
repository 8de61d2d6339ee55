"""Where lanes cross or merge, out of their middle lines, and who yields there."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.roads.network import Conflict, Lanelet, Network

#: Middle lines that are nearer than this [m] leave no room for two vehicles: a car is about 2 m wide.
CLEARANCE_M = 2.5
# The same as a part of the width of narrow lanes: vehicles pass each other on lanes side by side, however narrow.
_OF_WIDTH = 0.8
# Way [m] between the points of a middle line at which it is compared with others.
_STEP_M = 0.5
# Pieces of a line that are compared with others at a time.
_PIECES = 64
# An area that begins this near [m] to the start of a lane begins there.
_AT_END_M = 1e-6


class _Sampled(NamedTuple):
    """A middle line: places (K,) [m] on it, and points (K, 2) [m] there."""

    s: Array
    point: Array


class _Area(NamedTuple):
    """Where two lanes are near: first and last place [m] on each."""

    enter: tuple[float, float]
    leave: tuple[float, float]


# Areas of two lanes, by their numbers.
_Areas: TypeAlias = dict[tuple[int, int], list[_Area]]


def conflicts_of_geometry(
    lanes: Sequence[Lanelet],
    priority: Mapping[str, float] | None = None,
    stop_m: Mapping[str, float] | None = None,
) -> tuple[Conflict, ...]:
    """Find where lanes cross or merge.

    Two lanes meet where their middle lines are nearer than 2.5 m, or than 0.8 times their width if they are narrow.
    Lanes that follow one another, that lie side by side, or that part from each other do not meet.

    Parameters
    ----------
    lanes : sequence of Lanelet
        The lanes.
    priority : mapping of str to float, optional
        Priority of lanes by name, 0 for others. Drivers on a lane yield to those on a lane of a higher priority; of
        two lanes with the same priority, none yields by rule.
    stop_m : mapping of str to float, optional
        Place [m] on lanes by name where drivers wait; without it, they wait where the two lanes begin to be near.

    Returns
    -------
    tuple of Conflict
        Two for each part that two lanes share, one for each lane.

    Examples
    --------
    >>> import numpy as np
    >>> from sugiyama_ros.roads.conflicts import conflicts_of_geometry
    >>> from sugiyama_ros.roads.network import Lanelet
    >>> way, zero = np.array([-20.0, 20.0]), np.zeros(2)
    >>> found = conflicts_of_geometry([Lanelet("east", way, zero), Lanelet("north", zero, way)], {"east": 1.0})
    >>> [(one.lane, one.enter_m, one.leave_m, one.yields) for one in found]
    [('east', 17.5, 22.5, False), ('north', 17.5, 22.5, True)]
    """
    priority, stop_m = priority or {}, stop_m or {}
    network = Network(tuple(lanes))
    areas = _areas(network)
    _without_forks(areas, network)
    found = []
    for pair, there in areas.items():
        for area in there:
            for a, b in ((0, 1), (1, 0)):
                lane, other = lanes[pair[a]], lanes[pair[b]]
                yields = priority.get(lane.name, 0.0) < priority.get(other.name, 0.0)
                stop = min(stop_m.get(lane.name, np.inf), area.enter[a])
                places = (stop, area.enter[a], area.leave[a], area.enter[b], area.leave[b])
                found.append(Conflict(lane.name, other.name, *places, yields))
    return tuple(found)


def _areas(network: Network) -> _Areas:
    """Where each two lanes are near, that are not side by side."""
    sampled = [_sampled(lane) for lane in network.lanes]
    low = np.array([one.point.min(axis=0) for one in sampled]) - 0.5 * CLEARANCE_M
    high = np.array([one.point.max(axis=0) for one in sampled]) + 0.5 * CLEARANCE_M
    areas: _Areas = {}
    for i, lane in enumerate(network.lanes):
        overlap = ((low[i] <= high[i + 1 :]) & (low[i + 1 :] <= high[i])).all(axis=1)
        for j in (i + 1 + np.flatnonzero(overlap)).tolist():
            other = network.lanes[j]
            if other.name not in (lane.left, lane.right) and lane.name not in (other.left, other.right):
                clearance = min(CLEARANCE_M, 0.5 * _OF_WIDTH * (lane.width_m + other.width_m))
                areas[i, j] = [*_near(sampled[i], sampled[j], clearance)]
    return areas


def _sampled(lane: Lanelet) -> _Sampled:
    s = np.linspace(0.0, lane.length_m, int(np.ceil(lane.length_m / _STEP_M)) + 1, dtype=np.float64)
    return _Sampled(s, np.stack(lane.line.at(s, np.zeros_like(s)), axis=1))


def _near(one: _Sampled, other: _Sampled, clearance: float) -> Iterator[_Area]:
    """The parts in which two middle lines are near."""
    distance, place = _distance(one.point, other)
    back, _ = _distance(other.point, one)
    near_other = back < clearance
    for first, last in _runs(distance < clearance):
        on = place[first : last + 1]
        # samples of the other line at or around the places that this one is near to
        beside = near_other & (other.s > on.min() - clearance) & (other.s < on.max() + clearance)
        if not beside.any():
            continue
        its_first, its_last = np.flatnonzero(beside)[[0, -1]].tolist()
        ends = [
            tuple(_crossed(s, far, k, step, clearance) for k, step in zip(run, (-1, 1), strict=True))
            for s, far, run in ((one.s, distance, (first, last)), (other.s, back, (its_first, its_last)))
        ]
        if all(begin < end for begin, end in ends):
            yield _Area(*zip(*ends, strict=True))


def _distance(point: Array, line: _Sampled) -> tuple[Array, Array]:
    """Distance (K,) [m] of points to a line, infinite where it is large, and the place [m] on the line."""
    distance, place = np.full(len(point), np.inf), np.full(len(point), np.nan)
    for first in range(0, len(line.s) - 1, _PIECES):
        part = slice(first, first + _PIECES + 1)
        corner, s = line.point[part], line.s[part]
        low, high = corner.min(axis=0) - 2.0 * CLEARANCE_M, corner.max(axis=0) + 2.0 * CLEARANCE_M
        rows = np.flatnonzero(((point >= low) & (point <= high)).all(axis=1))
        way = np.diff(corner, axis=0)
        to = point[rows, None, :] - corner[:-1]
        along = np.clip((to * way).sum(axis=2) / (way**2).sum(axis=1), 0.0, 1.0)
        far = np.hypot(*np.moveaxis(to - along[:, :, None] * way, 2, 0))
        k, best = np.arange(len(rows)), far.argmin(axis=1)
        nearer = far[k, best] < distance[rows]
        rows, k, best = rows[nearer], k[nearer], best[nearer]
        distance[rows], place[rows] = far[k, best], s[best] + along[k, best] * np.diff(s)[best]
    return distance, place


def _runs(mask: Mask) -> Iterator[tuple[int, int]]:
    """First and last index of each run of true entries."""
    edge = np.diff(np.concatenate(([0], mask.astype(np.int64), [0])))
    yield from zip(np.flatnonzero(edge == 1).tolist(), (np.flatnonzero(edge == -1) - 1).tolist(), strict=True)


def _crossed(s: Array, distance: Array, k: int, step: int, clearance: float) -> float:
    """Place [m] between sample k and the next one outside at which the distance is the clearance."""
    out = k + step
    if not (0 <= out < len(s) and clearance <= distance[out] < np.inf):
        return float(s[k])
    part = (clearance - distance[k]) / (distance[out] - distance[k])
    return float(s[k] + part * (s[out] - s[k]))


def _without_forks(areas: _Areas, network: Network) -> None:
    """Take areas away in which two lanes follow one another or part from each other.

    A lane that follows within such an area goes on with it: its start is where the area with the lane before ends.
    """
    parting: set[tuple[int, int, int]] = set()

    def parts(area: _Area, i: int, j: int) -> bool:
        return _begins(area, i, j, network) or _goes_on(area, i, j, areas, parting, network)

    size = -1
    while size != len(parting):
        size = len(parting)
        for (i, j), there in areas.items():
            parting |= {(i, j, k) for k, area in enumerate(there) if parts(area, i, j) or parts(_turned(area), j, i)}
    for (i, j), there in areas.items():
        areas[i, j] = [area for k, area in enumerate(there) if (i, j, k) not in parting]


def _turned(area: _Area) -> _Area:
    return _Area(area.enter[::-1], area.leave[::-1])


def _begins(area: _Area, i: int, j: int, network: Network) -> bool:
    """Whether lane j begins in an area as the one that follows lane i, or as lane i does after the same lane."""
    follows = j in network.after[i] and area.leave[0] >= network.lanes[i].length_m - _AT_END_M
    forks = area.enter[0] <= _AT_END_M and not set(network.before[i]).isdisjoint(network.before[j])
    return area.enter[1] <= _AT_END_M and (follows or forks)


def _goes_on(area: _Area, i: int, j: int, areas: _Areas, parting: set[tuple[int, int, int]], network: Network) -> bool:
    """Whether an area at the start of lane j goes on with one of lane i and of a lane that j follows."""
    if area.enter[1] > _AT_END_M:
        return False
    for before in network.before[j]:
        pair = (min(i, before), max(i, before))
        for k, last in enumerate(areas.get(pair, ())):
            own, its = (0, 1) if pair[0] == i else (1, 0)
            ends = last.leave[its] >= network.lanes[before].length_m - _AT_END_M
            if (*pair, k) in parting and ends and last.leave[own] >= area.enter[0] - CLEARANCE_M:
                return True
    return False
