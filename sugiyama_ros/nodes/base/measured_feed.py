"""One subscription to ``measured`` for all nodes of a process that follow the vehicles."""

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from sugiyama_msgs.msg import MeasuredPositions

from sugiyama_ros.nodes.base.cdr_messages import Sample, measured
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import STREAM

TakeIn = Callable[[Sample], None]


class MeasuredFeed(Node):
    """Takes each message of the topic ``measured`` once, decodes it, and hands the sample to every node that listens.

    The nodes stay as they are otherwise: each reports its own progress, so the source waits for each of them.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("measured_feed", start_parameter_services=False, enable_rosout=False, **options)
        self._listeners: list[TakeIn] = []
        self.create_subscription(MeasuredPositions, "measured", self._on_measured, STREAM, raw=True)

    def listen(self, take_in: TakeIn) -> None:
        """Hand every sample from now on to ``take_in``."""
        self._listeners.append(take_in)

    def _on_measured(self, raw: bytes) -> None:
        sample = measured(raw)
        for take_in in self._listeners:
            take_in(sample)


def subscribe_measured(node: PacedNode, take_in: TakeIn, feed: MeasuredFeed | None) -> None:
    """Hand every sample to ``take_in``: from the feed of the process, or else from a subscription of the node."""
    if feed is not None:
        feed.listen(take_in)
        return
    topic = node.shared("measured")
    node.create_subscription(MeasuredPositions, topic, lambda raw: take_in(measured(raw)), STREAM, raw=True)
