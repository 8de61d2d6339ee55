"""The truth about simulated vehicles as topics: ``vehicle_NN/truth`` and ``vehicle_NN/true_parameters``."""

from collections.abc import Iterable
from typing import Any

from sugiyama_msgs.msg import TrueParameters, Truth

from sugiyama_ros.arrays import Array
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.formats.truth import namespaces, truth_message
from sugiyama_ros.nodes.base.cdr_messages import time_message
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.trajectories.truth import TrueDriver


class TrueTopics:
    """Publishes the true motion of each vehicle with every sample, and the true parameters when they change.

    node: the node that publishes; vehicles: numbers of the vehicles.
    """

    def __init__(self, node: PacedNode, vehicles: Iterable[int]) -> None:
        self._node = node
        numbers = list(vehicles)
        spaces = [space.lstrip("/") for space in namespaces(numbers)]
        self._motion: dict[int, Any] = {}
        self._parameters: dict[int, Any] = {}
        for vehicle, space in zip(numbers, spaces, strict=True):
            self._motion[vehicle] = node.create_publisher(Truth, f"{space}/truth", STREAM)
            self._parameters[vehicle] = node.create_publisher(TrueParameters, f"{space}/true_parameters", LATCHED)

    def send_motion(self, stamp_ns: int, motion: Array) -> None:
        """Send true position [m], speed [m/s], acceleration [m/s^2] and gap [m] of each vehicle, (N, 4)."""
        for (vehicle, publisher), one in zip(self._motion.items(), motion.tolist(), strict=True):
            self._node.send(publisher, truth_message(stamp_ns, vehicle, one))

    def send_parameters(self, stamp_ns: int, drive: TrueDriver) -> None:
        """Send the parameters with which a driver drives from a stamp [ns] on."""
        message = TrueParameters(
            vehicle=drive.vehicle, name=list(drive.parameters), value=list(drive.parameters.values())
        )
        message.header.stamp, message.header.frame_id = time_message(stamp_ns), FRAME
        self._node.send(self._parameters[drive.vehicle], message)
