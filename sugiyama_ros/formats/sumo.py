"""SUMO's floating car data: XML, and the same as CSV or Parquet."""

import re
from array import array
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import (
    Rows,
    about_file,
    fits,
    need,
    put_together,
    read_columns,
    stacked,
    take,
    text_of,
)
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.on_road import on_road
from sugiyama_ros.formats.reading import attribute, elements, has_root
from sugiyama_ros.formats.sheet import MAX_ROWS, Sheet, head_of, sheet_of
from sugiyama_ros.roads.network import Network
from sugiyama_ros.trajectories.labels import Labels, labels
from sugiyama_ros.trajectories.tracks import Tracks

# Length [m] of vehicles of SUMO, unless their type says otherwise; the files do not say it.
_LENGTH_M = 5.0
_WANTED = {
    "time_s": need("timestep_time", "time"),
    "vehicle": need("vehicle_id", "id"),
    "s_m": need("vehicle_pos", "pos"),
    "lane_name": take("vehicle_lane", "lane"),
    "edge": take("vehicle_edge", "edge"),
    "speed": need("vehicle_speed", "speed"),
    "class": take("vehicle_type", "type"),
    "leader": take("vehicle_leaderID", "leaderID"),
    "gap_m": take("vehicle_leaderGap", "leaderGap"),
    "length_m": take("vehicle_length", "length"),
}
# Name of a lane in a table.
_LANE = re.compile(r'\s*"?[^\s"]+_\d+"?\s*')
_TEXTS = {"vehicle": "id", "lane_name": "lane", "edge": "edge", "class": "type", "leader": "leaderID"}
_NUMBERS = {"s_m": "pos", "speed": "speed"}
# Where vehicles are in the plane: their front bumpers.
_IN_PLANE = {"x_m": "x", "y_m": "y", "angle_m": "angle"}
# How places in the plane are those of the network.
_CURE = "write the file without --fcd-output.geo and --fcd-output.utm, and give the network of this simulation"
# Present only if the user asked SUMO for leaders.
_GAP = "leaderGap"


def _read_sumo(path: Path, choices: Choices) -> Tracks:
    """Read floating car data. Positions on edges become positions along the road that the edges make.

    The mesoscopic model names edges without lanes; then nobody's leader is known.

    path: XML (``--fcd-output``), CSV or Parquet. Raises InputError.
    """
    if choices.network is not None:
        return _on_road(path, choices, choices.network)
    columns = _read(path, {})
    lane, edge = columns.pop("lane_name", None), columns.pop("edge", None)
    if not isinstance(lane, Labels) and not isinstance(edge, Labels):
        raise InputError(f"{path}: no vehicle has a lane or an edge; write the file with the attribute lane")
    about = about_file(path)
    edges, columns["lane"] = _edges(lane, edge, path)
    # others wait for a place, or are persons
    on_edge = edges.code >= 0
    if not on_edge.any():
        raise InputError(f"{path}: no vehicle is on an edge; write the file with the attribute lane")
    columns, edges = {name: column[on_edge] for name, column in columns.items()}, edges[on_edge]
    if (text_of(columns, "lane").code < 0).all():
        about = about.noting(
            "warning: edges have no lanes in the file, as in SUMO's mesoscopic model, so that no leader is known"
        )
    edges = _on_own_edges(columns, edges)
    columns["s_m"], root, ring_m = _along_edges(columns, edges)
    roads, many = len(np.unique(root)), len(edges.text)
    if roads > 1:
        columns["road"] = labels(root[edges.code].astype(np.int32), edges.text)
    gap = columns.pop("gap_m", None)
    if "length_m" not in columns:
        columns["length_m"], note = _lengths(columns, gap, root[edges.code], edges.code.astype(np.int64))
        about = about.noting(note)
    note = f"{many} edges make {roads} road{'s' * (roads > 1)}" * (many > 1)
    about = replace(about.noting(note), ring_m=ring_m if roads == 1 else 0.0)
    return put_together(columns, about, choices, reference="front")


def _read(path: Path, more: dict[str, str]) -> Rows:
    """Columns of a file; ``more`` names further attributes of vehicles, which are numbers. Raises InputError."""
    head = head_of(path)
    if _is_xml(head, path):
        return _of_xml(path, _NUMBERS | more)
    sheet = sheet_of(path, head)
    if sheet is None:
        raise InputError(f"{path}:1: not the columns of SUMO; check the file")
    return read_columns(sheet, _WANTED | {name: need(f"vehicle_{source}", source) for name, source in more.items()})


