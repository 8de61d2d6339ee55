"""A source of measured positions: paced by its subscribers and, if wanted, by the clock."""

import time
from collections.abc import Iterable
from math import pi
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Vector3
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import ColorRGBA, Int32MultiArray
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import MeasuredPositions, Progress, TrueParameters, Truth
from sugiyama_msgs.msg import Road as RoadMessage
from visualization_msgs.msg import Marker, MarkerArray

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.measured import CONTROLLED, FRAME
from sugiyama_ros.formats.truth import namespace, truth_message
from sugiyama_ros.nodes.base import cdr_messages, environment
from sugiyama_ros.nodes.base.cdr_layout import ENCAPSULATION, offset, over
from sugiyama_ros.nodes.base.cdr_messages import NS, time_message
from sugiyama_ros.nodes.base.node import ERROR, OK, RECORDER, WARN, Health, PacedNode
from sugiyama_ros.nodes.base.qos import LATCHED, PROGRESS_IN, STREAM, WINDOW
from sugiyama_ros.nodes.base.samples import PositionSamples
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.placing import Positions
from sugiyama_ros.trajectories.truth import TrueDriver

_TICK_S = 0.005
# Nodes that are waited for and named when the source starts, at most.
_NAMED = 3
#: Silence [s] after which a subscriber is no longer waited for.
PATIENCE_S = 10.0
# Time [s] in which a new source looks for another one; discovery between processes takes up to about 3 s.
_LOOKS_S, _LOOKS_EVERY_S = 3.0, 0.1
# Of the boxes of vehicles.
_WIDTH_M, _HEIGHT_M = 1.7, 1.5
_GREY = ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0)
_BLUE = ColorRGBA(r=0.2, g=0.5, b=0.9, a=1.0)
_CORNERS = 72
# Numbers that differ from sample to sample: of every marker, and of boxes.
_OF_ALL = {"header.stamp.sec": "<i4", "header.stamp.nanosec": "<u4"}
_REAL = ("pose.position.x", "pose.position.y", "pose.orientation.z", "pose.orientation.w", "scale.x")
_OF_BOXES = {"id": "<i4", **dict.fromkeys(_REAL, "<f8")}
# Where the number of markers stands in a message.
_COUNT = slice(ENCAPSULATION, ENCAPSULATION + 4)


