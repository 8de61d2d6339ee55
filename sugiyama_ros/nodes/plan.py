"""What a run consists of: its source and settings, the names of its nodes and topics, the parameters of its nodes."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.parameter import Parameter

from sugiyama_ros.driver.parameters import NAMES, population
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Output, make_directory
from sugiyama_ros.fit.model_file import drivers_of
from sugiyama_ros.formats.truth import namespaces
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.nodes.base.feed import DRIVERS_TOPIC
from sugiyama_ros.nodes.base.parameters import ENGINES, engine_of
from sugiyama_ros.nodes.keeper import file_of, read_learnt
from sugiyama_ros.nodes.replay import Replay, TrackSamples, samples_of
from sugiyama_ros.nodes.simulator import SimulatorNode
from sugiyama_ros.nodes.source import Source
from sugiyama_ros.simulation.experiment import Experiment

REPLAY, RECORDER, CRITIC, DRIVERS = "/replay", "/recorder", "/critic", "/drivers"
#: Vehicles up to which a run makes a node for each driver: 100 of them take half a minute to start, and 600 MB.
MOST_NODES = 100


def true_topics(vehicles: Iterable[int]) -> list[str]:
    """Full names of the topics with the true motion of simulated vehicles."""
    return [f"{space}/truth" for space in namespaces(vehicles)]


@dataclass(frozen=True, eq=False)
class RunSource:
    """Where the positions of a run come from.

    node: full name of the node that sends them; topics: further topics with one message a step; parameters, about: of
    the node, and what the recording says about the source; start: makes the node, with its parameters; tracks: where
    the vehicles come and go, so that one node follows all of them.
    """

    node: str
    vehicles: list[int]
    steps: int
    period_s: float
    topics: list[str]
    parameters: Mapping[str, Any]
    about: Mapping[str, Any]
    start: Callable[[list[Parameter]], Source]
    tracks: TrackSamples | None = None


def from_file(path: Path, ring_m: float | None) -> RunSource:
    """A file that is replayed. Raises InputError."""
    samples = samples_of(path, ring_m)
    truth = getattr(samples, "truth", None)
    about = {"source": samples.source, "sha256": samples.sha256}
    # which vehicle has which number, where the numbers are not the names
    names = {"vehicle_names": json.dumps(samples.names)} if samples.names else {}
    return RunSource(
        node=REPLAY,
        vehicles=samples.vehicle,
        steps=samples.steps,
        period_s=samples.period_s,
        topics=true_topics(truth.vehicle.tolist()) if truth is not None else [],
        parameters={"source": str(path), "ring": samples.road.circumference_m},
        about=about | names,
        start=lambda overrides: Replay(samples, parameter_overrides=overrides),
        tracks=samples if isinstance(samples, TrackSamples) else None,
    )


@dataclass(frozen=True)
class FromSimulator:
    """``number`` drivers in an experiment: their model file, changed parameters, and effects as text."""

    number: int
    experiment: Experiment
    model: Path | None = None
    changes: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[str, ...] = ()

    @property
    def source(self) -> RunSource:
        """The simulator, as the source of a run."""
        e, vehicles = self.experiment, list(range(self.number))
        parameters = {
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
        return RunSource(
            node="/simulator",
            vehicles=vehicles,
            steps=e.samples,
            period_s=e.period_s,
            topics=true_topics(vehicles),
            parameters=parameters,
            about={"source": "adaptiveSeek", "sha256": "", **{f"simulator_{k}": v for k, v in parameters.items()}},
            start=lambda overrides: SimulatorNode(parameter_overrides=overrides),
        )


def estimators(spaces: Iterable[str]) -> list[str]:
    """Full names of the estimators in the vehicles' namespaces."""
    return [f"{space}/estimator" for space in spaces]


def step_topics(spaces: Iterable[str]) -> list[str]:
    """Full names of the topics with one message a step, where each vehicle has topics of its own."""
    return ["/clock", "/measured", *(f"{space}/{topic}" for space in spaces for topic in ("state", "innovation"))]


def within(namespace: str, names: Iterable[str]) -> list[str]:
    """Full names of nodes or topics when all of them lie in a namespace; /clock is the same for everybody."""
    begin = namespace.strip("/")
    return [f"/{begin}{name}" if begin and name != "/clock" else name for name in names]


@dataclass(frozen=True)
class RunSettings:
    """How a recording is replayed.

    rate: times real time; 0 is as fast as the nodes take it; ring_m: circumference [m] of the ring, where the file does
    not say it; model: file with the drivers and effects from which the estimators start; law: law by which the drivers
    drive, without a model file; critic: whether a critic listens; save_state: directory in which the estimators keep
    what they have learnt; resume: directory with what the estimators of an earlier run have learnt, from which they go
    on; array: whether all drivers are in one message for each sample, on ``/drivers``, instead of on topics of each
    vehicle; engine: what works out a step of the filters: compiled, or filterpy; overwrite: whether a file of the
    output's name is replaced.
    """

    rate: float = 0.0
    ring_m: float | None = None
    model: Path | None = None
    law: str = PAPERS
    critic: bool = False
    save_state: Path | None = None
    resume: Path | None = None
    array: bool = False
    engine: str = ENGINES[0]
    overwrite: bool = False


