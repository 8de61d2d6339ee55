"""Which columns of a table become which columns of tracks, and in which units."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.reading import checksum_of, clock_of_digits, command_for, shown_name
from sugiyama_ros.formats.sheet import Sheet, head_of, read_sheet
from sugiyama_ros.trajectories.about import About, Leaders, Reference
from sugiyama_ros.trajectories.assemble import LATEST_S, assemble
from sugiyama_ros.trajectories.kinds import others
from sugiyama_ros.trajectories.labels import Labels, joined, labels
from sugiyama_ros.trajectories.time_base import is_regular, on_time_base
from sugiyama_ros.trajectories.tracks import INFINITE, NUMBERS, Tracks

#: Columns by name, (R,) each.
Rows: TypeAlias = dict[str, Array | Labels]
# Times above these count parts of a second since 1970: the part [s], and its name.
_PARTS = ((1e17, 1e-9, "nanoseconds"), (1e14, 1e-6, "microseconds"), (1e11, 1e-3, "milliseconds"))


@dataclass(frozen=True)
class Take:
    """A column of tracks: what files call it, and the factor to metres or seconds."""

    names: tuple[str, ...]
    factor: float = 1.0
    optional: bool = True


def take(*names: str, factor: float = 1.0) -> Take:
    """A column that may be missing."""
    return Take(names, factor)


def need(*names: str, factor: float = 1.0) -> Take:
    """A column that must be there."""
    return Take(names, factor, optional=False)


def fits(sheet: Sheet, wanted: Mapping[str, Take]) -> bool:
    """Whether a table has all columns that must be there."""
    return all(sheet.find(*one.names) for one in wanted.values() if not one.optional)


def read_columns(sheet: Sheet, wanted: Mapping[str, Take], hint: str = "") -> Rows:
    """Read the columns of tracks that a table has: arrays (R,) in metres and seconds, and `Labels`. Raises InputError.

    wanted: for each column of tracks, or any name that the caller knows, the columns it may come from; a name that ends
    in ``_s``, ``_m`` or ``speed`` is a number, any other a text; hint: what else helps, if a column is missing.
    """
    found = {name: place for name, one in wanted.items() if (place := sheet.find(*one.names)) is not None}
    missing = [" or ".join(one.names) for name, one in wanted.items() if not one.optional and name not in found]
    if missing:
        there = ", ".join(sheet.names)[:200] or "none"
        line = f":{sheet.header}" if sheet.header and not sheet.is_parquet else ""
        cure = f"say which is which: {command_for(sheet.path)} --columns map.yaml"
        if sheet.frame is not None:
            cure = "name them so, as by frame.rename(columns={'old': 'new'})"
        if there.startswith("#"):
            cure = "remove the lines before the one with the names, and the # before the names"
        raise InputError(f"{sheet.path}{line}: no column {', '.join(missing)}; the columns are {there}; {cure}{hint}")
    times = {place: wanted[name].factor for name, place in found.items() if name in ("time_s", "clock_s")}
    numbers = {place for name, place in found.items() if is_number(name)}
    texts = {place for name, place in found.items() if not is_number(name)} - numbers
    read = read_sheet(sheet, numbers, texts, times, [found[name] for name in INFINITE if name in found])
    table: Rows = {}
    for name, place in found.items():
        column = read[place]
        factor = 1.0 if place in times else wanted[name].factor
        # what becomes infinite is left out later on, as no time or no position
        with np.errstate(over="ignore"):
            table[name] = column if isinstance(column, Labels) or factor == 1.0 else column * factor
    return table


def is_number(name: str) -> bool:
    """Whether a column of tracks holds numbers."""
    return name in NUMBERS or name.endswith(("_s", "_m", "speed"))


def text_of(columns: Mapping[str, Array | Labels], name: str) -> Labels:
    """A column of text, which must be there."""
    column = columns[name]
    if not isinstance(column, Labels):
        raise TypeError(f"{name} is not a column of text")
    return column


def without_nobody(columns: Rows, *names: str) -> None:
    """Take names such as 0 out of the leaders, if there are any: nobody is known to be ahead.

    A vehicle may have such a name; then it means this vehicle.
    """
    if isinstance(leader := columns.get("leader"), Labels):
        vehicles = text_of(columns, "vehicle").text
        gone = np.array([text in names and text not in vehicles for text in leader.text] + [True])
        columns["leader"] = labels(np.where(gone[leader.code], -1, leader.code).astype(np.int32), leader.text)


def stacked(parts: Iterable[Labels]) -> Labels:
    """Columns of text one below the other."""
    code, text = [], list[str]()
    for one in parts:
        code.append(np.where(one.code < 0, -1, one.code + len(text)))
        text += one.text
    return labels(np.concatenate(code).astype(np.int32), text)


def rename(columns: Rows, name: str, names: Mapping[str, str]) -> None:
    """Replace some texts of a column, if there is such a column."""
    if isinstance(column := columns.get(name), Labels):
        columns[name] = labels(column.code, [names.get(text, text) for text in column.text])


def drivers_of(columns: Rows, about: About) -> tuple[Rows, About]:
    """The rows of vehicles in the plane, without those who drive nothing. Raises InputError if nobody drives."""
    kind, vehicle, recording = columns.get("class"), text_of(columns, "vehicle"), columns.get("recording")
    if not isinstance(kind, Labels):
        return columns, about
    who = joined(recording, vehicle, "/") if isinstance(recording, Labels) else vehicle
    gone, about = others(kind, who.code.astype(np.int64), about)
    return {name: column[~gone] for name, column in columns.items()}, about


def put_together(
    columns: Rows,
    about: About,
    choices: Choices,
    reference: Reference = "centre",
) -> Tracks:
    """Make tracks of columns, with what the user says.

    Parameters
    ----------
    columns : dict
        As `read_columns` gives them.
    about : About
        Where they come from.
    choices : Choices
        What the user says; it counts more than what the format says.
    reference : {"centre", "front", "rear"}
        Which point of a vehicle the positions of this format are of.

    Returns
    -------
    Tracks
        On a regular time base, if the vehicles do not share their times.
    """
    if choices.ring_m is not None:
        about = replace(about, ring_m=choices.ring_m)
    if choices.view is not None:
        about = replace(about, view=choices.view)
    columns["time_s"], note = _in_seconds(np.asarray(columns["time_s"]))
    about = about.noting(note)
    tracks = assemble(columns, about, choices.reference or reference, selection=choices.selection)
    if tracks.about.leaders == "given":
        choices.check_ring(tracks)
    if np.any(np.diff(tracks.start) > 1) and not is_regular(tracks):
        tracks = on_time_base(tracks)
    alone = tracks.runs > len(tracks.recording.used()) and not np.any(tracks.leader_row >= 0)
    note = "warning: no vehicle has another one ahead at the same time; check clocks and lanes (--columns)" * alone
    return replace(tracks, about=tracks.about.noting(note))


def _in_seconds(time: Array) -> tuple[Array, str]:
    """Times (R,) [s], where they may count parts of a second since 1970, or be a clock; and a note that says so."""
    latest = float(np.nanmax(np.abs(time), initial=0.0))
    for above, part, name in _PARTS:
        if above < latest < LATEST_S / part:
            return time * part, f"times are {name} in the file; they were made seconds"
    if (clock := clock_of_digits(time)) is not None:
        return clock, "times are digits of a clock in the file, as 65959.9 for 06:59:59.9; they were made seconds"
    return time, ""


def sheet_format(
    name: str,
    suffixes: tuple[str, ...],
    summary: str,
    sheet_of: Callable[[Path, bytes], Sheet | None],
    read: Callable[[Sheet, Choices], Tracks],
    refusal: str,
) -> Format:
    """A format of tables: ``sheet_of`` gives the table if its columns are known, ``read`` its tracks.

    refusal: what is wrong with a file whose columns are not known, and what to do.
    """

    def tracks(path: Path, choices: Choices) -> Tracks:
        sheet = sheet_of(path, head_of(path))
        if sheet is None:
            raise InputError(f"{path}:{refusal}")
        return read(sheet, choices)

    return Format(name, suffixes, lambda head, path: sheet_of(path, head) is not None, tracks, summary)


def about_file(path: Path, leaders: Leaders = "found", **said: str) -> About:
    """Where tracks come from: name and checksum of a file, and what the format says of its data."""
    return About(source=shown_name(path), sha256=checksum_of(path), leaders=leaders, **said)  # type: ignore[arg-type]
