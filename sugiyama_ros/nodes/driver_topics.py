"""What an estimator publishes about its driver: on topics of the vehicle, or in one message with other drivers."""

from typing import Protocol

from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sugiyama_msgs.msg import DriverParameters, DriverType, Innovation, StyleChange, VehicleState

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, V_STAR
from sugiyama_ros.effects.registry import ROW, active
from sugiyama_ros.filters.online import Estimate, OnlineFilter
from sugiyama_ros.filters.shown import ShownParameters, shown_of
from sugiyama_ros.fit.classes import DriverTypes
from sugiyama_ros.laws.registry import name_of
from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.driver_array_messages import KnownDriver, ParameterNames
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.base.qos import KEPT_STREAM, STREAM
from sugiyama_ros.trajectories.desired_speed import largest_v_star

_PARAMETERS_EVERY_NS = cdr_messages.NS


class AllDrivers(Protocol):
    """Where drivers are in one message."""

    def join(self, node: PacedNode) -> None:
        """One more driver will answer to every sample."""

    def put(self, node: PacedNode, stamp_ns: int, driver: KnownDriver | None) -> None:
        """Take what is known of a driver after the sample at a stamp [ns]; None if the sample was left out."""


def shared_topics(types: DriverTypes | None) -> list[tuple[type, str]]:
    """Classes and names of the topics that each driver has also where they are in one message with other drivers."""
    return [(StyleChange, "style_change"), *([(DriverType, "driver_type")] if types is not None else [])]


class DriverTopics:
    """Publishes ``state``, ``innovation``, ``style_change``, ``parameters`` and, with types, ``driver_type``.

    With an array topic, state, innovation and parameters go there instead, all three with every sample.

    node: the node that publishes; the topics lie in its namespace; vehicle: number of the driver's vehicle; types:
    types of drivers, if there are any; array: where the driver is in one message with other drivers; space: namespace
    of the topics within the node's, such as ``vehicle_07/``; empty for the node's own; drivers in the same namespace
    share its topics.
    """

    def __init__(
        self,
        node: PacedNode,
        vehicle: int,
        types: DriverTypes | None,
        array: AllDrivers | None = None,
        space: str = "",
    ) -> None:
        self._node = node
        self._vehicle = vehicle
        self._types = types
        #: Names of the parameters that the samples so far do not determine.
        self.not_identified: list[str] = []
        self._shown: ShownParameters | None = None
        self._stamp_ns: int | None = None
        # the largest speed [m/s] so far, and the place of v* among the adapted parameters
        self._fastest = 0.0
        self._v_star: int | None = None
        self._array = array
        self._space = space
        self._topics: list[str] = []
        if array is not None:
            array.join(node)
        else:
            self._to_state = self._stream(VehicleState, "state")
            self._to_innovation = self._stream(Innovation, "innovation")
            self._to_parameters = self._stream(DriverParameters, "parameters", KEPT_STREAM)
        self._to_changes, *to_type = [self._stream(kind, topic) for kind, topic in shared_topics(types)]
        if to_type:
            (self._to_type,) = to_type

    def _stream(self, kind: type, topic: str, qos: QoSProfile = STREAM) -> Publisher:
        self._topics.append(self._space + topic)
        return self._node.stream(kind, self._space + topic, qos)

    def close(self) -> None:
        """Take down the topics that are the driver's own."""
        if self._space:
            for topic in self._topics:
                self._node.end_stream(topic)

    def choose_parameters(self, effects: Array, filter_: OnlineFilter) -> None:
        """From now on, publish the driver's parameters, and those of the law and the effects in a row (WIDTH,)."""
        law = ROW.law_places.get(name_of(float(filter_.parameters[ROW.law])), slice(0))
        blocks = [law, *(ROW.places[name] for name in active(effects))]
        shown = [*range(len(NAMES)), *(k for block in blocks for k in range(ROW.width)[block])]
        self._shown = shown_of(filter_, shown)
        names = [ROW.entries[k] for k in shown]
        self._v_star = filter_.adapted.index("v_star") if "v_star" in filter_.adapted else None
        self._names = ParameterNames(tuple(names), filter_.adapted)
        self._message = cdr_messages.Parameters(self._vehicle, names, filter_.adapted)

    def restart(self) -> None:
        """Publish the parameters with the next sample, whatever its stamp."""
        self._stamp_ns = None

    def publish_estimate(self, stamp_ns: int, estimate: Estimate | None, change: tuple[str, float] | None) -> None:
        """Publish the state and the innovation, and a change of style (name and factor) if there is one.

        The estimate is None for a sample that was left out.
        """
        send, vehicle = self._node.send, self._vehicle
        if estimate is not None:
            self._fastest = max(self._fastest, estimate.speed)
        if self._array is not None:
            self._array.put(self._node, stamp_ns, None if estimate is None else self._known(estimate))
        elif estimate is not None:
            send(self._to_state, cdr_messages.state(stamp_ns, vehicle, estimate))
            send(self._to_innovation, cdr_messages.innovation(stamp_ns, vehicle, estimate))
        if change is not None:
            send(self._to_changes, cdr_messages.style_change(stamp_ns, vehicle, *change))

    def _known(self, estimate: Estimate) -> KnownDriver | None:
        """What an array message says of the driver."""
        shown = self._shown
        if shown is None:
            return None
        self._read(shown)
        return KnownDriver(
            self._vehicle,
            estimate,
            self._names,
            shown.value.copy(),
            shown.adapted_covariance,
            shown.adapted_identified,
        )

    def _read(self, shown: ShownParameters) -> None:
        """Read what the filter knows. A desired speed beyond what these speeds can tell is not identified."""
        shown.read()
        if self._v_star is not None and shown.value[V_STAR] > largest_v_star(self._fastest):
            shown.adapted_identified[self._v_star] = False

    def publish_parameters(self, stamp_ns: int, filter_: OnlineFilter, is_last: bool) -> bool:
        """Publish the parameters once a second of the recording's time, and with the last sample; whether it did."""
        is_due = self._stamp_ns is None or stamp_ns - self._stamp_ns >= _PARAMETERS_EVERY_NS
        shown = self._shown
        if shown is None or not (is_due or is_last):
            return False
        self._stamp_ns = stamp_ns
        if self._array is None:
            self._read(shown)
            message = self._message.message(stamp_ns, shown.value, shown.covariance, shown.identified)
            self._node.send(self._to_parameters, message)
        self.not_identified = shown.not_identified
        if self._types is not None:
            probability = self._types.probabilities(filter_.learnt, filter_.prior)
            self._node.send(self._to_type, cdr_messages.driver_type(stamp_ns, self._vehicle, probability))
        return True
