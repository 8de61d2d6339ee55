"""Runners of the nodes of a run: all nodes in this process, or each node in a process of its own."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from shutil import rmtree
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from sugiyama_ros.errors import InputError, SugiyamaError
from sugiyama_ros.nodes.base.measured_feed import MeasuredFeed
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import WINDOW
from sugiyama_ros.nodes.base.spin import RUNNER, Spinner, held_back
from sugiyama_ros.nodes.critic import Critic
from sugiyama_ros.nodes.driver_array import DriverArrayTopic
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.estimator import Estimator
from sugiyama_ros.nodes.plan import CRITIC, DRIVERS, RECORDER, Plan
from sugiyama_ros.nodes.recorder import Recorder

#: Longest time [s] that nodes get to come to an orderly end.
STOP_S = 15.0
_LAST_STEPS_S = 0.5
# How a line of a node's log begins that tells of no trouble.
_INFORMS = "[INFO]"
#: Exit codes of a node that was stopped. ``run_node`` sets the alarm when the work of the node is done.
_ENDED_WELL = (0, -signal.SIGALRM)


class OneProcess:
    """Runs all nodes in this process; ``nodes`` are to be executed here.

    plan: what runs; window: samples that may be under way.
    """

    def __init__(self, plan: Plan, window: int = WINDOW) -> None:
        self._paced: list[PacedNode] = []
        own = _overrides(plan.estimator)
        self._feed, array = MeasuredFeed(), DriverArrayTopic()
        try:
            self._source = plan.source.start(_overrides(plan.sending))
            self._paced.append(self._source)
            if plan.has_tracks:
                self._paced.append(DriversNode(parameter_overrides=_overrides(plan.drivers)))
            else:
                self._paced += (
                    Estimator(self._feed, array, namespace=n, parameter_overrides=own) for n in plan.namespaces
                )
            if plan.settings.critic:
                self._paced.append(Critic(self._feed))
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
        return [*self._paced, self._feed]

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
        if plan.has_tracks:
            self._start(DRIVERS, "drivers", plan.drivers)
        else:
            for name in plan.estimators:
                self._start(name, "estimator", plan.estimator)
        if plan.settings.critic:
            self._start(CRITIC, "critic", {})
        self._source = plan.source.node
        self._start(self._source, plan.source.module, plan.sending)

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
