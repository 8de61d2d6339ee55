"""All file formats for trajectories: the built-in formats and the formats of other packages.

A format of another package is a `Format` behind an entry point of the group ``sugiyama_ros.formats``.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from sugiyama_ros import plugins
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.reading import why_no_text
from sugiyama_ros.formats.sheet import head_of
from sugiyama_ros.trajectories.one_lane import tracks_of, whole_road
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Group of entry points by which other packages add formats.
GROUP = "sugiyama_ros.formats"
#: Modules of the built-in formats. A bag is recognised by its content, whatever its suffix, so it comes first.
BUILT_IN = (
    "measured",
    "mstf",
    "plain_csv",
    "tracks_parquet",
    "ngsim",
    "pairs",
    "platoon",
    "openacc",
    "highd",
    "sumo",
    "tgsim",
    "pneuma",
    "commonroad",
    "folder",
    "table",
)


@cache
def formats() -> tuple[Format, ...]:
    """All formats, in the order in which they are asked whether they recognise a file.

    The formats of other packages come first, so that they can also take files with a suffix of a built-in format.
    """
    found = tuple(plugins.registered(GROUP, Format, BUILT_IN, "FORMAT").values())
    return (*found[len(BUILT_IN) :], *found[: len(BUILT_IN)])


def known_suffixes() -> str:
    """Suffixes of all formats, for messages."""
    return ", ".join(dict.fromkeys(suffix for known in formats() for suffix in known.suffixes))


def read_trajectories(path: Path, ring_m: float | None = None) -> Trajectories:
    """Read trajectories from a file of any known format.

    ring_m: circumference [m] of the ring, where the file does not say it; 0 for an open road. Raises InputError.
    """
    path = Path(path)
    return format_of(path).read(path, ring_m)


def read_tracks(path: Path, choices: Choices | None = None, name: str = "auto") -> Tracks:
    """Read tracks from a file or a folder of any known format. Raises InputError."""
    path, choices = Path(path), choices or Choices()
    known = {one.name: one for one in formats()}
    if name == "auto":
        chosen = known["table"] if choices.columns else format_of(path)
    else:
        chosen = plugins.find(known, GROUP, name, "format")
    if chosen.tracks is not None:
        return chosen.tracks(path, choices)
    return tracks_of(chosen.read(path, choices.ring_m))


def read_recording(path: Path, ring_m: float | None = None) -> Trajectories | Tracks:
    """Read a file for a fit: as a whole road where everybody's leader is known throughout, else as tracks.

    ring_m: circumference [m] of the ring, where the file does not say it; 0 for an open road. Raises InputError.
    """
    path = Path(path)
    if not format_of(path).is_of_tracks:
        return read_trajectories(path, ring_m)
    tracks = read_tracks(path, Choices(ring_m=ring_m))
    return whole_road(tracks) or tracks


def read_recordings(paths: Sequence[Path], ring_m: float | None = None) -> Trajectories | Tracks:
    """Read one file as ``read_recording`` does, or pool several files: each is a recording of its own.

    ring_m: circumference [m] of the ring, where the files do not say it; 0 for an open road. Raises InputError.
    """
    if len(paths) == 1:
        return read_recording(paths[0], ring_m)
    # a folder is a format of this registry
    from sugiyama_ros.formats.folder import read_files

    return read_files(paths, Choices(ring_m=ring_m))


def format_of(path: Path) -> Format:
    """The format that recognises a file or a folder. Raises InputError if none does."""
    head = head_of(path)
    if not head and not path.is_dir():
        raise InputError(f"{path}: empty file; give trajectories in {known_suffixes()}")
    for known in formats():
        if known.recognise(head, path):
            return known
    failed = "".join(f"; format {name}: {reason}" for (group, name), reason in plugins.FAILED.items() if group == GROUP)
    why = why_no_text(head) or f"not a known file format; give a file in {known_suffixes()}{failed}"
    raise InputError(f"{path}: {why}")
