"""The main job: replay a recording through one estimator for each driver, all of it recorded in one MCAP file."""

import time
from dataclasses import dataclass
from pathlib import Path

from rclpy.node import Node
from sugiyama_msgs.msg import Progress

from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.base.qos import PROGRESS_IN
from sugiyama_ros.nodes.base.spin import Spinner, ros
from sugiyama_ros.nodes.plan import RECORDER, REPLAY, Plan
from sugiyama_ros.nodes.results import DriverResult, read_run
from sugiyama_ros.nodes.runners import OneProcess, Processes
from sugiyama_ros.progress import OnProgress

_START_S = 60.0


@dataclass(frozen=True)
class RunResult:
    """What a run did.

    steps: samples that all nodes have taken. messages_published, as the nodes counted them; messages_recorded, as read
    back from the finished file; messages_lost: what should be in the file and is not. wall_s [s]: from the start of the
    nodes to the closed file. real_time_factor: time of the recording over the time from the first sample sent to the
    last one taken. interrupted: stopped by a signal.
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
    """Hears how far every node has come, and how much it has published."""

    def __init__(self) -> None:
        super().__init__("monitor", start_parameter_services=False)
        self.heard = 0
        self.joined_s = self.moved_s = time.monotonic()
        self.last: dict[str, Progress] = {}
        self.create_subscription(Progress, "/_progress", self._on_progress, PROGRESS_IN)

    @property
    def steps(self) -> int:
        """Steps that all have taken."""
        return self.last[REPLAY].steps if REPLAY in self.last else 0

    def _on_progress(self, message: Progress) -> None:
        self.heard += 1
        before = self.last.get(message.node)
        if before is None:
            self.joined_s = time.monotonic()
        elif message.node == REPLAY and message.steps > before.steps:
            self.moved_s = time.monotonic()
        self.last[message.node] = message


def run(
    source: Path,
    output: Path,
    *,
    rate: float = 0.0,
    processes: bool = False,
    ring_m: float | None = None,
    model: Path | None = None,
    critic: bool = False,
    save_state: Path | None = None,
    resume: Path | None = None,
    on_progress: OnProgress | None = None,
) -> RunResult:
    """Replay ``source`` through one estimator for each driver and record everything in ``output``.

    rate: times real time; 0 is as fast as the nodes take it. processes: one process for each node instead of one for
    all. ring_m: circumference [m] where the file does not tell. model: file with the drivers and effects from which
    the estimators start; critic: whether a critic listens, and its verdicts are recorded; save_state: directory in
    which the estimators keep what they have learnt; resume: one from which they go on. A signal (SIGINT, SIGTERM) ends
    the run early, in good order. To be called in the main thread, where signals come.

    Raises InputError or OutputError for files that cannot be read or written, and SugiyamaError where a node has
    ended or has not started.
    """
    environment.isolate()
    plan = Plan.read(source, output, rate, ring_m, model, critic, save_state, resume)
    total = len(plan.trajectories.position_m)
    began = time.monotonic()
    with ros() as asked_to_stop:
        monitor = _Monitor()
        team = Processes(plan) if processes else OneProcess(plan)
        spinner = Spinner([monitor, *team.nodes])
        try:
            while not asked_to_stop() and monitor.steps < total:
                spinner.slice()
                team.check()
                missing = {REPLAY, RECORDER, *plan.followers} - set(monitor.last)
                if missing and time.monotonic() - began > _START_S:
                    raise SugiyamaError(
                        f"{min(missing)}: not heard of after {_START_S:.0f} s; is the machine overloaded?"
                    )
                if on_progress is not None:
                    on_progress(monitor.steps, total)
        finally:
            team.stop(spinner)
            wall_s = time.monotonic() - began
            spinner.until_quiet(lambda: monitor.heard)
            spinner.close()
            team.close()
            monitor.destroy_node()
        team.check()
        interrupted = asked_to_stop()
    counts, drivers = read_run(output)
    published = sum(message.published for message in monitor.last.values())
    recorded = sum(counts.values())
    # What a driver missed was never published either: his topics are short of messages.
    short = sum(monitor.steps - counts.get(topic, 0) for topic in plan.step_topics)
    return RunResult(
        steps=monitor.steps,
        vehicles=len(plan.estimators),
        messages_published=published,
        messages_recorded=recorded,
        messages_lost=max(0, published - recorded, short),
        wall_s=wall_s,
        real_time_factor=plan.trajectories.period_s * monitor.steps / max(monitor.moved_s - monitor.joined_s, 1e-9),
        output=output,
        interrupted=interrupted,
        drivers=drivers,
    )
