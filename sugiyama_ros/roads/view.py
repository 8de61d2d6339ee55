"""What a recording shows of a road: which places are in view, who is there without a sample, and who is beside whom.

Nobody ahead is a claim. It holds where the road is seen to be empty for as far as somebody ahead would matter. A place
is in view from when a vehicle was first seen there until one was last seen there.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.jit import kernel
from sugiyama_ros.roads.network import Path
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.leaders import MOST_UNSEEN, ticks

#: Way [m] ahead that must be seen to be empty for a free road: 200 m, and the length of a lorry that is not in view.
FREE_M = 220.0
# Length [m], at most, of the pieces of a lane that are in view or not.
_PIECE_M = 10.0
# A vehicle that stays away for longer [s] has left.
_LONGEST_ABSENCE_S = 60.0
# Time [s] on each side over which it is found on which side of its lane a vehicle drives.
_SIDE_S = 2.0
# Widths [m] of cars, of narrow and of wide vehicles, and the words by which classes are known.
_WIDTH_M, _NARROW_M, _WIDE_M = 1.8, 0.8, 2.5
_NARROW, _WIDE = ("cycl", "bike", "moped", "scooter"), ("truck", "bus", "trailer", "lorry", "tram", "rail", "coach")
# Lengths [m] below and above which a vehicle without a known class is narrow or wide.
_SHORT_M, _LONG_M = 2.6, 7.0


class Sides(NamedTuple):
    """Where N vehicles are across their lanes: now, and usually in these seconds (N,) [m]; half their widths (N,) [m].

    Half a width is infinite for a vehicle of which only the place along its lane is known.
    """

    across: Array
    usual: Array
    half: Array


@kernel
def is_beside(i: int, j: int, alongside: bool, sides: Sides) -> bool:
    """Whether vehicle j, ahead on the same lane, leaves the way to vehicle i; if alongside, whether it does so now."""
    both = sides.half[i] + sides.half[j]
    if abs(sides.usual[j] - sides.usual[i]) >= both:
        return True
    return alongside and abs(sides.across[j] - sides.across[i]) >= both


def nobody_beside(count: int) -> Sides:
    """Sides of vehicles of which only the places along their lanes are known."""
    return Sides(np.zeros(count), np.zeros(count), np.full(count, np.inf))


class OnNetwork(NamedTuple):
    """What is known of vehicles on a network, row by row.

    vehicle: (R,), number of the vehicle; route: (R,), number of its route, -1 for none; time_s: (R,), times [s], the
    same for all vehicles in view; place: (R,), places [m] of the centres on the route; length: (R,), lengths [m];
    recording: (R,), number of the recording; vehicles of other recordings are not there; sides: (R,), where they are
    across their lanes.
    """

    vehicle: Ints
    route: Ints
    time_s: Array
    place: Array
    length: Array
    recording: Ints
    sides: Sides

    def steps(self, of: Ints | None = None) -> tuple[Ints, Ints]:
        """Rows of successive samples of a vehicle, as rows before and after; ``of``: among these rows alone."""
        rows = np.arange(len(self.vehicle)) if of is None else of
        order = rows[np.lexsort((self.time_s[rows], self.vehicle[rows], self.recording[rows]))]
        before, after = order[:-1], order[1:]
        same = (self.vehicle[before] == self.vehicle[after]) & (self.recording[before] == self.recording[after])
        same &= self.time_s[after] - self.time_s[before] <= _LONGEST_ABSENCE_S
        return before[same], after[same]


class Hidden(NamedTuple):
    """Vehicles at times at which only others have samples, (U,) each: a row before or after, time [s] and place [m]."""

    row: Ints
    time_s: Array
    place: Array


def hidden(seen: OnNetwork) -> Hidden | None:
    """Where vehicles are between two samples of theirs when others have one; None for too many.

    A vehicle that changes its route meanwhile is on both. Who is on no lane between them, and back at once, was on it:
    to leave a lane takes longer.
    """
    every, following = seen.steps()
    following_of = np.full(len(seen.route), -1)
    following_of[every] = following
    before, after = seen.steps(np.flatnonzero(seen.route >= 0))
    there = (following_of[before] == after) | (seen.time_s[after] - seen.time_s[before] < _SIDE_S)
    before, after = before[there], after[there]
    tick = ticks(seen.time_s)
    width = int(tick.max(initial=0)) + 1
    moment = seen.recording * width + tick
    times, sample = np.unique(moment, return_index=True)
    low = np.searchsorted(times, moment[before]) + 1
    count = np.maximum(np.searchsorted(times, moment[after]) - low, 0)
    if count.sum() > MOST_UNSEEN:
        return None
    hole = np.repeat(np.arange(len(count)), count)
    time = seen.time_s[sample[low[hole] + np.arange(len(hole)) - np.repeat(np.cumsum(count) - count, count)]]
    begin, end = before[hole], after[hole]
    part = (time - seen.time_s[begin]) / (seen.time_s[end] - seen.time_s[begin])
    same = seen.route[begin] == seen.route[end]
    place = np.where(same, (1.0 - part) * seen.place[begin] + part * seen.place[end], seen.place[begin])
    changed = ~same
    return Hidden(
        np.concatenate((begin, end[changed])),
        np.concatenate((time, time[changed])),
        np.concatenate((place, seen.place[end][changed])),
    )


def leaving(seen: OnNetwork, paths: Sequence[Path]) -> Hidden:
    """Where vehicles still are on a route that they have left for another one: for the way of a vehicle's length."""
    before, after = seen.steps()
    changed = (seen.route[before] >= 0) & (seen.route[after] >= 0) & (seen.route[before] != seen.route[after])
    goes_on = dict(zip(before.tolist(), after.tolist(), strict=True))
    found: list[tuple[int, float, float]] = []
    for old, new in zip(before[changed].tolist(), after[changed].tolist(), strict=True):
        row, place, end = new, seen.place[old], paths[seen.route[old]].length_m
        later = goes_on.get(new, new)
        step_s = seen.time_s[later] - seen.time_s[new]
        if seen.route[later] == seen.route[new] and step_s > 0.0:
            speed = (seen.place[later] - seen.place[new]) / step_s
            place = place + speed * (seen.time_s[new] - seen.time_s[old])
        while seen.route[row] == seen.route[new]:
            way = seen.place[row] - seen.place[new]
            if way >= seen.length[old] or place + way >= end:
                break
            found.append((old, float(seen.time_s[row]), float(place + way)))
            if row not in goes_on or seen.time_s[row] - seen.time_s[new] > _LONGEST_ABSENCE_S:
                break
            row = goes_on[row]
    row_of, time, place_of = zip(*found, strict=True) if found else ((),) * 3
    return Hidden(
        np.array(row_of, dtype=np.int64), np.array(time, dtype=np.float64), np.array(place_of, dtype=np.float64)
    )


