"""The main job: replay a recording, follow each driver with a filter, and record everything in one MCAP file."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.parameter import Parameter

from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.filters.online import warm_up
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.laws.registry import LAWS
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import WINDOW
from sugiyama_ros.nodes.base.spin import Spinner, ros
from sugiyama_ros.nodes.critic import Critic
from sugiyama_ros.nodes.drivers import DriversNode, Told
from sugiyama_ros.nodes.plan import FromSimulator, Plan, RunSettings, UseOfModel, plan_of
from sugiyama_ros.nodes.recorder import LOG, Recorder
from sugiyama_ros.nodes.replay import Replay
from sugiyama_ros.nodes.simulator import SimulatorNode
from sugiyama_ros.nodes.source import Source
from sugiyama_ros.progress import OnProgress

#: Time [s] in which every node must be heard of, once all code is compiled.
START_S = 60.0
#: Longest time [s] that nodes get to come to an orderly end.
STOP_S = 15.0


@dataclass(frozen=True)
class DriverResult:
    """One driver at the end of a run: the last parameters, and how well each next position was predicted.

    vehicle, name: number of the vehicle, and its name in the recording; follows: whether the vehicle ever had a leader;
    v_star, kappa_v, sigma_nu, sigma_a: desired speed [m/s], risk premium [s], measurement noise [m] and acceleration
    noise [m/s^2]; one_step_rmse_m, nis_mean: root mean square of the innovations [m] and mean of their nis [1], over
    the scored samples; naN without any; law: parameters of the driver's law by names such as ``idm.T``, in SI units;
    empty for the paper's driver; identified: parameters that the samples determine.
    """

    vehicle: int
    name: str
    follows: bool
    v_star: float
    kappa_v: float
    sigma_nu: float
    sigma_a: float
    one_step_rmse_m: float
    nis_mean: float
    law: dict[str, float]
    identified: tuple[str, ...]


@dataclass(frozen=True)
class RunResult:
    """What a run did.

    steps: samples that all nodes have taken; vehicles: number of drivers; messages_published, messages_recorded,
    messages_lost: messages that the nodes have counted, messages in the finished file, and messages that the file
    lacks; wall_s: time [s] from the start of the nodes to the closed file; real_time_factor: duration of the recording,
    divided by the time from the first sample sent to the last sample taken [1]; output: the file; interrupted: whether
    a signal has ended the run; drivers: parameters and errors of every driver; use_of_model: how these started from a
    model file, if there is one.
    """

    steps: int
    vehicles: int
    messages_published: int
    messages_recorded: int
    messages_lost: int
    wall_s: float
    real_time_factor: float
    output: Path
    interrupted: bool
    drivers: tuple[DriverResult, ...]
    use_of_model: UseOfModel | None


def run(
    source: Path | FromSimulator, output: Path, on_progress: OnProgress = lambda done, total: None, **settings: Any
) -> RunResult:
    """Replay a recording, or simulate drivers, follow each driver with a filter, and record everything in one file.

    SIGINT or SIGTERM ends the run early, in good order; call this function in the main thread, where signals come.

    Raises SugiyamaError, KeyboardInterrupt.
    """
    environment.isolate()
    plan, before = plan_of(source, output, RunSettings(**settings)), _written(output)
    warm_up()  # first, so that compiling does not count as time that a node is not heard of
    began = time.monotonic()
    with ros() as asked_to_stop:
        nodes = RunNodes(plan)
        spinner = Spinner(nodes.all)
        try:
            while not asked_to_stop() and nodes.source.steps < plan.source.steps:
                spinner.slice()
                nodes.check()
                if nodes.source.missing and time.monotonic() - began > START_S:
                    first = nodes.source.missing[0]
                    raise SugiyamaError(f"{first}: not heard of after {START_S:.0f} s; is the machine overloaded?")
                on_progress(nodes.source.steps, plan.source.steps)
        finally:
            nodes.stop(spinner)
            wall_s = time.monotonic() - began
            spinner.close()
            nodes.close()
        if asked_to_stop() and _written(plan.output) == before:
            raise KeyboardInterrupt  # no sample came, so there is nothing to lose and nothing to report
        nodes.check()
    return _result(plan, nodes, wall_s, asked_to_stop())


def _written(path: Path) -> tuple[int, int] | None:
    """Identify the file under a name; None if there is none."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_ino, stat.st_mtime_ns


