"""What all nodes of this package share: they count messages and report their progress and their health."""

import time
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.client import Client
from rclpy.clock import Clock, ClockType, JumpHandle, JumpThreshold
from rclpy.duration import Duration
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterException,
    ParameterNotDeclaredException,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.service import Service
from rclpy.topic_or_service_is_hidden import topic_or_service_is_hidden
from sugiyama_msgs.msg import Progress

from sugiyama_ros.errors import InputError, SugiyamaError
from sugiyama_ros.nodes.base.incoming import receiver, unusable
from sugiyama_ros.nodes.base.names import for_other_nodes
from sugiyama_ros.nodes.base.qos import PROGRESS_OUT, STREAM, WINDOW

#: Name of the node that records, in any namespace, and how topics of ROS itself end that say nothing about the road.
RECORDER = "recorder"
UNRECORDED = ("/parameter_events", "/transition_event")
_BEAT_S = 0.1
_LOOK_S = 0.5
# Time [s] in which services that are there answer, all together.
_READY_S, _READY_LOOK_S = 1.0, 0.01
_REPORT_S = 1.0
_RECEIVED_S = 5.0
# What a parameter of a type is called, and several of them.
_KINDS = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
_LISTS = {float: "a list of numbers", int: "a list of whole numbers", str: "a list of texts"}
# Numbers that a vehicle can have, and the number that stands for no vehicle in a list of them.
_VEHICLES, _NO_VEHICLE = range(1 << 31), -1
_VOLATILE, _BEST_EFFORT = QoSDurabilityPolicy.VOLATILE, QoSReliabilityPolicy.BEST_EFFORT
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Health(NamedTuple):
    """Health of a node: a level of diagnostic_msgs, one line, and numbers that explain it."""

    level: bytes
    message: str
    values: Mapping[str, object] = {}


