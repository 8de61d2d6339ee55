"""Stretches: the unbroken parts of tracks in which a driver's leader is known, as dense arrays for a filter."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.leaders import RowIndex, ticks
from sugiyama_ros.trajectories.time_base import LONGEST_HOLE_S, on_time_base, period_of, pieces
from sugiyama_ros.trajectories.tracks import FREE, LINE, UNKNOWN, Tracks

#: Shortest stretch [s]: a few times as long as the acceleration noise lasts.
SHORTEST_STRETCH_S = 5.0
# Leaders and lanes that last for less than `_FLICKER_S` [s] are ignored; samples within `_AROUND_CHANGE_S` [s] of a
# driver's own lane change are not scored.
_FLICKER_S, _AROUND_CHANGE_S = 1.0, 2.0
# Speed [m/s] below which a vehicle stands, time [s] over which it is measured, and gap [m] up to which vehicles queue.
_STANDING, _STOOD_S, _QUEUE_M = 0.5, 0.6, 10.0
# Part of a stretch in which the leader's leader must be known, for the rest to be left out.
_MOST = 0.8


@dataclass(frozen=True, eq=False)
class Stretch:
    """One driver with the vehicles ahead, at T evenly spaced times.

    recording, vehicle, driver, vehicle_class: who drives; empty where the tracks do not say; start_s, period_s: time
    [s] of the first sample, and between two samples; ring_m: circumference [m] of the ring; 0 for an open road;
    position_m: (T, M), positions [m] of the driver and of the vehicles ahead; naN where missing; m is 3 where the
    leader's leader is known throughout, else 2: then nobody knows what the leader reacts to; identity: (T, M), number
    of each vehicle's run in the tracks; -1 where nobody is ahead; length_m: (T, M), lengths [m]; 0 where nobody is
    ahead; behind: (T, 3), run, position [m] and length [m] of the vehicle behind; -1 and NaN where there is none in the
    tracks; line: (T, 8), the columns of `LINE`, and those of the leader, NaN where there is none; scored: (T,), whether
    the sample says how the driver follows: False around the driver's own lane changes.
    """

    recording: str
    vehicle: str
    driver: str
    vehicle_class: str
    start_s: float
    period_s: float
    ring_m: float
    position_m: Array
    identity: Ints
    length_m: Array
    behind: Array
    line: Array
    scored: Mask

    @property
    def duration_s(self) -> float:
        """Time [s] from the first sample to the last."""
        return self.period_s * (len(self.position_m) - 1)


def stretches(tracks: Tracks, shortest_s: float = SHORTEST_STRETCH_S) -> Iterator[Stretch]:
    """Cut the tracks of drivers into stretches; who is controlled is no driver.

    A hole of more than 0.5 s ends a stretch, and so do another road and a leader who is unknown for a second or more:
    an unknown leader is not a free road. Where the leader's leader is known in four fifths of a stretch, the rest is
    left out. Tracks that are not on a regular time base are brought to one first.

    shortest_s: shortest stretch [s] that counts.
    """
    regular = on_time_base(tracks)
    cutter = _Cutter(regular)
    for first, last in pairwise(pieces(regular, max(LONGEST_HOLE_S, 1.5 * period_of(regular))).tolist()):
        if not regular.controlled_runs[regular.run[first]]:
            yield from cutter.cut(int(regular.run[first]), first, last, shortest_s)


class _Cutter:
    """Cuts tracks on a regular time base."""

    def __init__(self, tracks: Tracks) -> None:
        self._tracks = tracks
        self._period_s = period_of(tracks)
        self._run, self._tick = tracks.run, ticks(tracks.time_s)
        self._index = RowIndex(tracks)
        self._per_step = self._period_s * 1000.0
        self._flicker = round(_FLICKER_S / self._period_s)
        self._follower = np.full(len(tracks), -1, dtype=np.int64)
        led = np.flatnonzero(tracks.leader_row >= 0)
        self._follower[tracks.leader_row[led]] = led

    def cut(self, run: int, first: int, last: int, shortest_s: float) -> Iterator[Stretch]:
        """The stretches of one piece."""
        samples = round((self._tick[last - 1] - self._tick[first]) / self._per_step) + 1
        shortest = math.ceil(shortest_s / self._period_s - 1e-6) + 1
        if samples < shortest:
            return
        tick = self._tick[first] + np.round(np.arange(samples) * self._per_step).astype(np.int64)
        step = np.round((self._tick[first:last] - self._tick[first]) / self._per_step).astype(np.int64)
        own = np.full(samples, -1, dtype=np.int64)
        own[step] = np.arange(first, last)
        leader, leader_row = self._ahead(own, tick)
        second, second_row = self._ahead(leader_row, tick)
        second = np.where(leader == FREE, FREE, second)
        for begin, end in _spans(leader != UNKNOWN):
            first_known, last_known = max(_spans(second[begin:end] != UNKNOWN), key=_size, default=(0, 0))
            both = last_known - first_known >= max(_MOST * (end - begin), shortest)
            part = slice(begin + first_known, begin + last_known) if both else slice(begin, end)
            if part.stop - part.start >= shortest:
                ahead = [(leader[part], leader_row[part])]
                ahead += [(second[part], second_row[part])] * both
                yield self._stretch(run, tick[part], own[part], ahead)

    def _ahead(self, row: Ints, tick: Ints) -> tuple[Ints, Ints]:
        """Run of the vehicle ahead of each row (-1 for a row that is missing), without flicker, and its row."""
        ahead = np.where(row >= 0, self._tracks.leader_row[row], UNKNOWN)
        identity = np.where(ahead >= 0, self._run[np.maximum(ahead, 0)], ahead)
        missing = row < 0
        identity = _without_flicker(_held(identity, missing), self._flicker)
        found = self._rows(identity, tick)
        return identity, found

    def _rows(self, run: Ints, tick: Ints) -> Ints:
        """Rows of runs at ticks that may be off by the rounding of one tick."""
        found = self._index.at(run, tick)
        for off in (-1, 1):
            lost = (found < 0) & (run >= 0)
            if not lost.any():
                break
            found[lost] = self._index.at(run[lost], tick[lost] + off)
        return found

    def _stretch(self, run: int, tick: Ints, own: Ints, ahead: list[tuple[Ints, Ints]]) -> Stretch:
        """The stretch of a run with the vehicles ahead: their runs and their rows."""
        tracks = self._tracks
        columns: list[tuple[Ints, Ints]] = [(np.full(len(own), run), own)]
        for identity, row in ahead:
            # On a ring with two vehicles the leader's leader is the driver, who is not listed twice.
            identity = np.where(identity == run, FREE, identity)
            columns.append((identity, np.where(identity >= 0, row, -1)))
        row = np.stack([one for _, one in columns], axis=1)
        identity = np.stack([one for one, _ in columns], axis=1)
        length = tracks.length_m[tracks.start[np.maximum(identity, 0)]]
        position = np.where(row >= 0, tracks.s_m[row], np.nan)
        for k in range(1, row.shape[1]):  # along the driver's own way
            position[:, k:] += self._shift(row[:, k - 1], identity[:, k])[:, None]
        first = int(tracks.start[run])
        return Stretch(
            recording=tracks.recording.at(first),
            vehicle=tracks.vehicle.at(first),
            driver=_text(tracks.driver, first),
            vehicle_class=_text(tracks.vehicle_class, first),
            start_s=float(tracks.time_s[own[0]]) if own[0] >= 0 else float(tick[0]) * 1e-3 + float(tracks.time_s.min()),
            period_s=self._period_s,
            ring_m=tracks.about.ring_m,
            position_m=position,
            identity=np.maximum(identity, -1),
            length_m=np.where(identity >= 0, length, 0.0),
            behind=self._behind(own),
            line=np.hstack([self._line(own), self._line(row[:, 1], position[:, 1])]),
            scored=self._scored(own) & ~self._held(own, position, length),
        )

    def _behind(self, own: Ints) -> Array:
        """Run, position [m] and length [m] of the vehicle behind each row."""
        row = np.where(own >= 0, self._follower[own], -1)
        s = self._tracks.s_m[row] - self._shift(row, np.full(len(own), self._run[own[own >= 0][0]]))
        found = np.column_stack([self._run[row], s, self._tracks.length_m[row]]).astype(np.float64)
        found[row < 0] = (-1.0, np.nan, np.nan)
        return found

    def _shift(self, row: Ints, leader: Ints) -> Array:
        """What to add to the positions of leaders (T,), given by their runs, of rows (T,) [m]; NaN for nobody.

        Where the row has another leader for a moment, it is what it is at the nearest time at which it has this one.
        """
        if self._tracks.leader_shift_m is None:
            return np.zeros(len(row))
        ahead = np.where(row >= 0, self._tracks.leader_row[row], -1)
        known = (ahead >= 0) & (self._run[ahead] == leader) & (leader >= 0)
        shift, time = np.full(len(row), np.nan), np.arange(len(row))
        shift[known] = np.nan_to_num(self._tracks.leader_shift_m[row[known]])
        for run in np.unique(leader[~known & (leader >= 0)]).tolist():
            of = np.flatnonzero(known & (leader == run))
            wanted = ~known & (leader == run)
            if len(of):
                nearest = of[np.argmin(np.abs(time[wanted][:, None] - of), axis=1)]
                shift[wanted] = shift[nearest]
        return shift

    def _line(self, row: Ints, position: Array | None = None) -> Array:
        """The columns of the road ahead in each row; places move with the position [m], along the driver's own way."""
        columns = [getattr(self._tracks, name) for name in LINE]
        missing = np.full(len(row), np.nan)
        line = np.column_stack([missing if c is None else np.where(row >= 0, c[row], np.nan) for c in columns])
        if position is not None:
            line[:, 0] += position - self._tracks.s_m[row]
        return line

    def _held(self, own: Ints, position: Array, length: Array) -> Mask:
        """Whether the driver stands behind a vehicle that stands, or before a line that is not free.

        A car with its brake on does not move, not even at random. It is left out where drivers come to lines, and wait
        for long. What decides it is known before the sample, so that the others stay as likely as they were.
        """
        if self._tracks.line_m is None or self._tracks.clear_s is None:
            return np.zeros(len(own), dtype=bool)
        stands = [_stands(column, self._period_s) for column in position[:, :2].T]
        near = position[:, 1] - position[:, 0] - 0.5 * (length[:, 0] + length[:, 1]) < _QUEUE_M
        clear = np.where(own >= 0, self._tracks.clear_s[own], np.nan)
        held = stands[0] & ((stands[1] & near) | (clear > 0.0))
        return np.concatenate(([False], held[:-1]))

    def _scored(self, own: Ints) -> Mask:
        """Whether each sample lies far enough from the driver's own lane changes."""
        lane = self._tracks.lane
        if lane is None or self._tracks.leader_shift_m is not None:  # a lane then is a piece of the way
            return np.ones(len(own), dtype=bool)
        code = _without_flicker(_held(lane.code[own].astype(np.int64), own < 0), self._flicker)
        near = np.zeros(len(own), dtype=bool)
        around = round(_AROUND_CHANGE_S / self._period_s)
        for change in (np.flatnonzero(np.diff(code) != 0) + 1).tolist():
            near[max(0, change - around) : change + around] = True
        return ~near


