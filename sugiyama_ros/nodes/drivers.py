"""Nodes that follow drivers: samples in; state, innovation and parameters of each driver out.

`FollowingNode` is what the node of one driver (`estimator`) and the node of all drivers in view share.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import Road as RoadMessage
from sugiyama_msgs.srv import AddEffect, RemoveEffect

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.effects.registry import ROW, active, switched_on
from sugiyama_ros.errors import InputError, SugiyamaError
from sugiyama_ros.filters.online import warm_up
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.feed import FOLLOWED, WINDOW_S, Arrival, Arrivals, RoadFeed, new_counts
from sugiyama_ros.nodes.base.incoming import RefusedError, named_values
from sugiyama_ros.nodes.base.node import ERROR, OK, WARN, Health, PacedNode
from sugiyama_ros.nodes.base.parameters import check_driver, declare_adapt, declare_driver, declare_model, driver_of
from sugiyama_ros.nodes.base.samples import Sample
from sugiyama_ros.nodes.base.spin import run_node
from sugiyama_ros.nodes.driver import UNKNOWN, DivergedError, DriverTopics, Follower, shared_topics
from sugiyama_ros.nodes.keeper import Kept, file_of, read_learnt, write_learnt
from sugiyama_ros.nodes.outputs.output import StandardTopics
from sugiyama_ros.road import Road

_RETIRE_EVERY_NS = NS
_NEVER_NS = -(1 << 62)


@dataclass(eq=False)
class FollowedDriver:
    """A driver's filter, what is published of the driver, and the stamp [ns] at which the vehicle was last seen."""

    follower: Follower
    topics: DriverTopics
    seen_ns: int = _NEVER_NS