class Source(PacedNode):
    """Publishes samples as ``road``, ``measured``, ``/clock`` and ``markers``; and ``controlled`` if some vehicles are.

    The source is at most WINDOW steps ahead of the slowest subscriber that reports its progress. It no longer waits for
    a subscriber that is silent for 10 s. If it waits for a recorder, it sends nothing before the recorder hears every
    topic of the nodes that it waits for.

    Parameters of the node: ``rate`` (times real time; 0: as fast as the subscribers take it), ``start_paused``,
    ``wait_for`` (full names of nodes to wait for), ``exit_at_end``. Services: ``~/pause``, ``~/resume``, ``~/step``.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        about = ParameterDescriptor(description="times real time; 0: as fast as the subscribers take it")
        about.floating_point_range = [FloatingPointRange(from_value=0.0, to_value=1e6)]
        self.declare_parameter("rate", 1.0, about)
        awaited = self.full_names("wait_for", [""], "full names of the nodes to wait for before the first step")
        self._paused = self.option("start_paused", False, "wait for ~/resume or ~/step")
        self._exits_at_end = self.option("exit_at_end", False, "end when the last sample has been taken")
        self.loop = False
        self.samples = self.open()
        self._speed_up = self.get_parameter("rate").value
        self._pace = Pace(WINDOW, PATIENCE_S, awaited)
        self._is_for_recorder = any(name.rpartition("/")[2] == RECORDER for name in awaited)
        self.next_step = 0
        self._jump_to: int | None = None
        self._anchor: tuple[float, int] | None = None
        self._markers = Markers(self.samples.road)
        # times [s] at which the first sample was sent, and the last one taken
        self._first_s = self._last_s = 0.0
        self._awake_s = 0.0
        self._ticked_s = time.monotonic()
        self._to_road = self.create_publisher(RoadMessage, "road", LATCHED)
        if self.samples.controlled:
            self.send(
                self.create_publisher(Int32MultiArray, CONTROLLED, LATCHED),
                Int32MultiArray(data=self.samples.controlled),
            )
        self._to_measured = self.create_publisher(MeasuredPositions, "measured", STREAM)
        self._to_clock = self.create_publisher(Clock, "/clock", STREAM)
        self._to_markers = self.create_publisher(MarkerArray, "markers", STREAM)
        self.listen(Progress, "_progress", self._on_progress, PROGRESS_IN)
        for service, callback in (("pause", self._on_pause), ("resume", self._on_resume), ("step", self._on_step)):
            self.create_service(Trigger, f"~/{service}", callback)
        self.add_post_set_parameters_callback(lambda _: self._on_parameters())
        self.create_timer(_TICK_S, self._on_tick, clock=self.steady)
        self._looks_until_s = time.monotonic() + _LOOKS_S
        self._looking = self.create_timer(_LOOKS_EVERY_S, self._look_for_another, clock=self.steady)
        self._send_road()
        self.announce()

    def open(self) -> PositionSamples:
        """The samples to send, from the node's parameters. Raises InputError if there are none."""
        raise NotImplementedError

    def send_more(self, stamp_ns: int) -> None:
        """Send what belongs to a sample besides the measured positions."""

    def health(self) -> Health:
        """ERROR while a subscriber is no longer waited for, WARN while a subscriber is missing."""
        values = {"step": self.next_step, "steps": self.samples.steps, "paused": self._paused}
        if self._pace.dropped:
            return Health(ERROR, f"gave up waiting for {', '.join(sorted(self._pace.dropped))}", values)
        if self._pace.missing:
            return Health(WARN, f"waiting for {', '.join(self.missing)}", values)
        return Health(OK, "paused" if self._paused else "sending", values)

    def narrow(self, window: int) -> None:
        """Send at most ``window`` samples beyond the slowest subscriber."""
        super().narrow(window)
        self._pace.window = window

    @property
    def doing(self) -> str:
        """What is sent, how fast, and who is waited for."""
        s, rate = self.samples, f"{self._speed_up:g} times real time" if self._speed_up else "the fastest rate"
        what = f"{s.steps} samples ({(s.steps - 1) * s.period_s:.1f} s)" if s.steps else "samples without end"
        awaited = self.missing
        named = ", ".join(awaited[:_NAMED]) + f" and {len(awaited) - _NAMED} others" * (len(awaited) > _NAMED)
        waits = f", once {named} can take them" if awaited else ""
        return f"sends {what} of {s.source} at {rate}{waits}"

    @property
    def sent_for_s(self) -> float:
        """Time [s] from the first sample that was sent to the last one that all subscribers have taken."""
        return self._last_s - self._first_s

    @property
    def missing(self) -> list[str]:
        """Full names of the nodes that are waited for before the first sample."""
        return sorted(self._pace.missing)

    def finish(self) -> None:
        """Send nothing more."""
        self._paused = True
        super().finish()

    def jump(self, step: int) -> None:
        """Continue from sample number ``step``, as soon as the subscribers have taken everything that was sent."""
        self._jump_to = step
        self._pump()

    def _look_for_another(self) -> None:
        """Fail if another node sends positions already, since nobody could tell them apart. The other one goes on."""
        if time.monotonic() > self._looks_until_s:
            self._looking.cancel()
        if self.failure is None and self.count_publishers(self._to_measured.topic_name) > 1:
            self._paused = True
            self.failure = InputError(
                f"{self._to_measured.topic_name}: another node publishes it already in ROS domain"
                f" {environment.domain()}; end it, or set ROS_DOMAIN_ID to another number"
            )

    def _pump(self) -> None:
        """Send the steps that are due and fit into the window.

        No more than a window at a time: without a subscriber that reports its progress nothing else would end it, and
        nothing else would be heard, neither a service nor a signal.
        """
        if self.next_step == self.samples.steps > 0 and self.loop and self._jump_to is None:
            self._jump_to = 0
        if self._jump_to is not None and self._pace.drained:
            self.next_step, self._jump_to, self._anchor = self._jump_to, None, None
            self._pace.restart(self.next_step)
        for _ in range(self._pace.window):
            if self._paused or not self._may_send or not self._is_due():
                break
            self._send()
        if self._pace.acknowledged > self.steps:
            self._last_s = time.monotonic()
        at_end = self._pace.acknowledged == self.samples.steps
        self.taken(self._pace.acknowledged, last=at_end)
        self.is_done = at_end and self.samples.steps > 0 and self._exits_at_end

    @property
    def _may_send(self) -> bool:
        at_end = self.samples.steps and self.next_step == self.samples.steps
        if self._jump_to is not None or at_end or not self._pace.may_send:
            return False
        return self.is_recorded or not self._is_for_recorder

    def _is_due(self) -> bool:
        """Whether the next step is due. Its time is counted from the first step, so that no error adds up."""
        if self._speed_up == 0.0:
            return True
        now = time.monotonic()
        if self._anchor is None:
            self._anchor = (now, self.next_step)
        start_s, start = self._anchor
        return now >= start_s + (self.next_step - start) * self.samples.period_s / self._speed_up

    def _send(self) -> None:
        step, samples = self.next_step, self.samples
        self._first_s = self._first_s or time.monotonic()
        positions = samples.at(step)
        stamp_ns = round((samples.start_s + step * samples.period_s) * NS)
        self.send(self._to_clock, cdr_messages.clock(stamp_ns))
        self.send(self._to_measured, cdr_messages.measured_positions(stamp_ns, step, positions))
        self.send_more(stamp_ns)
        self.next_step += 1
        self._pace.sent()
        if self._to_markers.get_subscription_count():
            self.send(self._to_markers, self._markers.message(stamp_ns, positions))

    def _send_road(self) -> None:
        s = self.samples
        message = RoadMessage(circumference_m=s.road.circumference_m, period_s=s.period_s, steps=s.steps)
        message.source, message.sha256 = s.source, s.sha256
        message.header.stamp, message.header.frame_id = time_message(round(s.start_s * NS)), FRAME
        self.send(self._to_road, message)

    def _on_progress(self, message: Progress) -> None:
        if message.node == self.get_fully_qualified_name():
            return
        if self._is_for_recorder and message.node in self._pace.missing and not message.recorded:
            # its first messages would not be in the file
            return
        if message.node in self._pace.dropped:
            self.get_logger().info(f"{message.node} is back")
        self._pace.heard(message.node, message.steps, self._awake_s)
        self._pump()

    def _on_tick(self) -> None:
        # While this process itself pauses it hears nothing, so a pause counts as a moment only.
        now = time.monotonic()
        self._awake_s += min(now - self._ticked_s, 0.1)
        self._ticked_s = now
        for name in self._pace.drop_silent(self._awake_s):
            self.get_logger().warning(f"{name} has been silent for {PATIENCE_S:.0f} s: no longer waiting for it")
        self._pump()
        self.report_if_worse()

    def _on_parameters(self) -> None:
        self._speed_up = self.get_parameter("rate").value
        self._anchor = None

    def _on_pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._paused = True
        return answer(response)

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._paused, self._anchor = False, None
        self._pump()
        return answer(response)

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._paused:
            return answer(response, "not paused: call ~/pause first")
        if not self._may_send:
            return answer(response, "at the end, or the subscribers have not yet taken what was sent")
        self._send()
        return answer(response)


