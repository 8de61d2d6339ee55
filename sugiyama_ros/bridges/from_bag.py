"""Tracks from a bag of what a perception has seen: each vehicle at its own times becomes rows at regular times."""

import math
from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path
from statistics import median_low
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.bridges.fields import NS, Bridge
from sugiyama_ros.bridges.frames import Frames
from sugiyama_ros.bridges.perception import (
    RATES_DIFFER,
    TF_TOPICS,
    TF_TYPES,
    Counts,
    Numbers,
    PerceptionSettings,
    lane_numbers,
)
from sugiyama_ros.bridges.registry import BRIDGES
from sugiyama_ros.bridges.sightings import (
    Collector,
    Sightings,
    Stamps,
    Transforms,
    brought,
    check_followed,
    directed,
    recordings,
)
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.cdr import ros2_name, why_unreadable
from sugiyama_ros.formats.mcap_reader import BagSource
from sugiyama_ros.formats.reading import checksum_of, shown_name
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import LONGEST_ABSENCE_S, assemble
from sugiyama_ros.trajectories.centre_line import RoadLanes
from sugiyama_ros.trajectories.jumps import jumps_noted
from sugiyama_ros.trajectories.leaders import TICK_S
from sugiyama_ros.trajectories.placing import Placer, SeenVehicle
from sugiyama_ros.trajectories.time_base import LONGEST_HOLE_S, nearly
from sugiyama_ros.trajectories.tracks import FREE, NOBODY, UNKNOWN, Tracks

# Periods of a vehicle that make a hole in its track, and sightings from which its period follows.
_PERIODS, _FEW = 1.5, 3
# Steps whose leaders are found at once.
_AT_ONCE = 2000


class _Grid(NamedTuple):
    """Regular times: stamp [ns] of the first, and time [s] between two."""

    first_ns: int
    period_s: float


class _Rows(NamedTuple):
    """R rows of vehicles on the road: step, vehicle, lane, positions [m] along and across, length [m], and leader.

    ``leader`` is the number of a vehicle, `FREE` or `UNKNOWN`.
    """

    step: Ints
    vehicle: Ints
    lane: Ints
    s_m: Array
    d_m: Array
    length_m: Array
    leader: Ints


class _Lost(NamedTuple):
    """What became of sightings: rows beside the road, sightings without a neighbour, interpolated rows, and holes."""

    beside: int
    alone: int
    interpolated: int
    holes: int


def _own_periods(found: Sightings) -> list[float]:
    """Usual time [s] between two sightings of each vehicle, from the shortest to the longest."""
    periods = []
    for rows in found.steps():
        step = np.diff(found.stamp_ns[rows]) / NS
        if len(step) >= _FEW - 1:
            periods.append(float(np.median(step)))
    return sorted(periods)


def _usual_period(periods: list[float]) -> float:
    """The period [s] that most vehicles have, as a round number if it nearly is one."""
    return nearly(median_low(periods))


def _rates_noted(periods: list[float], period_s: float) -> str:
    """A warning where vehicles are seen at rates that differ, or less often than there are rows; empty otherwise."""
    if not periods or max(periods[-1] / periods[0], periods[-1] / period_s) <= RATES_DIFFER:
        return ""
    return (
        f"warning: vehicles were seen every {periods[0]:.3g} to {periods[-1]:.3g} s; in rows every {period_s:.3g} s,"
        " positions in between are interpolated; --period sets another time"
    )


class _AtSteps(NamedTuple):
    """Where vehicles are at the times of a grid: step, vehicle, position (x, y) [m], heading [rad] and length [m]."""

    step: Ints
    vehicle: Ints
    x_m: Array
    y_m: Array
    heading: Array
    length_m: Array


