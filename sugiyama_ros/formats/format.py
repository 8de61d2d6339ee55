"""What a file format declares about itself."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.trajectories.one_lane import one_lane
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Bytes from the start of a file by which a format may recognise it.
HEAD_BYTES = 4096


@dataclass(frozen=True)
class Format:
    """A file format for trajectories.

    Parameters
    ----------
    name : str
        Name of the format.
    suffixes : tuple of str
        Usual suffixes of its files, in lower case and with the dot; for messages.
    recognise : callable
        Gets the first ``HEAD_BYTES`` bytes of a file (none of a folder) and its path. Returns whether the file has
        this format.
    read : callable
        Gets the path and the circumference [m] of the ring that the user gave (None: not given; 0: an open road).
        Returns `Trajectories`. Raises InputError for a file that cannot be read.
    summary : str
        One line that explains the format.
    tracks : callable, optional
        Gets the path and the user's `Choices`. Returns `Tracks`: all vehicles on all lanes. Raises InputError. None
        for a format that only has one lane.
    is_of_tracks : bool
        Whether files hold vehicles that come and go on lanes, so that commands which can work on tracks do so.
    """

    name: str
    suffixes: tuple[str, ...]
    recognise: Callable[[bytes, Path], bool]
    read: Callable[[Path, float | None], Trajectories]
    summary: str
    tracks: Callable[[Path, Choices], Tracks] | None = None
    is_of_tracks: bool = False


def tracks_format(
    name: str,
    suffixes: tuple[str, ...],
    recognise: Callable[[bytes, Path], bool],
    tracks: Callable[[Path, Choices], Tracks],
    summary: str,
) -> Format:
    """A `Format` that gives tracks; a file with one recording on one lane can also be read as trajectories."""

    def read(path: Path, ring_m: float | None) -> Trajectories:
        return one_lane(tracks(path, Choices(ring_m=ring_m)), str(path))

    return Format(name, suffixes, recognise, read, summary, tracks, is_of_tracks=True)


def has_suffix(*suffixes: str) -> Callable[[bytes, Path], bool]:
    """Recognise files by their suffix, in lower or upper case."""
    return lambda head, path: path.suffix.lower() in suffixes
