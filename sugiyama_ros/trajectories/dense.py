"""Tracks of one recording on one lane as dense arrays, and dense arrays as tracks."""

import re
import shlex
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.about import About, checksum_of_parts, file_in
from sugiyama_ros.trajectories.assemble import Column, assemble
from sugiyama_ros.trajectories.jumps import jumps_noted
from sugiyama_ros.trajectories.labels import Labels, numbered
from sugiyama_ros.trajectories.leaders import LEAST_AGREEMENT, agreement
from sugiyama_ros.trajectories.time_base import SHORTEST_S, on_time_base, period_of, regular_time_base
from sugiyama_ros.trajectories.tracks import LINE, UNKNOWN, Tracks

#: Largest number of samples, including missing samples: vehicles times time steps.
MAX_SAMPLES = 20_000_000
# A dense table may have so many cells for each row that is there, of at least so many rows.
_EMPTIEST, _FEW_ROWS = 20, 10_000
# Share of a vehicle's rows with an unknown leader up to which the vehicle ahead counts as the leader.
_UNKNOWN_ROWS = 0.02
# Share of samples in which a leader may be behind, and samples from which on this is judged.
_BEHIND, _ENOUGH_SAMPLES = 0.02, 50
# Part of the time that vehicles of a whole road are there.
_PRESENT = 0.9
_NUMBER = re.compile(r"\d{1,10}")
#: Largest number of a vehicle, which ROS sends in 32 bits.
LAST_VEHICLE = 2**31 - 1


@dataclass(frozen=True, eq=False, repr=False)
class DenseTracks:
    """Positions of N vehicles at T regular times.

    Parameters
    ----------
    position_m : ndarray, shape (T, N)
        Positions [m] of the vehicles' centres, wrapped on a ring; NaN where a sample is missing.
    length_m : ndarray, shape (N,)
        Lengths [m] of the vehicles.
    vehicle : ndarray of int, shape (N,)
        Numbers of the vehicles, as in their file.
    road : Road
        The road.
    period_s : float
        Time [s] between two samples.
    start_s : float
        Time [s] of the first sample.
    source, sha256 : str
        Name and checksum of the file that the positions come from; without a file, the checksum of the positions.
    controlled : tuple of int
        Numbers of the vehicles that a controller drives.
    names : tuple of str
        Names (N,) of the vehicles in their file; empty where their numbers are their names.

    Raises
    ------
    InputError
        If the shapes do not fit together, or a value is impossible.
    """

    position_m: Array
    length_m: Array
    vehicle: Ints
    road: Road
    period_s: float
    start_s: float = 0.0
    source: str = ""
    sha256: str = ""
    controlled: tuple[int, ...] = ()
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        samples, vehicles = self.position_m.shape
        if samples < 2 or vehicles < 1:
            raise InputError(f"{self.source or 'tracks'}: need at least 2 samples of 1 vehicle")
        if self.length_m.shape != (vehicles,) or self.vehicle.shape != (vehicles,):
            raise InputError(f"{self.source or 'tracks'}: give one length and one number for each vehicle")
        if not (self.period_s > 0.0 and np.isfinite(self.period_s)):
            raise InputError(f"{self.source or 'tracks'}: the time between samples is {self.period_s} s")
        if len(np.unique(self.vehicle)) != vehicles:
            raise InputError(f"{self.source or 'tracks'}: a vehicle's number occurs twice")
        if not (np.all(np.isfinite(self.length_m)) and np.all(self.length_m >= 0.0)):
            raise InputError(f"{self.source or 'tracks'}: a vehicle's length is negative or not a number")
        if not self.sha256:
            rows = self.vehicle, self.position_m, np.array([self.start_s, self.period_s])
            object.__setattr__(self, "sha256", checksum_of_parts(rows))

    def headline(self) -> str:
        """Say how many vehicles there are, for how long, and on what road."""
        road = f"a ring of {self.road.circumference_m:g} m" if self.road.is_ring else "an open road"
        vehicles, samples = len(self.vehicle), len(self.position_m)
        return (
            f"{vehicles} vehicles on {road}, {samples} samples of {self.period_s:.4g} s, from {self.source or 'memory'}"
        )

    @property
    def name(self) -> tuple[str, ...]:
        """Names (N,) of the vehicles in their file."""
        return self.names or tuple(map(str, self.vehicle.tolist()))

    @property
    def time_s(self) -> Array:
        """Times [s] of the samples, shape (T,)."""
        return np.asarray(self.start_s + self.period_s * np.arange(len(self.position_m)), dtype=np.float64)

    @property
    def duration_s(self) -> float:
        """Time [s] from the first sample to the last."""
        return self.period_s * (len(self.position_m) - 1)

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """Whether each vehicle is on the road, from its first to its last known sample; shape (T, N)."""
        known = np.isfinite(self.position_m)
        seen = np.maximum.accumulate(known, axis=0)
        to_come = np.maximum.accumulate(known[::-1], axis=0)[::-1]
        return np.asarray(seen & to_come)

    @cached_property
    def leader(self) -> Ints:
        """Column of the vehicle directly ahead on the road, shape (T, N); -1 where there is none.

        The leader of a vehicle is the vehicle that is directly ahead in most samples, so that one bad measurement does
        not change the leader. Leaders change when a vehicle enters or leaves the road.
        """
        leader = np.full(self.position_m.shape, -1, dtype=np.int64)
        filled = self._filled
        changes = np.flatnonzero(np.any(self.present[1:] != self.present[:-1], axis=1)) + 1
        for first, last in zip([0, *changes], [*changes, len(leader)], strict=True):
            on_road = np.flatnonzero(self.present[first])
            if len(on_road) > 1:
                leader[first:last, on_road] = _leaders(filled[first:last][:, on_road], on_road, self.road)
        return leader

    def around(self, drivers: Sequence[int], ahead: int) -> "DenseTracks":
        """Return the part of the recording that some drivers see: these drivers first, then those who drive ahead.

        Parameters
        ----------
        drivers : sequence of int
            Columns of the drivers.
        ahead : int
            How many vehicles ahead of each driver belong to the part. They keep their leaders within the part.
        """
        near = np.asarray(drivers)
        seen = near.tolist()
        for _ in range(ahead):
            near = np.unique(self.leader[:, near])
            near = near[near >= 0]
            seen += near.tolist()
        columns = np.array(list(dict.fromkeys(seen)))
        place = np.full(len(self.vehicle) + 1, -1)  # the last entry is that of nobody, -1
        place[columns] = np.arange(len(columns))
        part = replace(
            self,
            position_m=self.position_m[:, columns],
            length_m=self.length_m[columns],
            vehicle=self.vehicle[columns],
            names=tuple(self.names[k] for k in columns.tolist()) if self.names else (),
        )
        part.__dict__["leader"] = place[self.leader[:, columns]]  # found among all vehicles
        return part

    @cached_property
    def follower(self) -> Ints:
        """(T, N): index of the vehicle whose leader is the vehicle of this column, -1 where there is none.

        The first of several vehicles with the same leader counts. The table is made once for all drivers.
        """
        vehicles = self.leader.shape[1]
        follower = np.empty(self.leader.shape, dtype=np.int64)
        for behind, leader, present in zip(follower, self.leader, self.present, strict=True):
            followers = np.flatnonzero((leader >= 0) & present)
            first = np.full(vehicles, vehicles)
            np.minimum.at(first, leader[followers], followers)
            behind[:] = np.where(first < vehicles, first, -1)
        return follower

    @property
    def _filled(self) -> Array:
        """Continuous positions [m], with straight lines in place of missing samples; shape (T, N)."""
        filled = self.road.unwrap(self.position_m).copy()
        ticks = np.arange(len(filled))
        for column in filled.T:
            known = np.isfinite(column)
            if known.any():
                column[:] = np.interp(ticks, ticks[known], column[known])
        return filled


