"""What a file format declares about itself."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.trajectories.tracks import Tracks

#: Bytes from the start of a file by which a format may recognise it.
HEAD_BYTES = 4096


@dataclass(frozen=True)
class Format:
    """A file format for tracks.

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
        Gets the path and the user's `Choices`. Returns `Tracks`. Raises InputError for a file that cannot be read.
    summary : str
        One line that explains the format.
    takes_reference : bool
        Whether the user may say what positions are of; not where a file has the centres of vehicles.
    takes_road : bool
        Whether the format has vehicles in the plane, which a road of `Choices` puts on lanes.
    """

    name: str
    suffixes: tuple[str, ...]
    recognise: Callable[[bytes, Path], bool]
    read: Callable[[Path, Choices], Tracks]
    summary: str
    takes_reference: bool = True
    takes_road: bool = False


def has_suffix(*suffixes: str) -> Callable[[bytes, Path], bool]:
    """Recognise files by their suffix, in lower or upper case."""
    return lambda head, path: path.suffix.lower() in suffixes
