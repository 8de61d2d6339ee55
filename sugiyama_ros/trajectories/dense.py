"""Tracks of one recording on one lane as dense arrays, and dense arrays as tracks."""

import re
import shlex
from contextlib import suppress
from itertools import count

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import Columns, assemble
from sugiyama_ros.trajectories.jumps import jumps_noted
from sugiyama_ros.trajectories.labels import Labels, numbered
from sugiyama_ros.trajectories.leaders import LEAST_AGREEMENT, agreement
from sugiyama_ros.trajectories.time_base import on_time_base, period_of
from sugiyama_ros.trajectories.tracks import UNKNOWN, Tracks
from sugiyama_ros.trajectories.trajectories import MAX_SAMPLES, Trajectories, regular_time_base

# A dense table may have so many cells for each row that is there, of at least so many rows.
_EMPTIEST, _FEW_ROWS = 20, 10_000
# Share of a vehicle's rows with an unknown leader up to which the vehicle ahead counts as the leader.
_UNKNOWN_ROWS = 0.02
# Share of samples in which a leader may be behind, and samples from which on this is judged.
_BEHIND, _ENOUGH_SAMPLES = 0.02, 50
# Part of the time that vehicles of a whole road are there.
_PRESENT = 0.9
_NUMBER = re.compile(r"\d{1,9}")


def dense(tracks: Tracks, where: str = "") -> Trajectories:
    """Put tracks of one lane into a dense table; ``where``: name of the file for messages. Raises InputError."""
    where = where or tracks.about.source or "tracks"
    for column, many, option in (
        (tracks.recording, "recordings", "recording"),
        (tracks.road, "roads", "road"),
        (tracks.lane, "lanes", "lane"),
    ):
        if column is not None:
            _check_one(column, many, option, where)
    regular, start, period = _regular(tracks, where)
    step = np.round((regular.time_s - start) / period).astype(np.int64)
    samples = int(step.max()) + 1
    if samples * regular.runs > min(MAX_SAMPLES, _EMPTIEST * max(len(regular), _FEW_ROWS)):
        raise InputError(
            f"{where}: {regular.runs} vehicles come and go during {samples} samples, which are not one lane with"
            f" everybody present; cut out a part: sugiyama convert {where} part.parquet --from SECONDS --to SECONDS"
        )
    _check_apart(regular, step, period, where)
    position = np.full((samples, regular.runs), np.nan)
    position[step, regular.run] = regular.s_m
    road = Road(regular.about.ring_m)
    found = Trajectories(
        position_m=road.wrap(position),
        length_m=regular.length_m[regular.start[:-1]],
        vehicle=numbers_of(regular),
        road=road,
        period_s=period,
        start_s=start,
        source=tracks.about.source,
        sha256=tracks.about.sha256,
    )
    if not _is_in_view(tracks):
        _check_leaders(regular, found, step, where)
    return found


def whole_road(tracks: Tracks) -> Trajectories | None:
    """Tracks as a dense table, if they are one lane on which everybody is recorded nearly all the time.

    Raises InputError if everybody was in view on one lane, but vehicles jump or drive through one another.
    """
    in_view = _is_in_view(tracks)
    if not in_view and np.mean(tracks.leader_row == UNKNOWN) > _UNKNOWN_ROWS:
        return None
    try:
        road = dense(tracks)
    except InputError:
        return None
    if in_view:
        where = tracks.about.source or "tracks"
        _check_order(road, where)
        if note := jumps_noted(tracks):
            raise InputError(f"{where}: {note.removeprefix('warning: ')}")
    return road if in_view or road.present.mean() >= _PRESENT else None


def _is_in_view(tracks: Tracks) -> bool:
    """Whether everybody was in view, so that positions say better than single rows who leads whom."""
    return tracks.about.view == "whole" and tracks.about.leaders == "found"


def _check_one(column: Labels, many: str, option: str, where: str) -> None:
    used = column.used()
    if len(used) > 1:
        raise InputError(
            f"{where}: {len(used)} {many} ({', '.join(used[:5])}{', ...' * (len(used) > 5)}) where one is needed;"
            f" choose: sugiyama convert {where} one.parquet --{option} {shlex.quote(used[0])}"
        )


def _regular(tracks: Tracks, where: str) -> tuple[Tracks, float, float]:
    """Tracks on a regular time base, its first time, and its period [s]."""
    if tracks.about.period_s > 0.0:
        return tracks, float(tracks.time_s.min()), tracks.about.period_s
    if _is_in_view(tracks):
        # Times that differ by less than a microsecond are the same instant, written with a different rounding.
        _, distinct = np.unique(np.round(tracks.time_s, 6), return_index=True)
        with suppress(InputError):
            return tracks, *regular_time_base(tracks.time_s[distinct], where)[:2]
    regular = on_time_base(tracks)
    return regular, float(regular.time_s.min()), period_of(regular)


