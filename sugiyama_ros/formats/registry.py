"""All file formats: the built-in formats and the formats of other packages.

A format of another package is a `Format` behind an entry point of the group ``sugiyama_ros.formats``.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from sugiyama_ros import plugins
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.reading import why_no_text
from sugiyama_ros.formats.sheet import head_of
from sugiyama_ros.trajectories.selection import chosen
from sugiyama_ros.trajectories.tracks import Tracks

#: Group of entry points by which other packages add formats.
GROUP = "sugiyama_ros.formats"
# Modules of the built-in formats. A bag is recognised by its content, whatever its suffix, so it comes first.
_BUILT_IN = (
    "measured",
    "mstf",
    "tracks_parquet",
    "ngsim",
    "pairs",
    "platoon",
    "openacc",
    "highd",
    "interaction",
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
    found = tuple(plugins.registered(GROUP, Format, _BUILT_IN, "FORMAT").values())
    return (*found[len(_BUILT_IN) :], *found[: len(_BUILT_IN)])


def known_suffixes() -> str:
    """Suffixes of all formats, for messages."""
    return ", ".join(dict.fromkeys(suffix for known in formats() for suffix in known.suffixes))


def read_tracks(
    source: str | Path | Sequence[str | Path], choices: Choices | None = None, name: str = "auto"
) -> Tracks:
    """Read a file or a folder of any known format, or several files as recordings. Raises InputError."""
    choices = choices or Choices()
    return chosen(read_all(source, choices, name), choices.selection)


def read_all(source: str | Path | Sequence[str | Path], choices: Choices, name: str) -> Tracks:
    """Read everything that files have, before somebody chooses and gaps are checked. Raises InputError."""
    given: list[str | Path] = [source] if isinstance(source, str | Path) else list(source)
    if "" in given:
        raise InputError("source: is empty; give the name of a file or a folder")
    paths = [Path(one) for one in given]
    if not paths:
        raise InputError("source: no file is given; give one or more")
    if len(paths) > 1:
        # a folder is a format of this registry
        from sugiyama_ros.formats.folder import read_files

        return read_files(paths, choices)
    known = {one.name: one for one in formats()}
    if name != "auto":
        form = plugins.find(known, GROUP, name, "format")
    else:
        form = known["table"] if choices.columns else format_of(paths[0])
    if choices.network is not None and not form.takes_road:
        able = ", ".join(one.name for one in formats() if one.takes_road)
        raise InputError(
            f"{paths[0]}: a file of the format {form.name}, which takes no road; those do: {able}; leave out the road"
        )
    if choices.reference is not None and not form.takes_reference:
        raise InputError(
            f"{paths[0]}: a file of the format {form.name}, whose positions are of centres; leave out the reference"
            f" ({choices.reference})"
        )
    try:
        tracks = form.read(paths[0], choices)
    except InputError as error:
        own = _recognised(paths[0]) if choices.columns and name == "auto" else None
        if own is None or own.name == form.name:
            raise
        raise InputError(f"{error}; or leave out --columns: the file has the form of {own.name}") from None
    if choices.network is None:
        return tracks
    return replace(tracks, about=tracks.about.noting(*choices.network.notes))


def format_of(path: Path) -> Format:
    """The format that recognises a file or a folder. Raises InputError if none does."""
    head = head_of(path)
    if not head and not path.is_dir():
        raise InputError(f"{path}: empty file; give tracks in {known_suffixes()}")
    if known := _recognised(path):
        return known
    failed = "".join(f"; format {name}: {reason}" for (group, name), reason in plugins.FAILED.items() if group == GROUP)
    why = why_no_text(head) or f"not a known file format; give a file in {known_suffixes()}{failed}"
    raise InputError(f"{path}: {why}")


def _recognised(path: Path) -> Format | None:
    """The first format that recognises a file or a folder."""
    head = head_of(path)
    return next((known for known in formats() if known.recognise(head, path)), None)
