"""One node for all drivers in view: a driver's filter is made at first sight, and retired some time after the last."""

from collections import deque
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import DriverArray, MeasuredPositions
from sugiyama_msgs.msg import Road as RoadMessage
from sugiyama_msgs.srv import AddEffect, RemoveEffect

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.filters.online import warm_up
from sugiyama_ros.nodes.arrivals import FOLLOWED, Arrival, Arrivals, new_counts
from sugiyama_ros.nodes.base import incoming
from sugiyama_ros.nodes.base.any_publisher import AnyPublisher
from sugiyama_ros.nodes.base.cdr_messages import NS, Sample
from sugiyama_ros.nodes.base.node import ERROR, OK, WARN, Health, PacedNode
from sugiyama_ros.nodes.base.qos import DEPTH, LATCHED, STREAM
from sugiyama_ros.nodes.base.spin import run_node
from sugiyama_ros.nodes.driver_array import TOPIC, ArrayMessages
from sugiyama_ros.nodes.driver_parameters import declare_float, declare_window
from sugiyama_ros.nodes.driver_topics import shared_topics
from sugiyama_ros.nodes.drivers_in_view import DriversInView, read_settings
from sugiyama_ros.nodes.effect_services import add_effect, remove_effect

_RETIRE_EVERY_NS = NS


