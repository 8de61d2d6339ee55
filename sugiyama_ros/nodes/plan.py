"""What a run consists of: names and parameters of its nodes, and the topics with one message a step."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from sugiyama_ros.driver.parameters import NAMES, population
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Output, make_directory
from sugiyama_ros.fit.model_file import drivers_of, read_model
from sugiyama_ros.formats.truth import namespace
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.nodes.base.node import RECORDER
from sugiyama_ros.nodes.base.parameters import ENGINES, engine_of
from sugiyama_ros.nodes.keeper import file_of, read_learnt
from sugiyama_ros.nodes.replay import RecordedPositions, TrackSamples, samples_of
from sugiyama_ros.simulation.experiment import Experiment
from sugiyama_ros.trajectories.about import SIMULATED


@dataclass(frozen=True)
class FromSimulator:
    """``number`` drivers in an experiment: their model file, changed parameters, and effects as text."""

    number: int
    experiment: Experiment
    model: Path | None = None
    changes: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[str, ...] = ()

    source = SIMULATED
    sha256 = ""
    controlled: ClassVar[Sequence[int]] = ()

    @property
    def vehicle(self) -> list[int]:
        """Numbers of the vehicles."""
        return list(range(self.number))

    @property
    def true_vehicles(self) -> list[int]:
        """Vehicles whose true motion is sent."""
        return self.vehicle

    @property
    def steps(self) -> int:
        """Number of samples."""
        return self.experiment.samples

    @property
    def period_s(self) -> float:
        """Time [s] between two samples."""
        return self.experiment.period_s

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the node that simulates."""
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


