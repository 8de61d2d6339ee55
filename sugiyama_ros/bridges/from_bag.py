"""Tracks from a bag of what a perception has seen: each vehicle at its own times becomes rows at regular times."""

import math
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from heapq import merge
from itertools import islice
from operator import itemgetter
from pathlib import Path
from statistics import median_low
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.bridges.bridge import BRIDGES, NS, Bridge
from sugiyama_ros.bridges.frames import TF_TOPICS, TF_TYPE, Frames
from sugiyama_ros.bridges.perception import (
    BACK_IN_A_ROW,
    BACK_NS,
    MOST_LOST,
    MOVING,
    RATES_DIFFER,
    Counts,
    Intake,
    Numbers,
    PerceptionSettings,
    lane_numbers,
)
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.cdr import ros2_name, why_unreadable
from sugiyama_ros.formats.mcap_reader import Bag, BagMessage
from sugiyama_ros.formats.reading import checksum_of, shown_name
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import LONGEST_ABSENCE_S, assemble
from sugiyama_ros.trajectories.centre_line import RoadLanes
from sugiyama_ros.trajectories.dense import MAX_SAMPLES
from sugiyama_ros.trajectories.jumps import jumps_noted
from sugiyama_ros.trajectories.kinds import drivers_only
from sugiyama_ros.trajectories.labels import Labels, labels, same_label
from sugiyama_ros.trajectories.leaders import MOST_UNSEEN, TICK_S, find_leaders
from sugiyama_ros.trajectories.placing import Placer, SeenVehicle
from sugiyama_ros.trajectories.time_base import LONGEST_HOLE_S, nearly
from sugiyama_ros.trajectories.tracks import FREE, NOBODY, UNKNOWN, Tracks, starts

# Two resets of vehicles that are logged within this time [ns] are one.
_ONE_RESET_NS = 5 * NS
# A vehicle that is seen less often is not followed, and has no period.
_FEW = 3
# Way [m] that a vehicle goes between two messages, so that they are not of the same time.
_MOVED_M = 0.01
# Clocks that are further apart [s] are set; those that are so far apart are warned of.
_CLOCKS_APART_S, _CLOCKS_DOUBTFUL_S = 1.0, 0.1
# Periods of a vehicle that make a hole in its track.
_PERIODS = 1.5
# A time [ns] after all others.
_END_NS = 1 << 62
# Messages that show which frames move, and the type of transforms in old bags of ROS 1.
_SOME, _OLD_TF_TYPE = 1000, "tf/msg/tfMessage"

# A vehicle as it was seen: as `SeenVehicle`, with numbers for the names; logged at a time [ns].
_ROW = np.dtype(
    [(name, "<i8") for name in ("stamp_ns", "log_ns")]
    + [(name, "<f8") for name in ("x_m", "y_m", "heading", "length_m")]
    + [(name, "<i8") for name in ("vehicle", "topic", "frame", "class")]
)
_PACKED = struct.Struct("<2q4d4q")
_Rows: TypeAlias = NDArray[np.void]
# The names of vehicles, topics, frames and classes, by their numbers.
_Names: TypeAlias = dict[str, tuple[str, ...]]


def tracks_of_bag(
    path: Path, pattern: str, lanes: RoadLanes, settings: PerceptionSettings, bridge: Bridge | None = None
) -> Tracks:
    """Read what a perception has seen from a bag.

    pattern: pattern of the topics' names, such as ``/car*/odom``. Raises InputError.
    """
    counts, notes = Counts(), list[str]()
    with Bag(path) as bag:
        bridges = _topics(bag, pattern, BRIDGES | ({bridge.type: bridge} if bridge is not None else {}))
        sightings, names = _collected(bag, bridges, counts)
        parts = [_stamped(part, names["topic"], bridges, notes) for part in _recordings(sightings)]
        once = [_once(part, names["vehicle"], path) for part in parts]
        _check_frames(bag, names["frame"], settings.frame)
        there = [_in_frame(part, names["frame"], _transforms(bag), settings.frame) for part in once]
    repeated = sum(map(len, parts)) - sum(map(len, once))
    counts.unknown_frame = sum(map(len, once)) - sum(map(len, there))
    _check_followed(path, there)
    there = [_directed(part) for part in there if len(part)]
    if not there:
        raise InputError(
            f"{path}: no transform leads from {', '.join(names['frame'])} to {settings.frame} when vehicles are seen;"
            " check --frame, and record /tf and /tf_static"
        )
    periods = _own_periods(there)
    period_s = settings.period_s or nearly(median_low(periods))
    lost: Counter[str] = Counter()
    regular = [_regular(part, period_s, lost) for part in there]
    placed = [_placed(part, Placer(lanes)) for part in regular]
    on_road = [one.on_road for one in placed]
    lost["beside"] = sum(int((~one).sum()) for one in on_road)
    if not any(one.any() for one in on_road):
        raise InputError(
            f"{path}: no vehicle is on the road ({lost['beside']} rows beside it); check the centre line and its frame"
        )
    notes += [_rates_noted(periods, period_s), *_notes(lost, sum(map(len, regular)), len(there))]
    about = _about(path, bag.files[0], lanes, counts, lost).without("second sighting at the same time", repeated)
    tracks = assemble(_columns(regular, placed, names, lanes), about.noting(*notes), checked=False)
    return drivers_only(replace(tracks, about=tracks.about.noting(jumps_noted(tracks))))


