"""The routes of vehicles through a network, out of where they were seen.

A vehicle is on a lane that is near and that points the way the vehicle does. Where several do, as on a crossing, the
vehicle's whole way decides: the sum of the squared distances from the lanes is least, and a step to a lane that does
not follow has a cost, too.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.roads.network import Lanelet, Network, Path

#: Angle [rad] between a vehicle on a lane and the lane, at most.
_WITHIN = 0.25 * np.pi
# Distance [m] from the middle of a lane beyond which a vehicle has left it, however wide both are.
_ON_LANE_M = 3.5
#: What a change to a lane costs: the square of a distance [m] of half a lane.
CHANGE = 1.75**2
# What a step to a lane costs that neither follows nor lies beside: nobody does it just to be nearer to a middle line.
_ELSEWHERE = 10.0**2
# Way [m] along lanes, at most, that a vehicle makes between two samples; and how it compares with the straight way
# between the two places: the road may bend, and places near the ends of lanes are not exact.
_FARTHEST_M, _BENDS, _SLACK_M = 200.0, 1.5, 7.0
# Length [m] below which a lane that leads back is a place to turn round.
_TURN_M = 40.0
# Places that are put on a path at a time.
_MOST = 2_000
# Way [m] of a vehicle over which its heading is measured: far more than the errors of positions.
_MOVED_M = 3.0


class SeenRows(NamedTuple):
    """Rows of vehicles: number of the vehicle, time [s], place (R, 2) [m] and heading [rad], NaN where unknown."""

    vehicle: Ints
    time_s: Array
    place_m: Array
    heading: Array

    def of_vehicles(self) -> list[Ints]:
        """Rows of each vehicle, in the order of time."""
        order = np.lexsort((self.time_s, self.vehicle))
        return [*np.split(order, np.flatnonzero(np.diff(self.vehicle[order])) + 1)] if len(order) else []


class Place(NamedTuple):
    """A place on a lane: number of the lane, way from its start, to the left, and distance [m]; x, y: in the plane."""

    lane: int
    along: float
    across: float
    distance: float
    x: float
    y: float


def places_near(network: Network, seen: SeenRows, within_m: float) -> dict[int, list[Place]]:
    """The lanes that each row is near to, and whose direction it has."""
    near: dict[int, list[Place]] = {}
    for lane, one in enumerate(network.lanes):
        middle = np.stack((one.x_m, one.y_m), axis=1)
        low, high = middle.min(axis=0) - within_m, middle.max(axis=0) + within_m
        rows = np.flatnonzero(((seen.place_m >= low) & (seen.place_m <= high)).all(axis=1))
        best = np.full(len(rows), within_m)
        along, across, start = np.zeros(len(rows)), np.zeros(len(rows)), 0.0
        for begin, end in pairwise(middle):
            way = end - begin
            length = float(np.hypot(*way))
            to = seen.place_m[rows] - begin
            part = np.clip(to @ way / length, 0.0, length)
            distance = np.hypot(*(to - part[:, None] * way / length).T)
            turn = np.abs(np.angle(np.exp(1j * (seen.heading[rows] - np.arctan2(way[1], way[0])))))
            # a heading that is not known suits every direction
            closer = (distance < best) & ~(turn > _WITHIN)
            best[closer], along[closer] = distance[closer], start + part[closer]
            across[closer] = (way[0] * to[closer, 1] - way[1] * to[closer, 0]) / length
            start += length
        for k in np.flatnonzero(best < within_m).tolist():
            row = int(rows[k])
            place = Place(lane, float(along[k]), float(across[k]), float(best[k]), *seen.place_m[row].tolist())
            near.setdefault(row, []).append(place)
    return near


class Ways:
    """Ways through a network: which lanes a vehicle may come to between two samples, and which way costs least.

    network: the network; elsewhere: what a step to a lane costs that neither follows nor lies beside.
    """

    def __init__(self, network: Network, elsewhere: float = _ELSEWHERE) -> None:
        self.after, self._elsewhere = network.after, elsewhere
        self._length = [one.length_m for one in network.lanes]
        self._beside = [[network.number(name) for name in (one.left, one.right) if name] for one in network.lanes]
        # who comes to the end of a road may also leave it there, and not turn round
        self._turns = {k for k, one in enumerate(network.lanes) if _turns_round(one)}
        self._onto: dict[int, dict[int, tuple[float, int]]] = {}

    def _reached(self, first: int) -> dict[int, tuple[float, int]]:
        """The lanes behind a lane: the way [m] from its end to where each begins, and the lane before."""
        if first in self._onto:
            return self._onto[first]
        reached: dict[int, tuple[float, int]] = {}
        waiting = [(0.0, after, first) for after in self.after[first]]
        while waiting:
            way_m, lane, before = heappop(waiting)
            if lane in reached or lane == first:
                continue
            reached[lane] = way_m, before
            if (beyond_m := way_m + self._length[lane]) < _FARTHEST_M:
                for after in self.after[lane]:
                    heappush(waiting, (beyond_m, after, lane))
        self._onto[first] = reached
        return reached

    def _comes(self, first: int, before: Place, place: Place, reach_m: float) -> bool:
        """Whether a vehicle that was at ``before``, as if on lane ``first``, comes to a place by following lanes."""
        if first == place.lane:
            return True
        way_m, _ = self._reached(first).get(place.lane, (math.inf, -1))
        return max(self._length[first] - before.along, 0.0) + way_m + place.along <= reach_m

    def follows(self, before: Place, place: Place) -> bool:
        """Whether a vehicle comes from a place to the next one by following lanes."""
        return self._comes(before.lane, before, place, _reach_m(before, place))

    def _cost(self, before: Place, place: Place, reach_m: float) -> float:
        """What a step from a place to the next one costs."""
        if before.lane == place.lane or self._comes(before.lane, before, place, reach_m):
            return 0.0
        beside = any(self._comes(lane, before, place, reach_m) for lane in self._beside[before.lane])
        return CHANGE if beside else self._elsewhere

    def least(self, near: Sequence[Sequence[Place]]) -> list[Place]:
        """The places of a vehicle at T times, out of those near at each, at least one: the way with the least cost."""
        costs = [place.distance**2 for place in near[0]]
        came: list[list[int]] = [[0] * len(costs)]
        for before, places in pairwise(near):
            reach_m = _reach_m(before[0], places[0])
            table = [
                [cost + self._cost(one, place, reach_m) for cost, one in zip(costs, before, strict=True)]
                for place in places
            ]
            least = [min(row) for row in table]
            came.append([row.index(cost) for row, cost in zip(table, least, strict=True)])
            costs = [cost + place.distance**2 for cost, place in zip(least, places, strict=True)]
        found: list[Place] = []
        k = costs.index(min(costs))
        for places, back in zip(reversed(near), reversed(came), strict=True):
            found.append(places[k])
            k = back[k]
        return found[::-1]

    def between(self, first: int, last: int) -> list[int]:
        """Lanes after the first one up to the last one; none if they are too far apart, or do not follow."""
        reached, way = self._reached(first), [last]
        while way[-1] in reached:
            before = reached[way[-1]][1]
            if before == first:
                return way[::-1]
            way.append(before)
        return []

    def onward(self, route: Sequence[int]) -> list[int]:
        """The lanes that a vehicle comes to, from the first of its route on, as far as somebody knows."""
        way = [route[0]]
        for one in route[1:]:
            new = self.between(way[-1], one) if one != way[-1] else []
            if not new:
                break
            way += new
        else:
            while len(after := self.after[way[-1]]) == 1 and after[0] not in way and after[0] not in self._turns:
                way += after
        if len(way) > 1 and way[-1] in way[:-1]:
            way.pop()
        return way


def _turns_round(lane: Lanelet) -> bool:
    """Whether a lane leads back at once: by more than three quarters of a half turn."""
    begin, end = lane.line.heading(np.array([0.0, lane.length_m]))
    return lane.length_m < _TURN_M and bool(np.cos(end - begin) < np.cos(0.75 * np.pi))


def _reach_m(before: Place, place: Place) -> float:
    """How far [m] a vehicle may have come along lanes between two places."""
    return _BENDS * math.hypot(place.x - before.x, place.y - before.y) + _SLACK_M


@dataclass(frozen=True, eq=False)
class Routes:
    """Where vehicles were on a road.

    paths: the routes that vehicles take, each once; route: (R,), number of the path of each row, -1 for a row on no
    lane; lane: (R,), number of its lane, or -1; s_m, d_m: (R,), place [m] along the path and across it, positive to its
    left; notes: what was cut.
    """

    paths: tuple[Path, ...]
    route: Ints
    lane: Ints
    s_m: Array
    d_m: Array
    notes: tuple[str, ...]

    def onward(self, network: Network) -> list[Path]:
        """The same paths, each followed on while there is no fork: who is there is ahead, seen to go there or not."""
        ways = Ways(network)
        return [Path(network, ways.onward(path.lanes)) for path in self.paths]


def routes_of(
    network: Network,
    vehicle: Ints,
    time_s: Array,
    x_m: Array,
    y_m: Array,
    heading: Array | None = None,
    width_m: Array | None = None,
) -> Routes:
    """Find the routes of vehicles through a network.

    Parameters
    ----------
    network : Network
        The road.
    vehicle : numpy.ndarray of int, shape (R,)
        Number of the vehicle of each row; rows may stand in any order.
    time_s : numpy.ndarray, shape (R,)
        Times [s].
    x_m, y_m : numpy.ndarray, shape (R,)
        Places [m] in the plane.
    heading : numpy.ndarray, shape (R,), optional
        Headings [rad]; where they are missing or NaN, they are found out of how the vehicle moves.
    width_m : numpy.ndarray, shape (R,), optional
        Widths [m] of the vehicles; without them, it does not matter how wide lanes are.

    Returns
    -------
    Routes
        The route of each row, and its place on it; none for a vehicle wholly beside its lane. Another route begins
        where a vehicle leaves its lane for one that does not follow, or comes to a lane for the second time.

    Examples
    --------
    >>> import numpy as np
    >>> from sugiyama_ros.roads.examples import roundabout
    >>> from sugiyama_ros.roads.routes import routes_of
    >>> network = roundabout()
    >>> path = network.path(["in1", "ring1_2", "out2"])
    >>> x, y, _ = path.at(np.arange(0.0, path.length_m, 2.0))
    >>> found = routes_of(network, np.zeros(len(x), dtype=int), np.arange(len(x)) * 0.2, x, y)
    >>> [network.lanes[k].name for k in found.paths[0].lanes]
    ['in1', 'ring1_2', 'out2']
    """
    known = np.full(len(x_m), np.nan) if heading is None else np.asarray(heading, dtype=np.float64)
    seen = _with_headings(SeenRows(np.asarray(vehicle), time_s, np.stack((x_m, y_m), axis=1), known))
    return _routes(network, seen, np.full(len(x_m), np.inf) if width_m is None else 0.5 * width_m)


def _routes(network: Network, seen: SeenRows, reach_m: Array) -> Routes:
    """Routes of rows; reach_m: (R,), how far [m] vehicles reach to their sides."""
    near, ways = places_near(network, seen, _ON_LANE_M), Ways(network)
    lane_m = np.array([0.5 * one.width_m for one in network.lanes])
    paths: dict[tuple[int, ...], Path] = {}
    route, lane = np.full(len(reach_m), -1, dtype=np.int64), np.full(len(reach_m), -1, dtype=np.int64)
    s_m, d_m = np.full(len(reach_m), np.nan), np.full(len(reach_m), np.nan)
    cuts = 0
    for rows in seen.of_vehicles():
        for k, (lanes, here, on) in enumerate(_parts(ways, rows, near)):
            if lanes not in paths:
                paths[lanes] = Path(network, lanes)
            s, d, own = _along(paths[lanes], seen.place_m[here], on)
            kept = np.abs(d) < np.minimum(_ON_LANE_M, lane_m[own] + reach_m[here])
            here = here[kept]
            s_m[here], d_m[here], lane[here], route[here] = s[kept], d[kept], own[kept], list(paths).index(lanes)
            cuts += k > 0
    return Routes(tuple(paths.values()), route, lane, s_m, d_m, _notes(int((route < 0).sum()), cuts))


def _notes(off: int, cuts: int) -> tuple[str, ...]:
    """What to say of rows without a route, and of routes that were cut."""
    notes = (
        f"{off} rows are on no lane that points their way (within {_ON_LANE_M:g} m, and not wholly beside it);"
        " they have no route" * (off > 0),
        f"{cuts} routes begin where a vehicle leaves its lane for one that does not follow, or comes back" * (cuts > 0),
    )
    return tuple(note for note in notes if note)


def _with_headings(seen: SeenRows) -> SeenRows:
    """Rows with the headings of their motion where none is known."""
    heading = seen.heading.copy()
    if (missing := np.isnan(heading)).any():
        for rows in seen.of_vehicles():
            heading[rows] = np.where(missing[rows], _of_motion(seen.place_m[rows]), heading[rows])
    return seen._replace(heading=heading)


def _of_motion(place_m: Array) -> Array:
    """Headings [rad] of a vehicle, (T,), at places (T, 2) [m]; NaN if it hardly moves; one who stands keeps theirs."""
    anchors = [0]
    x, y = place_m.T.tolist()
    for k in range(len(x)):
        if (x[k] - x[anchors[-1]]) ** 2 + (y[k] - y[anchors[-1]]) ** 2 >= _MOVED_M**2:
            anchors.append(k)
    if len(anchors) < 2:
        return np.full(len(x), np.nan)
    way = np.diff(place_m[anchors], axis=0)
    piece = np.searchsorted(anchors, np.arange(len(x)), side="right") - 1
    return np.asarray(np.arctan2(way[:, 1], way[:, 0])[np.minimum(piece, len(way) - 1)])


def _parts(
    ways: Ways, rows: Ints, near: Mapping[int, Sequence[Place]]
) -> Iterator[tuple[tuple[int, ...], Ints, dict[int, Place]]]:
    """The routes of a vehicle, the rows of each, and the places of those rows that are on a lane."""
    on = np.array([k for k, row in enumerate(rows.tolist()) if row in near], dtype=np.int64)
    places = ways.least([near[row] for row in rows[on].tolist()]) if len(on) else []
    for lanes, part in _pieces(ways, places):
        first, last = on[part][[0, -1]].tolist()
        # between them are rows in which the heading may have been unlike that of the lane
        yield lanes, rows[first : last + 1], dict(zip((on[part] - first).tolist(), places[part], strict=True))


def _pieces(ways: Ways, places: Sequence[Place]) -> Iterator[tuple[tuple[int, ...], slice]]:
    """The routes of a vehicle, one after the other, and the places of each.

    A vehicle that comes back by a little to a lane of its route has not left it: it stands between the two.
    """
    route: list[int] = []
    first = 0
    for k, place in enumerate(places):
        if place.lane in route and (place.lane == route[-1] or ways.follows(place, places[k - 1])):
            del route[route.index(place.lane) + 1 :]
            continue
        onward = ways.between(route[-1], place.lane) if route and ways.follows(places[k - 1], place) else []
        if not onward or set(onward) & set(route):
            if route:
                yield tuple(route), slice(first, k)
            route, first, onward = [], k, [place.lane]
        route += onward
    if route:
        yield tuple(route), slice(first, len(places))


def _along(path: Path, place_m: Array, on: Mapping[int, Place]) -> tuple[Array, Array, Ints]:
    """Places [m] along a path and across it of points (N, 2) [m], and their lanes; of some points, these are known."""
    parts = np.array_split(place_m, len(place_m) // _MOST + 1)
    s, d = np.concatenate([path.project(*part.T) for part in parts], axis=1)
    lane = path.lane_at(s)
    for k, place in on.items():
        along = path.place_of(place.lane) + place.along
        lane[k] = place.lane if np.isfinite(along) else lane[k]
        # where a path comes near to itself, its nearest point may be of another lane
        if abs(s[k] - along) > 2.0 * _ON_LANE_M:
            s[k], d[k] = along, place.across
    return s, d, lane
