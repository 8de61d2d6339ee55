"""What a file format declares about itself."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

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
        Gets the first ``HEAD_BYTES`` bytes of a file and its path. Returns whether the file has this format.
    read : callable
        Gets the path and the circumference [m] of the ring that the user gave (None: not given; 0: an open road).
        Returns `Trajectories`. Raises InputError for a file that cannot be read.
    summary : str
        One line that explains the format.
    """

    name: str
    suffixes: tuple[str, ...]
    recognise: Callable[[bytes, Path], bool]
    read: Callable[[Path, float | None], Trajectories]
    summary: str


def has_suffix(*suffixes: str) -> Callable[[bytes, Path], bool]:
    """Recognise files by their suffix, in lower or upper case."""
    return lambda head, path: path.suffix.lower() in suffixes
