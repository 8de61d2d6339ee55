"""The main job: replay a recording through one estimator for each driver, and record everything in one MCAP file."""

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.parameter import Parameter
from sugiyama_msgs.msg import DriverArray, Progress

from sugiyama_ros.errors import InputError, SugiyamaError
from sugiyama_ros.filters.online import warm_up
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.laws.registry import LAWS
from sugiyama_ros.nodes.base import cdr_messages, environment, incoming
from sugiyama_ros.nodes.base.feed import RoadFeed
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import PROGRESS_IN, WINDOW
from sugiyama_ros.nodes.base.spin import RUNNER, Spinner, held_back, ros
from sugiyama_ros.nodes.critic import Critic
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.estimator import Estimator
from sugiyama_ros.nodes.plan import CRITIC, DRIVERS, RECORDER, FromSimulator, Plan, RunSettings
from sugiyama_ros.nodes.recorder import LOG, Recorder
from sugiyama_ros.progress import OnProgress

#: Time [s] in which every node must be heard of, once all code is compiled.
START_S = 60.0
#: Longest time [s] that nodes get to come to an orderly end.
STOP_S = 15.0
_LAST_STEPS_S = 0.5
# How a line of a node's log begins that tells of no trouble.
_INFORMS = "[INFO]"
#: Exit codes of a node that was stopped. ``run_node`` sets the alarm when the work of the node is done.
_ENDED_WELL = (0, -signal.SIGALRM)
# Parameters of every driver; a message without them is of another node.
_SHOWN = {"v_star", "kappa_v", "sigma_nu", "sigma_a"}


@dataclass(frozen=True)
class DriverResult:
    """One driver at the end of a run: the last parameters, and how well each next position was predicted.

    vehicle: number of the vehicle; v_star, kappa_v, sigma_nu, sigma_a: desired speed [m/s], risk premium [s],
    measurement noise [m] and acceleration noise [m/s^2]; one_step_rmse_m, nis_mean: root mean square of the innovations
    [m] and mean of their nis [1], over the scored samples; naN without any; law: parameters of the driver's law by
    names such as ``idm.T``, in SI units; empty for the paper's driver; identified: parameters that the samples
    determine.
    """

    vehicle: int
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
    a signal has ended the run; drivers: parameters and errors of every driver.
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


class _Monitor(Node):
    """Receives how far every node has come, and how much it has published."""

    def __init__(self, source: str) -> None:
        self._source = source
        super().__init__("monitor", start_parameter_services=False)
        self.heard = 0
        self.joined_s = self.moved_s = time.monotonic()
        self.last: dict[str, Progress] = {}
        # what is no Progress comes from no node of this run
        on_progress = incoming.receiver(Progress, self._on_progress)
        self.create_subscription(Progress, "/_progress", on_progress, PROGRESS_IN, raw=True)

    @property
    def steps(self) -> int:
        """Steps that all nodes have taken."""
        return self.last[self._source].steps if self._source in self.last else 0

    def _on_progress(self, message: Progress) -> None:
        self.heard += 1
        before = self.last.get(message.node)
        if before is None:
            self.joined_s = time.monotonic()
        elif message.node == self._source and message.steps > before.steps:
            self.moved_s = time.monotonic()
        self.last[message.node] = message


