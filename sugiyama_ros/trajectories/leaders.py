"""Who leads whom: the next vehicle ahead in the same recording, road, lane and at the same time."""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.tracks import FREE, NOBODY, UNKNOWN, Tracks

#: Two samples within a millisecond are of the same time.
TICK_S = 1e-3
#: Positions between two samples of a vehicle, at most (a GB). More are there only where vehicles do not share their
#: times; leaders are found again when the tracks have been brought to a time base.
MOST_UNSEEN = 10_000_000
# Share of rows that may have a gap below zero, and share of given leaders that must be found again.
_MOST_NEGATIVE, LEAST_AGREEMENT = 0.005, 0.98
# Vehicles, at most, that a message asks to leave out; and speed [m/s] below which a vehicle stands.
_FEW, _STANDS = 3, 0.3
# Standard deviations of a gap below zero that noise may explain.
_WITHIN_STD = 4.0


def ticks(time_s: Array) -> Ints:
    """Times as numbers of ticks, from 0 at the earliest, shape of ``time_s``."""
    return np.round((time_s - time_s.min()) / TICK_S).astype(np.int64) if len(time_s) else np.zeros(0, dtype=np.int64)


def find_leaders(tracks: Tracks) -> Ints:
    """Find the leader of every row: the next ahead at the same time.

    A vehicle without a sample at a time, or without a lane then, is still on the road between its last sample and its
    next one: whoever drives behind it there has an unknown leader.

    Returns (R,), row of the leader; the first vehicle of an open road has an unknown leader if the view has an end, and
    a free road otherwise; a row without a lane, where others have one, has an unknown leader.
    """
    road = Road(tracks.about.ring_m)
    place, there = _places(tracks)
    tick = ticks(tracks.time_s)
    span = int(tick.max(initial=0)) + 1
    own = np.flatnonzero(there)
    leader = np.full(len(tracks) + 1, UNKNOWN, dtype=np.int64)
    if len(own) == 0:
        return leader[:-1]
    unseen = _unseen(tracks, place, own, tick)
    row = np.concatenate((own, np.full(len(unseen.s_m), len(tracks))))
    group = np.concatenate((place[own] * span + tick[own], unseen.place * span + unseen.tick))
    order = np.lexsort((road.wrap(np.concatenate((tracks.s_m[own], unseen.s_m))), group))
    sorted_group, row = group[order], row[order]
    last = np.append(sorted_group[1:] != sorted_group[:-1], True)
    ahead = np.roll(row, -1)
    if road.is_ring:
        first = np.flatnonzero(np.roll(last, 1))
        ahead[last] = row[first]
        found = np.where(ahead == row, FREE, ahead)
    else:
        found = np.where(last, FREE if tracks.about.view == "whole" else UNKNOWN, ahead)
    leader[row] = np.where(found == len(tracks), UNKNOWN, found)
    return leader[:-1]


class _Unseen(NamedTuple):
    """Where vehicles are between two samples when others have one: place, tick and position [m], shape (U,) each."""

    place: Ints
    tick: Ints
    s_m: Array


def _unseen(tracks: Tracks, place: Ints, own: Ints, tick: Ints) -> _Unseen:
    """Positions between successive rows with a lane (own,) of a vehicle, in the lanes that it left and came to."""
    before, after = own[:-1], own[1:]
    same = tracks.run[before] == tracks.run[after]
    if tracks.road is not None:
        same &= tracks.road.code[before] == tracks.road.code[after]
    before, after = before[same], after[same]
    nothing = np.zeros(0, dtype=np.int64)
    step = tick[after] - tick[before]
    if len(step) == 0 or step.max() < 1.5 * step.min():
        return _Unseen(nothing, nothing, np.zeros(0))
    width = int(tick.max()) + 1
    recording = tracks.recording.code.astype(np.int64) * width
    times = np.unique(recording + tick)
    low = np.searchsorted(times, (recording + tick)[before]) + 1
    # two samples of a vehicle may be of the same tick
    count = np.maximum(np.searchsorted(times, (recording + tick)[after]) - low, 0)
    if count.sum() > MOST_UNSEEN:
        return _Unseen(nothing, nothing, np.zeros(0))
    hole = np.repeat(np.arange(len(count)), count)
    at = times[low[hole] + np.arange(len(hole)) - np.repeat(np.cumsum(count) - count, count)] % width
    begin, end = before[hole], after[hole]
    way = Road(tracks.about.ring_m).difference(tracks.s_m[end], tracks.s_m[begin])
    s = tracks.s_m[begin] + way * (at - tick[begin]) / np.maximum(tick[end] - tick[begin], 1)
    moved = place[begin] != place[end]
    places = np.concatenate((place[begin], place[end][moved]))
    return _Unseen(places, np.concatenate((at, at[moved])), np.concatenate((s, s[moved])))


