"""Running nodes: the executor, signals, and an orderly end."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

import rclpy
from rclpy.exceptions import InvalidHandle, ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from sugiyama_ros import interrupts
from sugiyama_ros.errors import InputError, OutputError, SugiyamaError
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.base.node import PacedNode

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # older than Jazzy's seventh patch
    EventsExecutor = SingleThreadedExecutor

# Passes over what rclpy raises on an event of a subscription that a node has given up since.
_GIVEN_UP = suppress(InvalidHandle)
_SLICE_S = 0.02
_QUIET_S = 0.2
_LONGEST_S = 3.0
_TAKE_DOWN_S = 3
_GOODBYE_S = 0.05


@contextmanager
def ros() -> Iterator[Callable[[], bool]]:
    """Start rclpy and shut it down; yields a function that says whether SIGINT or SIGTERM has come.

    Raises InputError where the environment does not let ROS start.
    """
    asked: list[int] = []

    def ask(number: int, _: FrameType | None) -> None:
        asked.append(number)

    environment.find_packages()
    environment.check()
    try:
        # rclpy's own handlers would take the publishers away before the last messages are sent.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # the middleware's own class, which it does not export
        why = str(error).partition(", at /")[0]
        raise InputError(f"ROS does not start: {why}; correct the environment variables ROS_*") from None
    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    interrupts.settled()
    try:
        yield lambda: bool(asked or interrupts.came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        rclpy.shutdown()


class Spinner:
    """Executes the nodes of one process in turn."""

    def __init__(self, nodes: Iterable[Node]) -> None:
        self._executor: Executor = EventsExecutor()
        for node in nodes:
            self._executor.add_node(node)

    def slice(self) -> None:
        """Execute callbacks for a moment."""
        # The executor's spin() hangs in the wheels of rclpy 7.1.6; spin_once() executes one callback.
        end = time.monotonic() + _SLICE_S
        with _GIVEN_UP:
            while (left := end - time.monotonic()) > 0.0:
                self._executor.spin_once(timeout_sec=left)

    def until(self, done: Callable[[], bool], timeout_s: float) -> None:
        """Execute callbacks until ``done``, or for at most ``timeout_s``."""
        end = time.monotonic() + timeout_s
        while not done() and (left := end - time.monotonic()) > 0.0:
            self._once(min(left, _SLICE_S))

    def until_quiet(self, count: Callable[[], int]) -> None:
        """Execute callbacks until ``count`` has not changed for a while, so that nothing is under way any more.

        A publisher that goes on for ever is not waited for.
        """
        seen = count()
        began = since = time.monotonic()
        while time.monotonic() - since < _QUIET_S and since - began < _LONGEST_S:
            self._once(_SLICE_S)
            if count() != seen:
                seen, since = count(), time.monotonic()

    def close(self) -> None:
        """Release the nodes."""
        self._executor.shutdown()

    def _once(self, timeout_s: float) -> None:
        with _GIVEN_UP:
            self._executor.spin_once(timeout_sec=timeout_s)


def run_node(make: Callable[[], PacedNode]) -> None:
    """Run one node until a signal comes, or the node fails or is done, or who started it has ended.

    The exit code is 0 if the work is done, 2 for an error that the user can correct, and 1 for any other failure.
    """
    starter = os.getppid()
    try:
        with ros() as asked_to_stop:
            with _interruptible() as came:
                node = make()
            node.get_logger().info(f"in ROS domain {environment.domain()}: {node.doing}")
            spinner = Spinner([node])
            while not (came or asked_to_stop() or node.failure or node.is_done) and os.getppid() == starter:
                spinner.slice()
            spinner.until_quiet(lambda: node.received)
            node.finish()
            spinner.until_quiet(lambda: node.received)
            node.close()
            if node.failure is not None:
                raise node.failure
            _leave(node, spinner)
    except KeyboardInterrupt:
        os._exit(0)  # nothing has begun; what was made of the node goes with the process
    except (SugiyamaError, ParameterException) as error:
        # rclpy's errors of parameters say in one line which value is wrong
        print(" ".join(str(error).split()), file=sys.stderr)
        sys.exit(2 if isinstance(error, (InputError, OutputError, ParameterException)) else 1)


@contextmanager
def _interruptible() -> Iterator[list[int]]:
    """Let SIGINT and SIGTERM end the block at once, by KeyboardInterrupt; yields the signals that have come.

    A node takes seconds of processor time to start, which is a minute on a busy machine. A library may swallow a
    KeyboardInterrupt, so look at the signals afterwards.
    """
    came: list[int] = []

    def interrupt(number: int, _: FrameType | None) -> None:
        came.append(number)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _leave(node: Node, spinner: Spinner) -> NoReturn:
    """End this process, whose work is done, with exit code 0.

    Where many processes end at the same time, Fast DDS 2.14 sometimes waits forever while it takes its participant down
    (DomainParticipant::set_listener), and holds the lock of Python. So an empty node keeps the participant up while
    this node says goodbye to the others; the participant goes with the process. If even that hangs, an alarm ends it.
    """
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(_TAKE_DOWN_S)
    Node("_leaving", start_parameter_services=False, enable_rosout=False)
    spinner.close()
    node.destroy_node()
    time.sleep(_GOODBYE_S)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)