def _topics(bag: Bag, pattern: str, known: dict[str, Bridge]) -> dict[str, Bridge]:
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


def _messages(bag: Bag, topics: Iterable[str]) -> Iterator[BagMessage]:
    """Decoded messages of some topics. Raises InputError where they cannot be decoded."""
    for message in bag.messages(set(topics)):
        if isinstance(message.message, bytes):
            raise InputError(f"{bag.path}: {message.topic}: {bag.undecoded[message.topic]}")
        yield message


def _collected(bag: Bag, bridges: dict[str, Bridge], counts: Counts) -> tuple[_Rows, _Names]:
    """All that the topics say of vehicles, in the order of the log.

    Raises InputError where they say nothing that can be used, and for more than a table may have.
    """
    path, intake, content = bag.path, Intake(counts), bytearray()
    numbers: dict[str, dict[str, int]] = {name: {} for name in ("vehicle", "topic", "frame", "class")}
    for message in _messages(bag, bridges):
        topic, log_ns = message.topic, message.log_time_ns
        try:
            seen = intake.take(message.message, bridges[topic], topic, log_ns)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        for one in seen:
            texts = (one.name, topic, one.frame, one.vehicle_class)
            codes = [known.setdefault(text, len(known)) for known, text in zip(numbers.values(), texts, strict=True)]
            stamp_ns = min(max(one.stamp_ns, -_END_NS), _END_NS)
            content += _PACKED.pack(stamp_ns, log_ns, one.x_m, one.y_m, one.heading, one.length_m, *codes)
        if len(content) > MAX_SAMPLES * _ROW.itemsize:
            raise InputError(f"{path}: more than {MAX_SAMPLES} sightings of vehicles; split the bag")
    for lost, why in ((counts.unnamed, "have no id"), (counts.doubled, "share an id in a message")):
        if lost > MOST_LOST * counts.seen:
            raise InputError(
                f"{path}: {lost} of {counts.seen} detections {why}, so nobody can be followed; give the messages of a"
                " tracker, whose ids stay with the vehicles"
            )
    if not content:
        raise InputError(f"{path}: no vehicle in the messages of {', '.join(bridges)}; check --odometry")
    return np.frombuffer(content, _ROW), {name: tuple(known) for name, known in numbers.items()}


def _by_vehicle(rows: _Rows) -> list[Ints]:
    """Rows of each vehicle, in the order in which they stand."""
    order = np.argsort(rows["vehicle"], kind="stable")
    return np.split(order, np.flatnonzero(np.diff(rows["vehicle"][order])) + 1) if len(rows) else []


# --- stamps


def _recordings(rows: _Rows) -> list[_Rows]:
    """The parts between which time has begun anew, as when a simulation is reset."""
    resets: list[int] = []
    for own in _by_vehicle(rows):
        newest_ns, back = -_END_NS, 0
        for k, stamp_ns in zip(own.tolist(), rows["stamp_ns"][own].tolist(), strict=True):
            back = back + 1 if 0 < stamp_ns < newest_ns - BACK_NS else 0
            if back == 1:
                begin_ns = int(rows["log_ns"][k])
            if back == BACK_IN_A_ROW:
                resets.append(begin_ns)
                newest_ns = stamp_ns
            newest_ns = max(newest_ns, stamp_ns)
    resets.sort()
    first = [at for k, at in enumerate(resets) if not k or at - resets[k - 1] > _ONE_RESET_NS]
    part = np.searchsorted(np.array(first, dtype=np.int64), rows["log_ns"], side="right")
    return [rows[part == k] for k in np.unique(part)]


