"""CommonRoad scenarios: vehicles in the plane, and lanelets that say where the lanes are.

A vehicle is on a lanelet that is near and that points the way the vehicle does. Where several do, as behind a fork, the
vehicle's whole way decides. Positions count along the lanelets that follow one another; lanelets side by side begin at
the same position. The vehicle ahead is the next one on the way that the vehicle goes. It is unknown beyond a fork that
the vehicle has not reached when the recording ends.
"""

from array import array
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import about_file, put_together
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.reading import elements, has_root, number, root_of
from sugiyama_ros.formats.sheet import MAX_ROWS
from sugiyama_ros.trajectories.assemble import AGREES
from sugiyama_ros.trajectories.labels import Labels, labels, labels_of
from sugiyama_ros.trajectories.tracks import Tracks

# Distance [m] from the middle of a lanelet within which a vehicle is on it, and angle [rad] to its direction.
_ON_LANE_M, _WITHIN = 2.5, 0.25 * np.pi
# What a change to a lanelet that does not follow costs: the square of a distance [m] of half a lane.
_CHANGE = 1.75**2
# Lanelets that a vehicle may pass between two samples.
_PASSED = 3
# Way [m] by which positions may differ from the way between two places, for them to have one origin.
_SAME_ORIGIN_M = 1.0


class _Lanelet(NamedTuple):
    """The middle of a lanelet, (P, 2) [m], way [m] to each point, lanelets that follow, and those beside it."""

    middle: Array
    start_m: Array
    successors: tuple[str, ...]
    beside: tuple[str, ...]


class _SeenRows(NamedTuple):
    """Rows of vehicles: number of the vehicle, time [s], place (R, 2) [m] and heading [rad], NaN where unknown."""

    vehicle: Ints
    time_s: Array
    place_m: Array
    heading: Array


class _Place(NamedTuple):
    """A place on a lanelet: number of the lanelet, way from its start, to the left, and distance [m]."""

    lanelet: int
    along: float
    across: float
    distance: float


def _placed(network: Mapping[str, _Lanelet], seen: _SeenRows, names: Sequence[str]) -> dict[str, Array | Labels]:
    """Put vehicles on lanelets: columns of the road, the lane, the leader, and the positions along and across [m]."""
    graph = _Graph(network)
    near = _near(list(network.values()), seen)
    order = np.lexsort((seen.time_s, seen.vehicle))
    on: list[_Place | None] = [None] * len(order)
    for rows in np.split(order, np.flatnonzero(np.diff(seen.vehicle[order])) + 1):
        for row, place in zip(rows.tolist(), graph.way([near.get(row, ()) for row in rows.tolist()]), strict=True):
            on[row] = place
    lanelet = np.array([-1 if one is None else one.lanelet for one in on])
    along = np.array([np.nan if one is None else one.along for one in on])
    s = along + np.append(graph.offset, np.nan)[lanelet]
    road = _roads(graph, seen, order, lanelet, s)
    lane = labels(np.append(graph.lane, -1)[lanelet].astype(np.int32), list(network))
    ahead = _ahead(graph, seen, order, lanelet, along, s)
    leader = labels(np.where(ahead < 0, -1, seen.vehicle[ahead]).astype(np.int32), names)
    across = np.array([np.nan if one is None else one.across for one in on])
    return {"road": road, "lane": lane, "leader": leader, "s_m": s, "d_m": across}


