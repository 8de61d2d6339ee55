"""The topic on which all drivers of a process are in one message."""

from collections.abc import Sequence

from rclpy.publisher import Publisher
from sugiyama_msgs.msg import DriverArray

from sugiyama_ros.nodes.base.driver_array_messages import ArrayWriter, KnownDriver
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import DEPTH

#: Name of the topic, in the namespace of the road.
TOPIC = "drivers"


class ArrayMessages:
    """Messages about drivers; a layout is kept while the drivers and their parameters stay the same."""

    def __init__(self) -> None:
        self._writer: ArrayWriter | None = None

    def message(self, stamp_ns: int, drivers: Sequence[KnownDriver]) -> bytes:
        """Bytes of the message about at least one driver at a stamp [ns]."""
        if self._writer is None or not self._writer.fits(drivers):
            self._writer = ArrayWriter(drivers)
        return self._writer.message(stamp_ns, drivers)


class DriverArrayTopic:
    """Publishes ``drivers``: one message for each sample, as soon as every driver has taken the sample in.

    The nodes of a process share one object. Each driver joins once, and then answers to every sample. A driver who
    falls too far behind is no longer waited for.
    """

    def __init__(self) -> None:
        self._drivers = 0
        self._publisher: Publisher | None = None
        self._answers: dict[int, list[KnownDriver | None]] = {}
        self._messages = ArrayMessages()

    def join(self, node: PacedNode) -> None:
        """Wait for one more driver. The node of the first driver holds the publisher."""
        self._drivers += 1
        if self._publisher is None:
            self._publisher = node.stream(DriverArray, node.shared(TOPIC))

    def put(self, node: PacedNode, stamp_ns: int, driver: KnownDriver | None) -> None:
        """Take a driver's answer to the sample at a stamp [ns], and publish the message if it was the last answer.

        stamp_ns: stamp of the sample [ns].
        """
        answers = self._answers.setdefault(stamp_ns, [])
        answers.append(driver)
        if len(answers) == self._drivers:
            # samples come in order, so earlier ones that lack an answer will never have it
            while stamp_ns in self._answers:
                self._publish(node, next(iter(self._answers)))
        elif len(self._answers) > DEPTH:
            self._publish(node, next(iter(self._answers)))

    def _publish(self, node: PacedNode, stamp_ns: int) -> None:
        """Publish what is known at a stamp [ns]."""
        # the drivers may answer in any order
        known = sorted((one for one in self._answers.pop(stamp_ns) if one is not None), key=lambda one: one.vehicle)
        if known and self._publisher is not None:
            node.send(self._publisher, self._messages.message(stamp_ns, known))