def _check_apart(tracks: Tracks, step: Ints, period_s: float, where: str) -> None:
    """Refuse two samples of a vehicle that belong to the same time."""
    twice = np.flatnonzero((np.diff(step) == 0) & (np.diff(tracks.run) == 0))
    if len(twice):
        row = int(twice[0])
        raise InputError(
            f"{where}: vehicle {tracks.run_name(int(tracks.run[row]))} has samples at {tracks.time_s[row]:.9g} s and"
            f" {tracks.time_s[row + 1]:.9g} s, but the period is {period_s:.4g} s; remove one of them"
        )


def numbers_of(tracks: Tracks) -> Ints:
    """A number for each run, (V,)."""
    names = [tracks.vehicle.at(int(row)) for row in tracks.start[:-1]]
    found = [_NUMBER.findall(name) for name in names]
    numbers = [int(one[-1]) if one else -1 for one in found]
    named = [number for number in numbers if number >= 0]
    if len(set(named)) < len(named):
        return np.arange(len(names))
    free = count(max(named, default=-1) + 1)
    return np.array([number if number >= 0 else next(free) for number in numbers], dtype=np.int64)


def _check_leaders(tracks: Tracks, road: Trajectories, step: Ints, where: str) -> None:
    """Refuse tracks in which the vehicle ahead in the dense table is not the leader."""
    column = road.leader[step, tracks.run]
    ahead = np.where(tracks.leader_row >= 0, tracks.run[np.maximum(tracks.leader_row, 0)], tracks.leader_row)
    share = agreement(column, ahead)
    if share < LEAST_AGREEMENT:
        raise InputError(
            f"{where}: only {100.0 * share:.3g} % of the leaders are the next vehicle in this lane, because vehicles"
            f" change lanes or are missing; cut out a part: sugiyama convert {where} part.parquet --from SECONDS"
            " --to SECONDS"
        )
    hidden = (tracks.leader_row == UNKNOWN) & (column >= 0)
    part = np.bincount(tracks.run[hidden], minlength=tracks.runs) / np.diff(tracks.start)
    if part.max() > _UNKNOWN_ROWS:
        names = ", ".join(tracks.run_name(run) for run in np.flatnonzero(part > _UNKNOWN_ROWS).tolist()[:5])
        raise InputError(
            f"{where}: the vehicle ahead of {names} was not always recorded, and the next one is not the leader; leave"
            f" out what has no leader: sugiyama convert {where} rest.parquet{_cure(tracks, part)}"
        )


def _cure(tracks: Tracks, part: Array) -> str:
    """Options that leave out the vehicles without a leader, and the times when not all others were recorded."""
    lost = part > 0.5
    names = ",".join(tracks.vehicle.at(int(row)) for row in tracks.start[:-1][lost])
    cure = f" --without {shlex.quote(names)}" if names else ""
    if (part[~lost] > _UNKNOWN_ROWS).any():
        first, last = tracks.time_s[tracks.start[:-1]][~lost].max(), tracks.time_s[tracks.start[1:] - 1][~lost].min()
        cure += f" --from {first:.9g} --to {last:.9g}"
    return cure


def _check_order(road: Trajectories, where: str) -> None:
    """Refuse vehicles on an open road that drive through one another."""
    if road.road.is_ring or len(road.position_m) < _ENOUGH_SAMPLES:
        return
    leader, position = road.leader, road.position_m
    headway = np.where(leader >= 0, np.take_along_axis(position, np.maximum(leader, 0), axis=1) - position, np.nan)
    followed = np.isfinite(headway)
    if followed.any() and np.mean(headway[followed] < 0.0) > _BEHIND:
        step, column = (int(one[0]) for one in np.nonzero(headway < 0.0))
        raise InputError(
            f"{where}: vehicle {road.vehicle[column]} drives through vehicle {road.vehicle[leader[step, column]]} at"
            f" {road.time_s[step]:g} s: the road is a ring (give --ring METRES), or other lanes or recordings share"
            " this lane (give the column lane or recording)"
        )


def tracks_of(road: Trajectories) -> Tracks:
    """A dense table as tracks of one lane on which everybody is in view."""
    step, column = np.nonzero(np.isfinite(road.position_m))
    about = About(
        view="whole",
        ring_m=road.road.circumference_m,
        period_s=road.period_s,
        source=road.source,
        sha256=road.sha256,
    )
    columns: Columns = {
        "vehicle": numbered(road.vehicle[column]),
        "time_s": road.time_s[step],
        "s_m": road.position_m[step, column],
        "length_m": road.length_m[column],
    }
    return assemble(columns, about, checked=False)
