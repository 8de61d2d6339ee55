"""A source of measured positions: paced by its subscribers and, if wanted, by the clock."""

import time
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import MeasuredPositions, Progress
from sugiyama_msgs.msg import Road as RoadMessage
from visualization_msgs.msg import MarkerArray

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.base import cdr_messages, environment, incoming
from sugiyama_ros.nodes.base.node import ERROR, OK, RECORDER, WARN, Health, PacedNode
from sugiyama_ros.nodes.base.pacing import Pace
from sugiyama_ros.nodes.base.qos import LATCHED, PROGRESS_IN, STREAM, WINDOW
from sugiyama_ros.nodes.base.samples import PositionSamples
from sugiyama_ros.nodes.markers import Markers

_TICK_S = 0.005
# Nodes that are waited for and named when the source starts, at most.
_NAMED = 3
#: Silence [s] after which a subscriber is no longer waited for.
PATIENCE_S = 10.0
# Time [s] in which a new source looks for another one; discovery between processes takes up to about 3 s.
_LOOKS_S, _LOOKS_EVERY_S = 3.0, 0.1


class Source(PacedNode):
    """Publishes samples as ``road``, ``measured``, ``/clock`` and ``markers``.

    The source is at most WINDOW steps ahead of the slowest subscriber that reports its progress. It no longer waits for
    a subscriber that is silent for 10 s. If it waits for a recorder, it sends nothing before the recorder hears every
    topic of the nodes that it waits for.

    Parameters of the node: ``rate`` (times real time; 0: as fast as the subscribers take it), ``start_paused``,
    ``wait_for`` (full names of the nodes to wait for), ``exit_at_end``. Services: ``~/pause``, ``~/resume`` and
    ``~/step``.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.declare_parameter(
            "rate",
            1.0,
            ParameterDescriptor(
                description="times real time; 0: as fast as the subscribers take it",
                floating_point_range=[FloatingPointRange(from_value=0.0, to_value=1e6)],
            ),
        )
        self.declare_parameter(
            "start_paused", False, ParameterDescriptor(description="wait for ~/resume or ~/step", read_only=True)
        )
        self.declare_parameter(
            "wait_for",
            [""],
            ParameterDescriptor(
                description="full names of the nodes to wait for before the first step", read_only=True
            ),
        )
        about = ParameterDescriptor(description="end when the last sample has been taken", read_only=True)
        self._exits_at_end = bool(self.declare_parameter("exit_at_end", False, about).value)
        self.loop = False
        self.samples = self.open()
        self._speed_up = self.get_parameter("rate").value
        self._paused = self.get_parameter("start_paused").value
        awaited = [name for name in self.get_parameter("wait_for").value if name]
        self._pace = Pace(WINDOW, PATIENCE_S, awaited)
        self._is_for_recorder = any(name.rpartition("/")[2] == RECORDER for name in awaited)
        self.next_step = 0
        self._jump_to: int | None = None
        self._anchor: tuple[float, int] | None = None
        self._markers = Markers(self.samples.road)
        self._awake_s = 0.0
        self._ticked_s = time.monotonic()
        self._to_road = self.create_publisher(RoadMessage, "road", LATCHED)
        self._to_measured = self.create_publisher(MeasuredPositions, "measured", STREAM)
        self._to_clock = self.create_publisher(Clock, "/clock", STREAM)
        self._to_markers = self.create_publisher(MarkerArray, "markers", STREAM)
        self.listen(Progress, self.shared("_progress"), incoming.progress, self._on_progress, PROGRESS_IN)
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
            return Health(WARN, f"waiting for {', '.join(sorted(self._pace.missing))}", values)
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
        awaited = sorted(self._pace.missing)
        named = ", ".join(awaited[:_NAMED]) + f" and {len(awaited) - _NAMED} others" * (len(awaited) > _NAMED)
        waits = f", once {named} can take them" if awaited else ""
        return f"sends {what} of {s.source} at {rate}{waits}"

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
        """Send the steps that are due and fit into the window."""
        if self.next_step == self.samples.steps > 0 and self.loop and self._jump_to is None:
            self._jump_to = 0
        if self._jump_to is not None and self._pace.drained:
            self.next_step, self._jump_to, self._anchor = self._jump_to, None, None
            self._pace.restart(self.next_step)
        while not self._paused and self._may_send and self._is_due():
            self._send()
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
        positions = samples.at(step)
        stamp_ns = round((samples.start_s + step * samples.period_s) * cdr_messages.NS)
        self.send(self._to_clock, cdr_messages.clock(stamp_ns))
        self.send(self._to_measured, cdr_messages.measured_positions(stamp_ns, step, positions))
        self.send_more(stamp_ns)
        self.next_step += 1
        self._pace.sent()
        if self._to_markers.get_subscription_count():
            self.send(self._to_markers, self._markers.message(stamp_ns, positions))

    def _send_road(self) -> None:
        s = self.samples
        message = RoadMessage(
            circumference_m=s.road.circumference_m,
            period_s=s.period_s,
            steps=s.steps,
            source=s.source,
            sha256=s.sha256,
        )
        message.header.stamp, message.header.frame_id = (
            cdr_messages.time_message(round(s.start_s * cdr_messages.NS)),
            FRAME,
        )
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