def behind_lost(leader: Ints, seen: OnNetwork) -> Mask:
    """Rows (R,) behind somebody who is seen no more: who was there then is beyond, and not the leader.

    leader: (R,), row of each leader, or a negative number. Ends where somebody new comes between, and with the route.
    """
    run = seen.recording * (int(seen.vehicle.max(initial=0)) + 1) + seen.vehicle
    ahead = np.where(leader >= 0, run[leader], -1)
    begin, end, followed_until = (np.full(int(run.max(initial=0)) + 1, far) for far in (np.inf, -np.inf, np.inf))
    np.minimum.at(begin, run, seen.time_s)
    np.maximum.at(end, run, seen.time_s)
    # whoever comes later behind the leader of somebody who is lost does not see who is between, either
    last = (seen.time_s == end[run]) & (ahead >= 0)
    np.minimum.at(followed_until, ahead[last], seen.time_s[last])
    lost: Mask = (ahead >= 0) & (seen.time_s > followed_until[ahead]) & ~last
    order = np.lexsort((seen.time_s, run))
    new = (np.diff(run[order]) != 0) | (np.diff(seen.route[order]) != 0)
    for own in np.split(order, np.flatnonzero(new) + 1):
        who = ahead[own]
        for k in np.flatnonzero(np.diff(who)).tolist():
            if who[k] >= 0 and end[who[k]] < seen.time_s[own[k + 1]]:
                lost[own[k + 1 :]] |= (who[k + 1 :] < 0) | (begin[who[k + 1 :]] <= end[who[k]])
    return lost