class _Graph:
    """The lanelets by number: what follows, where each begins [m], its connected road, and its lane."""

    def __init__(self, network: Mapping[str, _Lanelet]) -> None:
        self.names = list(network)
        number = {name: k for k, name in enumerate(self.names)}
        found = list(network.values())
        self.length = np.array([one.start_m[-1] for one in found])
        self.after = [[number[name] for name in one.successors if name in number] for one in found]
        beside = [[number[name] for name in one.beside if name in number] for one in found]
        self.passed = [self._reached(k) for k in range(len(found))]
        entered = {after for one in self.after for after in one}
        # roads and lanes begin where no lanelet leads in; what is left then are rings
        self._first = [*(k for k in range(len(found)) if k not in entered), *range(len(found))]
        self.offset, self.road = self._offsets(found, beside)
        self.lane = self._lanes()

    def _reached(self, first: int) -> frozenset[int]:
        """The lanelet and those that a vehicle may come to between two samples."""
        reached, edge = {first}, {first}
        for _ in range(_PASSED):
            edge = {after for one in edge for after in self.after[one]} - reached
            reached |= edge
        return frozenset(reached)

    def _offsets(self, lanelets: Sequence[_Lanelet], beside: list[list[int]]) -> tuple[Array, Ints]:
        """Where each lanelet begins on its road [m], and the number of the road: the first of its lanelets."""
        links: list[list[tuple[int, float]]] = [[] for _ in lanelets]
        for one, after in enumerate(self.after):
            for other in after:
                links[one].append((other, self.length[one]))
                links[other].append((one, -self.length[one]))
        for one, others in enumerate(beside):
            way = lanelets[one].middle[-1] - lanelets[one].middle[0]
            for other in others:
                shift = lanelets[other].middle[0] - lanelets[one].middle[0]
                links[one].append((other, float(shift @ way / max(np.hypot(*way), 1e-9))))
        offset, road = np.full(len(lanelets), np.nan), np.full(len(lanelets), -1, dtype=np.int64)
        for first in self._first:
            if road[first] >= 0:
                continue
            offset[first], road[first], waiting = 0.0, first, deque([first])
            while waiting:
                one = waiting.popleft()
                for other, way_m in links[one]:
                    if road[other] < 0:
                        offset[other], road[other] = offset[one] + way_m, first
                        waiting.append(other)
        for first in np.unique(road).tolist():
            offset[road == first] -= offset[road == first].min()
        return offset, road

    def _lanes(self) -> Ints:
        """The first lanelet of the lane of each lanelet: a lane goes on with the first lanelet that follows."""
        lane = np.full(len(self.after), -1, dtype=np.int64)
        for first in self._first:
            one = first
            while lane[one] < 0:
                lane[one] = first
                one = next((after for after in self.after[one] if lane[after] < 0), one)
        return lane

    def way(self, near: Sequence[Sequence[_Place]]) -> list[_Place | None]:
        """The places of a vehicle at T times, of those that are near at each: the way with the least cost."""
        found: list[_Place | None] = []
        for is_near, group in groupby(near, key=bool):
            places = list(group)
            found += self._least(places) if is_near else [None] * len(places)
        return found

    def _least(self, near: Sequence[Sequence[_Place]]) -> list[_Place | None]:
        """The way with the least cost through places of which there is at least one at each time."""
        costs = [place.distance**2 for place in near[0]]
        came: list[list[int]] = [[0] * len(costs)]
        for before, places in pairwise(near):
            table = [
                [
                    cost + _CHANGE * (place.lanelet not in self.passed[last.lanelet])
                    for cost, last in zip(costs, before, strict=True)
                ]
                for place in places
            ]
            came.append([int(np.argmin(row)) for row in table])
            costs = [min(row) + place.distance**2 for row, place in zip(table, places, strict=True)]
        found: list[_Place | None] = []
        k = int(np.argmin(costs))
        for places, back in zip(reversed(near), reversed(came), strict=False):
            found.append(places[k])
            k = back[k]
        return found[::-1]

    def between(self, first: int, last: int) -> list[int]:
        """Lanelets after the first one up to the last one, which is among those that a vehicle may come to."""
        ways = [[first]]
        while ways:
            way = ways.pop(0)
            if last in self.after[way[-1]]:
                return [*way[1:], last]
            if len(way) < _PASSED:
                ways += [[*way, one] for one in self.after[way[-1]]]
        return []

    def _onward(self, route: Sequence[int]) -> list[int]:
        """The lanelets that a vehicle comes to, from the first of its route on, as far as somebody knows."""
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


def _near(lanelets: Sequence[_Lanelet], seen: _SeenRows) -> dict[int, list[_Place]]:
    """The lanelets that each row is near to, and whose direction it has."""
    near: dict[int, list[_Place]] = {}
    for lanelet, one in enumerate(lanelets):
        low, high = one.middle.min(axis=0) - _ON_LANE_M, one.middle.max(axis=0) + _ON_LANE_M
        rows = np.flatnonzero(((seen.place_m >= low) & (seen.place_m <= high)).all(axis=1))
        best = np.full(len(rows), _ON_LANE_M)
        along, across = np.zeros(len(rows)), np.zeros(len(rows))
        for begin, end, start in zip(one.middle[:-1], one.middle[1:], one.start_m, strict=False):
            way = end - begin
            length = float(np.hypot(*way))
            if length == 0.0:
                continue
            to = seen.place_m[rows] - begin
            part = np.clip(to @ way / length, 0.0, length)
            distance = np.hypot(*(to - part[:, None] * way / length).T)
            turn = np.abs(np.angle(np.exp(1j * (seen.heading[rows] - np.arctan2(way[1], way[0])))))
            # a heading that is not known suits every direction
            closer = (distance < best) & ~(turn > _WITHIN)
            best[closer], along[closer] = distance[closer], start + part[closer]
            across[closer] = (way[0] * to[closer, 1] - way[1] * to[closer, 0]) / length
        for k in np.flatnonzero(best < _ON_LANE_M).tolist():
            place = _Place(lanelet, float(along[k]), float(across[k]), float(best[k]))
            near.setdefault(int(rows[k]), []).append(place)
    return near


