"""Replay of recorded trajectories."""

from pathlib import Path
from typing import Any

import numpy as np
from sugiyama_msgs.srv import Seek

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.measured import FORMAT as BAG
from sugiyama_ros.formats.measured import stamp_ns
from sugiyama_ros.formats.registry import format_of, known_suffixes, read_tracks
from sugiyama_ros.formats.truth import read_truth
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.samples import UNKNOWN_LEADER, PositionSamples
from sugiyama_ros.nodes.source import Source, TrueTopics, answer
from sugiyama_ros.road import RINGS_M, Road
from sugiyama_ros.trajectories.dense import DenseTracks, numbers_of, whole_road
from sugiyama_ros.trajectories.placing import Positions
from sugiyama_ros.trajectories.time_base import on_time_base, period_of
from sugiyama_ros.trajectories.tracks import FREE, LINE, Tracks
from sugiyama_ros.trajectories.truth import Truth


class RecordedPositions:
    """Recorded trajectories as samples; truth: what the drivers really did, where they were simulated."""

    def __init__(self, trajectories: DenseTracks, truth: Truth | None = None) -> None:
        t, self.truth = trajectories, truth
        self.road, self.period_s, self.start_s, self.steps = t.road, t.period_s, t.start_s, len(t.position_m)
        self.source, self.sha256 = t.source, t.sha256
        self.trajectories = t
        self.vehicle, self.controlled = t.vehicle.tolist(), t.controlled
        self.names = dict(zip(self.vehicle, t.names, strict=False))
        self._leader = np.where(t.leader >= 0, t.vehicle[t.leader], -1)
        self.true_vehicles: list[int] = [] if truth is None else truth.vehicle.tolist()

    def at(self, step: int) -> Positions:
        """Sample number ``step``."""
        t = self.trajectories
        here = t.present[step]
        return Positions(
            t.vehicle[here].tolist(),
            self._leader[step, here].tolist(),
            t.position_m[step, here].tolist(),
            t.length_m[here].tolist(),
        )


class TrackSamples:
    """Tracks as samples, on a regular time base. Several recordings follow one another.

    A leader who is not known is sent as one who is not in view. vehicle: number of the vehicle of each run, as in a
    model file; names: vehicle and recording of each number; empty where the numbers are names.
    """

    def __init__(self, tracks: Tracks) -> None:
        tracks = on_time_base(tracks)
        self.road, self.period_s = Road(tracks.about.ring_m), period_of(tracks)
        self.source, self.sha256 = tracks.about.source, tracks.about.sha256
        step, self.start_s = _steps(tracks, self.period_s)
        self.steps = int(step.max(initial=-1)) + 1
        self.vehicle, self.true_vehicles = numbers_of(tracks).tolist(), list[int]()
        self.controlled = np.array(self.vehicle)[tracks.controlled_runs].tolist()
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
        more = {name: getattr(tracks, name) for name in ("d_m", *LINE, "leader_shift_m")}
        more["lane"] = None if tracks.lane is None else _lanes(tracks)
        self._more = {name: column[order] for name, column in more.items() if column is not None}

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
            **{name: column[here].tolist() for name, column in self._more.items()},
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


def _lanes(tracks: Tracks) -> Ints:
    """Number of the lane of each row (R,): its name if all names are numbers, else its place; -1 where unknown."""
    lane = tracks.lane
    assert lane is not None
    of_text = [int(t) if t.isascii() and t.isdigit() else -1 for t in lane.text]
    if min(of_text, default=0) < 0:
        of_text = list(range(len(lane.text)))
    return np.array([*of_text, -1], dtype=np.int64)[lane.code]


def samples_of(path: Path, ring_m: float | None) -> "RecordedPositions | TrackSamples":
    """Read a file: vehicles that come and go on lanes, or one road on which everybody is recorded.

    ring_m: circumference [m] of the ring, where the file does not say it. Raises InputError.
    """
    tracks = read_tracks(path, Choices(ring_m=ring_m))
    road = whole_road(tracks)
    if road is None:
        return TrackSamples(tracks)
    return RecordedPositions(road, read_truth(path) if format_of(path) is BAG else None)


class _RecordedTruth:
    """Sends the truth of a recording again, each part of it at its own time."""

    def __init__(self, node: PacedNode, truth: Truth, start_s: float) -> None:
        self._truth, self._topics = truth, TrueTopics(node, truth.vehicle.tolist())
        self._row = {stamp_ns(time_s): row for row, time_s in enumerate(truth.time_s.tolist())}
        self._motion = np.stack([truth.position_m, truth.speed, truth.acceleration, truth.gap_m], axis=2)
        self._unknown = np.full(self._motion.shape[1:], np.nan)
        self._told, self._last_ns = 0, 0
        self._tell_drivers(stamp_ns(start_s))

    def send(self, at_ns: int) -> None:
        """Send the motion at a stamp [ns], and the parameters that have changed until then."""
        if at_ns < self._last_ns:  # the replay has gone back
            self._told = 0
        self._tell_drivers(at_ns)
        row = self._row.get(at_ns)
        self._topics.send_motion(at_ns, self._unknown if row is None else self._motion[row])

    def _tell_drivers(self, until_ns: int) -> None:
        self._last_ns, drivers = until_ns, self._truth.drivers
        while self._told < len(drivers) and stamp_ns(drivers[self._told].time_s) <= until_ns:
            drive = drivers[self._told]
            self._topics.send_parameters(stamp_ns(drive.time_s), drive)
            self._told += 1


class Replay(Source):
    """Sends a file of trajectories, and the truth about simulated drivers where the file has it.

    Parameters of the node: ``source``, ``ring``, ``loop`` and the parameters of `Source`. Service: ``~/seek``.
    """

    def __init__(self, samples: PositionSamples | None = None, **options: Any) -> None:
        self._given = samples
        super().__init__("replay", **options)
        truth = getattr(self.samples, "truth", None)
        self._truth = _RecordedTruth(self, truth, self.samples.start_s) if truth is not None else None
        self.create_service(Seek, "~/seek", self._on_seek)

    def open(self) -> PositionSamples:
        """The samples that were given, or else the file that parameter ``source`` names."""
        source = self.option("source", "", f"file of trajectories: {known_suffixes()}")
        ring = "circumference [m] of the ring, where the file does not say it; 0: as the file says"
        ring_m = self.option("ring", 0.0, ring, (0.0, RINGS_M[1]))
        self.loop = self.option("loop", False, "start again at the end")
        if self._given is not None:
            return self._given
        if not source:
            raise InputError("replay: no file given; start it with -p source:=FILE")
        return samples_of(Path(source), ring_m or None)

    def send_more(self, stamp_ns: int) -> None:
        """Send the truth, if there is any."""
        if self._truth is not None:
            self._truth.send(stamp_ns)

    def _on_seek(self, request: Seek.Request, response: Seek.Response) -> Seek.Response:
        last_s = (self.samples.steps - 1) * self.samples.period_s
        if not 0.0 <= request.time_s <= last_s:
            return answer(response, f"{request.time_s:g} s is not within the recording, 0 to {last_s:g} s")
        self.jump(round(request.time_s / self.samples.period_s))
        return answer(response)
