"""SUMO's floating car data: XML, and the same as CSV or Parquet."""

from array import array
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import about_file, need, put_together, read_columns, take, text_of
from sugiyama_ros.formats.edges import Edges, along_edges
from sugiyama_ros.formats.format import tracks_format
from sugiyama_ros.formats.sheet import MAX_ROWS, head_of, sheet_of
from sugiyama_ros.formats.xml_events import attribute, elements
from sugiyama_ros.trajectories.labels import Labels, labels
from sugiyama_ros.trajectories.tracks import Tracks

#: Length [m] of vehicles of SUMO, unless their type says otherwise; the files do not say it.
DEFAULT_LENGTH_M = 5.0
_WANTED = {
    "time_s": need("timestep_time"),
    "vehicle": need("vehicle_id"),
    "s_m": need("vehicle_pos"),
    "lane_name": need("vehicle_lane"),
    "speed_m": need("vehicle_speed"),
    "class": take("vehicle_type"),
    "leader": take("vehicle_leaderID"),
    "gap_m": take("vehicle_leaderGap"),
    "length_m": take("vehicle_length"),
}
_TEXTS = {"vehicle": "id", "lane_name": "lane", "class": "type", "leader": "leaderID"}
_NUMBERS = {"s_m": "pos", "speed_m": "speed"}
# Present only if the user asked SUMO for leaders.
_GAP = "leaderGap"


def read_sumo(path: Path, choices: Choices) -> Tracks:
    """Read floating car data. Positions on edges become positions along the road that the edges make.

    Parameters
    ----------
    path : Path
        XML (``--fcd-output``), CSV or Parquet.
    choices : Choices
        What the user says.

    Returns
    -------
    Tracks
        Centres. Lanes are counted from the right, as SUMO counts them.

    Raises
    ------
    InputError
        With the line, for a file of another form.
    """
    head = head_of(path)
    if _is_xml(head):
        columns = _of_xml(path)
    else:
        sheet = sheet_of(path, head)
        if sheet is None:
            raise InputError(f"{path}:1: not the columns of SUMO; check the file")
        columns = read_columns(sheet, _WANTED)
    lane, vehicle = text_of(columns, "lane_name"), text_of(columns, "vehicle")
    del columns["lane_name"]
    about = about_file(path)
    edges, columns["lane"] = _edges(lane, path)
    time, speed = np.asarray(columns["time_s"]), np.asarray(columns.pop("speed_m"))
    placed = along_edges(Edges(edges, vehicle.code, time, np.asarray(columns["s_m"]), speed))
    columns["s_m"] = placed.s_m
    if placed.road is not None:
        columns["road"] = placed.road
    gap = columns.pop("gap_m", None)
    if "length_m" not in columns:
        columns["length_m"], note = _lengths(columns, gap)
        about = about.noting(note)
    about = replace(about.noting(placed.note), ring_m=placed.ring_m)
    return put_together(columns, about, choices, reference="front")


def _edges(lane: Labels, path: Path) -> tuple[Labels, Labels]:
    """Edge and number of the lane of each row, (R,), from names like ``E1_0``."""
    parts = [text.rpartition("_") for text in lane.text]
    if any(not edge or not number.isdigit() for edge, _, number in parts):
        bad = next(
            text for text, (edge, _, number) in zip(lane.text, parts, strict=True) if not edge or not number.isdigit()
        )
        raise InputError(f"{path}: lane {bad[:40]!r}: does not end in _ and a number, as SUMO's lanes do; correct it")
    return labels(lane.code, [edge for edge, _, _ in parts]), labels(lane.code, [number for _, _, number in parts])