def _leaders(position_m: Array, number: Ints, road: Road) -> Ints:
    """Find the most common leader of each vehicle in ``position_m`` (T, n), as entries of ``number`` (n,) or -1."""
    order = np.argsort(road.wrap(position_m), axis=1, kind="stable")
    ahead = np.empty_like(order)
    np.put_along_axis(ahead, order, np.roll(order, -1, axis=1), axis=1)
    if not road.is_ring:
        np.put_along_axis(ahead, order[:, -1:], -1, axis=1)
    found = np.empty(len(number), dtype=np.int64)
    for k, votes in enumerate(ahead.T):
        candidates, count = np.unique(votes, return_counts=True)
        winner = candidates[np.argmax(count)]
        found[k] = number[winner] if winner >= 0 else -1
    return found


def dense(tracks: Tracks, where: str = "") -> DenseTracks:
    """Put tracks of one lane into a dense table; ``where``: name of the file for messages. Raises InputError."""
    where = where or tracks.about.source or "tracks"
    if own_ways := [name for name in (*LINE, "leader_shift_m") if tracks.column(name) is not None]:
        raise InputError(
            f"{where}: has the column {own_ways[0]}, so drivers come to lines or curves of their own, where one lane is"
            " needed; keep them as tracks, in a .parquet or .csv file"
        )
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
            f" everybody present; cut out a part: {_part_of(where, 'part.parquet')} --from SECONDS --to SECONDS"
        )
    _check_apart(regular, step, period, where)
    position = np.full((samples, regular.runs), np.nan)
    position[step, regular.run] = regular.s_m
    road = Road(regular.about.ring_m)
    number = numbers_of(regular)
    names = tuple(regular.vehicle.at(row) for row in regular.start[:-1].tolist())
    found = DenseTracks(
        position_m=road.wrap(position),
        length_m=regular.length_m[regular.start[:-1]],
        vehicle=number,
        road=road,
        period_s=period,
        start_s=start,
        source=tracks.about.source,
        sha256=tracks.about.sha256,
        controlled=tuple(number[regular.controlled_runs].tolist()),
        names=() if names == tuple(map(str, number.tolist())) else names,
    )
    if not _is_in_view(tracks):
        _check_leaders(regular, found, step, where)
    return found


