"""Parts of tracks: some lanes, classes, recordings or vehicles, and a part of the time."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.kinds import class_name, drivers_only
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.leaders import check_gaps
from sugiyama_ros.trajectories.tracks import Tracks


@dataclass(frozen=True)
class Selection:
    """Which rows to keep; everything where nothing is said.

    recording, road, lane, vehicle_class: texts to keep; without: vehicles to leave out; from_s, to_s: times [s] between
    which rows are kept, both included.
    """

    recording: tuple[str, ...] = ()
    road: tuple[str, ...] = ()
    lane: tuple[str, ...] = ()
    vehicle_class: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    from_s: float = -np.inf
    to_s: float = np.inf


#: Keeps every row.
EVERYTHING = Selection()


def selected(selection: Selection, column_of: Callable[[str], Labels | None], time_s: Array) -> Mask:
    """The rows (R,) that a selection keeps, of columns by their names in files. Raises InputError."""
    keep: Mask = (time_s >= selection.from_s) & (time_s <= selection.to_s)
    for name, wanted in (
        ("recording", selection.recording),
        ("road", selection.road),
        ("lane", selection.lane),
        ("class", tuple(map(class_name, selection.vehicle_class))),
    ):
        if wanted:
            keep &= _is_one_of(column_of(name), wanted, name)
    if selection.without:
        keep &= ~_is_one_of(column_of("vehicle"), selection.without, "without")
    return keep


def select(tracks: Tracks, selection: Selection) -> Tracks:
    """Keep a part of tracks. A leader who is left out is unknown from then on. Raises InputError."""
    keep = selected(selection, tracks.column, tracks.time_s)  # type: ignore[arg-type]
    if keep.all():
        return tracks
    if not keep.any():
        raise InputError(
            f"{tracks.about.source or 'tracks'}: no row is left; the times go from {tracks.time_s.min():.12g} to"
            f" {tracks.time_s.max():.12g} s"
        )
    kept = tracks.select(keep)
    return replace(kept, about=kept.about.without("not selected", int(np.sum(~keep))))


def chosen(tracks: Tracks, selection: Selection) -> Tracks:
    """Keep the drivers among the rows that somebody wants, and check their gaps. Raises InputError."""
    kept = drivers_only(select(tracks, selection))
    note = "" if kept.about.checked else check_gaps(kept)
    return replace(kept, about=replace(kept.about, checked=True).noting(note))


def _is_one_of(column: Labels | None, wanted: tuple[str, ...], option: str) -> Mask:
    used = column.used() if column is not None else ()
    # who is beside the road, or no driver, was left out before
    known = column.text if column is not None and option == "without" else used
    missing = [text for text in wanted if text not in known]
    if column is None or missing:
        there = f"choose among {', '.join(used[:20])}" if used else "the tracks do not say it; leave it out"
        raise InputError(f"--{option} {missing[0] if missing else wanted[0]}: does not occur; {there}")
    return np.isin(column.code, [column.place(text) for text in wanted])
