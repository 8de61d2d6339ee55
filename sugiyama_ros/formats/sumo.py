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
from sugiyama_ros.formats.xml_events import attribute, elements, has_root
from sugiyama_ros.trajectories.labels import Labels, labels
from sugiyama_ros.trajectories.tracks import Tracks

#: Length [m] of vehicles of SUMO, unless their type says otherwise; the files do not say it.
DEFAULT_LENGTH_M = 5.0
_WANTED = {
    "time_s": need("timestep_time"),
    "vehicle": need("vehicle_id"),
    "s_m": need("vehicle_pos"),
    "lane_name": take("vehicle_lane"),
    "edge": take("vehicle_edge"),
    "speed": need("vehicle_speed"),
    "class": take("vehicle_type"),
    "leader": take("vehicle_leaderID"),
    "gap_m": take("vehicle_leaderGap"),
    "length_m": take("vehicle_length"),
}
_TEXTS = {"vehicle": "id", "lane_name": "lane", "edge": "edge", "class": "type", "leader": "leaderID"}
_NUMBERS = {"s_m": "pos", "speed": "speed"}
# Present only if the user asked SUMO for leaders.
_GAP = "leaderGap"


def read_sumo(path: Path, choices: Choices) -> Tracks:
    """Read floating car data. Positions on edges become positions along the road that the edges make.

    The mesoscopic model names edges without lanes; then nobody's leader is known.

    path: XML (``--fcd-output``), CSV or Parquet. Raises InputError.
    """
    head = head_of(path)
    if _is_xml(head, path):
        columns = _of_xml(path)
    else:
        sheet = sheet_of(path, head)
        if sheet is None:
            raise InputError(f"{path}:1: not the columns of SUMO; check the file")
        columns = read_columns(sheet, _WANTED)
    lane, edge = columns.pop("lane_name", None), columns.pop("edge", None)
    if not isinstance(lane, Labels) and not isinstance(edge, Labels):
        raise InputError(f"{path}: no vehicle has a lane or an edge; write the file with the attribute lane")
    about = about_file(path)
    edges, columns["lane"] = _edges(lane, edge, path)
    columns = _on_an_edge(columns, edges, path)
    edges = edges[edges.code >= 0]
    if (text_of(columns, "lane").code < 0).all():
        about = about.noting(
            "warning: edges have no lanes in the file, as in SUMO's mesoscopic model, so that no leader is known"
        )
    vehicle, speed = text_of(columns, "vehicle"), np.asarray(columns["speed"])
    placed = along_edges(Edges(edges, vehicle.code, np.asarray(columns["time_s"]), np.asarray(columns["s_m"]), speed))
    columns["s_m"] = placed.s_m
    if placed.road is not None:
        columns["road"] = placed.road
    gap = columns.pop("gap_m", None)
    if "length_m" not in columns:
        columns["length_m"], note = _lengths(columns, gap)
        about = about.noting(note)
    about = replace(about.noting(placed.note), ring_m=placed.ring_m)
    return put_together(columns, about, choices, reference="front")


def _on_an_edge(columns: dict[str, Array | Labels], edges: Labels, path: Path) -> dict[str, Array | Labels]:
    """The rows of vehicles that are on an edge; others wait for a place, or are persons."""
    on_edge = edges.code >= 0
    if not on_edge.any():
        raise InputError(f"{path}: no vehicle is on an edge; write the file with the attribute lane")
    if on_edge.all():
        return columns
    return {name: column[on_edge] for name, column in columns.items()}


def _edges(lane: Labels | Array | None, edge: Labels | Array | None, path: Path) -> tuple[Labels, Labels]:
    """Edge and number of the lane of each row, (R,), from names of lanes like ``E1_0``, or else of edges."""
    if not isinstance(lane, Labels):
        assert isinstance(edge, Labels)
        return edge, Labels(np.full(len(edge), -1, dtype=np.int32), ())
    edges, numbers = _of_lanes(lane, path)
    if isinstance(edge, Labels) and (edges.code < 0).any():
        texts = (*edges.text, *edge.text)
        edges = labels(
            np.where(edges.code < 0, np.where(edge.code < 0, -1, edge.code + len(edges.text)), edges.code), texts
        )
    return edges, numbers


def _of_lanes(lane: Labels, path: Path) -> tuple[Labels, Labels]:
    """Edge and number of the lane of each row, (R,), from names of lanes."""
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
            if name == "vehicle" or (code >= 0).any():
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


def _is_xml(head: bytes, path: Path) -> bool:
    return has_root(head, path, "fcd-export")


def _recognise(head: bytes, path: Path) -> bool:
    if _is_xml(head, path):
        return True
    sheet = sheet_of(path, head)
    return sheet is not None and sheet.has("timestep_time", "vehicle_id", "vehicle_pos", "vehicle_speed")


FORMAT = tracks_format(
    name="sumo",
    suffixes=(".xml", ".csv", ".parquet"),
    recognise=_recognise,
    tracks=read_sumo,
    summary="floating car data of SUMO as XML, CSV or Parquet: lanes on edges that follow one another",
)
