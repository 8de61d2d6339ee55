"""Tracks from a bag of what a perception has seen."""

from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.bridges.fields import Bridge
from sugiyama_ros.bridges.perception import TF_TOPICS, TF_TYPE, Perception, PerceptionSettings, RoadSample
from sugiyama_ros.bridges.registry import BRIDGES
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.bag_folder import bag_files
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.reading import open_input, sha256, shown_name
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import assemble
from sugiyama_ros.trajectories.centre_line import RoadLanes
from sugiyama_ros.trajectories.tracks import NOBODY, Tracks

# Difference [s] between two stamps that makes no difference.
_SAME_S = 1e-3
_COLUMNS = {"s_m": "position_m", "length_m": "length_m", "d_m": "d_m"}


def tracks_of_bag(
    path: Path, pattern: str, lanes: RoadLanes, settings: PerceptionSettings, bridge: Bridge | None = None
) -> Tracks:
    """Read what a perception has seen from a bag.

    Parameters
    ----------
    path : Path
        MCAP file, or directory of rosbag2 with MCAP files.
    pattern : str
        Pattern of the topics' names, such as ``/car*/odom``.
    lanes : RoadLanes
        The road.
    settings : PerceptionSettings
        How vehicles are seen.
    bridge : Bridge, optional
        Bridge for a type of message that has none.

    Returns
    -------
    Tracks
        The vehicles on the road, with their lanes and leaders.

    Raises
    ------
    InputError
        Where the bag cannot be read, or has no such topics.
    """
    files = bag_files(path)
    known = BRIDGES | ({bridge.type: bridge} if bridge is not None else {})
    perception = Perception(lanes, settings)
    samples = [s for s in _samples(path, files, pattern, known, perception) if s.vehicle]
    counts = perception.moments.counts
    if not samples:
        raise InputError(
            f"{path}: no vehicle is on the road ({counts.beside} beside it, {counts.unknown_frame} in unknown frames);"
            " check the centre line and its frame"
        )
    about = _about(path, files[0], perception)
    columns: dict[str, Any] = {
        name: np.array([v for s in samples for v in getattr(s, of)]) for name, of in _COLUMNS.items()
    }
    columns["time_s"] = np.array([1e-9 * s.stamp_ns for s in samples for _ in s.vehicle])
    off_s = max(abs(offset) for s in samples for offset in s.stamp_offset_s)
    if off_s > _SAME_S:
        about = about.noting(f"vehicles were seen up to {off_s:.3f} s before or after the time of their row")
    columns["vehicle"] = [str(v) for s in samples for v in s.vehicle]
    columns["lane"] = [str(v) for s in samples for v in s.lane]
    columns["leader"] = [str(v) if v >= 0 else NOBODY for s in samples for v in s.leader]
    return assemble(columns, about, checked=False)


def _about(path: Path, first: Path, perception: Perception) -> About:
    """Where the tracks come from, and what was left out."""
    counts = perception.moments.counts
    with open_input(first) as stream:
        checksum = sha256(stream)
    about = About(
        leaders="given",
        ring_m=perception.lanes.road.circumference_m,
        view="whole",
        source=shown_name(path),
        sha256=checksum,
    )
    for reason, rows in (
        ("beside the road", counts.beside),
        ("seen too late", counts.late),
        ("in an unknown frame", counts.unknown_frame),
    ):
        about = about.without(reason, rows)
    return about


def _samples(
    path: Path, files: list[Path], pattern: str, known: dict[str, Bridge], perception: Perception
) -> Iterator[RoadSample]:
    """Samples of the road from all files of a bag."""
    heard = False
    for file in files:
        with Bag(file) as bag:
            kinds = {topic.name: topic.type for topic in bag.info().topics if topic.count}
            wanted = {name for name, kind in kinds.items() if kind in known and fnmatchcase(name, pattern)}
            heard = heard or bool(wanted)
            transforms = {name for name, kind in kinds.items() if name in TF_TOPICS and kind == TF_TYPE}
            for topic, kind, _, message in bag.messages(wanted | transforms) if wanted else ():
                if topic in transforms:
                    perception.frames.add(message, static=TF_TOPICS[topic])
                else:
                    yield from perception.take(message, known[kind], topic)
    if not heard:
        raise InputError(f"{path}: no topic {pattern} of a type that is known; known are {', '.join(sorted(known))}")
    yield from perception.rest()
