"""The main job: replay a recording through one estimator for each driver, and record everything in one MCAP file."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.node import Node
from sugiyama_msgs.msg import Progress

from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.filters.online import warm_up
from sugiyama_ros.nodes.base import environment, incoming
from sugiyama_ros.nodes.base.qos import PROGRESS_IN
from sugiyama_ros.nodes.base.spin import Spinner, ros
from sugiyama_ros.nodes.plan import RECORDER, Plan, RunSettings
from sugiyama_ros.nodes.recorder import LOG
from sugiyama_ros.nodes.results import DriverResult, read_run
from sugiyama_ros.nodes.run_source import FromSimulator
from sugiyama_ros.nodes.runners import OneProcess, Processes
from sugiyama_ros.progress import OnProgress

#: Time [s] in which every node must be heard of, once all code is compiled.
START_S = 60.0


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
        on_progress = incoming.receiver(incoming.progress, self._on_progress, lambda reason: None)
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