def _rows_of(found: Sightings, grid: _Grid, placer: Placer) -> tuple[_Rows, _Lost]:
    """Rows at the times of a grid, interpolated between the sightings of each vehicle.

    A hole in which a vehicle was not seen for more than 0.5 s, or one and a half of its own periods if that is more,
    stays a hole. A vehicle may drive on in its hole, and for a minute before and after it was seen: whoever would have
    it as leader has an unknown leader.
    """
    parts, alone, interpolated, holes = [], 0, 0, 0
    for rows in found.steps():
        time_s = (found.stamp_ns[rows] - grid.first_ns) / NS
        step_s = np.diff(time_s)
        longest_s = max(LONGEST_HOLE_S, _PERIODS * float(np.median(step_s)) if len(step_s) else 0.0)
        ends = np.flatnonzero(step_s > longest_s) + 1
        holes += len(ends)
        for piece in np.split(np.arange(len(rows)), ends):
            part, off_s = _at_steps(found, rows[piece], time_s[piece], grid.period_s)
            alone += len(piece) == 1 and not len(part.step)
            interpolated += int(np.sum(off_s > TICK_S))
            parts.append(part)
    joined: list[Any] = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    in_time = np.argsort(joined[0], kind="stable")
    table = _AtSteps(*[column[in_time] for column in joined])
    on_road, lane, s_m, d_m = _placed(table, found.vehicles, placer)
    leader = np.full(len(on_road), UNKNOWN, dtype=np.int64)
    leader[on_road] = _leaders(table, on_road, lane, s_m, grid.period_s, placer.road)
    columns: list[Any] = [table.step, table.vehicle, lane, s_m, d_m, table.length_m, leader]
    return _Rows(*[column[on_road] for column in columns]), _Lost(int((~on_road).sum()), alone, interpolated, holes)


