"""Plain tables: CSV with any separator, Parquet or data frames, with columns of tracks or a map of columns.

A table with ``position_m`` in place of ``s_m``, and without recordings, roads, lanes and leaders, is of one road on
which everybody is in view.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Target, writing
from sugiyama_ros.formats.choices import COLUMNS, PAIRED, Choices
from sugiyama_ros.formats.columns import (
    Take,
    about_file,
    fits,
    need,
    put_together,
    read_columns,
    take,
    text_of,
    without_nobody,
)
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.pairs import both_of
from sugiyama_ros.formats.reading import why_no_text
from sugiyama_ros.formats.sheet import Sheet, head_of, sheet_of
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.trajectories.selection import chosen
from sugiyama_ros.trajectories.tracks import Tracks

# Columns by their own names, or by others that say the same.
_PLAIN: dict[str, Take] = {
    **{name: take(name) for name in COLUMNS},
    "vehicle": need("vehicle", "vehicle_id"),
    "time_s": need("time_s"),
    "s_m": need("s_m", "position_m"),
    "speed": take("speed_mps", "speed_m_s"),
    "some_speed": take("speed", "velocity"),
}
# Name of a data frame in messages.
_WHERE = Path("data frame")
# Columns of files with more than one road on which everybody is in view.
_OF_PARTS = {"recording", "road", "lane", "leader"}
_SUFFIXES = (".csv", ".tsv", ".parquet")


def read_table(path: Path, choices: Choices) -> Tracks:
    """Read a plain table. Raises InputError."""
    head = head_of(path)
    if why := why_no_text(head) if not head.startswith(b"PAR1") else "":
        raise InputError(f"{path}: {why}")
    sheet = sheet_of(path, head)
    if sheet is None:
        raise InputError(
            f"{path}:1: no column time_s, vehicle, position_m; give a table whose first line names its columns"
        )
    return _tracks_of_sheet(sheet, choices, about_file(path))


def _tracks_of_sheet(sheet: Sheet, choices: Choices, about: About) -> Tracks:
    """Read a plain table of any kind. Raises InputError."""
    wanted = _PLAIN | {
        "s_m" if name == "position_m" else name: Take((column,), factor, optional=False)
        for name, (column, factor) in choices.columns.items()
    }
    # A row with a second place is a pair; a pair needs no names.
    names_vehicles = "vehicle" in choices.columns or sheet.find(*_PLAIN["vehicle"].names) is not None
    is_pair = "leader_s_m" in choices.columns or (sheet.has("leader_s_m") and not names_vehicles)
    if is_pair:
        wanted = {name: take(name) for name in PAIRED} | wanted
        wanted["vehicle"] = replace(wanted["vehicle"], optional=True)
    hint = "" if names_vehicles else "; where a row has a follower and the leader, give time_s, s_m and leader_s_m"
    if not names_vehicles and sheet.find(*_PLAIN["s_m"].names) is None and _has_speeds(sheet):
        hint += " (of speeds, s_m is the sum of speed times step, and leader_s_m is s_m + gap + the leader's length)"
    columns = read_columns(sheet, wanted, hint)
    if is_pair:
        columns, about = both_of(columns), replace(about, leaders="given")
    elif "leader" in columns:
        without_nobody(columns, "-1")
        # A column without any leader leaves it to the lanes who leads.
        if (text_of(columns, "leader").code >= 0).any():
            about = replace(about, leaders="given")
        else:
            del columns["leader"]
    positions = choices.columns.keys() & {"s_m", "position_m"} or {
        one for one in ("s_m", "position_m") if sheet.has(one)
    }
    if positions == {"position_m"} and not _OF_PARTS & set(columns):
        about = replace(about, view="whole")
    return put_together(columns, about, choices)


def _has_speeds(sheet: Sheet) -> bool:
    return any("speed" in name.lower() or "velocity" in name.lower() for name in sheet.names)


def write_csv(road: DenseTracks, target: Target) -> None:
    """Write one road as CSV; missing samples have an empty position. Raises OutputError.

    There is a column ``controlled`` if a controller drives some vehicle.
    """
    with writing(target) as stream:
        stream.write(f"time_s,vehicle,position_m,length_m{',controlled' * bool(road.controlled)}\n".encode())
        vehicles = list(zip(road.vehicle.tolist(), road.length_m.tolist(), strict=True))
        for time, positions, present in zip(road.time_s.tolist(), road.position_m, road.present, strict=True):
            for column in np.flatnonzero(present):
                vehicle, length = vehicles[column]
                position = "" if np.isnan(positions[column]) else repr(float(positions[column]))
                flag = f",{int(vehicle in road.controlled)}" if road.controlled else ""
                stream.write(f"{time!r},{vehicle},{position},{length!r}{flag}\n".encode())


def _recognise(head: bytes, path: Path) -> bool:
    """Any file with the name of a table; a text only with the columns that tracks need."""
    if path.is_dir() or path.suffix.lower() != ".txt":
        return path.suffix.lower() in _SUFFIXES and not path.is_dir()
    sheet = sheet_of(path, head)
    return sheet is not None and fits(sheet, _PLAIN)


FORMAT = Format(
    name="table",
    suffixes=(*_SUFFIXES, ".txt"),
    recognise=_recognise,
    read=read_table,
    summary="a table with time_s, vehicle and s_m or position_m, and more columns if known; any table with --columns",
)


def tracks_of_frame(frame: Any, choices: Choices | None = None) -> Tracks:
    """Read tracks from a data frame.

    frame: columns vehicle, time_s [s] and s_m (or position_m) [m], and perhaps the other columns of tracks. Raises
    InputError.
    """
    choices = choices or Choices()
    tracks = _tracks_of_sheet(_sheet_of_frame(frame), choices, About(source=str(_WHERE)))
    return chosen(tracks, choices.selection)


def _sheet_of_frame(frame: Any) -> Sheet:
    """The table of a data frame; a named index counts as columns."""
    import pyarrow

    if isinstance(frame, pyarrow.Table):
        return Sheet(_WHERE, _once(frame.column_names), separator="", frame=frame)
    if not hasattr(frame, "columns"):
        raise InputError(f"{_WHERE}: {type(frame).__name__} is none; give a data frame, or the name of a file")
    index = getattr(frame, "index", None)
    named = [name for name in getattr(index, "names", ()) if name is not None and name not in frame.columns]
    if named:
        frame = frame.reset_index(level=named)
    names = _once([str(name) for name in frame.columns])
    columns = [_arrow(frame[name]) for name in frame.columns]
    return Sheet(_WHERE, names, separator="", frame=pyarrow.table(columns, names=list(names)))


def _once(names: Sequence[str]) -> tuple[str, ...]:
    """The names of columns. Raises InputError where one occurs twice."""
    if double := [name for name in names if names.count(name) > 1]:
        raise InputError(f"{_WHERE}: has {names.count(double[0])} columns {double[0]}; rename all but one")
    return tuple(names)


def _arrow(series: Any) -> Any:
    """A column as one of Arrow; a column of values of several types becomes text."""
    import pyarrow

    if hasattr(series, "to_arrow"):
        return series.to_arrow()
    if getattr(getattr(series, "dtype", None), "tz", None) is not None:
        series = series.dt.tz_convert(None)
    try:
        return pyarrow.array(series, from_pandas=True)
    except (pyarrow.ArrowException, TypeError, ValueError, OverflowError):
        texts = [None if _is_missing(value) else str(value) for value in series]
        return pyarrow.array(texts, pyarrow.string())


def _is_missing(value: Any) -> bool:
    """Whether a value is None, NaN, NaT or NA; NA says neither yes nor no when it is compared."""
    try:
        return value is None or bool(value != value)
    except (TypeError, ValueError):
        return True
