"""A folder of files with tracks: each file is a recording."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import Rows, stacked
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.reading import shown_name, shown_stem
from sugiyama_ros.formats.sheet import head_of
from sugiyama_ros.trajectories.about import About, checksum_of_parts
from sugiyama_ros.trajectories.exchange import of_columns
from sugiyama_ros.trajectories.labels import Labels, joined, same_label
from sugiyama_ros.trajectories.selection import EVERYTHING
from sugiyama_ros.trajectories.tracks import FLAGS, NUMBERS, TEXTS, Tracks

_SUFFIXES = (".csv", ".tsv", ".txt", ".parquet", ".data")
# Files in a folder, at most.
_MAX_FILES = 10_000


def _read_folder(path: Path, choices: Choices) -> Tracks:
    """Read all files of a folder that are tables; files beside them that hold metadata are left out.

    Raises InputError.
    """
    from sugiyama_ros.formats.registry import formats

    tables = sorted(one for one in path.iterdir() if _is_table(one))
    files = [one for one in tables if any(known.recognise(head_of(one), one) for known in formats())]
    if not files:
        raise InputError(
            f"{path}: not a regular file, but a folder without tables ({', '.join(_SUFFIXES)}); give a file"
        )
    if len(files) > _MAX_FILES:
        raise InputError(f"{path}: more than {_MAX_FILES} files; split the folder")
    together = read_files(files, choices, shown_name(path))
    others = ", ".join(shown_name(one) for one in tables if one not in files)
    note = f"files of no known format were left out: {others[:200]}" if others else ""
    return replace(together, about=together.about.noting(note))


def read_files(files: Sequence[Path], choices: Choices, source: str = "") -> Tracks:
    """Read several files as recordings of one table. Raises InputError."""
    from sugiyama_ros.formats.registry import read_all

    stems = [file.stem for file in files]
    twice = next((file for file in files if stems.count(file.stem) > 1), None)
    if twice is not None:
        raise InputError(f"{twice}: another file has the same name, so their recordings would mix; rename one")
    name = "table" if choices.columns else "auto"
    choices = replace(choices, selection=EVERYTHING)
    parts = [_named(read_all(file, choices, name), file) for file in files]
    if len({part.about.ring_m for part in parts}) > 1:
        raise InputError(f"{files[0]}: the files are of different roads; give the files of each road on their own")
    return _joined(source or shown_name(files[0]), parts)


def _is_table(file: Path) -> bool:
    meta = file.stem.endswith(("Meta", "_meta")) or file.name.upper().startswith(("LICENSE", "README"))
    return file.is_file() and file.suffix.lower() in _SUFFIXES and not meta


def _named(part: Tracks, file: Path) -> Tracks:
    """The tracks of a file, whose recordings have the name of the file."""
    here = same_label(len(part), shown_stem(file))
    single = len(part.recording.used()) == 1
    return replace(part, recording=here if single else joined(here, part.recording, "/"))


def _joined(source: str, parts: list[Tracks]) -> Tracks:
    """All parts in one table."""
    columns: Rows = {}
    for name in (*TEXTS, *NUMBERS, "leader", *FLAGS):
        if any(part.column(name) is not None for part in parts):
            columns[name] = _column(name, parts)
    each = [part.about for part in parts]
    about = About(
        source=source,
        sha256=checksum_of_parts(sorted(one.sha256 for one in each)),
        view=each[0].view,
        leaders="given",
        ring_m=each[0].ring_m,
        licence="; ".join(dict.fromkeys(one.licence for one in each if one.licence)),
        smoothing="; ".join(dict.fromkeys(one.smoothing for one in each if one.smoothing)),
    ).noting(*(note for one in each for note in one.notes))
    for reason, rows in (lost for one in each for lost in one.dropped):
        about = about.without(reason, rows)
    together = of_columns(dict(columns), about)
    return replace(together, about=replace(together.about, checked=all(one.checked for one in each)))


def _column(name: str, parts: list[Tracks]) -> Array | Labels:
    columns = [part.column(name) for part in parts]
    if name in (*NUMBERS, *FLAGS):
        missing = {"measured": 1.0, "controlled": 0.0}.get(name, np.nan)
        filled = [
            np.full(len(part), missing) if one is None else np.asarray(one, dtype=np.float64)
            for part, one in zip(parts, columns, strict=True)
        ]
        return np.asarray(np.concatenate(filled))
    empty = [Labels(np.full(len(part), -1, dtype=np.int32), ()) for part in parts]
    return stacked(one if isinstance(one, Labels) else none for one, none in zip(columns, empty, strict=True))


FORMAT = Format(
    name="folder",
    suffixes=(),
    recognise=lambda head, path: path.is_dir(),
    read=_read_folder,
    summary="a folder of tables in any of these formats: each file is a recording",
)