def answer(response: Any, why_not: str = "") -> Any:
    """Fill in the response of a service: success, or why not."""
    response.success, response.message = not why_not, why_not
    return response


class Pace:
    """How far a source may go: at most ``window`` steps beyond the slowest subscriber.

    A subscriber reports how many steps of the recording it has taken, at least once a second. A subscriber that is
    silent for ``patience_s`` is dropped, and joins again with its next report. Nothing is sent before all nodes in
    ``wait_for`` have reported.
    """

    def __init__(self, window: int, patience_s: float, wait_for: Iterable[str] = ()) -> None:
        self.missing = set(wait_for)
        self.dropped: set[str] = set()
        self.window = window
        self._patience_s = patience_s
        # of each subscriber: steps taken, and the time [s] of the last report
        self._steps: dict[str, int] = {}
        self._heard_s: dict[str, float] = {}
        self._first = 0
        self._next = 0
        self.acknowledged = 0

    @property
    def drained(self) -> bool:
        """Whether everything sent has been acknowledged."""
        return self.acknowledged == self._next

    @property
    def may_send(self) -> bool:
        """Whether one more step fits into the window."""
        return not self.missing and self._next < self.acknowledged + self.window

    def sent(self) -> None:
        """One more step was sent."""
        self._next += 1
        self._update()

    def heard(self, name: str, steps: int, now_s: float) -> None:
        """Subscriber ``name`` has taken all steps before number ``steps``."""
        self.missing.discard(name)
        self.dropped.discard(name)
        known = self._steps.setdefault(name, self._first)
        self._heard_s[name] = now_s
        # Any other number is from before the last restart. An old number that happens to fit lets the source run at
        # most one window too far, because all steps had been taken at the restart.
        if known < steps <= self._next:
            self._steps[name] = steps
        self._update()

    def restart(self, step: int) -> None:
        """Go on with step number ``step``. Everything sent before must have been acknowledged."""
        self._first = self._next = step
        self._steps = dict.fromkeys(self._steps, step)
        self._update()

    def drop_silent(self, now_s: float) -> list[str]:
        """Drop the subscribers that have been silent for too long; returns their names."""
        silent = [name for name, heard_s in self._heard_s.items() if now_s - heard_s > self._patience_s]
        for name in silent:
            del self._steps[name], self._heard_s[name]
        if silent:
            self.dropped.update(silent)
            self._update()
        return silent

    def _update(self) -> None:
        self.acknowledged = min(self._steps.values(), default=self._next)


