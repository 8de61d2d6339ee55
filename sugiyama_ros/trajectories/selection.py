"""Parts of tracks: some lanes, classes, recordings or vehicles, and a part of the time."""

from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.labels import Labels
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


def select(tracks: Tracks, selection: Selection) -> Tracks:
    """Keep a part of tracks. A leader who is left out is unknown from then on. Raises InputError."""
    keep = np.ones(len(tracks), dtype=bool)
    for option, column, wanted in (
        ("recording", tracks.recording, selection.recording),
        ("road", tracks.road, selection.road),
        ("lane", tracks.lane, selection.lane),
        ("class", tracks.vehicle_class, selection.vehicle_class),
    ):
        if wanted:
            keep &= _is_one_of(column, wanted, option)
    if selection.without:
        keep &= ~_is_one_of(tracks.vehicle, selection.without, "without")
    keep &= (tracks.time_s >= selection.from_s) & (tracks.time_s <= selection.to_s)
    if keep.all():
        return tracks
    if not keep.any():
        raise InputError(
            f"{tracks.about.source or 'tracks'}: no row is left; the times go from {tracks.time_s.min():.12g} to"
            f" {tracks.time_s.max():.12g} s"
        )
    kept = tracks.select(keep)
    return replace(kept, about=kept.about.without("not selected", int(np.sum(~keep))))


def _is_one_of(column: Labels | None, wanted: tuple[str, ...], option: str) -> Mask:
    used = column.used() if column is not None else ()
    missing = [text for text in wanted if text not in used]
    if column is None or missing:
        there = f"choose among {', '.join(used[:20])}" if used else "the tracks do not say it; leave it out"
        raise InputError(f"--{option} {missing[0] if missing else wanted[0]}: does not occur; {there}")
    return np.isin(column.code, [column.place(text) for text in wanted])
