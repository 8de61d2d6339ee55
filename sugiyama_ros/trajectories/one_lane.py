"""Tracks of one recording on one lane as dense trajectories, and trajectories as tracks."""

import re
import shlex
from itertools import count

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import Columns, assemble
from sugiyama_ros.trajectories.labels import Labels, numbered
from sugiyama_ros.trajectories.leaders import LEAST_AGREEMENT, agreement
from sugiyama_ros.trajectories.time_base import on_time_base, period_of
from sugiyama_ros.trajectories.tracks import UNKNOWN, Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Largest dense table: vehicles times samples, and how many of them for each row that is there.
MOST_CELLS, EMPTIEST = 20_000_000, 20
#: Share of a vehicle's rows with an unknown leader up to which the vehicle ahead counts as the leader.
_UNKNOWN_ROWS = 0.02
#: Share of samples in which a leader may be behind, and samples from which on this is judged.
_BEHIND, _ENOUGH_SAMPLES = 0.02, 50
#: Part of the time that vehicles of a whole road are there.
_PRESENT = 0.9
_NUMBER = re.compile(r"\d{1,9}")


def one_lane(tracks: Tracks, where: str) -> Trajectories:
    """Put tracks of one lane into a dense table. Raises InputError."""
    _one_of(tracks, tracks.recording, "recordings", "recording", where)
    if tracks.road is not None:
        _one_of(tracks, tracks.road, "roads", "road", where)
    if tracks.lane is not None:
        _one_of(tracks, tracks.lane, "lanes", "lane", where)
    regular = on_time_base(tracks)
    period, start = period_of(regular), float(regular.time_s.min())
    step = np.round((regular.time_s - start) / period).astype(np.int64)
    samples = int(step.max()) + 1
    if samples * regular.runs > min(MOST_CELLS, EMPTIEST * max(len(regular), 10_000)):
        raise InputError(
            f"{where}: {regular.runs} vehicles come and go during {samples} samples, which are not one lane with"
            f" everybody present; cut out a part: sugiyama convert {where} part.parquet --from SECONDS --to SECONDS"
        )
    position = np.full((samples, regular.runs), np.nan)
    position[step, regular.run] = regular.s_m
    road = Road(regular.about.ring_m)
    dense = Trajectories(
        position_m=road.wrap(position),
        length_m=regular.length_m[regular.start[:-1]],
        vehicle=numbers_of(regular),
        road=road,
        period_s=period,
        start_s=start,
        source=tracks.about.source,
        sha256=tracks.about.sha256,
    )
    _check_leaders(regular, dense, step, where)
    return dense


def whole_road(tracks: Tracks) -> Trajectories | None:
    """Tracks as a dense table, if they are one lane on which everybody is recorded nearly all the time."""
    if np.mean(tracks.leader_row == UNKNOWN) > _UNKNOWN_ROWS:
        return None
    try:
        dense = one_lane(tracks, tracks.about.source)
    except InputError:
        return None
    return dense if dense.present.mean() >= _PRESENT else None


def _one_of(tracks: Tracks, column: Labels, many: str, option: str, where: str) -> None:
    used = column.used()
    if len(used) > 1:
        raise InputError(
            f"{where}: {len(used)} {many} ({', '.join(used[:5])}{', ...' * (len(used) > 5)}), but this command takes"
            f" one; choose: sugiyama convert {where} one.parquet --{option} {shlex.quote(used[0])}"
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


def is_numbered(vehicle: Labels) -> bool:
    """Whether all vehicles have plain numbers for names."""
    return all(_NUMBER.fullmatch(text) and str(int(text)) == text for text in vehicle.used())


def _check_leaders(tracks: Tracks, dense: Trajectories, step: Ints, where: str) -> None:
    """Refuse tracks in which the vehicle ahead in the dense table is not the leader."""
    column = dense.leader[step, tracks.run]
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


def check_order(trajectories: Trajectories, where: str) -> None:
    """Refuse vehicles on an open road that drive through one another. Raises InputError."""
    if trajectories.road.is_ring or len(trajectories.position_m) < _ENOUGH_SAMPLES:
        return
    leader, position = trajectories.leader, trajectories.position_m
    headway = np.where(leader >= 0, np.take_along_axis(position, np.maximum(leader, 0), axis=1) - position, np.nan)
    followed = np.isfinite(headway)
    if followed.any() and np.mean(headway[followed] < 0.0) > _BEHIND:
        step, column = (int(one[0]) for one in np.nonzero(headway < 0.0))
        raise InputError(
            f"{where}: vehicle {trajectories.vehicle[column]} drives through vehicle"
            f" {trajectories.vehicle[leader[step, column]]} at {trajectories.time_s[step]:g} s: the road is"
            " a ring (give --ring METRES), or other lanes or recordings share this lane (give the column lane or"
            " recording)"
        )


def tracks_of(trajectories: Trajectories) -> Tracks:
    """Trajectories of one lane as tracks."""
    step, column = np.nonzero(np.isfinite(trajectories.position_m))
    road = trajectories.road
    about = About(view="whole", ring_m=road.circumference_m, source=trajectories.source, sha256=trajectories.sha256)
    columns: Columns = {
        "vehicle": numbered(trajectories.vehicle[column]),
        "time_s": trajectories.time_s[step],
        "s_m": trajectories.position_m[step, column],
        "length_m": trajectories.length_m[column],
    }
    return assemble(columns, about, checked=False)
