"""Replay of recorded trajectories."""

from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from sugiyama_msgs.srv import Seek

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.measured import FORMAT as BAG
from sugiyama_ros.formats.measured import stamp_ns
from sugiyama_ros.formats.registry import format_of, known_suffixes, read_tracks, read_trajectories
from sugiyama_ros.formats.truth import read_truth
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.samples import Positions, PositionSamples
from sugiyama_ros.nodes.base.spin import run_node
from sugiyama_ros.nodes.source import Source, answer
from sugiyama_ros.nodes.track_samples import TrackSamples
from sugiyama_ros.nodes.true_topics import TrueTopics
from sugiyama_ros.trajectories.trajectories import Trajectories
from sugiyama_ros.trajectories.truth import Truth


class RecordedPositions:
    """Recorded trajectories as samples.

    trajectories: the measured positions; truth: what the drivers really did, where they were simulated.
    """

    def __init__(self, trajectories: Trajectories, truth: Truth | None = None) -> None:
        t, self.truth = trajectories, truth
        self.road, self.period_s, self.start_s, self.steps = t.road, t.period_s, t.start_s, len(t.position_m)
        self.source, self.sha256 = t.source, t.sha256
        self.trajectories = t
        self.vehicle = t.vehicle.tolist()
        self._leader = np.where(t.leader >= 0, t.vehicle[t.leader], -1)

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


def samples_of(path: Path, ring_m: float | None) -> "RecordedPositions | TrackSamples":
    """Read a file: vehicles that come and go on lanes, or trajectories on one lane.

    ring_m: circumference [m] of the ring, where the file does not say it. Raises InputError.
    """
    if format_of(path).is_of_tracks:
        return TrackSamples(read_tracks(path, Choices(ring_m=ring_m)))
    trajectories = read_trajectories(path, ring_m)
    return RecordedPositions(trajectories, read_truth(path) if format_of(path) is BAG else None)


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
        self.loop = self.get_parameter("loop").value
        truth = getattr(self.samples, "truth", None)
        self._truth = _RecordedTruth(self, truth, self.samples.start_s) if truth is not None else None
        self.create_service(Seek, "~/seek", self._on_seek)

    def open(self) -> PositionSamples:
        """The samples that were given, or else the file that parameter ``source`` names."""
        for name, default, description in (
            ("source", "", f"file of trajectories: {known_suffixes()}"),
            ("ring", 0.0, "circumference [m] of the ring, where the file does not say it; 0: as the file says"),
            ("loop", False, "start again at the end"),
        ):
            self.declare_parameter(name, default, ParameterDescriptor(description=description, read_only=True))
        if self._given is not None:
            return self._given
        source, ring_m = self.get_parameter("source").value, self.get_parameter("ring").value
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


def main() -> None:
    """Run the replay."""
    run_node(Replay)


if __name__ == "__main__":
    main()
