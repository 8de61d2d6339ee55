"""Tracks in Parquet, as ``sugiyama convert`` writes them."""

from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Target, output_of, writing
from sugiyama_ros.formats.choices import COLUMNS, Choices
from sugiyama_ros.formats.columns import is_number
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.reading import shown_name
from sugiyama_ros.formats.sheet import head_of, parquet_file, read_sheet, sheet_of
from sugiyama_ros.trajectories.about import About, source_in
from sugiyama_ros.trajectories.exchange import about_of, of_columns, to_arrow, write_parquet
from sugiyama_ros.trajectories.tracks import INFINITE, Tracks


def _read_tracks_parquet(path: Path, choices: Choices) -> Tracks:
    """Read tracks that `write_tracks` wrote. Raises InputError."""
    head = head_of(path)
    sheet, about = sheet_of(path, head), _about(head, path)
    if sheet is None or about is None:
        raise InputError(f"{path}: does not say that it holds tracks; convert the source again")
    missing = [name for name in ("recording", "vehicle", "time_s", "s_m") if name not in sheet.names]
    if missing:
        raise InputError(f"{path}: no column {', '.join(missing)}; convert the source again")
    if choices.ring_m is not None:
        about = replace(about, ring_m=choices.ring_m)
    names = {name for name in COLUMNS if name in sheet.names}
    numbers = {name for name in names if is_number(name)}
    # Errors name the file that is read; the tracks keep the name of their source.
    columns = read_sheet(sheet, numbers, names - numbers, infinite=INFINITE)
    tracks = of_columns(dict(columns), replace(about, source=str(path)))
    choices.check_ring(tracks)
    return replace(tracks, about=replace(tracks.about, source=source_in(shown_name(path), about.source)))


def write_tracks(tracks: Tracks, target: Target) -> None:
    """Write tracks as Parquet, or as CSV if the name ends in ``.csv``. Raises OutputError."""
    with writing(target) as stream:
        if output_of(target).path.suffix.lower() == ".csv":
            _write_csv(tracks, stream)
        else:
            write_parquet(tracks, stream)


def _write_csv(tracks: Tracks, stream: BinaryIO) -> None:
    from pyarrow import csv, types

    table = to_arrow(tracks)
    plain = [one.cast(one.type.value_type) if types.is_dictionary(one.type) else one for one in table]
    csv.write_csv(type(table).from_arrays(plain, names=table.column_names), stream)


def _about(head: bytes, path: Path) -> About | None:
    """What a file says about its tracks; None for a file that holds none."""
    if not head.startswith(b"PAR1"):
        return None
    with parquet_file(path) as file:
        return about_of(file.schema_arrow.metadata)


FORMAT = Format(
    name="tracks",
    suffixes=(".parquet",),
    recognise=lambda head, path: _about(head, path) is not None,
    read=_read_tracks_parquet,
    summary="tracks in Parquet, as sugiyama convert writes them",
    takes_reference=False,
)
