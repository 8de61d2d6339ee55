"""All file formats for trajectories: the built-in formats and the formats of other packages.

A format of another package is a `Format` behind an entry point of the group ``sugiyama_ros.formats``.
"""

from functools import cache
from pathlib import Path

from sugiyama_ros import plugins
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.format import HEAD_BYTES, Format
from sugiyama_ros.formats.reading import open_input
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Group of entry points by which other packages add formats.
GROUP = "sugiyama_ros.formats"
#: Modules of the built-in formats. A bag is recognised by its content, whatever its suffix, so it comes first.
BUILT_IN = (
    "measured",
    "mstf",
    "plain_csv",
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

    Parameters
    ----------
    path : Path
        The file.
    ring_m : float, optional
        Circumference [m] of the ring, where the file does not say it; 0 for an open road.

    Returns
    -------
    Trajectories
        Positions of all vehicles on a regular time base.

    Raises
    ------
    InputError
        With the line or the offset, for a file that is missing, empty, damaged or of no known format, and where
        ``ring_m`` contradicts the file.
    """
    path = Path(path)
    with open_input(path) as stream:
        head = stream.read(HEAD_BYTES)
    if not head:
        raise InputError(f"{path}: empty file; give trajectories in {known_suffixes()}")
    for known in formats():
        if known.recognise(head, path):
            return known.read(path, ring_m)
    failed = "".join(f"; format {name}: {reason}" for (group, name), reason in plugins.FAILED.items() if group == GROUP)
    raise InputError(f"{path}: not a known file format; give a file in {known_suffixes()}{failed}")
