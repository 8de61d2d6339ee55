"""Conversion of files and folders to tables of tracks and to bags."""

from dataclasses import dataclass, field
from pathlib import Path

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Target, output_of
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.mcap_writer import BagWriter
from sugiyama_ros.formats.measured import channels_of, messages
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.trajectories.dense import DenseTracks, check_jumps, one_road
from sugiyama_ros.trajectories.time_base import on_time_base, period_of
from sugiyama_ros.trajectories.tracks import Tracks


def write_bag(trajectories: DenseTracks, target: Target) -> None:
    """Write a bag with the topics /road and /measured. Stamps and log times are the times of the samples."""
    about = {"source": trajectories.source, "sha256": trajectories.sha256}
    with BagWriter(target, about) as bag:
        channels = channels_of(bag, trajectories)
        for type_name, stamp, data in messages(trajectories):
            bag.write(channels[type_name], data, stamp, stamp)


@dataclass(frozen=True)
class Part:
    """Which part of a file is wanted, and how the file is read.

    name: name of the format, or "auto"; choices: what the user says about the file, and which rows to keep; period_s:
    time [s] between two samples; the file's own by default.
    """

    name: str = "auto"
    choices: Choices = field(default_factory=Choices)
    period_s: float | None = None


def convert(source: Path, target: Target, part: Part = Part()) -> Tracks:
    """Convert a file or a folder, or a part of it, to tracks; or one lane to a bag with the topics /road and /measured.

    target: ``.parquet``, ``.csv`` or ``.mcap`` to write. Raises InputError, OutputError.
    """
    output = output_of(target)
    output.check()
    suffix = output.path.suffix.lower()
    if suffix not in (".parquet", ".csv", ".mcap"):
        raise InputError(
            f"{output.path}: cannot be written as {suffix or 'nothing'}; give a .parquet, .csv or .mcap name"
        )
    tracks = read_tracks(source, part.choices, part.name)
    if part.period_s is not None:
        tracks = on_time_base(tracks, part.period_s)
    if suffix == ".mcap":
        road = one_road(tracks, str(source))
        check_jumps(tracks, str(source))
        write_bag(road, output)
        return tracks
    if tracks.runs < len(tracks):
        period_of(tracks)  # refuses times of a wrong unit before anything is written
    write_tracks(tracks, output)
    return tracks
