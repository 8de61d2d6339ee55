"""CommonRoad scenarios: vehicles in the plane, and lanelets that say where the lanes are.

A vehicle is on a lanelet that is near and that points the way the vehicle does. Where several do, as behind a fork, the
vehicle's whole way decides. Positions count along the lanelets that follow one another; lanelets side by side begin at
the same position. The vehicle ahead is the next one on the way that the vehicle goes. It is unknown beyond a fork that
the vehicle has not reached when the recording ends.
"""

from array import array
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import about_file, put_together
from sugiyama_ros.formats.commonroad_road import MAX_POINTS, add_lanelet, value_of
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.map_parts import MapLanes
from sugiyama_ros.formats.reading import elements, has_root, number, root_of
from sugiyama_ros.formats.sheet import MAX_ROWS
from sugiyama_ros.roads.network import Network
from sugiyama_ros.roads.routes import CHANGE, Place, SeenRows, Ways, places_near
from sugiyama_ros.roads.view import Sides, is_beside, sides, widths
from sugiyama_ros.trajectories.assemble import AGREES, lengths_of
from sugiyama_ros.trajectories.kinds import is_driver
from sugiyama_ros.trajectories.labels import Labels, labels, labels_of
from sugiyama_ros.trajectories.tracks import Tracks

# Distance [m] from the middle of a lanelet within which a vehicle is on it.
_ON_LANE_M = 2.5
# Way [m] by which positions may differ from the way between two places, for them to have one origin.
_SAME_ORIGIN_M = 1.0


def _placed(network: Network, seen: SeenRows, size_m: Array, names: Sequence[str]) -> dict[str, Array | Labels]:
    """Put vehicles on lanelets: columns of the road, the lane, the leader, and the positions along and across [m].

    size_m: (R, 2), lengths and widths [m] of the vehicles.
    """
    graph = _Graph(network)
    near = places_near(network, seen, _ON_LANE_M)
    order = np.lexsort((seen.time_s, seen.vehicle))
    on: list[Place | None] = [None] * len(order)
    for rows in seen.of_vehicles():
        for is_near, group in groupby(rows.tolist(), key=near.__contains__):
            if is_near:
                there = list(group)
                for row, place in zip(there, graph.ways.least([near[row] for row in there]), strict=True):
                    on[row] = place
    lanelet = np.array([-1 if one is None else one.lane for one in on])
    along = np.array([np.nan if one is None else one.along for one in on])
    s = along + np.append(graph.offset, np.nan)[lanelet]
    road = _roads(graph, seen, order, lanelet, s)
    lane = labels(np.append(graph.lane, -1)[lanelet].astype(np.int32), graph.names)
    across = np.array([np.nan if one is None else one.across for one in on])
    beside = sides(seen.vehicle, lanelet, seen.time_s, across, size_m[:, 1])
    ahead = _ahead(graph, seen, _OnLanelet(lanelet, along, s, size_m[:, 0], beside))
    leader = labels(np.where(ahead < 0, -1, seen.vehicle[ahead]).astype(np.int32), names)
    return {"road": road, "lane": lane, "leader": leader, "s_m": s, "d_m": across}


class _Graph:
    """The lanelets by number: where each begins [m], its connected road, and its lane."""

    def __init__(self, network: Network) -> None:
        self.names = [one.name for one in network.lanes]
        self.length = np.array([np.cumsum(np.hypot(np.diff(one.x_m), np.diff(one.y_m)))[-1] for one in network.lanes])
        self.after, self.ways = network.after, Ways(network, CHANGE)
        # roads and lanes begin where no lanelet leads in; what is left then are rings
        self._first = [*(k for k, before in enumerate(network.before) if not before), *range(len(self.names))]
        self.offset, self.road = self._offsets(network)
        self.lane = self._lanes()

    def _offsets(self, network: Network) -> tuple[Array, Ints]:
        """Where each lanelet begins on its road [m], and the number of the road: the first of its lanelets."""
        links: list[list[tuple[int, float]]] = [[] for _ in self.names]
        for one, after in enumerate(self.after):
            for other in after:
                links[one].append((other, self.length[one]))
                links[other].append((one, -self.length[one]))
        begin, end = (np.array([[lane.x_m[k], lane.y_m[k]] for lane in network.lanes]) for k in (0, -1))
        for one, lane in enumerate(network.lanes):
            way = end[one] - begin[one]
            for other in (network.number(name) for name in (lane.left, lane.right) if name):
                shift = begin[other] - begin[one]
                links[one].append((other, float(shift @ way / max(np.hypot(*way), 1e-9))))
        offset, road = np.full(len(links), np.nan), np.full(len(links), -1, dtype=np.int64)
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