def run(
    source: Path | FromSimulator,
    output: Path,
    *,
    processes: bool = False,
    on_progress: OnProgress = lambda done, total: None,
    **settings: Any,
) -> RunResult:
    """Replay a recording, or simulate drivers, with one estimator for each driver, and record everything in one file.

    SIGINT or SIGTERM ends the run early, in good order; call this function in the main thread, where signals come.

    Raises SugiyamaError, KeyboardInterrupt.
    """
    environment.isolate()
    plan, before = Plan.read(source, output, RunSettings(**settings)), _written(output)
    warm_up()  # first, so that compiling does not count as time that a node is not heard of
    began = time.monotonic()
    with ros() as asked_to_stop:
        monitor = _Monitor(plan.source.node)
        runners = Processes(plan) if processes else OneProcess(plan)
        spinner = Spinner([monitor, *runners.nodes])
        try:
            while not asked_to_stop() and monitor.steps < plan.source.steps:
                spinner.slice()
                runners.check()
                _check_started(plan, monitor, began)
                on_progress(monitor.steps, plan.source.steps)
        finally:
            runners.stop(spinner)
            wall_s = time.monotonic() - began
            spinner.until_quiet(lambda: monitor.heard)
            spinner.close()
            runners.close()
            monitor.destroy_node()
        if asked_to_stop() and _written(plan.output) == before:
            raise KeyboardInterrupt  # no sample came, so there is nothing to lose and nothing to report
        runners.check()
    return _result(plan, monitor, wall_s, asked_to_stop())