def _on_road(path: Path, choices: Choices, network: Network) -> Tracks:
    """Vehicles by their places in the plane, on the lanes of a road."""
    columns, about = _read(path, _IN_PLANE), about_file(path)
    # angles count in degrees from north, clockwise
    columns["heading_m"] = np.radians(90.0 - np.asarray(columns.pop("angle_m")))
    lane, edge, gap = (columns.pop(name, None) for name in ("lane_name", "edge", "gap_m"))
    if "length_m" not in columns:
        along = columns
        road: Ints = np.zeros(len(columns["s_m"]), dtype=np.int64)
        lane_of: Ints = road
        if isinstance(lane, Labels) or isinstance(edge, Labels):
            edges, _ = _edges(lane, edge, path)
            s_m, root, _ = _along_edges(columns, edges)
            along, road = columns | {"s_m": s_m}, np.asarray(root[edges.code])
            lane_of = np.asarray((lane if isinstance(lane, Labels) else edges).code, dtype=np.int64)
        columns["length_m"], note = _lengths(along, gap, road, lane_of)
        about = about.noting(note)
    columns.pop("leader", None)
    return put_together(*on_road(columns, network, about, "front", _CURE), choices, reference="front")


def _edges(lane: Labels | Array | None, edge: Labels | Array | None, path: Path) -> tuple[Labels, Labels]:
    """Edge and number of the lane of each row, (R,), from names of lanes like ``E1_0``, or else of edges."""
    if not isinstance(lane, Labels):
        assert isinstance(edge, Labels)
        return edge, Labels(np.full(len(edge), -1, dtype=np.int32), ())
    edges, numbers = _of_lanes(lane, path)
    if isinstance(edge, Labels) and (edges.code < 0).any():
        both = stacked((edges, edge))
        edges = Labels(np.where(edges.code < 0, both.code[len(edges) :], both.code[: len(edges)]), both.text)
    return edges, numbers


def _of_lanes(lane: Labels, path: Path) -> tuple[Labels, Labels]:
    """Edge and number of the lane of each row, (R,), from names of lanes."""
    parts = [text.rpartition("_") for text in lane.text]
    bad = [text for text, (edge, _, number) in zip(lane.text, parts, strict=True) if not edge or not number.isdigit()]
    if bad:
        raise InputError(
            f"{path}: lane {bad[0][:40]!r}: does not end in _ and a number, as SUMO's lanes do; correct it"
        )
    return labels(lane.code, [edge for edge, _, _ in parts]), labels(lane.code, [number for _, _, number in parts])


