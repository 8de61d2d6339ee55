"""One subscription to ``measured`` for all nodes of a process that follow the vehicles."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from sugiyama_msgs.msg import MeasuredPositions

from sugiyama_ros.nodes.base.cdr_messages import Sample
from sugiyama_ros.nodes.base.incoming import RefusedError, receiver, sample
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import STREAM

TakeIn = Callable[[Sample], None]


class MeasuredFeed(Node):
    """Takes each message of the topic ``measured`` once, decodes it, and hands the sample to every node that listens.

    The nodes stay as they are otherwise: each reports its own progress, so the source waits for each of them.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("measured_feed", start_parameter_services=False, enable_rosout=False, **options)
        self._listeners: list[tuple[PacedNode, TakeIn]] = []
        on_measured = receiver(sample, self._on_measured, self._on_refused)
        self.create_subscription(MeasuredPositions, "measured", on_measured, STREAM, raw=True)

    def hand_to(self, node: PacedNode, take_in: TakeIn) -> None:
        """Hand every sample from now on to ``take_in`` of a node, and tell the node of messages that are dropped."""
        self._listeners.append((node, take_in))

    def _on_measured(self, found: Sample) -> None:
        for _, take_in in self._listeners:
            take_in(found)

    def _on_refused(self, reason: RefusedError) -> None:
        for node, _ in self._listeners:
            node.refuse("measured", reason)


def subscribe_measured(node: PacedNode, take_in: TakeIn, feed: MeasuredFeed | None) -> None:
    """Hand every sample to ``take_in``: from the feed of the process, or else from a subscription of the node."""
    if feed is not None:
        feed.hand_to(node, take_in)
    else:
        node.hear(MeasuredPositions, node.shared("measured"), sample, take_in, STREAM)
