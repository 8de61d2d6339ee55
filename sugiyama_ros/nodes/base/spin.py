"""Running nodes: the executor, signals, an orderly end."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.base.node import PacedNode

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # older than Jazzy's seventh patch
    EventsExecutor = SingleThreadedExecutor

#: Names the process that started this node, and without which the node has no reason to go on.
RUNNER = "SUGIYAMA_RUNNER"
_SLICE_S = 0.02
_QUIET_S = 0.2
_TAKE_DOWN_S = 3


@contextmanager
def ros() -> Iterator[Callable[[], bool]]:
    """rclpy up and down; gives a function that tells whether SIGINT or SIGTERM has come."""
    asked: list[int] = []

    def ask(number: int, _: FrameType | None) -> None:
        asked.append(number)

    environment.find_packages()
    # rclpy's own handlers would take the publishers away before the last messages are sent.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        rclpy.shutdown()


class Spinner:
    """Executes nodes of one process in turn."""

    def __init__(self, nodes: Iterable[Node]) -> None:
        self._executor: Executor = EventsExecutor()
        for node in nodes:
            self._executor.add_node(node)

    def slice(self) -> None:
        """Carry out what there is to do for a moment."""
        # The executor's spin() hangs in the wheels of rclpy 7.1.6; spin_once() carries out one thing.
        end = time.monotonic() + _SLICE_S
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def until(self, done: Callable[[], bool], timeout_s: float) -> None:
        """Carry out what there is to do until ``done``, or for ``timeout_s`` at most."""
        end = time.monotonic() + timeout_s
        while not done() and (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, _SLICE_S))

    def until_quiet(self, count: Callable[[], int]) -> None:
        """Carry out everything that is under way: until ``count`` has not changed for a while."""
        seen, since = count(), time.monotonic()
        while time.monotonic() - since < _QUIET_S:
            self._executor.spin_once(timeout_sec=_SLICE_S)
            if count() != seen:
                seen, since = count(), time.monotonic()

    def close(self) -> None:
        """Let go of the nodes."""
        self._executor.shutdown()


def run_node(make: Callable[[], PacedNode]) -> None:
    """Run one node until a signal comes or it fails; the main function of every node."""
    runner = int(os.environ.get(RUNNER, os.getppid()))
    try:
        with ros() as asked_to_stop:
            node = make()
            spinner = Spinner([node])
            while not asked_to_stop() and node.failure is None and os.getppid() == runner:
                spinner.slice()
            spinner.until_quiet(lambda: node.received)
            node.finish()
            spinner.until_quiet(lambda: node.received)
            node.close()
            if node.failure is not None:
                raise node.failure
            # All is done. Where many processes end at the same time, Fast DDS 2.14 sometimes waits forever in taking
            # its participant down (DomainParticipant::set_listener), with Python locked.
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(_TAKE_DOWN_S)
            spinner.close()
            node.destroy_node()
    except SugiyamaError as error:
        sys.exit(str(error))