def _stamped(rows: _Rows, topics: Sequence[str], bridges: dict[str, Bridge], notes: list[str]) -> _Rows:
    """Log times instead of stamps that cannot be right, and one clock for all topics; notes say what was changed."""
    stamp, log = rows["stamp_ns"].copy(), rows["log_ns"]
    same = np.zeros(len(rows), dtype=bool)
    for own in _by_vehicle(rows):
        moved = np.hypot(np.diff(rows["x_m"][own]), np.diff(rows["y_m"][own])) > _MOVED_M
        same[own[1:]] = (np.diff(stamp[own]) == 0) & moved
    for number, topic in enumerate(topics):
        here, name = rows["topic"] == number, bridges[topic].stamp
        zero, many = here & (stamp == 0), int(here.sum())
        if not name:
            continue
        if (unset := zero.sum() > 0.5 * many) or same[here].sum() > MOST_LOST * many:
            stamp[here] = log[here]
            why = "is 0" if unset else "stays the same while vehicles move"
            notes.append(f"warning: {topic}: {name} {why}; the log times count instead")
        elif zero.any():
            stamp[zero] = log[zero] + round(np.median((stamp - log)[here & ~zero]))
            notes.append(f"warning: {topic}: {int(zero.sum())} stamps are 0; the log times count instead")
    offset = _offsets_s((log - stamp) / NS, (log - log.min()) / NS, rows["topic"])
    usual = median_low(offset.values()) if offset else 0.0
    for number, off_s in offset.items():
        topic, late_s = topics[number], off_s - usual
        if abs(late_s) > _CLOCKS_APART_S:
            stamp[rows["topic"] == number] += round(late_s * NS)
            which = "behind" if late_s > 0.0 else "ahead of"
            said = f"its clock is {abs(late_s):.3g} s {which} the others; it was set by the log times"
            notes.append(f"warning: {topic}: {said}")
        elif abs(late_s) > _CLOCKS_DOUBTFUL_S:
            notes.append(
                f"warning: {topic}: recorded {late_s:.3g} s later after its stamps than the others; if its clock is"
                " wrong, give a bridge with `stamp: ''`, which takes the log times"
            )
    rows = rows.copy()
    rows["stamp_ns"] = stamp
    return rows


def _offsets_s(late_s: Array, log_s: Array, topic: Ints) -> dict[int, float]:
    """How much later [s] the messages of each topic are logged after their stamps than those of the first one.

    Topics are compared at the times at which both were logged: a replay that is not in real time moves all of them.
    """
    rows = {number: np.flatnonzero(topic == number) for number in np.unique(topic).tolist()}
    rows = {number: here for number, here in rows.items() if len(here) > BACK_IN_A_ROW}
    if len(rows) < 2:
        return {}
    first = max(rows, key=lambda number: len(rows[number]))
    base = rows.pop(first)
    offset = {first: 0.0}
    for number, here in rows.items():
        both = here[(log_s[here] >= log_s[base[0]]) & (log_s[here] <= log_s[base[-1]])]
        if len(both):
            offset[number] = float(np.median(late_s[both] - np.interp(log_s[both], log_s[base], late_s[base])))
    return offset


def _once(rows: _Rows, vehicles: Sequence[str], path: Path) -> _Rows:
    """One sighting for each vehicle and time, sorted by time. Raises InputError for a vehicle at two places at once."""
    rows = rows[np.lexsort((rows["log_ns"], rows["stamp_ns"], rows["vehicle"]))]
    again = np.zeros(len(rows), dtype=bool)
    again[1:] = (np.diff(rows["stamp_ns"]) == 0) & (np.diff(rows["vehicle"]) == 0)
    apart = again.copy()
    apart[1:] &= np.hypot(np.diff(rows["x_m"]), np.diff(rows["y_m"])) > _MOVED_M
    if apart.sum() > MOST_LOST * len(rows):
        one = rows[np.argmax(apart)]
        raise InputError(
            f"{path}: {vehicles[one['vehicle']]} is at two places at {one['stamp_ns'] / NS:g} s, and so in"
            f" {int(apart.sum())} of {len(rows)} messages; one name stands for several vehicles, or the log times are"
            " wrong as well; record each vehicle with a name or a topic of its own"
        )
    rows = rows[~again]
    return rows[np.argsort(rows["stamp_ns"], kind="stable")]


