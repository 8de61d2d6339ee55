"""Tracks as tables of Arrow, and back."""

import json
import math
from dataclasses import asdict, fields, replace
from typing import TYPE_CHECKING, BinaryIO, get_args

from sugiyama_ros.trajectories.about import About, Leaders, Reference, View
from sugiyama_ros.trajectories.assemble import Column, assemble
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.tracks import Tracks

if TYPE_CHECKING:
    import pyarrow

#: Key of the metadata in the schema of an Arrow table.
KEY = b"sugiyama_ros.tracks"
# Rows of a group, which a reader may take one at a time.
_GROUP = 1 << 17


def to_arrow(tracks: Tracks) -> "pyarrow.Table":
    """Tracks as a table of Arrow, with what is known about them in its metadata."""
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

    table = to_arrow(tracks)
    parquet.write_table(table, stream, compression="zstd", row_group_size=_GROUP, write_page_checksum=True)


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
        and isinstance(about.checked, bool)
        and isinstance(about.ring_m, int | float)
        and 0.0 <= about.ring_m < math.inf
        and isinstance(about.period_s, int | float)
        and 0.0 <= about.period_s < math.inf
    )


def of_columns(columns: dict[str, Column], about: About) -> Tracks:
    """Tracks of columns that were tracks before: positions are at the centres, and leaders are known."""
    known = about if "leader" not in columns else replace(about, leaders="given")
    tracks = assemble(columns, known, checked=False)
    return replace(tracks, about=replace(tracks.about, leaders=about.leaders))