class TrueTopics:
    """Publishes the true motion of each vehicle with every sample, and the true parameters when they change."""

    def __init__(self, node: PacedNode, vehicles: Iterable[int]) -> None:
        self._node = node
        self._motion: dict[int, Any] = {}
        self._parameters: dict[int, Any] = {}
        for vehicle in vehicles:
            space = namespace(vehicle)
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


class Markers:
    """Messages with a box for each vehicle with a known position.

    The vehicles are on a circle for a ring, and along the x axis for an open road. Each message replaces the message
    before. The library takes twelve times as long for a message of 22 boxes as it takes to fill numbers into bytes that
    the library has made before, of at least so many boxes.
    """

    def __init__(self, road: Road) -> None:
        self._road = road
        self._make_room(0)

    def message(self, stamp_ns: int, positions: Positions) -> bytes:
        """Bytes of the message for a sample at a stamp [ns]."""
        position, length = np.array(positions.position_m), np.array(positions.length_m)
        known = np.isfinite(position)
        x, y, heading = _on_the_plane(self._road, position[known])
        if len(x) > self._room:
            self._make_room(2 * len(x))
        markers = len(self._ends) - 1 - self._room + len(x)
        raw = self._template[: self._ends[markers]].copy()
        raw[_COUNT].view("<u4")[:] = markers
        of_all = (np.full(markers, number) for number in divmod(stamp_ns, NS))
        of_boxes = np.array(positions.vehicle)[known], x, y, np.sin(0.5 * heading), np.cos(0.5 * heading), length[known]
        for (dtype, places), numbers in zip(self._places, (*of_all, *of_boxes), strict=True):
            here = places[: len(numbers)]
            raw[here] = numbers.astype(dtype).view(np.uint8).reshape(here.shape)
        return raw.tobytes()

    def _make_room(self, boxes: int) -> None:
        """Make the bytes of a message with so many boxes, and find by their types where their numbers stand."""
        box = _marker(Marker.ADD, "vehicles", Marker.CUBE, _BLUE)
        box.scale = Vector3(y=_WIDTH_M, z=_HEIGHT_M)
        first = [_marker(Marker.DELETEALL), *([_line(self._road)] if self._road.is_ring else [])]
        raw = bytes(serialize_message(MarkerArray(markers=[*first, *[box] * boxes])))
        ends = [_COUNT.stop - ENCAPSULATION]
        for _ in range(len(first) + boxes):
            ends.append(over(Marker, "<")(memoryview(raw)[ENCAPSULATION:], ends[-1]))

        def places(name: str, dtype: str, after: int) -> tuple[str, Ints]:
            """Type of a field, and where its bytes are in each marker after the first ones, (markers, size)."""
            starts = [offset(Marker, name, memoryview(raw)[ENCAPSULATION:], at) for at in ends[after:-1]]
            return dtype, ENCAPSULATION + np.array(starts, np.int64)[:, None] + np.arange(np.dtype(dtype).itemsize)

        self._room, self._template = boxes, np.frombuffer(raw, np.uint8)
        self._ends = ENCAPSULATION + np.array(ends)
        self._places = [places(*field, 0) for field in _OF_ALL.items()]
        self._places += [places(*field, len(first)) for field in _OF_BOXES.items()]


def _marker(action: int, name: str = "", shape: int = 0, color: ColorRGBA | None = None) -> Marker:
    marker = Marker(ns=name, action=action, type=shape, color=color or ColorRGBA())
    marker.header.frame_id = FRAME
    marker.pose.orientation.w = 1.0
    return marker


def _line(road: Road) -> Marker:
    """The road as a line."""
    line = _marker(Marker.ADD, "road", Marker.LINE_STRIP, _GREY)
    line.scale.x = 0.3
    x, y, _ = _on_the_plane(road, np.asarray(np.linspace(0.0, road.circumference_m, _CORNERS + 1)))
    line.points = [Point(x=x_m, y=y_m) for x_m, y_m in zip(x.tolist(), y.tolist(), strict=True)]
    return line


def _on_the_plane(road: Road, position_m: Array) -> tuple[Array, Array, Array]:
    """Coordinates x, y [m] and heading [rad] of positions [m], each (N,)."""
    if not road.is_ring:
        return position_m, np.zeros_like(position_m), np.zeros_like(position_m)
    angle, radius = 2.0 * pi * position_m / road.circumference_m, road.circumference_m / (2.0 * pi)
    return radius * np.cos(angle), radius * np.sin(angle), angle + 0.5 * pi