def _places(tracks: Tracks) -> tuple[Ints, Mask]:
    """A number for each recording, road and lane (R,), and whether the row has a lane and a road (R,)."""
    group = tracks.recording.code.astype(np.int64)
    there = np.ones(len(tracks), dtype=bool)
    for column in (tracks.road, tracks.lane):
        if column is not None:
            there &= column.code >= 0
            group = group * (len(column.text) + 1) + column.code
    _, group = np.unique(group, return_inverse=True)
    return group.astype(np.int64), there


class RowIndex:
    """Finds the rows of runs at given times.

    tracks: R rows.
    """

    def __init__(self, tracks: Tracks) -> None:
        own = ticks(tracks.time_s)
        self._span = int(own.max(initial=0)) + 1
        self._key = tracks.run * self._span + own

    def at(self, run: Ints, tick: Ints) -> Ints:
        """Find rows.

        run, tick: (n,), number of the run (below 0 for none) and time as `ticks` counts it. Returns (n,), the row; -1
        where the run has none at this time.
        """
        if len(self._key) == 0:
            return np.full(len(run), -1, dtype=np.int64)
        wanted = run * self._span + tick
        found = np.minimum(np.searchsorted(self._key, wanted), len(self._key) - 1)
        hit = (run >= 0) & (tick >= 0) & (tick < self._span) & (self._key[found] == wanted)
        return np.where(hit, found, -1)


def given_leaders(tracks: Tracks, named: Labels) -> Ints:
    """Rows of leaders that a file names.

    named: (R,), name of the vehicle ahead, `NOBODY` on a free road; missing where it is not known. Returns (R,), the
    leader's row; `UNKNOWN` also for a leader who has no row at this time.
    """
    names = {name: code for code, name in enumerate(tracks.vehicle.text)}
    code = np.array([names.get(name, -1) for name in named.text] + [-1], dtype=np.int64)[named.code]
    width = len(tracks.vehicle.text) + 1
    runs = tracks.start[:-1]
    known = tracks.recording.code[runs].astype(np.int64) * width + tracks.vehicle.code[runs]
    wanted = tracks.recording.code.astype(np.int64) * width + code
    place = np.minimum(np.searchsorted(known, wanted), max(len(known) - 1, 0))
    run = np.where((code >= 0) & (known[place] == wanted), place, -1) if len(known) else np.full(len(tracks), -1)
    row = RowIndex(tracks).at(run, ticks(tracks.time_s))
    free = named.code == (named.text.index(NOBODY) if NOBODY in named.text else len(named.text))
    return np.where(row >= 0, row, np.where(free, FREE, UNKNOWN))


def agreement(found: Ints, given: Ints) -> float:
    """Share of the given leaders (R,) that were found (R,), of rows in which both are known; NaN without such rows."""
    named = (given >= 0) & (found >= 0)
    return float(np.mean(found[named] == given[named])) if named.any() else float("nan")


def gaps(tracks: Tracks) -> Array:
    """Gaps [m], bumper to bumper, shape (R,); NaN where there is no leader."""
    ahead = np.maximum(tracks.leader_row, 0)
    shift = 0.0 if tracks.leader_shift_m is None else np.nan_to_num(tracks.leader_shift_m)
    headway = Road(tracks.about.ring_m).difference(tracks.s_m[ahead] + shift, tracks.s_m)
    if tracks.about.ring_m > 0.0:
        headway = np.where(headway < -tracks.length_m, headway + tracks.about.ring_m, headway)
    gap = headway - 0.5 * (tracks.length_m[ahead] + tracks.length_m)
    return np.where(tracks.leader_row >= 0, gap, np.nan)


def are_trusted(tracks: Tracks) -> bool:
    """Whether the leaders stand as they are given: places on different ways do not say who leads."""
    return tracks.about.leaders == "given" and tracks.leader_shift_m is not None


def check_gaps(tracks: Tracks) -> str:
    """Refuse tracks in which vehicles overlap; where everybody was in view on one lane, return a warning.

    Gaps behind leaders whom positions do not tell say nothing of lanes: those of vehicles that stand close to each
    other are below zero by their noise alone. Raises InputError.
    """
    if are_trusted(tracks):
        return ""
    gap = gaps(tracks)
    followed = int(np.isfinite(gap).sum())
    noise_m = _WITHIN_STD * _gap_std_m(tracks)
    negative = np.flatnonzero(gap < -noise_m)
    if followed == 0 or len(negative) <= _MOST_NEGATIVE * followed:
        return ""
    _check_room(tracks)
    row = int(negative[np.argmin(gap[negative])])
    ahead = int(tracks.leader_row[row])
    said = (
        f"{100.0 * len(negative) / followed:.3g} % of the gaps are below zero, as"
        f" {gap[row]:.1f} m behind vehicle {tracks.vehicle.at(ahead)}{_class_of(tracks, ahead)} at"
        f" {tracks.time_s[row]:g} s (vehicle {tracks.run_name(int(tracks.run[row]))}{_class_of(tracks, row)}):"
        f" {_cure(tracks, gap + noise_m, followed)}"
    )
    if tracks.about.view == "whole" and tracks.lane is None:
        return f"warning: {said}"
    raise InputError(f"{tracks.about.source or 'tracks'}: {said}")


