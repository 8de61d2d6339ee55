"""The topics on which an estimator publishes what it knows about its driver."""

from sugiyama_msgs.msg import DriverParameters, DriverType, Innovation, StyleChange, VehicleState

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.effects.registry import ROW, active
from sugiyama_ros.filters.online import Estimate, OnlineFilter
from sugiyama_ros.filters.shown import ShownParameters
from sugiyama_ros.fit.driver_types import DriverTypes
from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import STREAM

_PARAMETERS_EVERY_NS = cdr_messages.NS


class DriverTopics:
    """Publishes ``state``, ``innovation``, ``style_change``, ``parameters`` and, with types, ``driver_type``.

    Parameters
    ----------
    node : PacedNode
        The node that publishes; the topics lie in its namespace.
    vehicle : int
        Number of the driver's vehicle.
    types : DriverTypes or None
        Types of drivers, if there are any.
    """

    def __init__(self, node: PacedNode, vehicle: int, types: DriverTypes | None) -> None:
        self._node = node
        self._vehicle = vehicle
        self._types = types
        #: Names of the parameters that the samples so far do not determine.
        self.not_identified: list[str] = []
        self._shown: ShownParameters | None = None
        self._stamp_ns: int | None = None
        self._to_state = node.create_publisher(VehicleState, "state", STREAM)
        self._to_innovation = node.create_publisher(Innovation, "innovation", STREAM)
        self._to_changes = node.create_publisher(StyleChange, "style_change", STREAM)
        self._to_parameters = node.create_publisher(DriverParameters, "parameters", STREAM)
        if types is not None:
            self._to_type = node.create_publisher(DriverType, "driver_type", STREAM)

    def choose_parameters(self, effects: Array, filter_: OnlineFilter) -> None:
        """From now on, publish the driver's parameters and the parameters of the effects that act in a row (WIDTH,)."""
        of_effects = [k for name in active(effects) for k in range(ROW.places[name].start, ROW.places[name].stop)]
        shown = [*range(len(NAMES)), *of_effects]
        self._shown = ShownParameters(filter_, shown)
        names = [ROW.entries[k] for k in shown]
        self._message = cdr_messages.Parameters(self._vehicle, names, filter_.adapted)

    def restart(self) -> None:
        """Publish the parameters with the next sample, whatever its stamp."""
        self._stamp_ns = None

    def publish_estimate(self, stamp_ns: int, estimate: Estimate, change: tuple[str, float] | None) -> None:
        """Publish the state and the innovation, and a change of style (name and factor) if there is one."""
        send, vehicle = self._node.send, self._vehicle
        send(self._to_state, cdr_messages.state(stamp_ns, vehicle, estimate))
        send(self._to_innovation, cdr_messages.innovation(stamp_ns, vehicle, estimate))
        if change is not None:
            send(self._to_changes, cdr_messages.style_change(stamp_ns, vehicle, *change))

    def publish_parameters(self, stamp_ns: int, filter_: OnlineFilter, is_last: bool) -> bool:
        """Publish the parameters once a second of the recording's time, and with the last sample; whether it did."""
        is_due = self._stamp_ns is None or stamp_ns - self._stamp_ns >= _PARAMETERS_EVERY_NS
        shown = self._shown
        if shown is None or not (is_due or is_last):
            return False
        self._stamp_ns = stamp_ns
        shown.read()
        self.not_identified = shown.not_identified
        message = self._message.message(stamp_ns, shown.value, shown.covariance, shown.identified)
        self._node.send(self._to_parameters, message)
        if self._types is not None:
            probability = self._types.probabilities(filter_.learnt, filter_.prior)
            self._node.send(self._to_type, cdr_messages.driver_type(stamp_ns, self._vehicle, probability))
        return True