class AnyPublisher:
    """Subscribes to the bytes of a topic, and asks for no more than all its publishers offer.

    At first the subscription asks for what is ``wanted``. A publisher that offers less, such as a sensor's, would never
    be heard; as soon as there is one, the subscription asks for less too.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, callback: Callable[[bytes], None], wanted: QoSProfile
    ) -> None:
        self._node, self._kind, self._topic, self._callback = node, kind, topic, callback
        self._wanted = wanted
        self._asked = (wanted.reliability, wanted.durability)
        self._subscription = node.create_subscription(kind, topic, callback, wanted, raw=True)
        self._timer = node.create_timer(_LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

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


class PacedNode(Node):
    """A node that counts what it publishes, tells the source how far it has come, and reports its health.

    Subclasses define ``health``. A node that cannot go on sets ``failure``, and one whose work is done ``is_done``.
    Raises InputError where the node was given a parameter that no node has.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        given = [one for one in self._parameter_overrides if not self.has_parameter(one)]
        if others := for_other_nodes(name, self.get_name(), given):
            self.get_logger().warning(f"not used here, since other nodes have these parameters: {', '.join(others)}")
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        #: Samples that may be under way from the source to the slowest node.
        self.window = WINDOW
        self.published = 0
        self.steps = 0
        self.failure: SugiyamaError | None = None
        self.is_done = False
        self.received = 0
        self._announced = False
        self._told: tuple[int, int, bool] | None = None
        self._is_recorded = False
        self._told_s = self._reported_s = 0.0
        self._level = OK
        #: Messages that were dropped, and why the last one was.
        self.refused, self._reason = 0, ""
        self._told_refused = 0
        self._jumps: list[JumpHandle] = []
        self._streams: dict[str, Publisher] = {}
        self._to_progress = self.create_publisher(Progress, "_progress", PROGRESS_OUT)
        # made once: a message takes longer to make than to fill in
        self._progress = Progress(node=self.get_fully_qualified_name())
        self._to_diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", STREAM)
        self.create_timer(_BEAT_S, self.beat, clock=self.steady)

    def declare_parameter(self, name: str, value: Any = None, *rest: Any, **more: Any) -> Parameter:
        """Declare a parameter. Where a real number is expected, a whole number will do, as in ``v_star: 10``.

        Raises InputError for a value of another type, or out of range.
        """
        given = self._parameter_overrides.get(name)
        if given is not None:
            self._parameter_overrides[name] = given = _as_known(given, value)
        try:
            if given is None or given.type_ != Parameter.Type.NOT_SET:
                return super().declare_parameter(name, value, *rest, **more)
        except InvalidParameterTypeException:
            pass
        except InvalidParameterValueException as error:
            raise InputError(_out_of_bounds(name, (*rest, *more.values())) or str(error)) from None
        except ParameterException as error:
            raise InputError(str(error)) from None
        kind = _LISTS.get(type(value[0])) if isinstance(value, list) else _KINDS.get(type(value))
        raise InputError(
            f"parameter {name}: what was given is not {kind or 'of the right type'}; give one such as {value!r}"
        )

    def option(self, name: str, default: Any, description: str, bounds: tuple[float, float] | None = None) -> Any:
        """Declare a parameter that is given at the start, within bounds if it is a number, and return its value."""
        about = ParameterDescriptor(description=description, read_only=True)
        if bounds is not None and isinstance(default, int):
            about.integer_range = [IntegerRange(from_value=bounds[0], to_value=bounds[1])]
        elif bounds is not None:
            about.floating_point_range = [FloatingPointRange(from_value=bounds[0], to_value=bounds[1])]
        return self.declare_parameter(name, default, about).value

    def path(self, name: str, description: str) -> Path | None:
        """Declare a parameter that names a file or a directory; None if it is empty."""
        given = str(self.option(name, "", description))
        return Path(given) if given else None

    def texts(self, name: str, description: str) -> list[str]:
        """Declare a parameter with a list of texts, and return those that are not empty."""
        return [str(text) for text in self.option(name, [""], description) if text]

    def vehicles(self, name: str, description: str) -> list[int]:
        """Declare a parameter with numbers of vehicles, and return them; none if -1 is given. Raises InputError."""
        given = list(self.option(name, [_NO_VEHICLE], description))
        if given == [_NO_VEHICLE]:
            return []
        for k, number in enumerate(given):
            if number not in _VEHICLES or number in given[:k]:
                raise InputError(
                    f"parameter {name}: {number} is no vehicle, or was named before; give numbers from 0 on, each once,"
                    f" or {_NO_VEHICLE} alone for {description.rpartition(f'{_NO_VEHICLE}: ')[2]}"
                )
        return given

    def full_names(self, name: str, default: list[str], description: str) -> list[str]:
        """Declare a parameter with full names of nodes or topics, and return them. Raises InputError."""
        given = [str(text) for text in self.option(name, default, description) if text]
        for text in given:
            if not text.startswith("/"):
                raise InputError(f"parameter {name}: {text} is no full name; give /{text}, with its namespace if any")
        return given

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Set parameters, each on its own. Where a real number is expected, a whole number will do."""
        return super().set_parameters([self._as_declared(p) for p in parameter_list])

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all parameters or none. Where a real number is expected, a whole number will do."""
        return super().set_parameters_atomically([self._as_declared(p) for p in parameter_list])

    def _as_declared(self, parameter: Parameter) -> Parameter:
        if not parameter.name:  # rclpy would take it, because "" counts as false
            raise ParameterNotDeclaredException([parameter.name])
        known = self.has_parameter(parameter.name)
        return _as_known(parameter, self.get_parameter(parameter.name).value) if known else parameter

    def stream(self, kind: type, topic: str, qos: QoSProfile = STREAM) -> Publisher:
        """Publisher of a topic, made at the first call, and shared by everything in the node that publishes there."""
        if topic not in self._streams:
            self._streams[topic] = self.create_publisher(kind, topic, qos)
        return self._streams[topic]

    def end_stream(self, topic: str) -> None:
        """Publish no longer on a topic of ``stream``."""
        publisher = self._streams.pop(topic, None)
        if publisher is not None:
            self.destroy_publisher(publisher)

    def send(self, publisher: Publisher, message: Any) -> None:
        """Publish a message, or its bytes, on a topic that is recorded."""
        publisher.publish(message)
        self.published += 1

    def listen(self, kind: type, topic: str, take: Callable[[Any], None], qos: QoSProfile) -> AnyPublisher:
        """Subscribe to a topic, whatever its publishers offer. A message that is not valid is counted and dropped."""
        return AnyPublisher(self, kind, topic, receiver(kind, take, partial(self.refuse, topic)), qos)

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Service:
        """Offer a service. A request on which the callback fails is counted and refused, and the node goes on."""
        return super().create_service(srv_type, srv_name, partial(self._serve, srv_name, callback), **options)

    def guard_services(self) -> None:
        """Guard the services as well that a mixin of rclpy has offered."""
        for service in self.services:
            if getattr(service.callback, "func", None) != self._serve:
                service.callback = partial(self._serve, service.srv_name, service.callback)

    def _serve(self, name: str, callback: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:  # one request must not end the node
            reason = unusable(error)
            self.refuse(name, reason)
            refused = type(response)()
            if hasattr(refused, "message"):
                refused.message = str(reason)
            return refused

    def on_clock_jump(self, callback: Callable[[], None]) -> None:
        """Call back when the time of the recording, /clock, has jumped back; nothing happens on the system's clock."""
        threshold = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self._jumps.append(self.get_clock().create_jump_callback(threshold, post_callback=lambda _: callback()))

    def refuse(self, topic: str, reason: Exception) -> None:
        """Count a message that is dropped. The reason is logged once, and told with the health."""
        if not self.refused:
            self.get_logger().warning(f"{topic}: message dropped: {reason}")
        self.refused += 1
        self._reason = f"{topic}: {reason}"

    def announce(self) -> None:
        """Ask the source to wait for this node from now on."""
        if not self._announced:
            self._announced = True
            self._tell()

    @property
    def is_recorded(self) -> bool:
        """Whether a recorder hears everything that this node publishes, so that nothing is missing in its file."""
        self._is_recorded = self._is_recorded or all(map(self._has_recorder, self.publishers))
        return self._is_recorded

    def _has_recorder(self, publisher: Publisher) -> bool:
        topic = publisher.topic_name
        if topic.endswith(UNRECORDED) or topic_or_service_is_hidden(topic):
            return True
        known = self.get_subscriptions_info_by_topic(topic)
        # the graph may show a subscriber a moment before the middleware sends to it
        return any(one.node_name == RECORDER for one in known) and publisher.get_subscription_count() >= len(known)

    def narrow(self, window: int) -> None:
        """Let fewer samples be under way, so that what is asked of a busy process waits less. Call it at the start."""
        self.window = window

    def taken(self, steps: int, last: bool = False) -> None:
        """Note that all samples before number ``steps`` have been taken."""
        self.steps = steps
        if last or steps % max(1, self.window // 4) == 0:
            self._tell()

    def health(self) -> Health:
        """Health of this node now."""
        raise NotImplementedError

    @property
    def doing(self) -> str:
        """What the node does, in one line that it says when it starts."""
        return self.health().message

    def report(self) -> None:
        """Publish the health now."""
        level, message, values = self.health()
        self._level, self._reported_s = level, time.monotonic()
        if self.refused:
            values = {**values, "refused messages": self.refused, "last refused": self._reason}
        if self.refused > self._told_refused:
            level, message = max(level, WARN), f"{message}; message dropped: {self._reason}"
            self._told_refused = self.refused
        pairs = [KeyValue(key=k, value=str(v)) for k, v in values.items()]
        name = self.get_fully_qualified_name()
        message_array = DiagnosticArray(
            status=[DiagnosticStatus(level=level, name=name, message=message, hardware_id="", values=pairs)]
        )
        message_array.header.stamp = self.get_clock().now().to_msg()
        # what nobody hears cannot be in a recording
        if self._to_diagnostics.get_subscription_count():
            self.send(self._to_diagnostics, message_array)

    def report_if_worse(self) -> None:
        """Publish the health at once if it has worsened."""
        if self.health().level > self._level:
            self.report()

    def finish(self) -> None:
        """Send the last health and the number of messages, wait until both are received, and send nothing more."""
        for timer in self.timers:
            timer.cancel()
        self.report()
        self._tell()
        deadline = time.monotonic() + _RECEIVED_S
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))

    def close(self) -> None:
        """Close what the node holds, after its last callback."""

    def beat(self) -> None:
        """Report the health, and tell the source how far this node has come, if it is time; called by a timer."""
        now = time.monotonic()
        if now - self._reported_s >= _REPORT_S:
            self.report()
        now_known = (self.steps, self.published, self.is_recorded)
        if self._announced and (self._told != now_known or now - self._told_s >= _REPORT_S):
            self._tell()

    def _tell(self) -> None:
        self._told, self._told_s = (self.steps, self.published, self.is_recorded), time.monotonic()
        self._progress.steps, self._progress.published, self._progress.recorded = self._told
        self._to_progress.publish(self._progress)