def _roads(graph: _Graph, seen: _SeenRows, order: Ints, lanelet: Ints, s: Array) -> Labels:
    """Road of each row, (R,): another one from where positions have another origin than before."""
    here, there = order[:-1], order[1:]
    same = (seen.vehicle[here] == seen.vehicle[there]) & (lanelet[here] >= 0) & (lanelet[there] >= 0)
    moved = np.hypot(*(seen.place_m[there] - seen.place_m[here]).T)
    breaks = same & (lanelet[here] != lanelet[there]) & (np.abs(s[there] - s[here] - moved) > _SAME_ORIGIN_M)
    laps = np.concatenate(([0], np.cumsum(breaks)))
    first = np.concatenate(([True], np.diff(seen.vehicle[order]) != 0))
    lap = np.zeros(len(order), dtype=np.int64)
    lap[order] = laps - laps[first][np.cumsum(first) - 1]
    road = np.append(graph.road, -1)[lanelet]
    names = [
        None if r < 0 else graph.names[r] + f"~{n + 1}" * bool(n)
        for r, n in zip(road.tolist(), lap.tolist(), strict=True)
    ]
    return labels_of(names)


def _ahead(graph: _Graph, seen: _SeenRows, order: Ints, lanelet: Ints, along: Array, s: Array) -> Ints:
    """Row of the vehicle ahead of each row, (R,); -1 where nobody knows it."""
    ahead = np.full(len(order), -1, dtype=np.int64)
    on: dict[tuple[float, int], list[tuple[float, int]]] = {}
    for row in np.flatnonzero(lanelet >= 0).tolist():
        on.setdefault((round(float(seen.time_s[row]), 3), int(lanelet[row])), []).append((float(along[row]), row))
    for there in on.values():
        there.sort()
    for row, way in _ways(graph, seen, order, lanelet):
        time, start = round(float(seen.time_s[row]), 3), 0.0
        for k, one in enumerate(way):
            next_ones = [(a, r) for a, r in on.get((time, one), ()) if (k or a > along[row]) and r != row]
            if next_ones:
                distance = start + next_ones[0][0] - float(along[row])
                if abs(s[next_ones[0][1]] - s[row] - distance) <= _SAME_ORIGIN_M:
                    ahead[row] = next_ones[0][1]
                break
            start += graph.length[one]
    return ahead


def _ways(graph: _Graph, seen: _SeenRows, order: Ints, lanelet: Ints) -> Iterator[tuple[int, list[int]]]:
    """Each row on a lanelet, and the lanelets on its way from there on."""
    for rows in np.split(order, np.flatnonzero(np.diff(seen.vehicle[order])) + 1):
        own = lanelet[rows]
        begins = np.flatnonzero(np.diff(own, prepend=-2) != 0)
        ends = np.append(begins[1:], len(own))
        route = own[begins].tolist()
        for k, (begin, end) in enumerate(zip(begins.tolist(), ends.tolist(), strict=True)):
            if route[k] >= 0:
                way = graph._onward(route[k:])
                yield from ((int(row), way) for row in rows[begin:end].tolist())


# Points of all lanelets, at most.
_MAX_POINTS = 200_000
# Time [s] between two steps where the file does not say it.
_USUAL_S = 0.1


def _read_commonroad(path: Path, choices: Choices) -> Tracks:
    """Read a scenario. Lanelets that follow one another make a road; positions are measured along their middles.

    Raises InputError.
    """
    said = root_of(path).get("timeStepSize")
    period = _USUAL_S if said is None else number(said.strip(), "timeStepSize", str(path))
    network: dict[str, _Lanelet] = {}
    rows = array("d")
    vehicles: list[str] = []
    kinds: list[str] = []
    counts, points = Counter[str](), 0
    for element in elements(path, "lanelet", "dynamicObstacle", "obstacle"):
        if element.tag == "lanelet":
            one = network[element.get("id", "")] = _lanelet(element, path)
            points += len(one.middle)
        elif element.findtext("role", "dynamic").strip().lower() == "static":
            counts["static"] += 1
        else:
            states = _add(element, path, period, rows, counts)
            vehicles += [element.get("id", "")] * states
            kinds += [element.findtext("type", "").strip().lower()] * states
        if points > _MAX_POINTS or len(vehicles) > MAX_ROWS:
            raise InputError(f"{path}: more than {_MAX_POINTS} points of lanelets or {MAX_ROWS} states; split the file")
    if not vehicles or not network:
        raise InputError(f"{path}: no lanelets, or no obstacles with a trajectory; give a recorded scenario")
    vehicle = labels_of(vehicles)
    time, x, y, heading, speed, length, width = np.frombuffer(rows).reshape(-1, 7).T
    code, place = vehicle.code.astype(np.int64), np.stack((x, y), axis=1)
    seen = _SeenRows(code, time, place, _headings(code, time, place, heading))
    # what becomes too large is on no lanelet; a place on no lane has no position along a lane
    with np.errstate(over="ignore", invalid="ignore"):
        columns = _placed(network, seen, vehicle.text)
    columns |= {"vehicle": vehicle, "class": labels_of(kinds), "time_s": time, "speed": speed}
    columns |= {"length_m": length, "width_m": width}
    areas, static = counts["areas"], counts["static"]
    about = about_file(path, leaders="given").noting(
        f"places of {areas} states are areas in the file; their middles count" * (areas > 0),
        f"{static} obstacles stand still by their role; they were left out" * (static > 0),
    )
    about = about.without("a state without an exact time or a place", counts["unknown"])
    tracks = put_together(columns, about, choices)
    # The file names no leaders: those on the way of a driver are not compared with the next ones on the same lane.
    notes = tuple(note for note in tracks.about.notes if AGREES not in note)
    return replace(tracks, about=replace(tracks.about, notes=notes))