class DriversNode(LifecycleNodeMixin, PacedNode):
    """Follows every vehicle of the topic ``measured``, and publishes all drivers in one message, ``drivers``.

    All names are relative, so they can be remapped, and the node works in any namespace. The node configures and
    activates itself, unless ``autostart`` is false: then a lifecycle manager does.

    Parameters of the node: the parameters of a driver, from which a driver starts who is not in ``model``; ``model``,
    ``save_state``, ``resume``, ``reorder_window``, ``retire_after``, ``most_drivers``, ``vehicle_topics``
    and ``autostart``. Services: ``~/reset``, ``~/add_effect``, ``~/remove_effect``.

    **options: options of the ROS node.
    """

    def __init__(self, **options: Any) -> None:
        PacedNode.__init__(self, "drivers", **options)
        LifecycleNodeMixin.__init__(self)
        self.guard_services()
        warm_up()
        self._settings = read_settings(self)
        self._window_s = declare_window(self)
        self._retire_after_s = declare_float(
            self,
            "retire_after",
            5.0,
            ParameterDescriptor(
                description="time [s] after the last sight of a vehicle at which its driver's filter is retired",
                floating_point_range=[FloatingPointRange(from_value=0.0, to_value=3600.0)],
                read_only=True,
            ),
        )
        most = ParameterDescriptor(
            description="drivers in view, at most",
            integer_range=[IntegerRange(from_value=1, to_value=100_000, step=1)],
            read_only=True,
        )
        self._most = int(self.declare_parameter("most_drivers", 1000, most).value)
        starts = ParameterDescriptor(description="whether the node configures and activates itself", read_only=True)
        autostart = bool(self.declare_parameter("autostart", True, starts).value)
        self._counts = new_counts()
        self._effects = self._settings.effects
        self._road: RoadMessage | None = None
        self._view: DriversInView | None = None
        self._arrivals: Arrivals | None = None
        self._waiting: deque[Sample] = deque(maxlen=DEPTH)
        self._inputs: list[AnyPublisher] = []
        self._messages = ArrayMessages()
        self._is_active = False
        self._retired_ns = 0
        self._failure = ""
        for kind, name, callback in (
            (Trigger, "reset", self._on_reset),
            (AddEffect, "add_effect", self._on_add_effect),
            (RemoveEffect, "remove_effect", self._on_remove_effect),
        ):
            self.create_service(kind, f"~/{name}", callback)
        self.on_clock_jump(self._on_clock_jump)
        if autostart:
            self.trigger_configure()
            self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe, and offer the topics of all drivers, so that a recorder hears them from the first message on."""
        if not self._settings.has_vehicle_topics:
            for kind, topic in ((DriverArray, TOPIC), *shared_topics(self._settings.types)):
                self.stream(kind, topic)
        on_road = incoming.receiver(incoming.road, self._on_road, lambda reason: self.refuse("road", reason))
        on_sample = incoming.receiver(incoming.sample, self.take_in, lambda reason: self.refuse("measured", reason))
        self._inputs = [
            AnyPublisher(self, RoadMessage, "road", on_road, LATCHED),
            AnyPublisher(self, MeasuredPositions, "measured", on_sample, STREAM),
        ]
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Follow the vehicles from now on."""
        self._is_active = True
        self._go_on()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave out all samples until the node is active again. The drivers stay known."""
        self._is_active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save what was learnt, and forget the drivers and the road."""
        self._retire_all()
        for one in self._inputs:
            one.close()
        self._inputs, self._road, self._view, self._arrivals = [], None, None, None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save what was learnt."""
        self._is_active = False
        self._retire_all()
        return TransitionCallbackReturn.SUCCESS

    @property
    def in_view(self) -> tuple[int, ...]:
        """Numbers of the vehicles whose drivers have a filter now."""
        return tuple(self._view.drivers) if self._view is not None else ()

    def health(self) -> Health:
        """ERROR after a failure of a filter, WARN without a road, or with more drivers in view than are followed."""
        if self._failure:
            return Health(ERROR, self._failure, self._counts)
        if not self._is_active:
            return Health(OK, "not active", self._counts)
        if self._view is None or self._arrivals is None:
            return Health(WARN, f"waiting for a road on {self.resolve_topic_name('road')}", self._counts)
        if self._arrivals.stamp_ns is None:
            return Health(WARN, f"nothing heard on {self.resolve_topic_name('measured')} yet", self._counts)
        view = self._view
        values = {**self._counts, **self._arrivals.rhythm, **view.counts, "drivers": len(view.drivers)}
        if view.left_out:
            most = f"{len(view.left_out)} vehicles are not followed: there are more than most_drivers, {self._most}"
            return Health(WARN, most, values)
        return Health(OK, f"following {len(view.drivers)} drivers", values)

    def take_in(self, sample: Sample) -> None:
        """Take in a sample of the topic ``measured``."""
        if self._is_active:
            self._waiting.append(sample)
            self._go_on()

    def finish(self) -> None:
        """Keep what was learnt, and send nothing more."""
        self._is_active = False
        self._retire_all()
        super().finish()

    def _on_road(self, road: RoadMessage) -> None:
        known, self._road = self._road, road
        if known is None or (known.circumference_m, known.period_s) != (road.circumference_m, road.period_s):
            self._begin_anew()
        self._go_on()
        self.announce()

    def _begin_anew(self) -> None:
        """Forget all drivers, also what an earlier run has learnt of them."""
        if self._road is None:
            return
        self._arrivals = Arrivals(self._road.period_s, self._window_s, self._counts)
        self._view = DriversInView(
            self, self._settings, self._road, self._effects, self._counts, self._window_s, self._most
        )
        self._failure, self._retired_ns = "", 0

    def _go_on(self) -> None:
        """Take in what waits. A late node may hear the samples before the road."""
        while self._waiting and self._is_active and self._arrivals is not None and self._view is not None:
            self._arrive(self._waiting.popleft(), self._arrivals, self._view)

    def _arrive(self, sample: Sample, arrivals: Arrivals, view: DriversInView) -> None:
        """Do with a sample what its stamp asks for."""
        arrival = arrivals.judge(sample)
        if arrival is Arrival.JUMPED:
            view.restart()
            if (aside := arrivals.taken_aside()) is not None:
                self._publish(aside, view, late=False)
        if arrival in FOLLOWED:
            self._publish(sample, view, late=arrival is Arrival.LATE)
        self.taken(sample.step + 1, last=self._road is not None and sample.step + 1 == self._road.steps)

    def _publish(self, sample: Sample, view: DriversInView, late: bool) -> None:
        """Take in a sample, and publish what follows from it."""
        known = view.take_in(sample, late)
        if known and not self._settings.has_vehicle_topics:
            self.send(self.stream(DriverArray, TOPIC), self._messages.message(sample.stamp_ns, known))
        if view.failure and not self._failure:
            self._failure = view.failure
            self.get_logger().error(self._failure)
            self.report_if_worse()
        if abs(sample.stamp_ns - self._retired_ns) >= _RETIRE_EVERY_NS:
            self._retired_ns = sample.stamp_ns
            self._guarded_retire(view, sample.stamp_ns - round(self._retire_after_s * NS))

    def _guarded_retire(self, view: DriversInView, before_ns: int | None) -> None:
        try:
            view.retire(before_ns)
        except SugiyamaError as error:
            self.failure = error

    def _retire_all(self) -> None:
        if self._view is not None:
            self._guarded_retire(self._view, None)

    def _on_clock_jump(self) -> None:
        if self._arrivals is not None:
            self._arrivals.clock_has_jumped()

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._begin_anew()
        response.success = self._view is not None
        response.message = "" if response.success else "no road yet"
        return response

    def _on_add_effect(self, request: AddEffect.Request, response: AddEffect.Response) -> AddEffect.Response:
        return add_effect(request, response, self._effects, self._take_effects)

    def _on_remove_effect(
        self, request: RemoveEffect.Request, response: RemoveEffect.Response
    ) -> RemoveEffect.Response:
        return remove_effect(request, response, self._effects, self._take_effects)

    def _take_effects(self, effects: Array) -> None:
        """Go on with other effects (WIDTH,), and keep what was learnt about the drivers."""
        if self._view is not None:
            self._view.change(effects)
        self._effects = effects


def main() -> None:
    """Run the node of all drivers."""
    run_node(DriversNode)


if __name__ == "__main__":
    main()
