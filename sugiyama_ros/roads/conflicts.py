"""Where lanes cross or merge, out of their middle lines, and who yields there."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.jit import kernel
from sugiyama_ros.roads.network import Conflict, Lanelet, Network

#: Middle lines that are nearer than this [m] leave no room for two vehicles: a car is about 2 m wide.
CLEARANCE_M = 2.5
# The same as a part of the width of narrow lanes: vehicles pass each other on lanes side by side, however narrow.
_OF_WIDTH = 0.8
# Way [m] between the points of a middle line at which it is compared with others.
_STEP_M = 0.5
# Points are not compared with pieces of a line that are farther away [m]; a lane may also be too short to part two.
_FAR_M = 2.0 * CLEARANCE_M
# Length [m] of all lanes together, at most.
_LONGEST_M = 1e6
# Squares [m] in which lines are looked for that may be near; wider than the clearance.
_SQUARE_M = 5.0
# Pairs of lanes that may be near: on average of each lane, and beside. A large crossing has about 15 for each lane.
_MOST_EACH, _MOST_BESIDE = 15, 2_000
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
    """Where each two lanes are near, that are not side by side. Raises InputError for a road that is too large."""
    if (length_m := sum(lane.length_m for lane in network.lanes)) > _LONGEST_M:
        raise InputError(
            f"lanes: {length_m / 1e3:.0f} km in all are more than {_LONGEST_M / 1e3:.0f} km; cut out a part"
        )
    sampled = [_sampled(lane) for lane in network.lanes]
    areas: _Areas = {}
    for i, j in _may_be_near(sampled, network):
        lane, other = network.lanes[i], network.lanes[j]
        if other.name not in (lane.left, lane.right) and lane.name not in (other.left, other.right):
            clearance = min(CLEARANCE_M, 0.5 * _OF_WIDTH * (lane.width_m + other.width_m))
            areas[i, j] = [*_near(sampled[i], sampled[j], clearance)]
    return areas


def _may_be_near(sampled: Sequence[_Sampled], network: Network) -> list[tuple[int, int]]:
    """Numbers of each two lanes that are in the same square of the plane. Raises InputError for too many of them."""
    square, lane = _squares(sampled)
    most, found = _MOST_EACH * len(sampled) + _MOST_BESIDE, np.zeros(0, dtype=np.int64)
    for step in range(1, len(lane)):
        same = square[step:] == square[:-step]
        if not same.any():
            break
        found = np.unique(np.concatenate((found, (lane[:-step] * len(sampled) + lane[step:])[same])))
        if len(found) > most:
            name = network.lanes[int(lane[:-step][same][0])].name
            raise InputError(
                f"lane {name}: {step + 1} or more lanes lie over one another, and more than {most} pairs of the"
                f" {len(sampled)} lanes meet; give a road whose lanes lie beside one another"
            )
    return [divmod(pair, len(sampled)) for pair in found.tolist()]


def _squares(sampled: Sequence[_Sampled]) -> tuple[Ints, Ints]:
    """Number of each square in or beside which a lane has points, and of the lane (R,), sorted; each pair once."""
    point = np.concatenate([one.point for one in sampled])
    lane = np.repeat(np.arange(len(sampled)), [len(one.s) for one in sampled])
    # points that are near have their middle in a square of both
    reach = 0.5 * CLEARANCE_M + _STEP_M
    corner = np.concatenate([point + np.array([x, y]) for x in (-reach, reach) for y in (-reach, reach)])
    cell = np.floor((corner - point.min(axis=0)) / _SQUARE_M).astype(np.int64)
    _, square = np.unique(cell[:, 0] * (cell[:, 1].max() + 2) + cell[:, 1], return_inverse=True)
    both = np.unique(square.astype(np.int64) * len(sampled) + np.tile(lane, 4))
    return both // len(sampled), both % len(sampled)


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
    _compare(point, line.point, line.s, distance, place)
    return distance, place


@kernel(allocates=False)
def _compare(point: Array, corner: Array, s: Array, distance: Array, place: Array) -> None:
    """Fill in the distance (K,) [m] of points to the nearest piece of a line, and the place [m] there."""
    piece = s[1] - s[0]
    for k in range(len(point)):
        x, y = point[k, 0], point[k, 1]
        m = 0
        while m < len(corner) - 1:
            to_x, to_y = x - corner[m, 0], y - corner[m, 1]
            beyond = np.hypot(to_x, to_y) - _FAR_M
            if beyond > 0.0:
                # no piece is longer, so none before this one is nearer
                m += max(int(beyond / piece), 1)
                continue
            way_x, way_y = corner[m + 1, 0] - corner[m, 0], corner[m + 1, 1] - corner[m, 1]
            along = min(max((to_x * way_x + to_y * way_y) / (way_x * way_x + way_y * way_y), 0.0), 1.0)
            far = np.hypot(to_x - along * way_x, to_y - along * way_y)
            if far < distance[k]:
                distance[k], place[k] = far, s[m] + along * (s[m + 1] - s[m])
            m += 1


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
    follows = j in _soon_after(i, network) and area.leave[0] >= network.lanes[i].length_m - _AT_END_M
    forks = area.enter[0] <= _AT_END_M and not set(network.before[i]).isdisjoint(network.before[j])
    return area.enter[1] <= _AT_END_M and (follows or forks)


def _soon_after(i: int, network: Network) -> set[int]:
    """Lanes that follow a lane, also after others that are shorter than two lanes are apart."""
    found, waiting = set[int](), [i]
    while waiting:
        new = set(network.after[waiting.pop()]) - found
        found |= new
        waiting += [k for k in new if network.lanes[k].length_m < _FAR_M]
    return found


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