def _check_room(tracks: Tracks) -> None:
    """Raise InputError for a ring that is shorter than the vehicles on it."""
    (place, there), tick = _places(tracks), ticks(tracks.time_s)
    _, moment = np.unique((place * (int(tick.max(initial=0)) + 1) + tick)[there], return_inverse=True)
    length_m = np.bincount(moment, tracks.length_m[there])
    if 0.0 < tracks.about.ring_m < length_m.max(initial=0.0):
        vehicles = int(np.sum(moment == np.argmax(length_m)))
        raise InputError(
            f"{tracks.about.source or 'tracks'}: {vehicles} vehicles of {length_m.max():.0f} m in all do not fit on a"
            f" ring of {tracks.about.ring_m:g} m; give its circumference with --ring, or their lengths (length_m)"
        )


def _cure(tracks: Tracks, gap: Array, followed: int) -> str:
    """What makes most of the gaps (R,) [m], with what noise may take away, positive."""
    ahead = np.maximum(tracks.leader_row, 0)
    half = 0.5 * (tracks.length_m[ahead] - tracks.length_m)
    references = (("front", -half), ("rear", half)) if tracks.about.reference == "centre" else ()
    for reference, shift in references:
        # Centres that are front bumpers in truth lie half a length further back.
        if np.sum(gap + shift < 0.0) <= _MOST_NEGATIVE * followed:
            return f"positions look like {reference} bumpers; give --reference {reference}"
    overlaps = (gap < 0.0) & (gap >= -0.5 * (tracks.length_m[ahead] + tracks.length_m))
    if tracks.about.ring_m == 0.0 and np.sum(overlaps) <= _MOST_NEGATIVE * followed:
        return "leaders are behind their followers, as on a ring; convert it with --ring METRES"
    if few := _in_the_way(tracks, gap):
        return f"only {', '.join(few)} overlap with others; leave them out with --without {','.join(few)}"
    if tracks.lane is None:
        return (
            "several lanes, or recordings that have nothing to do with each other, or clocks that differ, share one"
            " lane here, or positions are not metres; give the column lane or recording, or the unit (--columns)"
        )
    return "check units, lengths and the reference of the positions (--columns, --reference)"


def _class_of(tracks: Tracks, row: int) -> str:
    """The class of the vehicle of a row, in brackets; nothing where it is not known."""
    known = tracks.vehicle_class is not None and tracks.vehicle_class.at(row)
    return f" ({known})" if known else ""


def _in_the_way(tracks: Tracks, gap: Array) -> list[str]:
    """The few vehicles without which hardly any gap (R,) is below zero; nobody if there are not so few."""
    led = np.flatnonzero(np.isfinite(gap))
    own, ahead = tracks.run[led], tracks.run[tracks.leader_row[led]]
    there, found = np.ones(len(led), dtype=bool), list[int]()
    while (bad := there & (gap[led] < 0.0)).sum() > _MOST_NEGATIVE * there.sum():
        if len(found) == _FEW or 2 * len(found) + 4 > tracks.runs:
            return []
        found.append(int(np.argmax(np.bincount(np.concatenate((own[bad], ahead[bad]))))))
        there &= (own != found[-1]) & (ahead != found[-1])
    return [tracks.vehicle.at(int(tracks.start[run])) for run in sorted(found)] if there.any() else []


def _gap_std_m(tracks: Tracks) -> float:
    """Standard deviation [m] of a gap by the noise of positions, as vehicles show it that stand; 0 if none does."""
    if len(tracks) < 3:
        return 0.0
    same = tracks.run[2:] == tracks.run[:-2]
    stands = same & (np.abs(tracks.s_m[2:] - tracks.s_m[:-2]) < _STANDS * (tracks.time_s[2:] - tracks.time_s[:-2]))
    if not stands.any():
        return 0.0
    second = (tracks.s_m[2:] - 2.0 * tracks.s_m[1:-1] + tracks.s_m[:-2])[stands]
    # a gap has the noise of two positions, a second difference that of one weighted 1, -2, 1
    return float(np.median(np.abs(second)) / 0.6745 * math.sqrt(2.0 / 6.0))