def _stands(position: Array, period_s: float) -> Mask:
    """Whether a vehicle at positions (T,) [m] has stood until each sample."""
    back = max(1, round(_STOOD_S / period_s))
    way = np.full(len(position), np.inf)
    way[back:] = np.abs(position[back:] - position[:-back])
    return np.asarray(way < _STANDING * period_s * back)


def _text(column: Labels | None, row: int) -> str:
    return "" if column is None else column.at(row)


def _size(span: tuple[int, int]) -> int:
    return span[1] - span[0]


def _spans(yes: Mask) -> list[tuple[int, int]]:
    """First place of each unbroken part where ``yes`` holds, and the place after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], yes, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _held(value: Ints, missing: Mask) -> Ints:
    """The values (T,), each kept on over missing samples."""
    last = np.maximum.accumulate(np.where(missing, 0, np.arange(len(value))))
    return np.asarray(value[last])


def _without_flicker(value: Ints, shortest: int) -> Ints:
    """The values (T,) with parts that are shorter than ``shortest`` samples replaced by the value before them."""
    start = np.concatenate(([0], np.flatnonzero(np.diff(value)) + 1))
    size = np.diff(np.append(start, len(value)))
    # Parts of the same value that only flicker divides count together.
    keep = size >= shortest
    if keep.all() or not keep.any():
        return value
    place = np.arange(len(start))
    before = np.maximum.accumulate(np.where(keep, place, -1))
    chosen = np.where(before >= 0, before, int(np.argmax(keep)))
    return np.repeat(value[start[chosen]], size)
