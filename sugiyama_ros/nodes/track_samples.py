"""Tracks as samples to send: at each time, the vehicles that are in view then."""

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.nodes.base.samples import UNKNOWN_LEADER, Positions
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.time_base import on_time_base, period_of
from sugiyama_ros.trajectories.tracks import FREE, Tracks

# Largest number of a vehicle, which ROS sends in 32 bits.
_LAST_VEHICLE = 2**31 - 1


class TrackSamples:
    """Tracks as samples, on a regular time base. Several recordings follow one another.

    tracks: R rows, with their leaders; a leader who is not known is sent as one who is not in view; vehicle: number of
    the vehicle of each run: its name if all names are numbers and each comes once, else the number of the run; names:
    vehicle and recording of each number; empty where the numbers are names.
    """

    def __init__(self, tracks: Tracks) -> None:
        tracks = on_time_base(tracks)
        self.road, self.period_s = Road(tracks.about.ring_m), period_of(tracks)
        self.source, self.sha256 = tracks.about.source, tracks.about.sha256
        step, self.start_s = _steps(tracks, self.period_s)
        self.steps = int(step.max(initial=-1)) + 1
        self.vehicle = _numbers(tracks)
        given = {number: tracks.run_name(run) for run, number in enumerate(self.vehicle)}
        self.names = {} if all(str(number) == name for number, name in given.items()) else given
        order = np.argsort(step, kind="stable")
        self._first = np.searchsorted(step[order], np.arange(self.steps + 1))
        number = np.array(self.vehicle, dtype=np.int64)[tracks.run]
        ahead = number[np.maximum(tracks.leader_row, 0)]
        other = np.where(tracks.leader_row == FREE, -1, UNKNOWN_LEADER)
        self._number = number[order]
        self._leader = np.where(tracks.leader_row >= 0, ahead, other)[order]
        self._position_m, self._length_m = self.road.wrap(tracks.s_m)[order], tracks.length_m[order]
        self._lane = _lanes(tracks)[order] if tracks.lane is not None else None
        self._d_m = None if tracks.d_m is None else tracks.d_m[order]

    @property
    def drivers_per_s(self) -> float:
        """Samples of drivers in a second, where most vehicles are in view."""
        return float(np.diff(self._first).max(initial=0)) / self.period_s

    def at(self, step: int) -> Positions:
        """Sample number ``step``: the vehicles that are in view then."""
        here = slice(self._first[step], self._first[step + 1])
        return Positions(
            self._number[here].tolist(),
            self._leader[here].tolist(),
            self._position_m[here].tolist(),
            self._length_m[here].tolist(),
            () if self._lane is None else self._lane[here].tolist(),
            () if self._d_m is None else self._d_m[here].tolist(),
        )


def _steps(tracks: Tracks, period_s: float) -> tuple[Ints, float]:
    """Number of the sample of each row (R,), and time [s] of the first; recordings one after the other."""
    step = np.zeros(len(tracks), dtype=np.int64)
    start_s, last = float(tracks.time_s.min(initial=np.inf)), -1
    codes = tracks.recording.code
    for code in dict.fromkeys(codes.tolist()):
        here = codes == code
        time: Array = tracks.time_s[here]
        step[here] = last + 1 + np.round((time - time.min()) / period_s).astype(np.int64)
        last = int(step[here].max())
    return step, start_s if np.isfinite(start_s) else 0.0


def _numbers(tracks: Tracks) -> list[int]:
    """Number of the vehicle of each run."""
    names = [tracks.vehicle.at(int(row)) for row in tracks.start[:-1]]
    if len(set(names)) == len(names) and all(n.isascii() and n.isdigit() and int(n) <= _LAST_VEHICLE for n in names):
        return [int(name) for name in names]
    return list(range(len(names)))


def _lanes(tracks: Tracks) -> Ints:
    """Number of the lane of each row (R,): its name if all names are numbers, else its place; -1 where unknown."""
    lane = tracks.lane
    assert lane is not None
    of_text = [int(t) if t.isascii() and t.isdigit() else -1 for t in lane.text]
    if min(of_text, default=0) < 0:
        of_text = list(range(len(lane.text)))
    return np.array([*of_text, -1], dtype=np.int64)[lane.code]
