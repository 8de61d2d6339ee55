"""The topic on which all drivers of a process are in one message."""

from collections.abc import Sequence

from rclpy.publisher import Publisher
from sugiyama_msgs.msg import DriverArray

from sugiyama_ros.nodes.base.driver_array_messages import ArrayWriter, KnownDriver
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import STREAM

#: Name of the topic, in the namespace of the road.
TOPIC = "drivers"


class DriverArrayTopic:
    """Publishes ``drivers``: one message for each sample, as soon as every driver has taken the sample in.

    The nodes of a process share one object. Each driver joins once, and then answers to every sample.
    """

    def __init__(self) -> None:
        self._drivers = 0
        self._publisher: Publisher | None = None
        self._answers: dict[int, list[KnownDriver | None]] = {}
        self._writer: ArrayWriter | None = None

    def join(self, node: PacedNode) -> None:
        """Wait for one more driver. The node of the first driver holds the publisher."""
        self._drivers += 1
        if self._publisher is None:
            self._publisher = node.create_publisher(DriverArray, node.shared(TOPIC), STREAM)

    def put(self, node: PacedNode, stamp_ns: int, driver: KnownDriver | None) -> None:
        """Take a driver's answer to the sample at a stamp [ns], and publish the message if it was the last answer.

        Parameters
        ----------
        node : PacedNode
            The node that counts the message as published.
        stamp_ns : int
            Stamp of the sample [ns].
        driver : KnownDriver or None
            What is known of the driver; None if the sample was left out.
        """
        answers = self._answers.setdefault(stamp_ns, [])
        answers.append(driver)
        if len(answers) < self._drivers or self._publisher is None:
            return
        # stamps come in order, so earlier stamps that lack an answer will never have it
        for earlier in list(self._answers):
            del self._answers[earlier]
            if earlier == stamp_ns:
                break
        # the drivers may answer in any order
        known = sorted((one for one in answers if one is not None), key=lambda one: one.vehicle)
        if known:
            node.send(self._publisher, self._message(stamp_ns, known))

    def _message(self, stamp_ns: int, drivers: Sequence[KnownDriver]) -> bytes:
        """Bytes of the message. Its layout is kept while the drivers and their parameters stay the same."""
        if self._writer is None or not self._writer.fits(drivers):
            self._writer = ArrayWriter(drivers)
        return self._writer.message(stamp_ns, drivers)