class InSight:
    """Which places of routes are in view, and when.

    paths: the routes; seen: the samples of all vehicles.
    """

    def __init__(self, paths: Sequence[Path], seen: OnNetwork) -> None:
        network = paths[0].network
        pieces = np.array([max(int(np.ceil(lane.length_m / _PIECE_M)), 1) for lane in network.lanes])
        base = np.concatenate(([0], np.cumsum(pieces)))
        ids, begins, count = [], [], []
        for path in paths:
            ends = np.append(path.start_m[1:], path.length_m)
            for lane, begin, end in zip(path.lanes, path.start_m.tolist(), ends.tolist(), strict=True):
                ids.append(base[lane] + np.arange(pieces[lane]))
                begins.append(begin + (end - begin) / pieces[lane] * np.arange(pieces[lane]))
            count.append(int(pieces[list(path.lanes)].sum()))
        # after the pieces of each route, one that nobody is ever seen on
        ends_at = np.cumsum(count)
        self._first = np.concatenate(([0], ends_at)) + np.arange(len(count) + 1)
        self._piece = np.insert(np.concatenate(ids), ends_at, -1)
        self._begin = np.insert(np.concatenate(begins), ends_at, np.inf)
        self._kinds, self._seen = int(base[-1]), seen
        self._since, self._until, self._key = self._times()

    def _at(self, rows: Ints) -> Ints:
        """Number of the piece, counted over all routes, on which each row is."""
        found = np.zeros(len(rows), dtype=np.int64)
        for route in np.unique(self._seen.route[rows]).tolist():
            own = self._seen.route[rows] == route
            first, last = self._first[route], self._first[route + 1] - 1
            k = np.searchsorted(self._begin[first:last], self._seen.place[rows[own]], side="right") - 1
            found[own] = first + np.maximum(k, 0)
        return found

    def _times(self) -> tuple[Array, Array, Ints]:
        """When each piece was seen first and last [s], and the numbers of recording and piece, which rise."""
        seen = self._seen
        before, after = seen.steps()
        same = (seen.route[before] == seen.route[after]) & (seen.route[before] >= 0)
        alone = np.flatnonzero(seen.route >= 0)
        begin, end = np.append(before[same], alone), np.append(after[same], alone)
        first, last = self._at(begin), self._at(end)
        low, count = np.minimum(first, last), np.abs(last - first) + 1
        step = np.repeat(np.arange(len(count)), count)
        k = np.arange(len(step)) - np.repeat(np.cumsum(count) - count, count)
        part = k / np.maximum(count - 1, 1)[step]
        time = seen.time_s[begin][step] * (1.0 - part) + seen.time_s[end][step] * part
        key, place = np.unique(
            seen.recording[begin][step] * self._kinds + self._piece[low[step] + k], return_inverse=True
        )
        since, until = np.full(len(key), np.inf), np.full(len(key), -np.inf)
        np.minimum.at(since, place, time)
        np.maximum.at(until, place, time)
        return since, until, key

    def far(self, rows: Ints, way_m: float) -> Mask:
        """Whether the road ahead of some rows (N,) is in view, at their times, without a hole for a way [m]."""
        at, target = self._at(rows), self._seen.place[rows] + way_m
        time, recording = self._seen.time_s[rows], self._seen.recording[rows]
        done = np.zeros(len(rows), dtype=bool)
        there = np.arange(len(rows))
        while len(there):
            key = recording[there] * self._kinds + self._piece[at[there]]
            place = np.minimum(np.searchsorted(self._key, key), len(self._key) - 1)
            shown = (self._piece[at[there]] >= 0) & (self._key[place] == key)
            shown &= (self._since[place] <= time[there] + 1e-6) & (time[there] <= self._until[place] + 1e-6)
            there = there[shown]
            done[there] = self._begin[at[there]] >= target[there]
            there = there[~done[there]]
            at[there] += 1
        return done


def widths(width: Array | None, kind: Labels | None, length: Array) -> Array:
    """Widths [m] of vehicles (R,): as measured, or usual for the class, or for a vehicle of this length."""
    usual = np.where(length < _SHORT_M, _NARROW_M, np.where(length > _LONG_M, _WIDE_M, _WIDTH_M))
    if kind is not None:
        of_class = [np.nan] * (len(kind.text) + 1)
        for k, text in enumerate(kind.text):
            for words, metres in ((_NARROW, _NARROW_M), (_WIDE, _WIDE_M), (("car", "passenger"), _WIDTH_M)):
                if np.isnan(of_class[k]) and any(word in text.lower() for word in words):
                    of_class[k] = metres
        named = np.array(of_class)[kind.code]
        usual = np.where(np.isnan(named), usual, named)
    if width is None:
        return usual
    return np.where((width > 0.1) & (width < 10.0), width, usual)


def sides(vehicle: Ints, route: Ints, time_s: Array, across: Array, width: Array) -> Sides:
    """Sides of vehicles (R,), row by row: across [m] their lanes, and the mean over two seconds before and after."""
    usual = np.full(len(across), np.nan)
    there = np.flatnonzero(np.isfinite(across))
    order = there[np.lexsort((time_s[there], route[there], vehicle[there]))]
    new = (np.diff(vehicle[order]) != 0) | (np.diff(route[order]) != 0)
    for own in np.split(order, np.flatnonzero(new) + 1):
        time, sums = time_s[own], np.concatenate(([0.0], np.cumsum(across[own])))
        first = np.searchsorted(time, time - _SIDE_S - 1e-6)
        last = np.searchsorted(time, time + _SIDE_S + 1e-6)
        usual[own] = (sums[last] - sums[first]) / np.maximum(last - first, 1)
    return Sides(across, usual, 0.5 * width)