def _roads(graph: _Graph, seen: SeenRows, order: Ints, lanelet: Ints, s: Array) -> Labels:
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


class _OnLanelet(NamedTuple):
    """Rows of vehicles, (R,) each: lanelet (-1 for none), places [m] on it and on the road, length [m], and side."""

    lanelet: Ints
    along: Array
    s: Array
    length: Array
    sides: Sides


def _ahead(graph: _Graph, seen: SeenRows, rows: _OnLanelet) -> Ints:
    """Row of the vehicle ahead of each row, (R,); -1 where nobody knows it."""
    lanelet, along, s, length, beside = rows
    ahead = np.full(len(lanelet), -1, dtype=np.int64)
    on: dict[tuple[float, int], list[tuple[float, int]]] = {}
    for row in np.flatnonzero(lanelet >= 0).tolist():
        on.setdefault((round(float(seen.time_s[row]), 3), int(lanelet[row])), []).append((float(along[row]), row))
    for there in on.values():
        there.sort()
    for row, way in _ways(graph, seen, lanelet):
        time, start = round(float(seen.time_s[row]), 3), 0.0
        for k, one in enumerate(way):
            next_ones = [
                (a, r)
                for a, r in on.get((time, one), ())
                if (k or a > along[row])
                and r != row
                and not is_beside(row, r, start + a - along[row] < 0.5 * (length[row] + length[r]), beside)
            ]
            if next_ones:
                distance = start + next_ones[0][0] - float(along[row])
                if abs(s[next_ones[0][1]] - s[row] - distance) <= _SAME_ORIGIN_M:
                    ahead[row] = next_ones[0][1]
                break
            start += graph.length[one]
    return ahead


def _ways(graph: _Graph, seen: SeenRows, lanelet: Ints) -> Iterator[tuple[int, list[int]]]:
    """Each row on a lanelet, and the lanelets on its way from there on."""
    for rows in seen.of_vehicles():
        own = lanelet[rows]
        begins = np.flatnonzero(np.diff(own, prepend=-2) != 0)
        ends = np.append(begins[1:], len(own))
        route = own[begins].tolist()
        for k, (begin, end) in enumerate(zip(begins.tolist(), ends.tolist(), strict=True)):
            if route[k] >= 0:
                way = graph.ways.onward(route[k:])
                yield from ((int(row), way) for row in rows[begin:end].tolist())


# Numbers of a state: time, x, y, heading, speed, length and width.
_WIDTH = 7
# Time [s] between two steps where the file does not say it.
_USUAL_S = 0.1


