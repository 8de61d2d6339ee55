"""Where the positions of a run come from: a recording that is replayed, or drivers who are simulated."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol

from rclpy.parameter import Parameter

from sugiyama_ros.formats.truth import namespaces
from sugiyama_ros.nodes.replay import RecordedPositions, Replay
from sugiyama_ros.nodes.simulator import SimulatorNode
from sugiyama_ros.nodes.source import Source
from sugiyama_ros.nodes.track_samples import TrackSamples
from sugiyama_ros.simulation.experiment import Experiment


def true_topics(vehicles: list[int]) -> list[str]:
    """Full names of the topics with the true motion of simulated vehicles."""
    return [f"{space}/truth" for space in namespaces(vehicles)]


class RunSource(Protocol):
    """The source of a run.

    node, module: full name of the node, and module of ``sugiyama_ros.nodes`` that runs it; vehicles: numbers of the
    vehicles; steps: number of samples; period_s: time [s] between two samples; topics: full names of further topics
    with one message a step; parameters, about: parameters of the node, and what the recording says about the source.
    """

    @property
    def node(self) -> str: ...
    @property
    def module(self) -> str: ...
    @property
    def vehicles(self) -> list[int]: ...
    @property
    def steps(self) -> int: ...
    @property
    def period_s(self) -> float: ...
    @property
    def topics(self) -> list[str]: ...
    @property
    def parameters(self) -> Mapping[str, Any]: ...
    @property
    def about(self) -> Mapping[str, Any]: ...

    def start(self, overrides: list[Parameter]) -> Source:
        """The node, in this process."""
        ...


@dataclass(frozen=True)
class FromFile:
    """A file of trajectories, as samples."""

    path: Path
    samples: RecordedPositions
    node: ClassVar[str] = "/replay"
    module: ClassVar[str] = "replay"

    @property
    def topics(self) -> list[str]:
        """The true motion of every vehicle, where the drivers were simulated."""
        truth = self.samples.truth
        return [] if truth is None else true_topics(truth.vehicle.tolist())

    @property
    def vehicles(self) -> list[int]:
        """Numbers of the vehicles."""
        return [int(vehicle) for vehicle in self.samples.trajectories.vehicle]

    @property
    def steps(self) -> int:
        """Samples in the recording."""
        return len(self.samples.trajectories.position_m)

    @property
    def period_s(self) -> float:
        """Time [s] between two samples."""
        return self.samples.trajectories.period_s

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Parameters of the replay."""
        return {"source": str(self.path), "ring": self.samples.trajectories.road.circumference_m}

    @property
    def about(self) -> Mapping[str, Any]:
        """Name and checksum of the file."""
        return {"source": self.samples.trajectories.source, "sha256": self.samples.trajectories.sha256}

    def start(self, overrides: list[Parameter]) -> Source:
        """The replay; it does not read the file again."""
        return Replay(self.samples, parameter_overrides=overrides)


@dataclass(frozen=True)
class FromTracks:
    """A file of vehicles that come and go, as samples."""

    path: Path
    samples: TrackSamples
    node: ClassVar[str] = "/replay"
    module: ClassVar[str] = "replay"
    topics: ClassVar[list[str]] = []

    @property
    def vehicles(self) -> list[int]:
        """Numbers of the vehicles."""
        return self.samples.vehicle

    @property
    def steps(self) -> int:
        """Samples in the recording."""
        return self.samples.steps

    @property
    def period_s(self) -> float:
        """Time [s] between two samples."""
        return self.samples.period_s

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Parameters of the replay."""
        return {"source": str(self.path), "ring": self.samples.road.circumference_m}

    @property
    def about(self) -> Mapping[str, Any]:
        """Name and checksum of the file, and which vehicle has which number, where the numbers are not the names."""
        about = {"source": self.samples.source, "sha256": self.samples.sha256}
        return {**about, "vehicle_names": json.dumps(self.samples.names)} if self.samples.names else about

    def start(self, overrides: list[Parameter]) -> Source:
        """The replay; it does not read the file again."""
        return Replay(self.samples, parameter_overrides=overrides)


@dataclass(frozen=True)
class FromSimulator:
    """``number`` drivers in an experiment: their model file, changed parameters, and effects as text."""

    number: int
    experiment: Experiment
    model: Path | None = None
    changes: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[str, ...] = ()
    node: ClassVar[str] = "/simulator"
    module: ClassVar[str] = "simulator"

    @property
    def vehicles(self) -> list[int]:
        """Numbers of the vehicles."""
        return list(range(self.number))

    @property
    def steps(self) -> int:
        """Samples of the simulation."""
        return self.experiment.samples

    @property
    def period_s(self) -> float:
        """Time [s] between two samples."""
        return self.experiment.period_s

    @property
    def topics(self) -> list[str]:
        """The true motion of every vehicle."""
        return true_topics(self.vehicles)

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Parameters of the simulator."""
        e = self.experiment
        return {
            "vehicles": self.number,
            "ring": e.ring_m,
            "duration": e.duration_s,
            "start": e.start,
            "start_gap": e.gap_m,
            "lengths": list(e.length_m) or [0.0],
            "period": e.period_s,
            "spread": e.spread,
            "seed": e.seed,
            "model": str(self.model or ""),
            "effects": list(self.effects) or [""],
            **self.changes,
        }

    @property
    def about(self) -> Mapping[str, Any]:
        """The setting of the experiment."""
        return {"source": "adaptiveSeek", "sha256": "", **{f"simulator_{k}": v for k, v in self.parameters.items()}}

    def start(self, overrides: list[Parameter]) -> Source:
        """The simulator."""
        return SimulatorNode(parameter_overrides=overrides)