def _check_followed(path: Path, parts: Sequence[_Rows]) -> None:
    """Raise InputError where most sightings are of vehicles that are seen once or twice: their ids do not stay."""
    often = [len(own) for part in parts for own in _by_vehicle(part)]
    seldom = [number for number in often if number < _FEW]
    if sum(seldom) > 0.5 * sum(often):
        raise InputError(
            f"{path}: {len(seldom)} ids are seen once or twice each, so nobody can be followed; give the messages of a"
            " tracker, whose ids stay with the vehicles"
        )


# --- frames and directions


class _Transforms(NamedTuple):
    """A message with transforms, whether they are static, and its log time [ns]."""

    message: Any
    static: bool
    log_ns: int


def _transforms(bag: Bag) -> Iterator[_Transforms]:
    """Transforms of a bag; the static ones first, since they hold from the beginning."""
    types = (TF_TYPE, _OLD_TF_TYPE)
    topics = {topic.name for topic in bag.info().topics if topic.count and ros2_name(topic.type) in types}
    for static in (True, False):
        wanted = [name for name in topics if TF_TOPICS.get(name) is static]
        for message in _messages(bag, wanted) if wanted else ():
            yield _Transforms(message.message, static, -1 if static else message.log_time_ns)


def _check_frames(bag: Bag, frames: Sequence[str], frame: str) -> None:
    """Raise InputError where positions are in several frames, or in one that moves, and no frame is given."""
    names = [name for name in frames if name]
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


def _in_frame(rows: _Rows, frames: Sequence[str], transforms: Iterator[_Transforms], frame: str) -> _Rows:
    """The sightings that transforms bring into a frame, in the order in which they stand."""
    if not frame:
        return rows
    known, place = Frames(frame), {}
    in_log = np.argsort(rows["log_ns"], kind="stable")
    sightings = (
        (log_ns, partial(known.take, [SeenVehicle(stamp_ns, str(k), x, y, heading, frame=frames[own])]))
        for k, (stamp_ns, log_ns, x, y, heading, _, _, _, own, _) in zip(
            in_log.tolist(), rows[in_log].tolist(), strict=True
        )
    )
    heard = ((one.log_ns, partial(known.hear, one.message, one.static)) for one in transforms)
    for _, act in merge(heard, sightings, key=itemgetter(0)):
        place.update({int(seen.name): (seen.x_m, seen.y_m, seen.heading) for seen in act()})
    kept = sorted(place)
    rows = rows[kept]
    for name, values in zip(("x_m", "y_m", "heading"), zip(*(place[k] for k in kept), strict=True), strict=False):
        rows[name] = values
    return rows


def _directed(rows: _Rows) -> _Rows:
    """The same, with the direction in which a vehicle moves where it does not say in which direction it points."""
    rows = rows.copy()
    for own in _by_vehicle(rows):
        unknown = np.isnan(rows["heading"][own])
        if unknown.any() and len(own) > 1:
            time_s = (rows["stamp_ns"][own] - rows["stamp_ns"][own[0]]) / NS
            vx, vy = np.gradient(rows["x_m"][own], time_s), np.gradient(rows["y_m"][own], time_s)
            fast = unknown & (np.hypot(vx, vy) > MOVING)
            rows["heading"][own[fast]] = np.arctan2(vy, vx)[fast]
    return rows


# --- rows at regular times


def _own_periods(parts: Sequence[_Rows]) -> list[float]:
    """Usual time [s] between two sightings of each vehicle, from the shortest to the longest."""
    each = (part["stamp_ns"][own] for part in parts for own in _by_vehicle(part) if len(own) >= _FEW)
    return sorted(float(np.median(np.diff(stamp_ns) / NS)) for stamp_ns in each)


def _rates_noted(periods: list[float], period_s: float) -> str:
    """A warning where vehicles are seen at rates that differ, or less often than there are rows; empty otherwise."""
    if not periods or max(periods[-1] / periods[0], periods[-1] / period_s) <= RATES_DIFFER:
        return ""
    return (
        f"warning: vehicles were seen every {periods[0]:.3g} to {periods[-1]:.3g} s; in rows every {period_s:.3g} s,"
        " positions in between are interpolated; --period sets another time"
    )


