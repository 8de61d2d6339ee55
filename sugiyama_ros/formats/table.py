"""Plain tables of tracks: CSV with any separator, or Parquet, with columns of tracks or a map of columns."""

from dataclasses import replace
from pathlib import Path

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import COLUMNS, PAIRED, Choices
from sugiyama_ros.formats.columns import Take, about_file, need, nobody, put_together, read_columns, take, text_of
from sugiyama_ros.formats.format import tracks_format
from sugiyama_ros.formats.pairs import both_of
from sugiyama_ros.formats.reading import why_no_text
from sugiyama_ros.formats.sheet import Sheet, head_of, sheet_of
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.tracks import Tracks

#: Columns by their own names, or by others that say the same.
_PLAIN: dict[str, Take] = {
    **{name: take(name) for name in COLUMNS},
    "vehicle": need("vehicle", "vehicle_id"),
    "time_s": need("time_s"),
    "s_m": need("s_m", "position_m"),
    "speed": take("speed_mps", "speed_m_s"),
    "some_speed": take("speed", "velocity"),
}
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
    return tracks_of_sheet(sheet, choices, about_file(path))


def tracks_of_sheet(sheet: Sheet, choices: Choices, about: About) -> Tracks:
    """Read a plain table of any kind. Raises InputError."""
    wanted = _PLAIN | {
        name: Take((column,), factor, optional=False) for name, (column, factor) in choices.columns.items()
    }
    # A row with a second place is a pair; a pair needs no names.
    names_vehicles = "vehicle" in choices.columns or sheet.has_one(*_PLAIN["vehicle"].names)
    is_pair = "leader_s_m" in choices.columns or (sheet.has("leader_s_m") and not names_vehicles)
    if is_pair:
        wanted = {name: take(name) for name in PAIRED} | wanted
        wanted["vehicle"] = replace(wanted["vehicle"], optional=True)
    hint = "" if names_vehicles else "; where a row has a follower and the leader, give time_s, s_m and leader_s_m"
    columns = read_columns(sheet, wanted, hint)
    if is_pair:
        columns, about = both_of(columns), replace(about, leaders="given")
    elif isinstance(leader := columns.pop("leader", None), Labels):
        leader = nobody(leader, text_of(columns, "vehicle"), "-1")
        # A column without any leader leaves it to the lanes who leads.
        if (leader.code >= 0).any():
            columns["leader"], about = leader, replace(about, leaders="given")
    return put_together(columns, about, choices)


def _recognise(head: bytes, path: Path) -> bool:
    """Any file with the name of a table; a text only with the columns that tracks need."""
    if path.is_dir() or path.suffix.lower() != ".txt":
        return path.suffix.lower() in _SUFFIXES and not path.is_dir()
    sheet = sheet_of(path, head)
    return sheet is not None and all(sheet.find(*one.names) for one in _PLAIN.values() if not one.optional)


FORMAT = tracks_format(
    name="table",
    suffixes=(*_SUFFIXES, ".txt"),
    recognise=_recognise,
    tracks=read_table,
    summary="a table with the columns of tracks (time_s, vehicle, s_m, and more if known), or any table with --columns",
)
