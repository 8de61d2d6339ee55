"""A subscription that hears every publisher of its topic, whatever quality of service the publisher offers."""

from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

_LOOK_S = 0.5
_TRANSIENT, _VOLATILE = QoSDurabilityPolicy.TRANSIENT_LOCAL, QoSDurabilityPolicy.VOLATILE
_RELIABLE, _BEST_EFFORT = QoSReliabilityPolicy.RELIABLE, QoSReliabilityPolicy.BEST_EFFORT


class AnyPublisher:
    """Subscribes to the bytes of a topic, and asks for no more than all its publishers offer.

    At first the subscription asks for what is best: reliable, and the messages sent before. A publisher that offers
    less, such as a sensor's, would never be heard; as soon as there is one, the subscription asks for less too.

    node: the node that subscribes; kind: class of the messages; topic: name of the topic, as the node would give it;
    callback: gets the bytes of each message; wanted: what to ask for where the publishers offer it.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, callback: Callable[[bytes], None], wanted: QoSProfile
    ) -> None:
        self._node, self._kind, self._topic, self._callback = node, kind, topic, callback
        self._wanted = wanted
        self._asked = (wanted.reliability, wanted.durability)
        self._subscription = node.create_subscription(kind, topic, callback, wanted, raw=True)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_LOOK_S, self._look, clock=steady)

    @property
    def is_reliable(self) -> bool:
        """Whether the middleware sends again what is lost on the way."""
        return bool(self._asked[0] == _RELIABLE)

    def close(self) -> None:
        """Subscribe no longer."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_subscription(self._subscription)

    def _look(self) -> None:
        """Subscribe anew if a publisher offers less than was asked for."""
        name = self._subscription.topic_name
        if self._node.count_publishers(name) <= self._subscription.get_publisher_count():
            return
        offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)]
        reliability, durability = self._asked
        if any(one.reliability == _BEST_EFFORT for one in offered):
            reliability = _BEST_EFFORT
        if any(one.durability == _VOLATILE for one in offered):
            durability = _VOLATILE
        if (reliability, durability) == self._asked:
            return
        self._asked = reliability, durability
        if reliability == _BEST_EFFORT:
            self._node.get_logger().warning(f"{name}: a publisher offers best effort only, so samples may be lost")
        profile = QoSProfile(
            history=self._wanted.history, depth=self._wanted.depth, reliability=reliability, durability=durability
        )
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._node.create_subscription(self._kind, self._topic, self._callback, profile, raw=True)