def _regular(rows: _Rows, period_s: float, lost: Counter[str]) -> _Rows:
    """The vehicles at regular times, interpolated between their sightings, vehicle by vehicle.

    A hole in which a vehicle was not seen for more than 0.5 s, or one and a half of its own periods if that is more,
    stays a hole.
    """
    first_ns, parts = int(rows["stamp_ns"].min()), []
    for own in _by_vehicle(rows):
        step_s = np.diff(rows["stamp_ns"][own]) / NS
        longest_s = max(LONGEST_HOLE_S, _PERIODS * float(np.median(step_s)) if len(step_s) else 0.0)
        ends = np.flatnonzero(step_s > longest_s) + 1
        lost["holes"] += len(ends)
        for piece in np.split(own, ends):
            at_steps, off_s = _at_steps(rows[piece], first_ns, period_s)
            lost["alone"] += len(piece) == 1 and not len(at_steps)
            lost["interpolated"] += int(np.sum(off_s > TICK_S))
            parts.append(at_steps)
    return np.concatenate(parts)


def _at_steps(piece: _Rows, first_ns: int, period_s: float) -> tuple[_Rows, Array]:
    """A piece of a vehicle's track at regular times, and the time [s] from each to the nearest sighting."""
    time_s, near = (piece["stamp_ns"] - first_ns) / NS, TICK_S / period_s
    step = np.arange(math.ceil(time_s[0] / period_s - near), math.floor(time_s[-1] / period_s + near) + 1)
    at_s = np.clip(step * period_s, time_s[0], time_s[-1])
    right = np.clip(np.searchsorted(time_s, at_s), 0, len(time_s) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(at_s - time_s[left] < time_s[right] - at_s, left, right)
    rows = piece[nearest]
    if len(piece) > 1:
        for name in ("x_m", "y_m"):
            rows[name] = CubicHermiteSpline(time_s, piece[name], np.gradient(piece[name], time_s))(at_s)
    rows["stamp_ns"] = first_ns + np.round(step * (period_s * NS)).astype(np.int64)
    return rows, np.abs(at_s - time_s[nearest])


class _OnRoad(NamedTuple):
    """Whether each of R rows is on the road (R,); lane, place [m] along and across, and leader of those that are.

    ``leader`` is the number of a vehicle, `FREE` or `UNKNOWN`.
    """

    on_road: Mask
    lane: Ints
    s_m: Array
    d_m: Array
    leader: Ints


def _placed(rows: _Rows, placer: Placer) -> _OnRoad:
    """Put the vehicles on the road, one time after the other."""
    on_road, lane = np.zeros(len(rows), dtype=bool), np.full(len(rows), -1, dtype=np.int64)
    s_m, d_m = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    order = np.argsort(rows["stamp_ns"], kind="stable")
    for now in np.split(order, np.flatnonzero(np.diff(rows["stamp_ns"][order])) + 1) if len(order) else ():
        here = rows[now]
        seen = [
            SeenVehicle(k, str(vehicle), x, y, heading)
            for k, vehicle, x, y, heading in zip(
                now.tolist(), *(here[name].tolist() for name in ("vehicle", "x_m", "y_m", "heading")), strict=True
            )
        ]
        for one in placer.place(seen):
            row = one.seen.stamp_ns
            on_road[row], lane[row], s_m[row], d_m[row] = True, one.lane, one.s_m, one.d_m
    leader = _leaders(rows, on_road, lane, s_m, placer.road) if on_road.any() else np.zeros(0, dtype=np.int64)
    return _OnRoad(on_road, lane[on_road], s_m[on_road], d_m[on_road], leader)


def _leaders(rows: _Rows, on_road: Mask, lane: Ints, s_m: Array, road: Road) -> Ints:
    """Leader of each row on the road: the next vehicle ahead on its lane, `UNKNOWN` where another may be between.

    A vehicle may drive on in its hole, and for a minute before and after it was seen, but not where it was seen beside
    the road. So it gets more rows there, one a second or one a period, which lead nobody. Raises InputError.
    """
    at = np.flatnonzero(on_road)
    vehicle, time_s, s_m = rows["vehicle"][at], (rows["stamp_ns"][at] - rows["stamp_ns"].min()) / NS, s_m[at]
    step_s = np.diff(time_s)
    goes_on = (np.diff(vehicle) == 0) & (np.diff(at) == 1) & (step_s <= LONGEST_ABSENCE_S)
    speed = np.where(goes_on, road.difference(s_m[1:], s_m[:-1]) / np.where(goes_on, step_s, 1.0), 0.0)
    speed = np.where(np.append(goes_on, False), np.append(speed, 0.0), np.append(0.0, speed))
    same = np.diff(rows["vehicle"]) == 0
    before = np.append(True, ~goes_on) & ~np.append(False, same & ~on_road[:-1])[at]
    after = np.append(~goes_on, True) & ~np.append(same & ~on_road[1:], False)[at]
    period_s = float(np.min(step_s[goes_on], initial=1.0))
    each_s = max(1.0 // period_s, 1.0) * period_s
    many = int(LONGEST_ABSENCE_S / each_s)
    if LONGEST_ABSENCE_S / period_s * (before.sum() + after.sum()) > MOST_UNSEEN:
        raise InputError("too many vehicles come and go to find their leaders; split the bag")
    count = 1 + many * before + many * after
    of = np.repeat(np.arange(len(at)), count)
    away_s = each_s * (np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count) - many * before[of])
    tracks = Tracks(
        recording=same_label(len(of), ""),
        vehicle=same_label(len(of), ""),
        time_s=time_s[of] + away_s,
        s_m=road.wrap(s_m[of] + speed[of] * away_s),
        leader_row=np.full(len(of), UNKNOWN, dtype=np.int64),
        start=starts(np.concatenate(([0], np.cumsum(~goes_on)))[of]),
        length_m=np.zeros(len(of)),
        about=About(view="whole", ring_m=road.circumference_m),
        lane=labels(lane[at][of], map(str, range(int(lane.max()) + 1))),
    )
    found = find_leaders(tracks)[away_s == 0.0]
    return np.where(found < 0, found, np.where(away_s[found] == 0.0, vehicle[of[found]], UNKNOWN))


def _columns(
    regular: Sequence[_Rows], placed: Sequence[_OnRoad], names: _Names, lanes: RoadLanes
) -> dict[str, Labels | Array]:
    """Columns of tracks."""
    rows = np.concatenate([part[one.on_road] for part, one in zip(regular, placed, strict=True)])
    lane, s_m, d_m, leader = (np.concatenate(columns) for columns in zip(*(one[1:] for one in placed), strict=True))
    number = Numbers()
    first_seen = np.concatenate([part[np.argsort(part["stamp_ns"], kind="stable")]["vehicle"] for part in regular])
    for vehicle in dict.fromkeys(first_seen.tolist()):
        number(names["vehicle"][vehicle])
    vehicles, nobody = [str(number(name)) for name in names["vehicle"]], len(names["vehicle"])
    kind = np.where(np.array([bool(name) for name in names["class"]])[rows["class"]], rows["class"], -1)
    part = np.repeat(np.arange(len(placed)), [int(one.on_road.sum()) for one in placed])
    columns: dict[str, Labels | Array] = {"class": labels(kind, names["class"])} if any(names["class"]) else {}
    return columns | {
        "recording": labels(part, [str(k + 1) for k in range(len(placed))]),
        "vehicle": labels(rows["vehicle"], vehicles),
        "lane": labels(lane, map(str, lane_numbers(lanes))),
        "leader": labels(np.where(leader == FREE, nobody, np.maximum(leader, -1)), [*vehicles, NOBODY]),
        "time_s": 1e-9 * rows["stamp_ns"],
        "s_m": s_m,
        "d_m": d_m,
        "length_m": rows["length_m"],
    }


def _notes(lost: Counter[str], rows: int, parts: int) -> Iterator[str]:
    if lost["interpolated"]:
        yield f"{100.0 * lost['interpolated'] / rows:.3g} % of the positions are interpolated"
    if lost["holes"]:
        yield (
            f"{lost['holes']} times a vehicle was not seen for more than 0.5 s and 1.5 of its periods; whoever followed"
            " it then has an unknown leader"
        )
    if parts > 1:
        yield f"warning: time begins anew {parts - 1} times, as in a simulation that is reset; each part is a recording"


def _about(path: Path, first: Path, lanes: RoadLanes, counts: Counts, lost: Counter[str]) -> About:
    """Where the tracks come from, and what was left out."""
    about = About(
        leaders="given",
        ring_m=lanes.road.circumference_m,
        view="whole",
        source=shown_name(path),
        sha256=checksum_of(first),
    )
    for reason, rows in (
        ("beside the road", lost["beside"] + counts.beside),
        ("without a transform to the frame", counts.unknown_frame),
        ("without an id", counts.unnamed),
        ("with the id of another one", counts.doubled),
        ("seen once, between two times", lost["alone"]),
    ):
        about = about.without(reason, rows)
    return about
