"""Tracks from a bag of what a perception has seen."""

from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.bridges.fields import Bridge
from sugiyama_ros.bridges.frames import Frames
from sugiyama_ros.bridges.moments import Counts, Numbers
from sugiyama_ros.bridges.on_grid import Grid, Lost, own_periods, rates_noted, rows_of, usual_period
from sugiyama_ros.bridges.perception import TF_TOPICS, TF_TYPES, PerceptionSettings, lane_numbers
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
from sugiyama_ros.formats.reading import open_input, sha256, shown_name
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import assemble
from sugiyama_ros.trajectories.centre_line import RoadLanes
from sugiyama_ros.trajectories.jumps import jumps_noted
from sugiyama_ros.trajectories.placing import Placer
from sugiyama_ros.trajectories.tracks import FREE, NOBODY, UNKNOWN, Tracks

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
) -> tuple[dict[str, Any], Lost, list[str]]:
    """Columns of tracks, what was lost, and notes."""
    periods = sorted(period for part in parts for period in own_periods(part))
    period_s = settings.period_s or usual_period(periods)
    numbers, number = Numbers(), lane_numbers(lanes)
    texts = ("recording", "vehicle", "lane", "leader")
    columns: dict[str, list[Any]] = {name: [] for name in (*_OF_ROWS, "time_s", *texts)}
    losts = []
    for k, part in enumerate(parts):
        grid = Grid(int(part.stamp_ns.min()), period_s)
        rows, lost = rows_of(part, grid, Placer(lanes))
        losts.append(lost)
        for name in _OF_ROWS:
            columns[name].extend(getattr(rows, name).tolist())
        name_of = {v: str(numbers(part.vehicles[v])) for v in dict.fromkeys(part.vehicle.tolist())}
        columns["time_s"].extend((1e-9 * (grid.first_ns + np.round(rows.step * (period_s * 1e9)))).tolist())
        columns["recording"].extend([str(k + 1)] * len(rows.step))
        columns["vehicle"].extend(name_of[v] for v in rows.vehicle.tolist())
        columns["lane"].extend(str(number[lane]) for lane in rows.lane.tolist())
        columns["leader"].extend(_LEADERS.get(v) if v < 0 else name_of[v] for v in rows.leader.tolist())
    lost = Lost(*(sum(values) for values in zip(*losts, strict=True)))
    made = {name: np.array(values) if name not in texts else values for name, values in columns.items()}
    return made, lost, [rates_noted(periods, period_s), *_notes(lost, len(columns["s_m"]), len(parts))]


def _notes(lost: Lost, rows: int, parts: int) -> Iterator[str]:
    if lost.interpolated:
        yield f"{100.0 * lost.interpolated / (rows + lost.beside):.3g} % of the positions are interpolated"
    if lost.holes:
        yield (
            f"{lost.holes} times a vehicle was not seen for more than 0.5 s and 1.5 of its periods; whoever followed"
            " it then has an unknown leader"
        )
    if parts > 1:
        yield f"warning: time begins anew {parts - 1} times, as in a simulation that is reset; each part is a recording"


def _about(path: Path, first: Path, lanes: RoadLanes, counts: Counts, lost: Lost) -> About:
    """Where the tracks come from, and what was left out."""
    with open_input(first) as stream:
        checksum = sha256(stream)
    about = About(
        leaders="given", ring_m=lanes.road.circumference_m, view="whole", source=shown_name(path), sha256=checksum
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