def _lengths(
    columns: Mapping[str, Array | Labels], gap: Array | Labels | None, road: Ints, lane: Ints
) -> tuple[Array, str]:
    """Lengths [m] of the vehicles of the rows, (R,), and a note on where they come from.

    A vehicle that others follow on a road is as long as the way between two front bumpers is longer than the gap. On
    one lane, or edge, it is sure that they follow: a gap over a junction may be that to somebody who crosses.
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
        told = (ahead >= 0) & (key[row] == wanted) & (road[row] == road[followed]) & (way > 0.0)
        sure = told & (lane[row] == lane[followed])
        for one in np.unique(ahead[told]).tolist():
            own = ahead == one
            length[one] = round(float(np.median(way[sure & own] if (sure & own).any() else way[told & own])), 2)
    known = np.isfinite(length)
    if "class" in columns:
        # a type of vehicles has one length
        kind = text_of(columns, "class").code
        of_vehicle = np.full(len(length), -1)
        of_vehicle[vehicle.code] = kind
        for one in np.unique(of_vehicle[known & (of_vehicle >= 0)]).tolist():
            same = of_vehicle == one
            length[same & ~known] = round(float(np.median(length[same & known])), 2)
    told_of, known = known, np.isfinite(length)
    rest = f"every {'other ' * bool(known.any())}vehicle counts as {_LENGTH_M:g} m long"
    if known.any():
        typed = f", of {sum(known) - sum(told_of)} from others of their type" * bool((known & ~told_of).any())
        note = f"lengths of {told_of.sum()} vehicles follow from the gaps of those behind{typed}"
        note += f"; {rest}" * (not known.all())
    else:
        note = f"lengths are not in the file: {rest}"
    return np.where(known, length, _LENGTH_M)[vehicle.code], note


def _of_xml(path: Path, numbers: Mapping[str, str]) -> Rows:
    """Columns of an XML file, gathered vehicle by vehicle; columns of text that are empty are left out."""
    number = {name: array("d") for name in ("time_s", *numbers, "gap_m")}
    code = {name: array("i") for name in _TEXTS}
    texts: dict[str, dict[str, int]] = {name: {} for name in _TEXTS}
    for step in elements(path, "timestep"):
        time = attribute(step.attrib, "time", f"{path}: timestep")
        for one in step.iter("vehicle"):
            said = one.attrib
            where = f"{path}: vehicle {said.get('id', '')[:40]} at {time:g} s"
            number["time_s"].append(time)
            for name, source in numbers.items():
                number[name].append(attribute(said, source, where))
            number["gap_m"].append(attribute(said, _GAP, where) if _GAP in said else -1.0)
            for name, source in _TEXTS.items():
                text, known = said.get(source, ""), texts[name]
                code[name].append(known.setdefault(text, len(known)) if text else -1)
        if len(number["time_s"]) > MAX_ROWS:
            raise InputError(f"{path}: more than {MAX_ROWS} rows; split the file")
    if not number["time_s"]:
        raise InputError(f"{path}: no samples; write it with sumo --fcd-output")
    columns: Rows = {name: np.frombuffer(values) for name, values in number.items()}
    for name, codes in code.items():
        if name == "vehicle" or texts[name]:
            columns[name] = labels(np.frombuffer(codes, dtype=np.int32), texts[name])
    return columns


def _is_xml(head: bytes, path: Path) -> bool:
    return has_root(head, path, "fcd-export")


def _recognise(head: bytes, path: Path) -> bool:
    if _is_xml(head, path):
        return True
    sheet = sheet_of(path, head)
    if sheet is None or not fits(sheet, _WANTED):
        return False
    # with a plain header, others may mean other things by such names
    return sheet.has("timestep_time", "vehicle_id") or _has_lanes(sheet, head)


def _has_lanes(sheet: Sheet, head: bytes) -> bool:
    """Whether the first row of a table of text is on a lane of SUMO, as E1_0."""
    rows, lane = head.decode("utf-8-sig", errors="replace").splitlines(), sheet.find("lane")
    if sheet.is_parquet or lane is None or len(rows) <= sheet.header:
        return False
    fields = rows[sheet.header].split(sheet.separator)
    place = sheet.names.index(lane)
    return place < len(fields) and _LANE.fullmatch(fields[place]) is not None


FORMAT = Format(
    name="sumo",
    suffixes=(".xml", ".csv", ".parquet"),
    recognise=_recognise,
    read=_read_sumo,
    summary="floating car data of SUMO as XML, CSV or Parquet: lanes on edges that follow one another",
    takes_road=True,
)


# A vehicle that stays away for longer [s] says nothing about how long an edge is.
_LONGEST_STEP_S = 2.0
# Way [m] back on an edge from which on a vehicle drives against its direction.
_FALLS_M = 1.0
# Share of the vehicles that leave an edge for the edge that counts as its next.
_MOST = 0.5


def _on_own_edges(columns: Rows, edges: Labels) -> Labels:
    """Edges of the rows, (R,): a vehicle that overtakes on the opposite edge is on its own edge, but on no lane of it.

    On the opposite edge its position falls: it is the way to the end of its own edge. Both positions add up to the
    length of the edge where the vehicle changes over.
    """
    vehicle, edge, lane = text_of(columns, "vehicle").code, edges.code.copy(), text_of(columns, "lane")
    time_s, position, speed = (np.asarray(columns[name]).copy() for name in ("time_s", "s_m", "speed"))
    order = np.lexsort((time_s, vehicle))
    new = (np.diff(vehicle[order]) != 0) | (np.diff(edge[order]) != 0)
    visits = np.split(order, np.flatnonzero(new) + 1)
    fell = np.array(
        [
            position[own[-1]] < position[own[0]] - _FALLS_M and np.sign(np.diff(position[own])).sum() < 0
            for own in visits
        ]
    )
    code, length = lane.code.copy(), dict[int, list[float]]()
    against: list[tuple[Ints, int, int]] = []
    for k in np.flatnonzero(fell).tolist():
        own, other = visits[k], int(edges.code[visits[k][0]])
        before, after = (visits[j] if 0 <= j < len(visits) and not fell[j] else own for j in (k - 1, k + 1))
        beside = next((one for one in (before, after) if one is not own and vehicle[one[0]] == vehicle[own[0]]), None)
        if beside is None:
            code[own] = -1
            continue
        # the rows on both sides of the change, the earlier one first
        pair = (beside[-1], own[0]) if beside is before else (own[-1], beside[0])
        way = 0.5 * float(speed[list(pair)].sum()) * float(time_s[pair[1]] - time_s[pair[0]])
        both = float(position[list(pair)].sum()) + (way if beside is before else -way)
        length.setdefault(other, []).append(both)
        against.append((own, other, int(edges.code[beside[0]])))
    for own, other, mine in against:
        position[own], edge[own], code[own] = float(np.median(length[other])) - position[own], mine, -1
    columns["s_m"], columns["lane"] = position, labels(code, lane.text)
    return labels(edge, edges.text)


def _along_edges(columns: Rows, edges: Labels) -> tuple[Array, Ints, float]:
    """Put the edges of a road one behind the other.

    The length of an edge is what vehicles say that leave it for the next edge: where they were last, how far they came
    in between, and where they are now. Returns positions [m] of the rows, (R,), the first edge of the road of each
    edge, and the circumference [m] of the last ring, or 0.
    """
    position = np.asarray(columns["s_m"])
    if len(edges.text) == 1:
        return position, np.zeros(1, dtype=np.int64), 0.0
    straight, nexts, lengths = _nexts(columns, edges)
    offset, root, ring_m = _chained(nexts, lengths)
    # Edges inside a crossing, which few vehicles are seen on, end where the next edge begins.
    for edge, name in enumerate(edges.text):
        if name.startswith(":") and (target := int(straight[edge])) >= 0 and root[edge] != root[target]:
            offset[edge], root[edge] = offset[target] - lengths[edge], root[target]
    return position + offset[edges.code], root, ring_m


def _chained(nexts: Ints, lengths: Array) -> tuple[Array, Ints, float]:
    """Where each edge begins on its road [m], the first edge of this road, and the length of the last ring [m]."""
    count = len(nexts)
    offset, root, ring_m = np.zeros(count), np.arange(count), 0.0
    led_to = np.zeros(count, dtype=bool)
    led_to[nexts[nexts >= 0]] = True
    placed = np.zeros(count, dtype=bool)
    # Roads begin where no edge leads in; what is left then are rings, which begin at their first edge.
    for first in [*np.flatnonzero(~led_to).tolist(), *range(count)]:
        edge, place = int(first), 0.0
        while edge >= 0 and not placed[edge]:
            placed[edge], offset[edge], root[edge] = True, place, first
            place += lengths[edge]
            edge = int(nexts[edge])
        if edge == first and place > 0.0:
            ring_m = float(place)
    return offset, root, ring_m


def _nexts(columns: Rows, edges: Labels) -> tuple[Ints, Ints, Array]:
    """The edge that most vehicles go to from each edge (-1 for none), the same where it leads on, and lengths [m]."""
    count, edge, vehicle = len(edges.text), edges.code, text_of(columns, "vehicle").code
    time_s, position, speed = (np.asarray(columns[name]) for name in ("time_s", "s_m", "speed"))
    order = np.lexsort((time_s, vehicle))
    here, there = order[:-1], order[1:]
    step = time_s[there] - time_s[here]
    changed = (vehicle[here] == vehicle[there]) & (edge[here] != edge[there]) & (step <= _LONGEST_STEP_S)
    here, there, step = here[changed], there[changed], step[changed]
    length = position[here] + 0.5 * (speed[here] + speed[there]) * step - position[there]
    nexts, lengths = np.full(count, -1, dtype=np.int64), np.zeros(count)
    for one in range(count):
        from_here = np.flatnonzero(edge[here] == one)
        if len(from_here) == 0:
            continue
        target, times = np.unique(edge[there[from_here]], return_counts=True)
        if times.max() >= _MOST * len(from_here):
            nexts[one] = target[np.argmax(times)]
            to_next = from_here[edge[there[from_here]] == nexts[one]]
            lengths[one] = float(np.median(length[to_next]))
    straight = nexts.copy()
    # Of several edges that lead into one, the one with the most vehicles goes on; the others end there.
    for target in np.unique(nexts[nexts >= 0]).tolist():
        into = np.flatnonzero(nexts == target)
        if len(into) > 1:
            busiest = max(into.tolist(), key=lambda one: int(np.sum((edge[here] == one) & (edge[there] == target))))
            nexts[into[into != busiest]] = -1
    return straight, nexts, lengths
