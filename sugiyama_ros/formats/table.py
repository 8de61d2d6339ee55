"""Plain tables of tracks: CSV with any separator, or Parquet, with columns of tracks or a map of columns."""

from dataclasses import replace
from pathlib import Path

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import MAPPED, Choices
from sugiyama_ros.formats.columns import Take, about_file, need, nobody, put_together, read_columns, take
from sugiyama_ros.formats.format import tracks_format
from sugiyama_ros.formats.sheet import head_of, sheet_of
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.tracks import Tracks

#: Columns by their own names, or by others that say the same.
_PLAIN: dict[str, Take] = {
    **{name: take(name) for name in MAPPED},
    "vehicle": need("vehicle", "vehicle_id"),
    "time_s": need("time_s"),
    "s_m": need("s_m", "position_m"),
}
_SUFFIXES = (".csv", ".tsv", ".parquet")


def read_table(path: Path, choices: Choices) -> Tracks:
    """Read a plain table.

    Parameters
    ----------
    path : Path
        The file.
    choices : Choices
        A map of columns, where the file has other names.

    Returns
    -------
    Tracks
        Its tracks.

    Raises
    ------
    InputError
        With line and column, for a file of another form.
    """
    sheet = sheet_of(path, head_of(path))
    if sheet is None:
        raise InputError(
            f"{path}:1: no column time_s, vehicle, position_m; give a table whose first line names its columns"
        )
    wanted = _PLAIN | {
        name: Take((column,), factor, optional=False) for name, (column, factor) in choices.columns.items()
    }
    columns = read_columns(sheet, wanted)
    about = about_file(path)
    if isinstance(leader := columns.pop("leader", None), Labels):
        leader = nobody(leader, "", "-1")
        # A column without any leader leaves it to the lanes who leads.
        if (leader.code >= 0).any():
            columns["leader"], about = leader, replace(about, leaders="given")
    return put_together(columns, about, choices)


FORMAT = tracks_format(
    name="table",
    suffixes=_SUFFIXES,
    recognise=lambda head, path: path.suffix.lower() in _SUFFIXES and not path.is_dir(),
    tracks=read_table,
    summary="a table with the columns of tracks (time_s, vehicle, s_m, and more if known), or any table with --columns",
)