class FollowingNode(PacedNode):
    """Follows the driver of one vehicle, or every driver in view.

    A late sample is sorted in. A sample whose stamp came before, or that comes too late, is left out. After a jump in
    time, the filters forget where the vehicles are, and keep what they have learnt.

    Parameters of the node: the parameters of a driver, ``model``, ``law``, ``adapt``, ``engine``, ``save_state``,
    ``resume``, ``reorder_window``, and those of `StandardTopics`. Services: ``~/reset``, ``~/add_effect`` and
    ``~/remove_effect``.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.vehicle = self.only_vehicle()
        warm_up()
        self._model = declare_model(self)
        # nobody has the number -1, and so what the model file says of everybody
        self._effects = self._model.rows_of(np.array([-1 if self.vehicle is None else self.vehicle]))[0]
        self._save_state = self.path("save_state", "directory in which to keep what was learnt, for resume")
        self._resume = self.path("resume", "directory with what an earlier run has learnt, to go on from")
        self._online = declare_adapt(self, self._model.rows if self.vehicle is None else self._effects[None])
        declare_driver(self, self._effects)
        check_driver(self)
        window = "time [s] by which a sample may be late and still be sorted in; later ones are dropped"
        self._window_s = float(self.option("reorder_window", WINDOW_S, window, (0.0, 1.0)))
        self._standard = StandardTopics(self)
        self._road: RoadMessage | None = None
        self._arrivals: Arrivals | None = None
        #: The drivers who have a filter now, by the numbers of their vehicles.
        self.drivers: dict[int, FollowedDriver] = {}
        #: What was learnt of drivers before, by the numbers of their vehicles.
        self.known: dict[int, Kept] = {}
        self._counts = new_counts()
        self._failure = ""
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(AddEffect, "~/add_effect", self._on_add_effect)
        self.create_service(RemoveEffect, "~/remove_effect", self._on_remove_effect)
        self.on_clock_jump(self._on_clock_jump)

    def only_vehicle(self) -> int | None:
        """Number of the only vehicle that is followed; None if all are."""
        return None

    def topics_of(self, vehicle: int) -> DriverTopics:
        """Where a driver is published."""
        raise NotImplementedError

    def follow_all(self, sample: Sample, late: bool) -> None:
        """Take in a sample that is next, or late, and publish what follows from it."""
        raise NotImplementedError

    def on_road(self, road: RoadMessage) -> None:
        """Begin with the first road, and anew with another one."""
        known, self._road = self._road, road
        if known is None or (known.circumference_m, known.period_s) != (road.circumference_m, road.period_s):
            self.restart()
        self.announce()

    def take_in(self, sample: Sample) -> None:
        """Do with a sample what its stamp asks for."""
        arrivals = self._arrivals
        assert arrivals is not None, "the feed hands samples over once there is a road"
        arrival = arrivals.judge(sample)
        if arrival is Arrival.JUMPED:
            self._failure = ""
            for driver in self.drivers.values():
                driver.follower.restart()
                driver.topics.restart()
                driver.seen_ns = _NEVER_NS
            if (aside := arrivals.taken_aside()) is not None:
                self.follow_all(aside, late=False)
        if arrival in FOLLOWED:
            self.follow_all(sample, late=arrival is Arrival.LATE)
        self.taken(sample.step + 1, last=self.is_last(sample))

    def is_last(self, sample: Sample) -> bool:
        """Whether a sample is the last one of the recording."""
        return self._road is not None and sample.step + 1 == self._road.steps

    def meet(self, vehicle: int, kept: Kept | None) -> FollowedDriver:
        """Follow one more driver, of whom an earlier run may have learnt something."""
        follower, topics = self._follower_of(vehicle, kept), self.topics_of(vehicle)
        topics.choose_parameters(self._effects, follower.filter)
        driver = self.drivers[vehicle] = FollowedDriver(follower, topics)
        return driver

    def follow(self, driver: FollowedDriver, sample: Sample, late: bool) -> None:
        """Take in a sample, and publish what follows from it about one driver."""
        topics, stamp_ns, vehicle = driver.topics, sample.stamp_ns, driver.follower.vehicle
        try:
            estimate = driver.follower.sort_in(sample) if late else driver.follower.follow(sample)
        except Exception as error:
            estimate = UNKNOWN
            if isinstance(error, DivergedError):
                driver.follower = self._follower_of(vehicle, None)
                driver.follower.stamp_ns = stamp_ns
                topics.choose_parameters(self._effects, driver.follower.filter)
                topics.restart()
            if not self._failure:
                self._failure = f"vehicle {vehicle} at {stamp_ns / NS:.3f} s: {error!r}"
                self.get_logger().error(self._failure)
        driver.seen_ns = max(driver.seen_ns, stamp_ns)
        if estimate is None:
            return
        filter_ = driver.follower.filter
        change = filter_.change_of_style
        self._counts["changes of style"] += change is not None
        topics.publish_estimate(stamp_ns, estimate, change)
        if not late:
            self._standard.publish(self._lane, driver.follower, estimate, stamp_ns, self.space_of(vehicle))
        topics.publish_parameters(stamp_ns, filter_, self.vehicle is not None and self.is_last(sample))

    def space_of(self, vehicle: int) -> str:
        """Namespace of a driver's own topics within that of the node."""
        return f"vehicle_{vehicle:02}/" if self.vehicle is None else ""

    def restart(self) -> None:
        """Start all filters anew, from the node's parameters and what was learnt before."""
        if self._road is None:
            return
        self._lane = Road(self._road.circumference_m)
        self._arrivals = Arrivals(self._road.period_s, self._window_s, self._counts)
        self.drivers.clear()
        self._failure = ""

    def begin_anew(self) -> None:
        """Forget everything, also what an earlier run has learnt."""
        self.known.clear()
        self.restart()

    def keep(self, vehicle: int, kept: Kept) -> None:
        """Save what was learnt of a driver, if there is a directory for it."""
        if self._save_state is not None:
            try:
                write_learnt(file_of(self._save_state, vehicle), kept)
            except SugiyamaError as error:
                self.failure = error

    def _follower_of(self, vehicle: int, kept: Kept | None) -> Follower:
        """A new filter: from the parameters of the node, or those that the model file has for one of all drivers."""
        assert self._road is not None
        row = self._effects.copy()
        row[: len(NAMES)] = driver_of(self)
        if self.vehicle is None and vehicle in self._model.vehicle:
            row[: len(NAMES)] = self._model.rows_of(np.array([vehicle]))[0, : len(NAMES)]
        filter_ = self._online.filter_of(self._road.period_s, self._lane, row, self._standard.vehicles)
        return Follower(vehicle, filter_, kept, self._counts, self._window_s)

    def _on_clock_jump(self) -> None:
        if self._arrivals is not None:
            self._arrivals.clock_has_jumped()

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.begin_anew()
        response.success = self._road is not None
        response.message = "" if response.success else "no road yet"
        return response

    def _on_add_effect(self, request: AddEffect.Request, response: AddEffect.Response) -> AddEffect.Response:
        try:
            values = named_values(f"effect {request.effect}", request.name, request.value)
            self._take_effects(switched_on(self._effects, request.effect, values))
            response.success = True
        except (InputError, ValueError) as error:
            response.message = str(error)
        return response

    def _on_remove_effect(
        self, request: RemoveEffect.Request, response: RemoveEffect.Response
    ) -> RemoveEffect.Response:
        if request.effect in active(self._effects):
            without = self._effects.copy()
            without[ROW.places[request.effect]] = 0.0
            self._take_effects(without)
            response.success = True
        else:
            response.message = str(RefusedError(f"effect {request.effect!r}: is not in the model"))
        return response

    def _take_effects(self, effects: Array) -> None:
        """Go on with other effects (WIDTH,), and keep what was learnt about the drivers."""
        for driver in self.drivers.values():
            driver.follower.change(effects)
            driver.topics.choose_parameters(effects, driver.follower.filter)
        self._effects = effects