@dataclass(frozen=True)
class Plan:
    """Send what ``source`` holds, and record everything in ``output``."""

    source: RunSource
    output: Path
    settings: RunSettings

    @classmethod
    def read(cls, source: Path | FromSimulator, output: Path, settings: RunSettings) -> "Plan":
        """Read a file of trajectories, unless drivers are simulated, and check what the settings name.

        Raises InputError, OutputError.
        """
        given = (source if isinstance(source, Path) else source.model, settings.model)
        _check_names(*(path for path in given if path is not None), output, settings.save_state, settings.resume)
        Output(output, settings.overwrite).check()
        engine_of(settings.engine)
        drivers_of(settings.model, settings.law, "--{}".format)
        if settings.law != PAPERS and settings.engine != ENGINES[0]:
            raise InputError(f"--engine {settings.engine}: learns no parameters of a law; leave out --engine or --law")
        if settings.save_state is not None:
            make_directory(settings.save_state)
        opened = from_file(source, settings.ring_m) if isinstance(source, Path) else source.source
        plan = cls(opened, output, settings)
        plan.check_size()
        plan.check_saved_states()
        if settings.resume is not None:
            saved = [path for v in plan.source.vehicles if (path := file_of(settings.resume, v)).exists()]
            if not saved:
                raise InputError(
                    f"{settings.resume}: nothing is known of these vehicles; give a directory of --save-state"
                )
            for path in saved:
                read_learnt(path)
        return plan

    def check_size(self) -> None:
        """Raise InputError for what the graph of a run cannot do."""
        count = len(self.source.vehicles)
        if self.source.tracks is None and count > MOST_NODES:
            raise InputError(
                f"{count} vehicles: a node for each driver works for at most {MOST_NODES}; convert the file to tracks,"
                " which one node follows: sugiyama convert FILE TRACKS.parquet, or cut out some vehicles"
            )

    def check_saved_states(self) -> None:
        """Raise OutputError where states of another run would be replaced. A run may go on in its own directory."""
        s = self.settings
        is_own = s.resume is not None and s.save_state is not None and s.resume.resolve() == s.save_state.resolve()
        if s.save_state is None or s.overwrite or is_own:
            return
        for vehicle in self.source.vehicles:
            Output(file_of(s.save_state, vehicle)).check()

    @property
    def vehicles_with_topics(self) -> list[int]:
        """Vehicles that have topics of their own; none where one message holds all drivers."""
        return [] if self.source.tracks is not None or self.settings.array else self.source.vehicles

    @property
    def namespaces(self) -> list[str]:
        """Namespace of each vehicle."""
        return namespaces(self.source.vehicles)

    @property
    def estimators(self) -> list[str]:
        """Full names of the estimators."""
        return estimators(self.namespaces)

    @property
    def step_topics(self) -> list[str]:
        """Full names of the topics with one message a step."""
        if self.source.tracks is not None:
            return ["/clock", "/measured", *self.source.topics]
        own = ["/clock", "/measured", f"/{DRIVERS_TOPIC}"] if self.settings.array else step_topics(self.namespaces)
        return [*own, *self.source.topics]

    @property
    def estimator(self) -> dict[str, Any]:
        """Parameters of every estimator."""
        s = self.settings
        given = {"model": s.model, "save_state": s.save_state, "resume": s.resume}
        paths = {name: str(path) for name, path in given.items() if path is not None}
        return {**paths, "law": s.law, "array_topic": s.array, "engine": s.engine}

    @property
    def drivers(self) -> dict[str, Any]:
        """Parameters of the node that follows all vehicles."""
        own = {name: value for name, value in self.estimator.items() if name != "array_topic"}
        return {**own, "most_drivers": max(1000, len(self.source.vehicles))}

    @property
    def followers(self) -> list[str]:
        """Full names of the nodes that follow the source; without the recorder."""
        own = [DRIVERS] if self.source.tracks is not None else self.estimators
        return [*own, *([CRITIC] if self.settings.critic else [])]

    @property
    def sending(self) -> dict[str, Any]:
        """Parameters of the source."""
        followers = [RECORDER, *self.followers]
        return {**self.source.parameters, "rate": float(self.settings.rate), "wait_for": followers}

    @property
    def recorder(self) -> dict[str, Any]:
        """Parameters of the recorder."""
        about = {
            **self.source.about,
            "vehicles": len(self.source.vehicles),
            "steps": self.source.steps,
            "rate": self.settings.rate or "max",
            "model": str(self.settings.model or ""),
            "start_parameters": json.dumps(dict(zip(NAMES, population().tolist(), strict=True))),
        }
        return {
            "output": str(self.output),
            "overwrite": self.settings.overwrite,
            "paced_topics": self.step_topics,
            "time_source": "data",
            "metadata": [f"{key}={value}" for key, value in about.items()],
        }


def _check_names(*paths: Path | None) -> None:
    """Raise InputError for a name that no parameter of a node can hold."""
    for path in paths:
        try:
            str(path).encode()
        except UnicodeEncodeError:
            raise InputError(f"{path}: its name is not UTF-8, which ROS needs; rename it") from None
