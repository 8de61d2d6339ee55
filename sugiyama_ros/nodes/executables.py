"""The executables of the nodes, such as ``sugiyama_replay``: each runs one node, or says in one line what is missing.

``python -m sugiyama_ros.nodes.executables replay`` is the same where they are not installed.

This module imports nothing of ROS, so that it can say that ROS is not there.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module

from sugiyama_ros.errors import InputError, SugiyamaError, nowhere_to_compile

#: The nodes: modules of ``sugiyama_ros.nodes``, and the class of each.
NODES = {
    "critic": "Critic",
    "drivers": "DriversNode",
    "keeper": "Keeper",
    "recorder": "Recorder",
    "replay": "Replay",
    "simulator": "SimulatorNode",
    "tracks": "TracksNode",
}


@contextmanager
def ros_needed() -> Iterator[None]:
    """Raise InputError where the block imports a package that is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package in ("", "sugiyama_ros"):
            raise
        raise InputError(f"{package}: not installed; run `make demo` once, or source a ROS 2 workspace") from None


def run(node: str) -> None:
    """Run a node of ``NODES`` until it ends. What the user can correct is one line, and exit code 2."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))  # nothing has begun; the node itself handles its signals
    try:
        with ros_needed():
            run_node = import_module("sugiyama_ros.nodes.base.spin").run_node
            make = getattr(import_module(f"sugiyama_ros.nodes.{node}"), NODES[node])
        run_node(make)
    except Exception as error:
        reason = str(error) if isinstance(error, SugiyamaError) else nowhere_to_compile(error)
        if reason is None:
            raise
        print(reason, file=sys.stderr)
        sys.exit(2)


critic, drivers, keeper, recorder, replay, simulator, tracks = (partial(run, node) for node in NODES)

if __name__ == "__main__":
    run(sys.argv.pop(1))