def _at_steps(found: Sightings, rows: Ints, time_s: Array, period_s: float) -> tuple[_AtSteps, Array]:
    """A piece of a vehicle's track at the steps of a grid, and the time [s] from each to the nearest sighting."""
    near = TICK_S / period_s
    step = np.arange(math.ceil(time_s[0] / period_s - near), math.floor(time_s[-1] / period_s + near) + 1)
    at_s = np.clip(step * period_s, time_s[0], time_s[-1])
    right = np.clip(np.searchsorted(time_s, at_s), 0, len(time_s) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(at_s - time_s[left] < time_s[right] - at_s, left, right)
    x, y = found.x_m[rows], found.y_m[rows]
    if len(rows) > 1:
        x, y = (CubicHermiteSpline(time_s, v, np.gradient(v, time_s))(at_s) for v in (x, y))
    else:
        x, y = x[nearest], y[nearest]
    own = rows[nearest]
    table = _AtSteps(step, found.vehicle[own], x, y, found.heading[own], found.length_m[own])
    return table, np.abs(at_s - time_s[nearest])


def _placed(table: _AtSteps, names: tuple[str, ...], placer: Placer) -> tuple[Mask, Ints, Array, Array]:
    """Whether each row is on the road (R,), its lane, and its positions along and across [m]."""
    count = len(table.step)
    on_road, lane = np.zeros(count, dtype=bool), np.full(count, -1, dtype=np.int64)
    s_m, d_m = np.full(count, np.nan), np.full(count, np.nan)
    starts = np.flatnonzero(np.diff(table.step, prepend=-(1 << 62)))
    for first, last in zip(starts.tolist(), [*starts[1:].tolist(), count], strict=True):
        rows = {names[table.vehicle[row]]: row for row in range(first, last)}
        seen = [SeenVehicle(0, n, table.x_m[r], table.y_m[r], table.heading[r]) for n, r in rows.items()]
        for one in placer.place(seen):
            row = rows[one.seen.name]
            on_road[row], lane[row], s_m[row], d_m[row] = True, one.lane, one.s_m, one.d_m
    return on_road, lane, s_m, d_m


class _Ghost(NamedTuple):
    """A vehicle that may be on the road without a row: steps from ``first`` to before ``last``, lane, and position.

    The position [m] is ``s_m`` at the step ``first``, and grows by ``way_m`` [m] with each step.
    """

    first: int
    last: int
    lane: int
    s_m: float
    way_m: float

    def within(self, begin: int, end: int) -> tuple[Ints, Array]:
        """Steps of a block, and positions [m] at them."""
        steps: Ints = np.arange(max(self.first, begin), min(self.last, end), dtype=np.int64)
        return steps, self.s_m + self.way_m * (steps - self.first).astype(np.float64)


def _leaders(table: _AtSteps, on_road: Mask, lane: Ints, s_m: Array, period_s: float, road: Road) -> Ints:
    """Leader of each row on the road: the next vehicle ahead on its lane, `UNKNOWN` where another may be between."""
    ghosts = sorted(_ghosts(table, on_road, lane, s_m, round(LONGEST_ABSENCE_S / period_s), road))
    step, vehicle = table.step[on_road], table.vehicle[on_road]
    lane, s_m = lane[on_road], s_m[on_road]
    leader = np.full(len(step), FREE, dtype=np.int64)
    for begin in range(int(step[0]), int(step[-1]) + 1, _AT_ONCE) if len(step) else ():
        here = np.arange(*np.searchsorted(step, (begin, begin + _AT_ONCE)))
        more = [ghost.within(begin, begin + _AT_ONCE) for ghost in ghosts]
        all_step = np.concatenate([step[here], *(steps for steps, _ in more)])
        all_lane = np.concatenate(
            [lane[here], *(np.full(len(k), g.lane) for g, (k, _) in zip(ghosts, more, strict=True))]
        )
        all_s = np.concatenate([s_m[here], *(road.wrap(positions) for _, positions in more)])
        name = np.concatenate([vehicle[here], np.full(len(all_step) - len(here), UNKNOWN)])
        ahead = _next_ahead(all_step, all_lane, all_s, road.is_ring)
        leader[here] = np.where(ahead >= 0, name[ahead], FREE)[: len(here)]
    return leader


def _next_ahead(step: Ints, lane: Ints, s_m: Array, is_ring: bool) -> Ints:
    """Number of the next entry ahead at the same step on the same lane (N,); -1 for none."""
    order = np.lexsort((s_m, lane, step))
    last = np.ones(len(order), dtype=bool)
    last[:-1] = (np.diff(step[order]) != 0) | (np.diff(lane[order]) != 0)
    ahead = np.roll(order, -1)
    first = np.flatnonzero(np.roll(last, 1))
    ahead[last] = order[first] if is_ring else -1
    ahead[ahead == order] = -1
    found = np.empty(len(order), dtype=np.int64)
    found[order] = ahead
    return found


def _ghosts(table: _AtSteps, on_road: Mask, lane: Ints, s_m: Array, most: int, road: Road) -> Iterator[_Ghost]:
    """Where vehicles may be that have no row: in their holes, and before and after they were seen."""
    order = np.lexsort((table.step, table.vehicle))
    for rows in np.split(order, np.flatnonzero(np.diff(table.vehicle[order])) + 1):
        step, there = table.step[rows], on_road[rows]
        way = road.difference(s_m[rows[1:]], s_m[rows[:-1]]) / np.diff(step)
        way = np.where(np.isfinite(way), way, 0.0)
        # the way with each step, before and after each row
        before, after = np.append(way[:1], way), np.append(way, way[-1:])
        if not len(way):
            before = after = np.zeros(1)
        for k in range(-1, len(rows)):
            left, right = k >= 0 and bool(there[k]), k + 1 < len(rows) and bool(there[k + 1])
            start = int(step[k]) + 1 if k >= 0 else int(step[0]) - most
            end = int(step[k + 1]) if k + 1 < len(rows) else int(step[-1]) + most + 1
            if start >= end:
                continue
            if left:
                ahead = float(after[k] if right else before[k])
                last = min(end, start + most)
                yield _Ghost(start, last, int(lane[rows[k]]), float(s_m[rows[k]]) + ahead, ahead)
            elif right:
                back, begin = float(after[k + 1]), max(start, end - most)
                yield _Ghost(begin, end, int(lane[rows[k + 1]]), float(s_m[rows[k + 1]]) - back * (end - begin), back)


_OF_ROWS = ("s_m", "d_m", "length_m")
_LEADERS = {FREE: NOBODY, UNKNOWN: None}
# Messages that show which frames move.
_SOME = 1000


def tracks_of_bag(
    path: Path, pattern: str, lanes: RoadLanes, settings: PerceptionSettings, bridge: Bridge | None = None
) -> Tracks:
    """Read what a perception has seen from a bag.

    pattern: pattern of the topics' names, such as ``/car*/odom``. Raises InputError.
    """
    bag = BagSource(path)
    known = BRIDGES | ({bridge.type: bridge} if bridge is not None else {})
    bridges = _topics(bag, pattern, known)
    counts = Counts()
    sightings = _collected(bag, bridges, counts)
    stamps = Stamps(path, bridges)
    parts = [stamps.corrected(part) for part in recordings(sightings) if len(part)]
    _check_frames(bag, sightings, settings.frame)
    if settings.frame:
        for k, part in enumerate(parts):
            parts[k], unknown = brought(part, _transforms(bag), settings.frame)
            counts.unknown_frame += unknown
    check_followed(path, parts)
    if not any(map(len, parts)):
        raise InputError(
            f"{path}: no transform leads from {', '.join(sightings.frames)} to {settings.frame} when vehicles are seen;"
            " check --frame, and record /tf and /tf_static"
        )
    columns, lost, notes = _columns([directed(part) for part in parts if len(part)], lanes, settings)
    about = _about(path, bag.files[0], lanes, counts, lost)
    about = about.without("second sighting at the same time", stamps.repeated).noting(*stamps.notes, *notes)
    if not len(columns["s_m"]):
        raise InputError(
            f"{path}: no vehicle is on the road ({lost.beside} rows beside it); check the centre line and its frame"
        )
    tracks = assemble(columns, about, checked=False)
    return replace(tracks, about=tracks.about.noting(jumps_noted(tracks)))


def _collected(bag: BagSource, bridges: dict[str, Bridge], counts: Counts) -> Sightings:
    """All that the topics say of vehicles. Raises InputError where they say nothing that can be used."""
    collector = Collector(bag.path, counts)
    for message in bag.messages(bridges):
        if isinstance(message.message, bytes):
            raise InputError(f"{bag.path}: {message.topic}: {bag.undecoded[message.topic]}")
        collector.add(message, bridges[message.topic])
    sightings = collector.all()
    if not len(sightings):
        raise InputError(f"{bag.path}: no vehicle in the messages of {', '.join(bridges)}; check --odometry")
    return sightings


def _topics(bag: BagSource, pattern: str, known: dict[str, Bridge]) -> dict[str, Bridge]:
    """The bridge of each topic that is wanted. Raises InputError if there is none."""
    topics = bag.info().topics
    kinds = {topic.name: ros2_name(topic.type) for topic in topics if topic.count and fnmatchcase(topic.name, pattern)}
    found = {name: known[kind] for name, kind in kinds.items() if kind in known}
    if found:
        return found
    for topic in topics:
        if topic.name in kinds and (why := why_unreadable(topic.serialization)):
            raise InputError(f"{bag.path}: {topic.name}: {why}")
    if kinds:
        other = ", ".join(f"{name} is {kind or 'of no type'}" for name, kind in list(kinds.items())[:3])
        raise InputError(f"{bag.path}: {other}; known are {', '.join(sorted(known))}; give a --bridge for another type")
    have = ", ".join(topic.name for topic in topics[:5] if topic.count) or "none with messages"
    raise InputError(f"{bag.path}: no topic {pattern}; it has {have}; see `sugiyama info {bag.path}`")


def _transforms(bag: BagSource) -> Iterator[Transforms]:
    """Transforms of a bag; the static ones first, since they hold from the beginning."""
    topics = {topic.name for topic in bag.info().topics if topic.count and ros2_name(topic.type) in TF_TYPES}
    for static in (True, False):
        wanted = {name for name in topics if TF_TOPICS.get(name) is static}
        for message in bag.messages(wanted) if wanted else ():
            if isinstance(message.message, bytes):
                raise InputError(f"{bag.path}: {message.topic}: {bag.undecoded[message.topic]}")
            yield Transforms(message.message, static, message.log_time_ns)


def _check_frames(bag: BagSource, sightings: Sightings, frame: str) -> None:
    """Raise InputError where positions are in several frames, or in one that moves, and no frame is given."""
    names = [name for name in sightings.frames if name]
    if frame or not names:
        return
    known = Frames()
    for transforms in islice(_transforms(bag), _SOME):
        known.add(transforms.message, transforms.static)
    cure = "; give --frame, the frame of the centre line"
    if moving := [name for name in names if known.is_moving(name)]:
        raise InputError(f"{bag.path}: positions are in {moving[0]}, which moves{cure}")
    if len(names) > 1:
        raise InputError(
            f"{bag.path}: positions are in several frames ({', '.join(names[:5])}){cure}, or a --bridge with"
            " `frame: ''` if they are the same"
        )


def _columns(
    parts: list[Sightings], lanes: RoadLanes, settings: PerceptionSettings
) -> tuple[dict[str, Any], _Lost, list[str]]:
    """Columns of tracks, what was lost, and notes."""
    periods = sorted(period for part in parts for period in _own_periods(part))
    period_s = settings.period_s or _usual_period(periods)
    numbers, number = Numbers(), lane_numbers(lanes)
    texts = ("recording", "vehicle", "lane", "leader")
    columns: dict[str, list[Any]] = {name: [] for name in (*_OF_ROWS, "time_s", *texts)}
    losts = []
    for k, part in enumerate(parts):
        grid = _Grid(int(part.stamp_ns.min()), period_s)
        rows, lost = _rows_of(part, grid, Placer(lanes))
        losts.append(lost)
        for name in _OF_ROWS:
            columns[name].extend(getattr(rows, name).tolist())
        name_of = {v: str(numbers(part.vehicles[v])) for v in dict.fromkeys(part.vehicle.tolist())}
        columns["time_s"].extend((1e-9 * (grid.first_ns + np.round(rows.step * (period_s * 1e9)))).tolist())
        columns["recording"].extend([str(k + 1)] * len(rows.step))
        columns["vehicle"].extend(name_of[v] for v in rows.vehicle.tolist())
        columns["lane"].extend(str(number[lane]) for lane in rows.lane.tolist())
        columns["leader"].extend(_LEADERS.get(v) if v < 0 else name_of[v] for v in rows.leader.tolist())
    lost = _Lost(*(sum(values) for values in zip(*losts, strict=True)))
    made = {name: np.array(values) if name not in texts else values for name, values in columns.items()}
    return made, lost, [_rates_noted(periods, period_s), *_notes(lost, len(columns["s_m"]), len(parts))]


def _notes(lost: _Lost, rows: int, parts: int) -> Iterator[str]:
    if lost.interpolated:
        yield f"{100.0 * lost.interpolated / (rows + lost.beside):.3g} % of the positions are interpolated"
    if lost.holes:
        yield (
            f"{lost.holes} times a vehicle was not seen for more than 0.5 s and 1.5 of its periods; whoever followed"
            " it then has an unknown leader"
        )
    if parts > 1:
        yield f"warning: time begins anew {parts - 1} times, as in a simulation that is reset; each part is a recording"


def _about(path: Path, first: Path, lanes: RoadLanes, counts: Counts, lost: _Lost) -> About:
    """Where the tracks come from, and what was left out."""
    about = About(
        leaders="given",
        ring_m=lanes.road.circumference_m,
        view="whole",
        source=shown_name(path),
        sha256=checksum_of(first),
    )
    for reason, rows in (
        ("beside the road", lost.beside + counts.beside),
        ("without a transform to the frame", counts.unknown_frame),
        ("without an id", counts.unnamed),
        ("with the id of another one", counts.doubled),
        ("seen once, between two times", lost.alone),
    ):
        about = about.without(reason, rows)
    return about
