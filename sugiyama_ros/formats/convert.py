"""Conversion of trajectory files to bags, and of files and folders to tables of tracks."""

from dataclasses import dataclass, field
from pathlib import Path

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Target, output_of
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.mcap_writer import LATCHED_TOPIC, BagWriter, Qos
from sugiyama_ros.formats.measured import MEASURED_TYPE, ROAD_TYPE, messages
from sugiyama_ros.formats.registry import read_tracks, read_trajectories
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.trajectories.one_lane import one_lane
from sugiyama_ros.trajectories.selection import Selection, select
from sugiyama_ros.trajectories.time_base import on_time_base, period_of
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories


def convert(source: Path, target: Target, ring_m: float | None = None) -> Trajectories:
    """Convert a trajectory file to a bag with the topics /road and /measured.

    ring_m: circumference [m] of the ring, where the file does not say it; 0 for an open road. Raises InputError,
    OutputError.
    """
    output_of(target).check()
    trajectories = read_trajectories(source, ring_m)
    write_trajectories(trajectories, target)
    return trajectories


def write_trajectories(trajectories: Trajectories, target: Target) -> None:
    """Write a bag with the topics /road and /measured. Stamps and log times are the times of the samples."""
    about = {"source": trajectories.source, "sha256": trajectories.sha256}
    with BagWriter(target, about) as bag:
        channels = {
            ROAD_TYPE: bag.topic("/road", ROAD_TYPE, LATCHED_TOPIC),
            MEASURED_TYPE: bag.topic("/measured", MEASURED_TYPE, Qos()),
        }
        for type_name, stamp, data in messages(trajectories):
            bag.write(channels[type_name], data, stamp, stamp)


@dataclass(frozen=True)
class Part:
    """Which part of a file is wanted, and how the file is read.

    name: name of the format, or "auto"; choices: what the user says about the file; selection: which rows to keep;
    period_s: time [s] between two samples; the file's own by default.
    """

    name: str = "auto"
    choices: Choices = field(default_factory=Choices)
    selection: Selection = field(default_factory=Selection)
    period_s: float | None = None


def convert_tracks(source: Path, target: Target, part: Part) -> Tracks:
    """Convert a file or a folder to tracks, or a part of it on one lane to a bag.

    target: ``.parquet``, ``.csv`` or ``.mcap`` to write. Raises InputError, OutputError.
    """
    out = output_of(target).path
    if out.suffix.lower() not in (".parquet", ".csv", ".mcap"):
        raise InputError(f"{out}: cannot be written as {out.suffix or 'nothing'}; give a .parquet, .csv or .mcap name")
    tracks = select(read_tracks(source, part.choices, part.name), part.selection)
    if part.period_s is not None:
        tracks = on_time_base(tracks, part.period_s)
    if out.suffix.lower() == ".mcap":
        write_trajectories(one_lane(tracks, str(source)), target)
    else:
        if tracks.runs < len(tracks):
            period_of(tracks)  # refuses times of a wrong unit before anything is written
        write_tracks(tracks, target)
    return tracks
