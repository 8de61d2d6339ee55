"""The routes of vehicles through a network, out of where they were seen.

A vehicle is on a lane that is near and that points the way the vehicle does. Where several do, as on a crossing, the
vehicle's whole way decides: the sum of the squared distances from the lanes is least, and a step to a lane that does
not follow has a cost, too.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.roads.network import Network, Path

#: Angle [rad] between a vehicle on a lane and the lane, at most.
_WITHIN = 0.25 * np.pi
# Distance [m] from the middle of a lane beyond which a vehicle has left it: the width of a lane.
_ON_LANE_M = 3.5
#: What a change to a lane costs: the square of a distance [m] of half a lane.
CHANGE = 1.75**2
# What a step to a lane costs that neither follows nor lies beside: nobody does it just to be nearer to a middle line.
_ELSEWHERE = 10.0**2
# Lanes that a vehicle may pass between two samples.
_PASSED = 3
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
    """A place on a lane: number of the lane, way from its start, to the left, and distance [m]."""

    lane: int
    along: float
    across: float
    distance: float


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
            near.setdefault(int(rows[k]), []).append(Place(lane, float(along[k]), float(across[k]), float(best[k])))
    return near


class Ways:
    """Ways through a network: which lanes a vehicle may come to between two samples, and which way costs least.

    network: the network; elsewhere: what a step to a lane costs that neither follows nor lies beside; passed: for each
    lane the lane itself and those that a vehicle may come to.
    """

    def __init__(self, network: Network, elsewhere: float = _ELSEWHERE) -> None:
        self.after, self._elsewhere = network.after, elsewhere
        self.passed = [self._reached(k) for k in range(len(self.after))]
        beside = [[network.number(name) for name in (one.left, one.right) if name] for one in network.lanes]
        self._beside = [frozenset[int]().union(*(self.passed[k] for k in ones)) for ones in beside]

    def _reached(self, first: int) -> frozenset[int]:
        reached, edge = {first}, {first}
        for _ in range(_PASSED):
            edge = {after for one in edge for after in self.after[one]} - reached
            reached |= edge
        return frozenset(reached)

    def least(self, near: Sequence[Sequence[Place]]) -> list[Place]:
        """The places of a vehicle at T times, out of those near at each, at least one: the way with the least cost."""
        costs = [place.distance**2 for place in near[0]]
        came: list[list[int]] = [[0] * len(costs)]
        for before, places in pairwise(near):
            last = [
                (cost, self.passed[one.lane], self._beside[one.lane]) for cost, one in zip(costs, before, strict=True)
            ]
            table = [
                [
                    cost if lane in passed else cost + (CHANGE if lane in beside else self._elsewhere)
                    for cost, passed, beside in last
                ]
                for lane in (place.lane for place in places)
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
        """Lanes after the first one up to the last one, which is among those that a vehicle may come to."""
        ways = [[first]]
        while ways:
            way = ways.pop(0)
            if last in self.after[way[-1]]:
                return [*way[1:], last]
            if len(way) < _PASSED:
                ways += [[*way, one] for one in self.after[way[-1]]]
        return []

    def onward(self, route: Sequence[int]) -> list[int]:
        """The lanes that a vehicle comes to, from the first of its route on, as far as somebody knows."""
        way = [route[0]]
        for one in route[1:]:
            new = self.between(way[-1], one) if one in self.passed[way[-1]] else []
            if not new:
                break
            way += new
        else:
            while len(after := self.after[way[-1]]) == 1 and after[0] not in way:
                way += after
        if len(way) > 1 and way[-1] in way[:-1]:
            way.pop()
        return way


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


def routes_of(
    network: Network, vehicle: Ints, time_s: Array, x_m: Array, y_m: Array, heading: Array | None = None
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

    Returns
    -------
    Routes
        The route of each row, and its place on it. A vehicle has another route from where it leaves its lane for one
        that does not follow, and from where it comes to a lane for the second time.

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
    near, ways = places_near(network, seen, _ON_LANE_M), Ways(network)
    paths: dict[tuple[int, ...], Path] = {}
    route, lane = np.full(len(x_m), -1, dtype=np.int64), np.full(len(x_m), -1, dtype=np.int64)
    s_m, d_m = np.full(len(x_m), np.nan), np.full(len(x_m), np.nan)
    cuts = 0
    for rows in seen.of_vehicles():
        for k, (lanes, here, on) in enumerate(_parts(ways, rows, near)):
            if lanes not in paths:
                paths[lanes] = Path(network, lanes)
            s, d, own = _along(paths[lanes], seen.place_m[here], on)
            kept = np.abs(d) < _ON_LANE_M
            here = here[kept]
            s_m[here], d_m[here], lane[here], route[here] = s[kept], d[kept], own[kept], list(paths).index(lanes)
            cuts += k > 0
    off = int((route < 0).sum())
    notes = (
        f"{off} rows are not within {_ON_LANE_M:g} m of a lane that points their way; they have no route" * (off > 0),
        f"{cuts} routes begin where a vehicle leaves its lane for one that does not follow, or comes back" * (cuts > 0),
    )
    return Routes(tuple(paths.values()), route, lane, s_m, d_m, tuple(note for note in notes if note))


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

    A vehicle that comes back to one of the last lanes of its route has not left it: it stands between the two.
    """
    route: list[int] = []
    first = 0
    for k, place in enumerate(places):
        if place.lane in route[-1 - _PASSED :]:
            del route[route.index(place.lane) + 1 :]
            continue
        onward = ways.between(route[-1], place.lane) if route and place.lane in ways.passed[route[-1]] else []
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