def message_type(type_name: str) -> Any:
    """Class of a message type, such as ``std_msgs/msg/Header``. Raises ImportError or AttributeError."""
    package, _, name = type_name.split("/")
    return getattr(import_module(f"{package}.msg"), name)


def followers(node: Node) -> list[str]:
    """Full names of the nodes in a node's namespace that follow drivers: their models take effects, and lose them."""
    space, ends = node.get_namespace().rstrip("/") + "/", "/remove_effect"
    services = (name for name, _ in node.get_service_names_and_types())
    return sorted(name.removesuffix(ends) for name in services if name.startswith(space) and name.endswith(ends))


def clients_of(node: Node, kind: type, services: Iterable[str]) -> tuple[list[Client], list[str]]:
    """Make clients of services, and name the services that no node of the graph offers; nothing waits for those.

    Who has called a client destroys it.
    """
    offered = {name for name, _ in node.get_service_names_and_types()}
    wanted = list(services)
    waiting = [node.create_client(kind, name) for name in wanted if name in offered]
    ready: list[Client] = []
    end = time.monotonic() + _READY_S
    while waiting:
        ready += [client for client in waiting if client.service_is_ready()]
        waiting = [client for client in waiting if client not in ready]
        if time.monotonic() > end:
            break
        if waiting:
            time.sleep(_READY_LOOK_S)
    for client in waiting:
        node.destroy_client(client)
    found = {client.srv_name for client in ready}
    return ready, [name for name in wanted if name not in found]


def _out_of_bounds(name: str, about: Sequence[Any]) -> str:
    """Say within which bounds a parameter must lie; empty if none of ``about`` is a descriptor with bounds."""
    descriptors = [one for one in about if isinstance(one, ParameterDescriptor)]
    found = [bounds for one in descriptors for bounds in (*one.floating_point_range, *one.integer_range)]
    return "".join(
        f"parameter {name}: out of bounds; give {bounds.from_value:.10g} to {bounds.to_value:.10g}"
        for bounds in found[:1]
    )


def _as_known(given: Parameter, known: Any) -> Parameter:
    """A parameter of the type of a known value, if what was given can be meant so.

    Whole numbers stand for real numbers, too. ROS does not know the type of an empty list: of texts, none stand in it.
    """
    kind = type(known[0]) if isinstance(known, (list, array)) and len(known) else type(known)
    if given.type_ == Parameter.Type.INTEGER and kind is float:
        return Parameter(given.name, value=float(given.value))
    if given.type_ == Parameter.Type.INTEGER_ARRAY and kind is float:
        return Parameter(given.name, value=[float(v) for v in given.value])
    if given.type_ == Parameter.Type.NOT_SET and kind is str and isinstance(known, list):
        return Parameter(given.name, value=[""])
    return given