class DriversNode(LifecycleNodeMixin, FollowingNode):
    """Follows every vehicle of the topic ``measured``, and publishes all drivers in one message, ``drivers``.

    A driver's filter is made at first sight, and retired some time after the last. All names are relative, so they can
    be remapped, and the node works in any namespace. The node configures and activates itself, unless ``autostart`` is
    false: then a lifecycle manager does.

    More parameters of the node: ``retire_after``, ``most_drivers``, ``vehicle_topics`` and ``autostart``. A driver who
    is in ``model`` starts from there, and others from the parameters of the node.
    """

    def __init__(self, **options: Any) -> None:
        FollowingNode.__init__(self, "drivers", **options)
        LifecycleNodeMixin.__init__(self)
        self.guard_services()
        retire = "time [s] after the last sight of a vehicle at which its driver's filter is retired"
        self._retire_after_ns = round(self.option("retire_after", 5.0, retire, (0.0, 3600.0)) * NS)
        self._most = self.option("most_drivers", 1000, "drivers in view, at most", (1, 100_000))
        own = "whether each driver has topics of their own, not `drivers`"
        self._has_vehicle_topics = bool(self.option("vehicle_topics", False, own))
        autostart = self.option("autostart", True, "whether the node configures and activates itself")
        self._feed: RoadFeed | None = None
        self._is_active = False
        self._retired_ns = 0
        # vehicles of the last sample that are not followed, because there are too many
        self._left_out: set[int] = set()
        self._visits: dict[str, int] = {}
        if autostart:
            self.trigger_configure()
            self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe, and offer the topics of all drivers, so that a recorder hears them from the first message on."""
        self._feed = RoadFeed(self, str)
        self._feed.hand_to(self)
        if not self._has_vehicle_topics:
            self._feed.offer_drivers()
            for kind, topic in shared_topics(self._model.types):
                self.stream(kind, topic)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Follow the vehicles from now on."""
        self._is_active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave out all samples until the node is active again. The drivers stay known."""
        self._is_active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save what was learnt, and forget the drivers and the road."""
        self._retire()
        if self._feed is not None:
            self._feed.close()
        self._feed, self._road, self._arrivals = None, None, None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save what was learnt."""
        self._is_active = False
        self._retire()
        return TransitionCallbackReturn.SUCCESS

    def health(self) -> Health:
        """ERROR after a failure of a filter, WARN without a road, or with more drivers in view than are followed."""
        if self._failure:
            return Health(ERROR, self._failure, self._counts)
        if not self._is_active:
            return Health(OK, "not active", self._counts)
        if self._arrivals is None:
            return Health(WARN, f"waiting for a road on {self.resolve_topic_name('road')}", self._counts)
        if self._arrivals.stamp_ns is None:
            return Health(WARN, f"nothing heard on {self.resolve_topic_name('measured')} yet", self._counts)
        values = {**self._counts, **self._arrivals.rhythm, **self._visits, "drivers": len(self.drivers)}
        if self._left_out:
            most = f"{len(self._left_out)} vehicles are not followed: there are more than most_drivers, {self._most}"
            return Health(WARN, most, values)
        return Health(OK, f"following {len(self.drivers)} drivers", values)

    def take_in(self, sample: Sample) -> None:
        """Do with a sample what its stamp asks for, if the node is active."""
        if self._is_active:
            super().take_in(sample)

    def finish(self) -> None:
        """Keep what was learnt, and send nothing more."""
        self._is_active = False
        self._retire()
        super().finish()

    def restart(self) -> None:
        """Forget all drivers; what a file has learnt of them is read again."""
        self.known.clear()
        super().restart()
        self._retired_ns, self._visits = 0, {"came": 0, "came again": 0, "retired": 0}
        self._left_out.clear()

    def topics_of(self, vehicle: int) -> DriverTopics:
        """Publish the driver in one message with the others, or on topics of their own."""
        own = self._has_vehicle_topics
        feed, space = (None, self.space_of(vehicle)) if own else (self._feed, "")
        return DriverTopics(self, vehicle, self._model.types, feed, space)

    def follow_all(self, sample: Sample, late: bool) -> None:
        """Take in a sample, and publish what follows from it about each of its vehicles."""
        self._left_out.clear()
        for vehicle in sample.place:
            driver = self.drivers.get(vehicle)
            if driver is None and late:
                continue
            if driver is None and len(self.drivers) >= self._most:
                self._left_out.add(vehicle)
                continue
            self.follow(driver or self._come(vehicle), sample, late)
        if self._failure:
            self.report_if_worse()
        if abs(sample.stamp_ns - self._retired_ns) >= _RETIRE_EVERY_NS:
            self._retired_ns = sample.stamp_ns
            self._retire(sample.stamp_ns - self._retire_after_ns)

    def _come(self, vehicle: int) -> FollowedDriver:
        """Follow a driver who may have been here before. A damaged file of an earlier run is told, and not used."""
        kept = self.known.pop(vehicle, None)
        file = file_of(self._resume, vehicle) if self._resume is not None else None
        if kept is None and file is not None and file.exists():
            try:
                kept = read_learnt(file)
            except InputError as error:
                self.get_logger().warning(str(error))
        self._visits["came" if kept is None else "came again"] += 1
        return self.meet(vehicle, kept)

    def _retire(self, before_ns: int | None = None) -> None:
        """Retire drivers who were last seen before a stamp [ns], or all drivers, and keep what was learnt of them."""
        for vehicle in [v for v, one in self.drivers.items() if before_ns is None or one.seen_ns < before_ns]:
            driver = self.drivers.pop(vehicle)
            driver.topics.close()
            self._standard.retire(vehicle, self.space_of(vehicle))
            self._visits["retired"] += 1
            # without a stamp, nobody has seen the vehicle since time has jumped
            self.known[vehicle] = Kept(driver.follower.filter.learnt, driver.follower.stamp_ns or 0)
            self.keep(vehicle, self.known[vehicle])


if __name__ == "__main__":
    run_node(DriversNode)