def _written(path: Path) -> tuple[int, int] | None:
    """Identify the file under a name; None if there is none."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_ino, stat.st_mtime_ns


def _check_started(plan: Plan, monitor: _Monitor, began_s: float) -> None:
    """Raise SugiyamaError where a node has not been heard of for too long."""
    missing = {plan.source.node, RECORDER, *plan.followers} - set(monitor.last)
    if missing and time.monotonic() - began_s > START_S:
        raise SugiyamaError(f"{min(missing)}: not heard of after {START_S:.0f} s; is the machine overloaded?")


def _result(plan: Plan, monitor: _Monitor, wall_s: float, interrupted: bool) -> RunResult:
    """Compare what the nodes say that they published with what is in the finished file."""
    counts, drivers = read_run(plan.output)
    published = sum(message.published for message in monitor.last.values())
    recorded = sum(count for topic, count in counts.items() if topic != LOG)
    # For a sample that an estimator missed, it published nothing: its topics then have too few messages.
    short = sum(monitor.steps - counts.get(topic, 0) for topic in plan.step_topics)
    return RunResult(
        steps=monitor.steps,
        vehicles=len(plan.source.vehicles),
        messages_published=published,
        messages_recorded=recorded,
        messages_lost=max(0, published - recorded, short),
        wall_s=wall_s,
        real_time_factor=plan.source.period_s * monitor.steps / max(monitor.moved_s - monitor.joined_s, 1e-9),
        output=plan.output,
        interrupted=interrupted,
        drivers=drivers,
    )


class OneProcess:
    """Runs all nodes in this process; ``nodes`` are to be executed here. window: samples that may be under way."""

    def __init__(self, plan: Plan, window: int = WINDOW) -> None:
        self._paced: list[PacedNode] = []
        own = _overrides(plan.estimator)
        try:
            self._source = plan.source.start(_overrides(plan.sending))
            self._paced.append(self._source)
            feed: RoadFeed | None = None
            if plan.source.tracks is not None:
                self._paced.append(DriversNode(parameter_overrides=_overrides(plan.drivers)))
            else:
                for _, namespace in sorted(zip(plan.source.vehicles, plan.namespaces, strict=True)):
                    estimator = Estimator(feed, namespace=namespace, parameter_overrides=own)
                    self._paced.append(estimator)
                    feed = estimator.feed
            if plan.settings.critic:
                self._paced.append(Critic(feed))
            self._followers = self._paced[1:]
            # The recorder comes last, so that it finds the topics of all other nodes at once.
            self._recorder = Recorder(parameter_overrides=_overrides(plan.recorder))
            self._paced.append(self._recorder)
            for node in self._paced:
                node.narrow(window)
        except SugiyamaError:
            # a source that stays alive would send its road to other runs of this process
            self.close()
            raise

    @property
    def nodes(self) -> list[Node]:
        """Nodes to be executed in this process."""
        return list(self._paced)

    def check(self) -> None:
        """Raise the error that a node has met."""
        for node in self._paced:
            if node.failure is not None:
                raise node.failure

    def stop(self, spinner: Spinner) -> None:
        """Stop the source first and the recorder last, so that everything sent is in the file."""
        self._source.finish()
        spinner.until(lambda: all(node.steps == self._source.next_step for node in self._followers), STOP_S)
        for node in [*self._followers, self._recorder]:
            node.finish()
        spinner.until(lambda: self._recorder.received == sum(node.published for node in self._paced), STOP_S)
        self._recorder.close()

    def close(self) -> None:
        """Take the nodes down."""
        for node in self.nodes:
            node.destroy_node()


class Processes:
    """Runs every node in a process of its own; ``nodes``, to be executed here, is empty."""

    def __init__(self, plan: Plan) -> None:
        if plan.settings.array:
            raise InputError("array: one message can hold only the drivers of one process; leave out --processes")
        self.nodes: list[Node] = []
        self._logs = Path(tempfile.mkdtemp(prefix="sugiyama-"))
        self._stopped = False
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._start(RECORDER, "recorder", plan.recorder)
        if plan.source.tracks is not None:
            self._start(DRIVERS, "drivers", plan.drivers)
        else:
            for name in plan.estimators:
                self._start(name, "estimator", plan.estimator)
        if plan.settings.critic:
            self._start(CRITIC, "critic", {})
        self._source = plan.source.node
        self._start(self._source, plan.source.node.strip("/"), plan.sending)

    def check(self) -> None:
        """Raise SugiyamaError if a process has ended without being asked to, or with a failure."""
        for name, child in self._children.items():
            code = child.poll()
            if code is not None and not (self._stopped and code in _ENDED_WELL):
                log = self._log(name)
                lines = log.read_text(errors="replace").split("\n") if log.exists() else []
                told = (line.strip() for line in reversed(lines) if not line.startswith(_INFORMS))
                said = next(filter(None, told), "said nothing")
                raise SugiyamaError(f"{name}: ended with code {code}: {said}; its log is {log}")

    def stop(self, spinner: Spinner) -> None:
        """Stop the source first and the recorder last. Kill a process that does not end."""
        self._stopped = True
        self._interrupt(self._source)
        spinner.until(lambda: False, _LAST_STEPS_S)
        estimators = [name for name in self._children if name not in (self._source, RECORDER)]
        self._interrupt(*estimators)
        self._wait_for(spinner, self._source, *estimators)
        self._interrupt(RECORDER)
        self._wait_for(spinner, RECORDER)

    def close(self) -> None:
        """Remove the logs, unless they tell of a failure."""
        if all(child.returncode in _ENDED_WELL for child in self._children.values()):
            rmtree(self._logs)

    def _start(self, name: str, module: str, parameters: dict[str, Any]) -> None:
        """Start one node. Its parameters go into a file, because a command line gives some characters a meaning."""
        arguments = ["--ros-args", "-r", f"__ns:={name.rpartition('/')[0] or '/'}"]
        if parameters:
            given = self._log(name).with_suffix(".yaml")
            given.write_text(json.dumps({"/**": {"ros__parameters": parameters}}))
            arguments += ["--params-file", str(given)]
        with self._log(name).open("wb") as log, held_back():
            self._children[name] = subprocess.Popen(
                [sys.executable, "-m", f"sugiyama_ros.nodes.{module}", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                # A Ctrl-C in the terminal is for the runner, which stops its children in order.
                start_new_session=True,
                env=os.environ | {RUNNER: str(os.getpid())},
            )

    def _interrupt(self, *names: str) -> None:
        for name in names:
            self._children[name].send_signal(signal.SIGINT)

    def _wait_for(self, spinner: Spinner, *names: str) -> None:
        """Wait until processes have ended. Kill those that do not end."""
        children = [self._children[name] for name in names]
        spinner.until(lambda: all(child.poll() is not None for child in children), STOP_S)
        for child in children:
            if child.poll() is None:
                child.kill()
                child.wait()

    def _log(self, name: str) -> Path:
        return self._logs / (name.strip("/").replace("/", ".") + ".log")


def _overrides(parameters: dict[str, Any]) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in parameters.items()]


def read_run(path: Path) -> tuple[dict[str, int], tuple[DriverResult, ...]]:
    """Read the file of a run.

    Returns counts: number of messages on each topic; drivers: the drivers, in the order of their numbers. Raises
    InputError.
    """
    read = _Read()
    with Bag(path) as bag:
        topics = bag.info().topics
        for topic, kind, _, raw in bag.raw_messages({topic.name for topic in topics if topic.type in read.kinds}):
            read.kinds[kind](topic, raw)
    counts = {topic.name: topic.count for topic in topics}
    return counts, tuple(sorted(read.drivers(), key=lambda driver: driver.vehicle))


class _Read:
    """What is read of the messages: scores of all samples, and the last message about each driver."""

    def __init__(self) -> None:
        #: What takes in a message, by the type of the message.
        self.kinds = {
            "sugiyama_msgs/msg/Innovation": self._innovation,
            "sugiyama_msgs/msg/DriverParameters": self._parameters,
            "sugiyama_msgs/msg/DriverArray": self._array,
        }
        self._innovations: list[bytes] = []
        self._scores: defaultdict[int, list[tuple[float, float]]] = defaultdict(list)
        self._last: dict[str, bytes] = {}
        self._last_array: dict[int, DriverArray] = {}

    def _innovation(self, _: str, raw: bytes) -> None:
        self._innovations.append(raw)

    def _parameters(self, topic: str, raw: bytes) -> None:
        self._last[topic] = raw

    def _array(self, _: str, raw: bytes) -> None:
        try:
            message = incoming.drivers(raw)
        except incoming.RefusedError:
            return
        scores = zip(message.vehicle, message.scored, message.innovation_m, message.nis, strict=True)
        for vehicle, scored, innovation_m, nis in scores:
            self._last_array[vehicle] = message
            if scored:
                self._scores[vehicle].append((innovation_m**2, nis))

    def drivers(self) -> Iterator[DriverResult]:
        """Every driver."""
        innovation = cdr_messages.read_innovations(self._innovations)
        scored = innovation[innovation["scored"]]
        scores = np.column_stack([np.square(scored["innovation_m"]), scored["nis"]])
        for vehicle in np.unique(scored["vehicle"]).tolist():
            self._scores[vehicle] += scores[scored["vehicle"] == vehicle].tolist()
        for raw in self._last.values():
            try:
                one = incoming.parameters(raw)
            except incoming.RefusedError:
                continue
            if set(one.name) >= _SHOWN:
                known = tuple(compress(one.name, one.identified))
                yield _driver(one.vehicle, one.name, np.array(one.value), self._scores[one.vehicle], known)
        for vehicle, array in self._last_array.items():
            values = np.reshape(array.value, (len(array.vehicle), len(array.name)))
            row, adapted = list(array.vehicle).index(vehicle), list(compress(array.name, array.estimated))
            known = tuple(compress(adapted, array.identified[row * len(adapted) : (row + 1) * len(adapted)]))
            yield _driver(vehicle, array.name, values[row], self._scores[vehicle], known)


def _driver(
    vehicle: int, names: Sequence[str], values: Any, score: list[tuple[float, float]], identified: tuple[str, ...]
) -> DriverResult:
    parameters = dict(zip(names, values.tolist(), strict=True))
    squared, nis = np.array(score).mean(axis=0).tolist() if score else (math.nan, math.nan)
    return DriverResult(
        vehicle=vehicle,
        v_star=parameters["v_star"],
        kappa_v=parameters["kappa_v"],
        sigma_nu=parameters["sigma_nu"],
        sigma_a=parameters["sigma_a"],
        one_step_rmse_m=math.sqrt(squared),
        nis_mean=nis,
        law={name: value for name, value in parameters.items() if name.partition(".")[0] in LAWS},
        identified=identified,
    )