def _read_commonroad(path: Path, choices: Choices) -> Tracks:
    """Read a scenario. Lanelets that follow one another make a road; positions are measured along their middles.

    Raises InputError.
    """
    said = root_of(path).get("timeStepSize")
    period = _USUAL_S if said is None else number(said.strip(), "timeStepSize", str(path))
    lanelets = MapLanes(path)
    rows = array("d")
    vehicles: list[str] = []
    kinds: list[str] = []
    still: list[tuple[str, str, array[float]]] = []
    counts, points = Counter[str](), 0
    for element in elements(path, "lanelet", "dynamicObstacle", "staticObstacle", "obstacle"):
        name, kind = element.get("id", ""), element.findtext("type", "").strip()
        if element.tag == "lanelet":
            add_lanelet(element, path, lanelets)
            points += len(element.findall("leftBound/point"))
        elif element.tag == "staticObstacle" or element.findtext("role", "").strip().lower() == "static":
            still.append((name, "static_obstacle" if is_driver(kind) else kind, array("d")))
            _add(element, path, period, still[-1][2], counts)
        else:
            states = _add(element, path, period, rows, counts)
            vehicles += [name] * states
            kinds += [kind] * states
        if points > MAX_POINTS or len(vehicles) > MAX_ROWS:
            raise InputError(f"{path}: more than {MAX_POINTS} points of lanelets or {MAX_ROWS} states; split the file")
    if not vehicles or not lanelets.lanes:
        raise InputError(f"{path}: no lanelets, or no obstacles with a trajectory; give a recorded scenario")
    drive, standing = len(vehicles), _add_standing(still, path, rows)
    vehicle = labels_of([*vehicles, *(name for name, _ in standing)])
    kinds += [kind for _, kind in standing]
    time, x, y, heading, speed, length, width = np.frombuffer(rows).reshape(-1, _WIDTH).T
    code, place = vehicle.code.astype(np.int64), np.stack((x, y), axis=1)
    seen = SeenRows(code, time, place, _headings(code, time, place, heading))
    # what becomes too large is on no lanelet; a place on no lane has no position along a lane
    of_class, size = labels_of(kinds), lengths_of(code, length)
    size_m = np.stack((size, widths(width, of_class, size)), axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        columns = _placed(Network(lanelets.linked("give a recorded scenario")), seen, size_m, vehicle.text)
    columns |= {"vehicle": vehicle, "class": of_class, "time_s": time, "speed": speed}
    columns |= {"length_m": length, "width_m": width}
    # what stands beside all lanes is in nobody's way
    kept = np.isfinite(np.asarray(columns["s_m"])) | (np.arange(len(vehicle)) < drive)
    beside = len(np.unique(code[~kept]))
    columns = {name: column[kept] for name, column in columns.items()}
    areas = counts["areas"]
    about = about_file(path, leaders="given").noting(
        *lanelets.notes(),
        f"places of {areas} states are areas in the file; their middles count" * (areas > 0),
        f"static obstacles beside all lanes, which were left out: {beside}" * (beside > 0),
    )
    about = about.without("a state without an exact time or a place", counts["unknown"])
    tracks = put_together(columns, about, choices)
    # The file names no leaders: those on the way of a driver are not compared with the next ones on the same lane.
    notes = tuple(note for note in tracks.about.notes if AGREES not in note)
    return replace(tracks, about=replace(tracks.about, notes=notes))


def _add_standing(
    still: Sequence[tuple[str, str, "array[float]"]], path: Path, rows: "array[float]"
) -> list[tuple[str, str]]:
    """Add obstacles that stand, by name, class and state, at each time of the rows; returns name and class of each."""
    times = sorted(set(rows[::_WIDTH]))
    if len(times) * len(still) > MAX_ROWS:
        raise InputError(f"{path}: more than {MAX_ROWS} states of obstacles that stand; split the file")
    known = [(name, kind, state) for name, kind, state in still if state]
    for _, _, state in known:
        for now in times:
            # the direction of what stands says nothing of its lane
            rows.extend((now, *state[1:3], np.nan, 0.0, *state[5:_WIDTH]))
    return [(name, kind) for name, kind, _ in known for _ in times]


def _add(obstacle: Element, path: Path, period_s: float, rows: "array[float]", counts: Counter[str]) -> int:
    """Add the states of an obstacle, seven numbers each; returns how many."""
    where = f"{path}: obstacle {obstacle.get('id', '')[:40]}"
    shape = obstacle.find("shape/rectangle")
    length, width = (value_of(shape, name, where) if shape is not None else np.nan for name in ("length", "width"))
    added = 0
    for state in [*obstacle.iterfind("initialState"), *obstacle.iterfind("trajectory/state")]:
        place = _place(state.find("position"), where, counts)
        if place is None or state.find("time/exact") is None:
            counts["unknown"] += 1
            continue
        time = value_of(state, "time/exact", where) * period_s
        heading, speed = (
            value_of(state, f"{name}/exact", where) if state.find(f"{name}/exact") is not None else np.nan
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
        x, y = (value_of(point, axis, where, "position point ") for axis in "xy")
        return x, y
    found = [point for area in ("rectangle", "circle") for point in position.iterfind(f"{area}/center")]
    found = found or [*position.iterfind("polygon/point")]
    if not found:
        return None
    counts["areas"] += 1
    x, y = (float(np.mean([value_of(point, axis, where, "position ") for point in found])) for axis in "xy")
    return x, y


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


FORMAT = Format(
    name="commonroad",
    suffixes=(".xml",),
    recognise=lambda head, path: has_root(head, path, "commonRoad"),
    read=_read_commonroad,
    summary="CommonRoad scenarios: obstacles on lanelets",
)
