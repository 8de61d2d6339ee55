"""Replay of recorded trajectories."""

from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from sugiyama_msgs.srv import Seek

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.registry import format_of, known_suffixes, read_tracks, read_trajectories
from sugiyama_ros.nodes.base.samples import Positions, PositionSamples
from sugiyama_ros.nodes.base.spin import run_node
from sugiyama_ros.nodes.source import Source, answer
from sugiyama_ros.nodes.track_samples import TrackSamples
from sugiyama_ros.trajectories.trajectories import Trajectories


class RecordedPositions:
    """Recorded trajectories as samples."""

    def __init__(self, trajectories: Trajectories) -> None:
        t = trajectories
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

    Parameters
    ----------
    path : Path
        The file.
    ring_m : float or None
        Circumference [m] of the ring, where the file does not say it.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    if format_of(path).is_of_tracks:
        return TrackSamples(read_tracks(path, Choices(ring_m=ring_m)))
    return RecordedPositions(read_trajectories(path, ring_m))


class Replay(Source):
    """Sends a file of trajectories.

    Parameters of the node: ``source``, ``ring``, ``loop`` and the parameters of `Source`. Service: ``~/seek``.
    """

    def __init__(self, samples: PositionSamples | None = None, **options: Any) -> None:
        self._given = samples
        super().__init__("replay", **options)
        self.loop = self.get_parameter("loop").value
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