@dataclass(frozen=True)
class RunSettings:
    """How a recording is replayed.

    rate: times real time; 0 is as fast as the nodes take it; ring_m: circumference [m] of the ring, where the file does
    not say it; model: file with the drivers and effects from which the filters start; law: law by which the drivers
    drive, without a model file; critic: whether a critic listens; save_state: directory in which to keep what was
    learnt; resume: directory with what an earlier run has learnt, from which this one goes on; array: whether all
    drivers are in one message for each sample, on ``/drivers``, instead of on topics of each vehicle; engine: what
    works out a step of the filters: compiled, or filterpy; overwrite: whether a file of the output's name is replaced.
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
class UseOfModel:
    """How the drivers of a run start from a model file.

    is_own: whether the file was fitted to the recording, so that they start from their own parameters; if not, they
    start as the file's typical driver; None if that is not known: then their numbers say which driver of the file they
    are; left_out: effects of the file that are tied to a moment of another recording.
    """

    is_own: bool | None
    left_out: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Plan:
    """Send the positions of ``source``, follow the drivers, and record everything in ``output``.

    parameters: of the node that sends the positions.
    """

    source: RecordedPositions | TrackSamples | FromSimulator
    parameters: Mapping[str, Any]
    output: Path
    settings: RunSettings

    @property
    def vehicles(self) -> list[int]:
        """Numbers of the vehicles that have drivers, in their order."""
        return sorted(set(self.source.vehicle) - set(self.source.controlled))

    @property
    def use_of_model(self) -> UseOfModel | None:
        """How the drivers start from the model file, if there is one."""
        if self.settings.model is None:
            return None
        file = read_model(self.settings.model)
        is_own = file.is_of(self.source.sha256)
        return UseOfModel(is_own, file.of_a_moment if is_own is False else ())

    @property
    def vehicles_with_topics(self) -> list[int]:
        """Vehicles that have topics of their own; none where one message holds all drivers."""
        return [] if isinstance(self.source, TrackSamples) or self.settings.array else self.vehicles

    @property
    def paced_topics(self) -> list[str]:
        """Full names of the topics with one message a step; on tracks, there may be nobody to tell of."""
        is_array = self.settings.array and not isinstance(self.source, TrackSamples)
        return [*paced_topics(self.vehicles_with_topics, self.source.true_vehicles), *["/drivers"] * is_array]

    @property
    def drivers(self) -> dict[str, Any]:
        """Parameters of the node that follows those in view on tracks, and else all vehicles all the time."""
        s = self.settings
        given = {"model": s.model, "save_state": s.save_state, "resume": s.resume}
        return {
            **{name: str(path) for name, path in given.items() if path is not None},
            **({} if isinstance(self.source, TrackSamples) else {"vehicles": self.vehicles}),
            "law": s.law,
            "engine": s.engine,
            "vehicle_topics": bool(self.vehicles_with_topics),
            "most_drivers": max(1000, len(self.vehicles)),
        }

    def sending(self, followers: Iterable[str]) -> dict[str, Any]:
        """Parameters of the source, which waits for the recorder, the critic, and the nodes that follow drivers."""
        names = [RECORDER, *followers, *(["critic"] if self.settings.critic else [])]
        waits = {"rate": float(self.settings.rate), "wait_for": [f"/{name}" for name in names]}
        return {**self.parameters, **waits}

    @property
    def recorder(self) -> dict[str, Any]:
        """Parameters of the recorder."""
        s = self.source
        about: dict[str, Any] = {"source": s.source, "sha256": s.sha256}
        if isinstance(s, FromSimulator):
            about |= {f"simulator_{name}": value for name, value in self.parameters.items()}
        elif s.names:  # which vehicle has which number, where the numbers are not the names
            about["vehicle_names"] = json.dumps(s.names)
        about |= {
            "vehicles": len(self.vehicles),
            "steps": s.steps,
            "rate": self.settings.rate or "max",
            "model": str(self.settings.model or ""),
            "start_parameters": json.dumps(dict(zip(NAMES, population().tolist(), strict=True))),
        }
        return {
            "output": str(self.output),
            "overwrite": self.settings.overwrite,
            "paced_topics": self.paced_topics,
            "time_source": "data",
            "metadata": [f"{key}={value}" for key, value in about.items()],
        }


def plan_of(source: Path | FromSimulator, output: Path, settings: RunSettings) -> Plan:
    """Read a file of trajectories, unless drivers are simulated, and check what the settings name.

    Raises InputError, OutputError.
    """
    given = source if isinstance(source, Path) else source.model
    for path in (given, settings.model, output, settings.save_state, settings.resume):
        try:
            str(path).encode()
        except UnicodeEncodeError:
            raise InputError(f"{path}: its name is not UTF-8, which ROS needs; rename it") from None
    Output(output, settings.overwrite).check()
    engine_of(settings.engine)
    drivers_of(settings.model, settings.law, "--{}".format)
    if settings.law != PAPERS and settings.engine != ENGINES[0]:
        raise InputError(f"--engine {settings.engine}: learns no parameters of a law; leave out --engine or --law")
    if settings.save_state is not None:
        make_directory(settings.save_state)
    if isinstance(source, Path):
        samples = samples_of(source, settings.ring_m)
        parameters = {"source": str(source), "ring": samples.road.circumference_m}
        plan = Plan(samples, parameters, output, settings)
    else:
        plan = Plan(source, source.parameters, output, settings)
    if plan.source.controlled and not plan.vehicles:
        raise InputError("run: a controller drives every vehicle; nobody is left to follow")
    _check_saved_states(plan)
    return plan


def _check_saved_states(plan: Plan) -> None:
    """Raise OutputError where states of another run would be replaced, InputError where there are none to go on from.

    A run may go on in its own directory.
    """
    s, vehicles = plan.settings, plan.vehicles
    is_own = s.resume is not None and s.save_state is not None and s.resume.resolve() == s.save_state.resolve()
    if s.save_state is not None and not s.overwrite and not is_own:
        for vehicle in vehicles:
            Output(file_of(s.save_state, vehicle)).check()
    if s.resume is not None:
        saved = [path for vehicle in vehicles if (path := file_of(s.resume, vehicle)).exists()]
        if not saved:
            raise InputError(f"{s.resume}: nothing is known of these vehicles; give a directory of --save-state")
        for path in saved:
            read_learnt(path)


def paced_topics(vehicles: Iterable[int], true_vehicles: Iterable[int]) -> list[str]:
    """Full names of the topics with one message a step; vehicles, true_vehicles: with estimates, and with a truth."""
    own = [f"/{namespace(vehicle)}/{topic}" for vehicle in vehicles for topic in ("state", "innovation")]
    return ["/clock", "/measured", *own, *(f"/{namespace(vehicle)}/truth" for vehicle in true_vehicles)]


def one_for_each(vehicles: Iterable[int], parameters: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Names and parameters of nodes of which each follows one driver."""
    return {f"driver_{v:02}": {**parameters, "vehicles": [v], "vehicle_topics": True} for v in vehicles}


def within(space: str, names: Iterable[str]) -> list[str]:
    """Full names of nodes or topics when all of them lie in a namespace; /clock is the same for everybody."""
    begin = space.strip("/")
    return [f"/{begin}{name}" if begin and name != "/clock" else name for name in names]