def _add(obstacle: Element, path: Path, period_s: float, rows: "array[float]", counts: Counter[str]) -> int:
    """Add the states of an obstacle, seven numbers each; returns how many."""
    where = f"{path}: obstacle {obstacle.get('id', '')[:40]}"
    shape = obstacle.find("shape/rectangle")
    length, width = (_value(shape, name, where) if shape is not None else np.nan for name in ("length", "width"))
    added = 0
    for state in [*obstacle.iterfind("initialState"), *obstacle.iterfind("trajectory/state")]:
        place = _place(state.find("position"), where, counts)
        if place is None or state.find("time/exact") is None:
            counts["unknown"] += 1
            continue
        time = _value(state, "time/exact", where) * period_s
        heading, speed = (
            _value(state, f"{name}/exact", where) if state.find(f"{name}/exact") is not None else np.nan
            for name in ("orientation", "velocity")
        )
        rows.extend((time, *place, heading, speed, length, width))
        added += 1
    return added


def _place(position: Element | None, where: str, counts: Counter[str]) -> tuple[float, float] | None:
    """A place [m]: a point, or the middle of an area; None where it is a lanelet or nothing."""
    if position is None:
        return None
    if (point := position.find("point")) is not None:
        x, y = (_value(point, axis, where, "position point ") for axis in "xy")
        return x, y
    found = [point for area in ("rectangle", "circle") for point in position.iterfind(f"{area}/center")]
    found = found or [*position.iterfind("polygon/point")]
    if not found:
        return None
    counts["areas"] += 1
    x, y = (float(np.mean([_value(point, axis, where, "position ") for point in found])) for axis in "xy")
    return x, y


def _value(element: Element, name: str, where: str, of: str = "") -> float:
    return number(element.findtext(name, "").strip(), of + name.replace("/", " "), where)


def _headings(vehicle: Ints, time_s: Array, place_m: Array, heading: Array) -> Array:
    """Headings [rad] of the rows, (R,): where the file does not say one, the direction from a place to the next one."""
    if np.isfinite(heading).all():
        return heading
    order = np.lexsort((time_s, vehicle))
    way = np.diff(place_m[order], axis=0)
    moves = (np.diff(vehicle[order]) == 0) & (np.hypot(*way.T) > 0.1)
    after = np.where(moves, np.arctan2(way[:, 1], way[:, 0]), np.nan)
    guessed = np.full(len(heading), np.nan)
    guessed[order[1:]] = after
    guessed[order[:-1]] = np.where(np.isfinite(after), after, guessed[order[:-1]])
    return np.where(np.isfinite(heading), heading, guessed)


def _lanelet(element: Element, path: Path) -> _Lanelet:
    where = f"{path}: lanelet {element.get('id', '')[:40]}"
    left, right = (
        np.array([[_value(p, "x", where), _value(p, "y", where)] for p in element.iterfind(f"{side}Bound/point")])
        for side in ("left", "right")
    )
    if len(left) != len(right) or len(left) < 2:
        raise InputError(
            f"{where}: {len(left)} points on the left and {len(right)} on the right; give two or more of each"
        )
    after = tuple(one.get("ref", "") for one in element.iterfind("successor"))
    beside = [one for side in ("Left", "Right") for one in element.iterfind(f"adjacent{side}")]
    same = tuple(one.get("ref", "") for one in beside if one.get("drivingDir", "same") == "same")
    middle = 0.5 * (left + right)
    way = np.cumsum(np.hypot(*np.diff(middle, axis=0).T))
    return _Lanelet(middle, np.concatenate(([0.0], way)), after, same)


FORMAT = Format(
    name="commonroad",
    suffixes=(".xml",),
    recognise=lambda head, path: has_root(head, path, "commonRoad"),
    read=_read_commonroad,
    summary="CommonRoad scenarios: obstacles on lanelets",
)
