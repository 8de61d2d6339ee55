"""CommonRoad scenarios: vehicles in the plane, and lanelets that say where the lanes are."""

from array import array
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import about_file, put_together
from sugiyama_ros.formats.format import tracks_format
from sugiyama_ros.formats.lanelets import Lanelet, SeenRows, placed
from sugiyama_ros.formats.reading import number
from sugiyama_ros.formats.sheet import MAX_ROWS
from sugiyama_ros.formats.xml_events import elements, has_root, root_of
from sugiyama_ros.trajectories.assemble import AGREES
from sugiyama_ros.trajectories.labels import Labels, labels_of
from sugiyama_ros.trajectories.tracks import Tracks

#: Points of all lanelets, at most.
_MAX_POINTS = 200_000
# Time [s] between two steps where the file does not say it.
_USUAL_S = 0.1
_DIRECTION = "drivingDir"


class _State(NamedTuple):
    """What is kept of each row."""

    time_s: float
    x_m: float
    y_m: float
    heading: float
    speed: float
    length_m: float
    width_m: float


class _Counts:
    """States that are not exact."""

    def __init__(self) -> None:
        self.areas = self.unknown = self.static = 0

    def notes(self) -> list[str]:
        """What was done with these states."""
        return [
            f"places of {self.areas} states are areas in the file; their middles count" * (self.areas > 0),
            f"{self.static} obstacles stand still by their role; they were left out" * (self.static > 0),
        ]


def read_commonroad(path: Path, choices: Choices) -> Tracks:
    """Read a scenario. Lanelets that follow one another make a road; positions are measured along their middles.

    Raises InputError.
    """
    said = root_of(path).get("timeStepSize")
    period = _USUAL_S if said is None else number(said.strip(), "timeStepSize", str(path))
    network: dict[str, Lanelet] = {}
    rows = {name: array("d") for name in _State._fields}
    vehicles: list[str] = []
    kinds: list[str] = []
    counts, points = _Counts(), 0
    for element in elements(path, "lanelet", "dynamicObstacle", "obstacle"):
        if element.tag == "lanelet":
            one = network[element.get("id", "")] = _lanelet(element, path)
            points += len(one.middle)
        elif element.findtext("role", "dynamic").strip().lower() == "static":
            counts.static += 1
        else:
            states = _add(element, path, period, rows, counts)
            vehicles += [element.get("id", "")] * states
            kinds += [element.findtext("type", "").strip().lower()] * states
        if points > _MAX_POINTS or len(vehicles) > MAX_ROWS:
            raise InputError(f"{path}: more than {_MAX_POINTS} points of lanelets or {MAX_ROWS} states; split the file")
    if not vehicles or not network:
        raise InputError(f"{path}: no lanelets, or no obstacles with a trajectory; give a recorded scenario")
    columns: dict[str, Array | Labels] = {name: np.frombuffer(values) for name, values in rows.items()}
    vehicle = labels_of(vehicles)
    place = np.stack((np.asarray(columns.pop("x_m")), np.asarray(columns.pop("y_m"))), axis=1)
    code, time = vehicle.code.astype(np.int64), np.asarray(columns["time_s"])
    seen = SeenRows(code, time, place, _headings(code, time, place, np.asarray(columns.pop("heading"))))
    # what becomes too large is on no lanelet
    with np.errstate(over="ignore", invalid="ignore"):
        on = placed(network, seen, vehicle.text)
    # A place on no lane has no position along a lane.
    columns |= {"vehicle": vehicle, "class": labels_of(kinds), "road": on.road, "lane": on.lane, "leader": on.leader}
    columns |= {"s_m": on.s_m, "d_m": on.d_m}
    about = about_file(path, leaders="given").noting(*counts.notes())
    about = about.without("a state without an exact time or a place", counts.unknown)
    tracks = put_together(columns, about, choices)
    # The file names no leaders: those on the way of a driver are not compared with the next ones on the same lane.
    notes = tuple(note for note in tracks.about.notes if AGREES not in note)
    return replace(tracks, about=replace(tracks.about, notes=notes))


def _add(obstacle: Element, path: Path, period_s: float, rows: "dict[str, array[float]]", counts: _Counts) -> int:
    """Add the states of an obstacle; returns how many."""
    where = f"{path}: obstacle {obstacle.get('id', '')[:40]}"
    shape = obstacle.find("shape/rectangle")
    length, width = (_value(shape, name, where) if shape is not None else np.nan for name in ("length", "width"))
    added = 0
    for state in [*obstacle.iterfind("initialState"), *obstacle.iterfind("trajectory/state")]:
        place = _place(state.find("position"), where, counts)
        if place is None or state.find("time/exact") is None:
            counts.unknown += 1
            continue
        time = _value(state, "time/exact", where) * period_s
        heading, speed = (
            _value(state, f"{name}/exact", where) if state.find(f"{name}/exact") is not None else np.nan
            for name in ("orientation", "velocity")
        )
        for values, value in zip(rows.values(), _State(time, *place, heading, speed, length, width), strict=True):
            values.append(value)
        added += 1
    return added


def _place(position: Element | None, where: str, counts: _Counts) -> tuple[float, float] | None:
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
    counts.areas += 1
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


def _lanelet(element: Element, path: Path) -> Lanelet:
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
    same = tuple(one.get("ref", "") for one in beside if one.get(_DIRECTION, "same") == "same")
    return Lanelet(0.5 * (left + right), after, same)


FORMAT = tracks_format(
    name="commonroad",
    suffixes=(".xml",),
    recognise=lambda head, path: has_root(head, path, "commonRoad"),
    tracks=read_commonroad,
    summary="CommonRoad scenarios: obstacles on lanelets",
)
