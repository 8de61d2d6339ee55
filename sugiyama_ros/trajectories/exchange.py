"""Tracks as tables of Arrow and of pandas, and back."""

import json
import math
from dataclasses import asdict, fields, replace
from typing import TYPE_CHECKING, Any, BinaryIO, get_args

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.about import About, Leaders, Reference, View
from sugiyama_ros.trajectories.assemble import Column, assemble
from sugiyama_ros.trajectories.labels import Labels, labels
from sugiyama_ros.trajectories.tracks import NUMBERS, TEXTS, Tracks

if TYPE_CHECKING:
    import pandas
    import pyarrow

#: Key of the metadata in the schema of an Arrow table.
KEY = b"sugiyama_ros.tracks"
# Rows of a group, which a reader may take one at a time.
_GROUP = 1 << 17
_COLUMNS = (*TEXTS, *NUMBERS, "leader", "measured")


def to_arrow(tracks: Tracks) -> "pyarrow.Table":
    """Tracks as a table of Arrow, with what is known about them in its metadata.

    Parameters
    ----------
    tracks : Tracks
        R rows.

    Returns
    -------
    pyarrow.Table
        R rows; columns of text are dictionaries.
    """
    import pyarrow

    columns = {}
    for name in tracks.columns:
        column = tracks.column(name)
        if isinstance(column, Labels):
            code = pyarrow.array(column.code, mask=column.code < 0)
            columns[name] = pyarrow.DictionaryArray.from_arrays(code, pyarrow.array(column.text, pyarrow.string()))
        else:
            columns[name] = pyarrow.array(column)
    about = json.dumps(asdict(tracks.about))
    return pyarrow.table(columns).replace_schema_metadata({KEY: about.encode()})


def write_parquet(tracks: Tracks, stream: BinaryIO) -> None:
    """Write tracks as Parquet into a file that is open for writing."""
    from pyarrow import parquet

    parquet.write_table(to_arrow(tracks), stream, compression="zstd", row_group_size=_GROUP)


def about_of(metadata: dict[bytes, bytes] | None) -> About | None:
    """What the metadata of an Arrow table says about its tracks; None for a table that was not made by `to_arrow`."""
    if not metadata or KEY not in metadata:
        return None
    try:
        said = json.loads(metadata[KEY])
        known = {one.name: said[one.name] for one in fields(About) if one.name in said}
        known["dropped"] = tuple((str(reason), int(rows)) for reason, rows in known.get("dropped", ()))
        known["notes"] = tuple(map(str, known.get("notes", ())))
        about = About(**known)
    except (ValueError, TypeError, RecursionError):
        return None
    return about if _is_valid(about) else None


def _is_valid(about: About) -> bool:
    """Whether what a file says about its tracks has the right types and values."""
    texts = (about.unit, about.smoothing, about.source, about.sha256, about.licence)
    choices = ((about.reference, Reference), (about.view, View), (about.leaders, Leaders))
    return (
        all(isinstance(text, str) for text in texts)
        and all(chosen in get_args(known) for chosen, known in choices)
        and isinstance(about.ring_m, int | float)
        and 0.0 <= about.ring_m < math.inf
    )


def of_columns(columns: dict[str, Column], about: About) -> Tracks:
    """Tracks of columns that were tracks before: positions are at the centres, and leaders are known.

    Parameters
    ----------
    columns : dict
        Columns of tracks by name, as for `assemble`.
    about : About
        Where they come from.

    Returns
    -------
    Tracks
        The same tracks.
    """
    known = about if "leader" not in columns else replace(about, leaders="given")
    tracks = assemble(columns, known, checked=False)
    return replace(tracks, about=replace(tracks.about, leaders=about.leaders))


def from_frame(frame: "pandas.DataFrame", about: About | None = None) -> Tracks:
    """Tracks of a data frame.

    Parameters
    ----------
    frame : pandas.DataFrame
        Columns vehicle, time_s [s] and s_m (or position_m) [m], and perhaps the other columns of tracks.
    about : About, optional
        Where they come from.

    Returns
    -------
    Tracks
        With leaders found, or as the column ``leader`` says if ``about.leaders`` is "given".

    Raises
    ------
    InputError
        For a missing column, a value that is not a number, or vehicles that overlap.
    """
    if "s_m" not in frame.columns:
        frame = frame.rename(columns={"position_m": "s_m"})
    missing = [name for name in ("vehicle", "time_s", "s_m") if name not in frame.columns]
    if missing:
        raise InputError(f"data frame: no column {', '.join(missing)}; name it so, as by frame.rename")
    try:
        columns = {name: _column(name, frame[name]) for name in _COLUMNS if name in frame.columns}
    except (TypeError, ValueError) as error:
        raise InputError(f"data frame: {error}; give numbers") from None
    return assemble(columns, about or About(source="data frame"))


def _column(name: str, series: Any) -> Column:
    if name not in (*TEXTS, "leader"):
        return np.asarray(series, dtype=np.float64)
    if hasattr(series, "cat"):
        texts = [str(one) for one in series.cat.categories]
        return labels(np.asarray(series.cat.codes, dtype=np.int32), texts)
    values = [None if one is None or one != one else one for one in series.tolist()]
    return np.array(values, dtype=object)
