"""What the graph of a run costs: the loop of a run, and the same messages between nodes that do nothing with them.

    python -m benchmarks.speed.graph loop SOURCE BAG [--array]
    python -m benchmarks.speed.graph empty BAG

``loop`` replays a recording and leaves a bag; ``empty`` sends the messages of such a bag once more. Both print the time
of the processor [s]. `benchmarks.speed.run` starts both, in processes of their own.
"""

import argparse
import time
from collections import defaultdict
from pathlib import Path

from rclpy.node import Node
from rclpy.publisher import Publisher

from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.base.node import message_type
from sugiyama_ros.nodes.base.qos import STREAM, WINDOW
from sugiyama_ros.nodes.base.spin import Spinner, ros
from sugiyama_ros.nodes.run import run

_TIMEOUT_S = 60.0
_MEASURED = "/measured"


def loop(source: Path, bag: Path, array: bool) -> float:
    """Measure the time of the processor [s] from the first sample to the last one.

    The run says how far it is about every 20 ms. What comes before it says so first is added in proportion.

    Raises SugiyamaError.
    """
    seen: list[tuple[int, float]] = []

    def note(steps: int, _: int) -> None:
        if steps and (not seen or steps > seen[-1][0]):
            seen.append((steps, time.process_time()))

    result = run(source, bag, array=array, on_progress=note)
    if result.messages_lost:
        raise SugiyamaError(f"{result.messages_lost} messages lost; the time means nothing")
    if len(seen) < 2:
        raise SugiyamaError(f"{source}: too short to be measured; give a longer recording")
    (first, began_s), (last, ended_s) = seen[0], seen[-1]
    return (ended_s - began_s) * result.steps / (last - first)


class _EmptyGraph:
    """Nodes as in a run: a source, a node for each vehicle, and one that hears every topic. None of them computes.

    bag: bag with the messages to send.
    """

    def __init__(self, bag: Path) -> None:
        sent: defaultdict[str, list[bytes]] = defaultdict(list)
        with Bag(bag) as opened:
            types = {topic.name: topic.type for topic in opened.info().topics}
            for topic, _, _, raw in opened.raw_messages():
                sent[topic].append(raw)
        self.steps = len(sent[_MEASURED])
        self._received = self._answered = 0
        self._due: list[list[tuple[Publisher, bytes]]] = [[] for _ in range(self.steps)]
        self._source, self._sink = Node("source"), Node("sink")
        self._vehicles: dict[str, Node] = {}
        self._source.create_subscription(message_type(types[_MEASURED]), _MEASURED, self._answer, STREAM, raw=True)
        for topic, messages in sent.items():
            kind, space = message_type(types[topic]), topic.rpartition("/")[0]
            publisher = self._node(space).create_publisher(kind, topic, STREAM)
            self._sink.create_subscription(kind, topic, self._receive, STREAM, raw=True)
            if topic == _MEASURED:
                self._measured = [(publisher, raw) for raw in messages]
                continue
            for k, raw in enumerate(messages):
                self._due[k * self.steps // len(messages)].append((publisher, raw))

    @property
    def nodes(self) -> list[Node]:
        """Nodes to be executed."""
        return [self._source, self._sink, *self._vehicles.values()]

    def send(self, spinner: Spinner) -> float:
        """Send everything in its order; returns the time of the processor [s]."""
        began_s, expected = time.process_time(), 0
        for first in range(0, self.steps, WINDOW // 2):
            window = slice(first, first + WINDOW // 2)
            for publisher, raw in self._measured[window]:
                publisher.publish(raw)
            expected += sum(1 + len(due) for due in self._due[window])
            self._wait_for(expected, spinner)
        return time.process_time() - began_s

    def _wait_for(self, messages: int, spinner: Spinner) -> None:
        """Execute callbacks until so many messages have come. Raises SugiyamaError if they do not."""
        spinner.until(lambda: self._received >= messages, _TIMEOUT_S)
        if self._received != messages:
            raise SugiyamaError(f"{self._received} of {messages} messages received; is the machine overloaded?")

    def _node(self, space: str) -> Node:
        """Node that publishes in a namespace: the source, or a node for each vehicle."""
        if not space:
            return self._source
        if space not in self._vehicles:
            self._vehicles[space] = Node("vehicle", namespace=space)
        return self._vehicles[space]

    def _answer(self, _: bytes) -> None:
        """Send everything that goes with a sample."""
        for publisher, raw in self._due[self._answered]:
            publisher.publish(raw)
        self._answered += 1

    def _receive(self, _: bytes) -> None:
        self._received += 1


def empty(bag: Path) -> float:
    """Measure the time of the processor [s] that the messages of a bag take between nodes that do nothing with them."""
    environment.isolate()
    with ros():
        graph = _EmptyGraph(bag)
        spinner = Spinner(graph.nodes)
        try:
            return graph.send(spinner)
        finally:
            spinner.close()
            for node in graph.nodes:
                node.destroy_node()


def main() -> None:
    """Measure what the arguments ask for, and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="kind", required=True)
    looped, emptied = kinds.add_parser("loop"), kinds.add_parser("empty")
    looped.add_argument("source", type=Path)
    looped.add_argument("--array", action="store_true")
    for one in (looped, emptied):
        one.add_argument("bag", type=Path)
    given = parser.parse_args()
    print(loop(given.source, given.bag, given.array) if given.kind == "loop" else empty(given.bag))


if __name__ == "__main__":
    main()
