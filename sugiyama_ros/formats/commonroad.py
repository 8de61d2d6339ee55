"""CommonRoad scenarios: vehicles in the plane, and lanelets that say where the lanes are."""

import re
from array import array
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import about_file, put_together
from sugiyama_ros.formats.format import tracks_format
from sugiyama_ros.formats.reading import number
from sugiyama_ros.formats.sheet import MAX_ROWS, head_of
from sugiyama_ros.formats.xml_events import elements
from sugiyama_ros.trajectories.labels import Labels, labels, labels_of
from sugiyama_ros.trajectories.tracks import Tracks

#: Distance [m] from the middle of a lane within which a vehicle is on it.
_ON_LANE_M = 2.5
#: Points of all lanelets, at most.
_MAX_POINTS = 200_000
_PERIOD = re.compile(rb'timeStepSize="([^"]{1,20})"')
# Times, places and sizes: what is kept of each row.
_KEPT = ("time_s", "x_m", "y_m", "length_m", "width_m")


class _Lanelet(NamedTuple):
    """The middle of a lanelet, (P, 2) [m], and the lanelet that follows; empty for none."""

    middle: Array
    successor: str


def read_commonroad(path: Path, choices: Choices) -> Tracks:
    """Read a scenario. Lanelets that follow one another make a lane; positions are measured along its middle.

    Parameters
    ----------
    path : Path
        XML.
    choices : Choices
        What the user says.

    Returns
    -------
    Tracks
        Centres. A vehicle that is on no lane has an unknown leader.

    Raises
    ------
    InputError
        With the line, for a file of another form.
    """
    found = _PERIOD.search(head_of(path))
    period = number(found[1].decode(), "timeStepSize", str(path)) if found else 0.1
    lanelets: dict[str, _Lanelet] = {}
    rows = {name: array("d") for name in _KEPT}
    vehicles: list[str] = []
    kinds: list[str] = []
    points = 0
    for element in elements(path, "lanelet", "dynamicObstacle", "obstacle"):
        if element.tag == "lanelet":
            one = lanelets[element.get("id", "")] = _lanelet(element, path)
            points += len(one.middle)
        else:
            states = _add(element, path, period, rows)
            vehicles += [element.get("id", "")] * states
            kinds += [element.findtext("type", "").strip().lower()] * states
        if points > _MAX_POINTS or len(vehicles) > MAX_ROWS:
            raise InputError(f"{path}: more than {_MAX_POINTS} points of lanelets or {MAX_ROWS} states; split the file")
    if not vehicles or not lanelets:
        raise InputError(f"{path}: no lanelets, or no obstacles with a trajectory; give a recorded scenario")
    columns: dict[str, Array | Labels] = {name: np.frombuffer(values) for name, values in rows.items()}
    place = np.stack((np.asarray(columns.pop("x_m")), np.asarray(columns.pop("y_m"))), axis=1)
    lane, s, off = _on_lanes(lanelets, place)
    # A place on no lane has no position along a lane.
    columns |= {"vehicle": labels_of(vehicles), "class": labels_of(kinds), "lane": lane, "s_m": s, "d_m": off}
    return put_together(columns, about_file(path), choices)


def _add(obstacle: Element, path: Path, period_s: float, rows: "dict[str, array[float]]") -> int:
    """Add the states of an obstacle; returns how many."""
    where = f"{path}: obstacle {obstacle.get('id', '')[:40]}"
    shape = obstacle.find("shape/rectangle")
    size = [_value(shape, name, where) if shape is not None else np.nan for name in ("length", "width")]
    states = [*obstacle.iterfind("initialState"), *obstacle.iterfind("trajectory/state")]
    for state in states:
        time = _value(state, "time/exact", where) * period_s
        place = [_value(state, f"position/point/{axis}", where) for axis in "xy"]
        for name, value in zip(_KEPT, (time, *place, *size), strict=True):
            rows[name].append(value)
    return len(states)


def _value(element: Element, name: str, where: str) -> float:
    return number(element.findtext(name, "").strip(), name.replace("/", " "), where)


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
    successor = element.find("successor")
    return _Lanelet(0.5 * (left + right), "" if successor is None else successor.get("ref", ""))


def _on_lanes(lanelets: dict[str, _Lanelet], place_m: Array) -> tuple[Labels, Array, Array]:
    """Lane of each place (R, 2), its position along the lane and its distance to the left [m], (R,) each."""
    lane, offset = _chained(lanelets)
    best = np.full(len(place_m), _ON_LANE_M)
    code = np.full(len(place_m), -1, dtype=np.int32)
    s, off = np.full(len(place_m), np.nan), np.full(len(place_m), np.nan)
    for number_of, (name, one) in enumerate(lanelets.items()):
        low, high = one.middle.min(axis=0) - _ON_LANE_M, one.middle.max(axis=0) + _ON_LANE_M
        near = np.flatnonzero(((place_m >= low) & (place_m <= high)).all(axis=1))
        start = offset[name]
        for begin, end in zip(one.middle[:-1], one.middle[1:], strict=True):
            way = end - begin
            length = float(np.hypot(*way))
            if length == 0.0:
                continue
            to = place_m[near] - begin
            along = np.clip(to @ way / length, 0.0, length)
            across = (way[0] * to[:, 1] - way[1] * to[:, 0]) / length
            distance = np.hypot(*(to - along[:, None] * way / length).T)
            closer = distance < best[near]
            hit = near[closer]
            best[hit], code[hit], s[hit], off[hit] = distance[closer], number_of, start + along[closer], across[closer]
            start += length
    return labels(code, [lane[name] for name in lanelets]), s, off


def _chained(lanelets: dict[str, _Lanelet]) -> tuple[dict[str, str], dict[str, float]]:
    """For each lanelet the first one of its lane, and where it begins on the lane [m]."""
    followed = {one.successor for one in lanelets.values()}
    lane: dict[str, str] = {}
    offset: dict[str, float] = {}
    for first in [*(name for name in lanelets if name not in followed), *lanelets]:
        name, start = first, 0.0
        while name in lanelets and name not in lane:
            lane[name], offset[name] = first, start
            start += float(np.hypot(*np.diff(lanelets[name].middle, axis=0).T).sum())
            name = lanelets[name].successor
    return lane, offset


FORMAT = tracks_format(
    name="commonroad",
    suffixes=(".xml",),
    recognise=lambda head, path: b"<commonRoad" in head,
    tracks=read_commonroad,
    summary="CommonRoad scenarios: obstacles on lanelets",
)