def _lengths(columns: Mapping[str, Array | Labels], gap: Array | Labels | None) -> tuple[Array, str]:
    """Lengths [m] of the vehicles of the rows, (R,), and a note on where they come from.

    A vehicle that others follow is as long as the way between two front bumpers is longer than the gap.
    """
    vehicle, s, time = text_of(columns, "vehicle"), np.asarray(columns["s_m"]), np.asarray(columns["time_s"])
    length = np.full(len(vehicle.text), np.nan)
    if gap is not None and "leader" in columns:
        followed = np.flatnonzero(np.asarray(gap) >= 0.0)
        leader = text_of(columns, "leader")
        place = {text: code for code, text in enumerate(vehicle.text)}
        ahead = np.array([place.get(text, -1) for text in leader.text])[leader.code[followed]]
        _, moment = np.unique(time, return_inverse=True)
        key, wanted = vehicle.code + moment * len(place), ahead + moment[followed] * len(place)
        order = np.argsort(key)
        row = order[np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)]
        way = s[row] - s[followed] - np.asarray(gap)[followed]
        told = (ahead >= 0) & (key[row] == wanted) & (way > 0.0)
        for one in np.unique(ahead[told]).tolist():
            length[one] = round(float(np.median(way[told & (ahead == one)])), 2)
    known = np.isfinite(length)
    rest = f"every {'other ' * bool(known.any())}vehicle counts as {DEFAULT_LENGTH_M:g} m long"
    if known.any():
        note = f"lengths of {known.sum()} vehicles follow from the gaps of those behind; {rest}"
    else:
        note = f"lengths are not in the file: {rest}"
    return np.where(known, length, DEFAULT_LENGTH_M)[vehicle.code], note


class _Gathered:
    """Columns of an XML file, gathered vehicle by vehicle."""

    def __init__(self) -> None:
        self.number = {name: array("d") for name in ("time_s", *_NUMBERS)}
        self._gap = array("d")
        self._code = {name: array("i") for name in _TEXTS}
        self._texts: dict[str, dict[str, int]] = {name: {} for name in _TEXTS}

    def add(self, time_s: float, said: Mapping[str, str], path: Path) -> None:
        """Add what is said of a vehicle at a time."""
        where = f"{path}: vehicle {said.get('id', '')[:40]} at {time_s:g} s"
        self.number["time_s"].append(time_s)
        for name, source in _NUMBERS.items():
            self.number[name].append(attribute(said, source, where))
        self._gap.append(attribute(said, _GAP, where) if _GAP in said else -1.0)
        for name, source in _TEXTS.items():
            text, known = said.get(source, ""), self._texts[name]
            self._code[name].append(known.setdefault(text, len(known)) if text else -1)

    def columns(self) -> dict[str, Array | Labels]:
        """The columns; those of text that are empty are left out."""
        found: dict[str, Array | Labels] = {name: np.frombuffer(values) for name, values in self.number.items()}
        found["gap_m"] = np.frombuffer(self._gap)
        for name, codes in self._code.items():
            code = np.frombuffer(codes, dtype=np.int32)
            if name in ("vehicle", "lane_name") or (code >= 0).any():
                found[name] = labels(code, self._texts[name])
        return found


def _of_xml(path: Path) -> dict[str, Array | Labels]:
    """Columns of an XML file."""
    gathered = _Gathered()
    times = gathered.number["time_s"]
    for step in elements(path, "timestep"):
        time = attribute(step.attrib, "time", f"{path}: timestep")
        for one in step.iter("vehicle"):
            gathered.add(time, one.attrib, path)
        if len(times) > MAX_ROWS:
            raise InputError(f"{path}: more than {MAX_ROWS} rows; split the file")
    if not times:
        raise InputError(f"{path}: no samples; write it with sumo --fcd-output")
    return gathered.columns()


def _is_xml(head: bytes) -> bool:
    return b"<fcd-export" in head


def _recognise(head: bytes, path: Path) -> bool:
    if _is_xml(head):
        return True
    sheet = sheet_of(path, head)
    return sheet is not None and sheet.has("timestep_time", "vehicle_id", "vehicle_pos", "vehicle_lane")


FORMAT = tracks_format(
    name="sumo",
    suffixes=(".xml", ".csv", ".parquet"),
    recognise=_recognise,
    tracks=read_sumo,
    summary="floating car data of SUMO as XML, CSV or Parquet: lanes on edges that follow one another",
)