def whole_road(tracks: Tracks) -> DenseTracks | None:
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
        check_jumps(tracks, where)
    return road if road.present.mean() >= _PRESENT else None


def road_of_drivers(tracks: Tracks) -> DenseTracks | None:
    """Tracks as ``whole_road``, if nobody there is controlled: the others then follow vehicles as these were measured.

    What is sampled more often than anybody decides is brought to the usual period, as tracks are. Raises InputError as
    ``whole_road``.
    """
    road = whole_road(tracks)
    if road is not None and road.period_s < SHORTEST_S:
        road = whole_road(on_time_base(tracks))
    return None if road is None or road.controlled else road


def one_road(tracks: Tracks, where: str = "") -> DenseTracks:
    """Tracks of one lane as a dense table: as a whole road where they are one. Raises InputError."""
    return whole_road(tracks) or dense(tracks, where)


def check_jumps(tracks: Tracks, where: str) -> None:
    """Refuse vehicles that jump."""
    if note := jumps_noted(tracks):
        raise InputError(f"{where}: {note.removeprefix('warning: ')}")


def _is_in_view(tracks: Tracks) -> bool:
    """Whether everybody was in view, so that positions say better than single rows who leads whom."""
    return tracks.about.view == "whole" and tracks.about.leaders == "found"


def _check_one(column: Labels, many: str, option: str, where: str) -> None:
    used = column.used()
    if len(used) > 1:
        raise InputError(
            f"{where}: {len(used)} {many} ({', '.join(used[:5])}{', ...' * (len(used) > 5)}) where one is needed;"
            f" choose: {_part_of(where, 'one.parquet')} --{option} {shlex.quote(used[0])}"
        )


def _part_of(where: str, output: str) -> str:
    """The command, without its options, that writes a part of a file."""
    return f"sugiyama convert {shlex.quote(file_in(where))} {output}"


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
    """A number for each run, (V,): the last one in its name where no two are alike, else the number of the run."""
    names = [tracks.vehicle.at(int(row)) for row in tracks.start[:-1]]
    found = [_NUMBER.findall(name) for name in names]
    numbers = [int(one[-1]) if one else -1 for one in found]
    named = [number for number in numbers if number >= 0]
    last = max(named, default=-1) + len(names) - len(named)
    if len(set(named)) < len(named) or last > LAST_VEHICLE:
        return np.arange(len(names))
    free = count(max(named, default=-1) + 1)
    return np.array([number if number >= 0 else next(free) for number in numbers], dtype=np.int64)


def _check_leaders(tracks: Tracks, road: DenseTracks, step: Ints, where: str) -> None:
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


def _check_order(road: DenseTracks, where: str) -> None:
    """Refuse vehicles on an open road that drive through one another."""
    if road.road.is_ring or len(road.position_m) < _ENOUGH_SAMPLES:
        return
    leader, position = road.leader, road.position_m
    headway = np.where(leader >= 0, np.take_along_axis(position, np.maximum(leader, 0), axis=1) - position, np.nan)
    followed = np.isfinite(headway)
    if followed.any() and np.mean(headway[followed] < 0.0) > _BEHIND:
        step, column = (int(one[0]) for one in np.nonzero(headway < 0.0))
        raise InputError(
            f"{where}: vehicle {road.name[column]} drives through vehicle {road.name[leader[step, column]]} at"
            f" {road.time_s[step]:g} s: the road is a ring (give --ring METRES), or other lanes or recordings share"
            " this lane (give the column lane or recording)"
        )


def tracks_of(road: DenseTracks) -> Tracks:
    """A dense table as tracks of one lane on which everybody is in view."""
    step, column = np.nonzero(np.isfinite(road.position_m))
    about = About(
        view="whole",
        ring_m=road.road.circumference_m,
        period_s=road.period_s,
        source=road.source,
        sha256=road.sha256,
    )
    columns: dict[str, Column] = {
        "vehicle": numbered(road.vehicle[column]),
        "time_s": road.time_s[step],
        "s_m": road.position_m[step, column],
        "length_m": road.length_m[column],
    }
    if road.controlled:
        columns["controlled"] = np.isin(road.vehicle[column], road.controlled)
    return assemble(columns, about, checked=False)