class RunNodes:
    """The nodes of a run, all in this process. window: samples that may be under way."""

    def __init__(self, plan: Plan, window: int = WINDOW) -> None:
        self.all: list[PacedNode] = []
        #: Samples that all nodes have taken, once the source is stopped.
        self.steps = 0
        given = {"parameter_overrides": _overrides(plan.sending(["drivers"]))}
        try:
            self.source: Source = (
                SimulatorNode(**given) if isinstance(plan.source, FromSimulator) else Replay(plan.source, **given)
            )
            self.all.append(self.source)
            self.drivers = DriversNode(parameter_overrides=_overrides(plan.drivers))
            self.all.append(self.drivers)
            if plan.settings.critic:
                self.all.append(Critic())
            self._followers = self.all[1:]
            # The recorder comes last, so that it finds the topics of all other nodes at once.
            self._recorder = Recorder(parameter_overrides=_overrides(plan.recorder))
            self.all.append(self._recorder)
            for node in self.all:
                node.narrow(window)
        except SugiyamaError:
            # a source that stays alive would send its road to other runs of this process
            self.close()
            raise

    @property
    def published(self) -> int:
        """Messages that the nodes have published."""
        return sum(node.published for node in self.all)

    def check(self) -> None:
        """Raise the error that a node has met."""
        for node in self.all:
            if node.failure is not None:
                raise node.failure

    def stop(self, spinner: Spinner) -> None:
        """Stop the source first and the recorder last, so that everything sent is in the file."""
        self.source.finish()
        spinner.until(lambda: all(node.steps == self.source.next_step for node in self._followers), STOP_S)
        self.steps = self.source.steps
        for node in [*self._followers, self._recorder]:
            node.finish()
        spinner.until(lambda: self._recorder.received == self.published, STOP_S)
        self._recorder.close()

    def close(self) -> None:
        """Take the nodes down."""
        for node in self.all:
            node.destroy_node()


def _overrides(parameters: Mapping[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in parameters.items()]


def _result(plan: Plan, nodes: RunNodes, wall_s: float, interrupted: bool) -> RunResult:
    """Compare what the nodes say that they published with what is in the finished file."""
    with Bag(plan.output) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
    steps, recorded = nodes.steps, sum(count for topic, count in counts.items() if topic != LOG)
    # For a sample that a filter missed, nothing was published: these topics then have too few messages.
    short = sum(steps - counts.get(topic, 0) for topic in plan.paced_topics)
    names = {} if isinstance(plan.source, FromSimulator) else plan.source.names
    return RunResult(
        steps=steps,
        vehicles=len(plan.vehicles),
        messages_published=nodes.published,
        messages_recorded=recorded,
        messages_lost=max(0, nodes.published - recorded, short),
        wall_s=wall_s,
        real_time_factor=plan.source.period_s * steps / max(nodes.source.sent_for_s, 1e-9),
        output=plan.output,
        interrupted=interrupted,
        drivers=tuple(_driver(v, names.get(v, str(v)), told) for v, told in sorted(nodes.drivers.told.items())),
        use_of_model=plan.use_of_model,
    )


def _driver(vehicle: int, name: str, told: Told) -> DriverResult:
    squared, nis = (total / told.scored if told.scored else math.nan for total in (told.squares_m2, told.nis))
    return DriverResult(
        vehicle=vehicle,
        name=name,
        follows=told.follows,
        v_star=told.value["v_star"],
        kappa_v=told.value["kappa_v"],
        sigma_nu=told.value["sigma_nu"],
        sigma_a=told.value["sigma_a"],
        one_step_rmse_m=math.sqrt(squared),
        nis_mean=nis,
        law={name: value for name, value in told.value.items() if name.partition(".")[0] in LAWS},
        identified=told.identified,
    )
