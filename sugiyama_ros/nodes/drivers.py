"""The node that follows drivers: samples in; state, innovation and parameters of each driver out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import compress
from typing import Any

import numpy as np
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import DriverArray, DriverParameters, DriverType, Innovation, StyleChange, VehicleState
from sugiyama_msgs.msg import Road as RoadMessage
from sugiyama_msgs.srv import AddEffect, RemoveEffect

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import NAMES, V_STAR
from sugiyama_ros.effects.registry import ROW, active, switched_on
from sugiyama_ros.errors import InputError, SugiyamaError
from sugiyama_ros.files import make_directory
from sugiyama_ros.filters.goals import GoalFilter
from sugiyama_ros.filters.online import Estimate, OnlineFilter, warm_up
from sugiyama_ros.fit.model_file import ModelFile
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.formats.truth import namespace
from sugiyama_ros.laws.registry import name_of
from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.cdr_messages import NS, KnownDriver, ParameterNames, time_message
from sugiyama_ros.nodes.base.feed import FOLLOWED, WINDOW_S, Arrival, Arrivals, RoadFeed, new_counts
from sugiyama_ros.nodes.base.incoming import RefusedError, named_values
from sugiyama_ros.nodes.base.node import ERROR, OK, WARN, Health, PacedNode
from sugiyama_ros.nodes.base.parameters import check_driver, declare_adapt, declare_driver, declare_model, driver_of
from sugiyama_ros.nodes.base.qos import KEPT_STREAM, LATCHED, STREAM
from sugiyama_ros.nodes.base.samples import Sample
from sugiyama_ros.nodes.follower import UNKNOWN, DivergedError, Follower
from sugiyama_ros.nodes.keeper import Kept, file_of, kept_in, read_learnt, write_learnt
from sugiyama_ros.nodes.outputs import StandardTopics
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.desired_speed import largest_v_star

_RETIRE_EVERY_NS = _PARAMETERS_EVERY_NS = NS
_SAVE_EVERY_NS = 10 * NS
# Time [s] in which a keeper may answer.
_PATIENCE_S = 5.0
_NEVER_NS = -(1 << 62)
# Stands for every vehicle in view in the parameter ``vehicles``.
_EVERYBODY = -1


@dataclass(eq=False)
class _Followed:
    """A driver who is followed: row (WIDTH,) of the start, and stamps [ns] of the last sight and the last saving."""

    row: Array
    follower: Follower
    topics: "_Topics"
    seen_ns: int = _NEVER_NS
    saved_ns: int | None = None


@dataclass(eq=False)
class Told:
    """What was told of a driver.

    follows: whether the vehicle ever had a leader; scored, squares_m2, nis: number of samples that count, and sums of
    the squared innovations [m^2] and of their nis; value, identified: parameters by their names, as they were last
    published, and names of those that the samples determine.
    """

    follows: bool = False
    scored: int = 0
    squares_m2: float = 0.0
    nis: float = 0.0
    value: dict[str, float] = field(default_factory=dict)
    identified: tuple[str, ...] = ()


class DriversNode(LifecycleNodeMixin, PacedNode):
    """Follows the drivers of some vehicles, whether they are in view or not, or every driver in view.

    A driver in view gets a filter at first sight, which is retired some time after the last. A vehicle that is
    ``controlled`` has no driver. A late sample is sorted in. A sample whose stamp came before, or that comes too late,
    is left out. After a jump in time, the filters forget where the vehicles are, and keep what they have learnt. The
    node configures and activates itself, unless ``autostart`` is false: then a lifecycle manager does.

    Parameters of the node: ``vehicles``; the parameters of a driver, ``model`` and ``law``, of which a parameter that
    is given or set holds for all drivers; ``adapt``, ``engine``, ``save_state``, ``resume``, ``ask_keeper``,
    ``reorder_window``, ``retire_after``, ``most_drivers``, ``vehicle_topics``, ``autostart``, and those of
    `StandardTopics`. Services: ``~/reset``, ``~/add_effect`` and ``~/remove_effect``.
    """

    def __init__(self, **options: Any) -> None:
        PacedNode.__init__(self, "drivers", **options)
        LifecycleNodeMixin.__init__(self)
        self.guard_services()
        warm_up()
        some = f"numbers of the vehicles to follow, in view or not; {_EVERYBODY}: every vehicle in view"
        self._only = self.vehicles("vehicles", some)
        self._model = declare_model(self)
        typical = self._model.rows_of(np.array([_EVERYBODY]))[0]
        self._usual = typical[: len(NAMES)]
        self._save_state = self.path("save_state", "directory in which to keep what was learnt, for resume")
        if self._save_state is not None:
            make_directory(self._save_state)
        self._resume = self.path("resume", "directory with what an earlier run has learnt, to go on from")
        if self._resume is not None and not self._resume.is_dir():
            raise InputError(f"resume: {self._resume} is no directory; give one that save_state has named")
        asks = self.option("ask_keeper", False, "whether to go on from what the keeper has last heard of vehicles")
        self._asked = set(self._only if asks else ())
        rows = self._model.rows_of(np.array(self._only)) if self._only else self._model.rows
        self._online = declare_adapt(self, rows, self._model)
        declare_driver(self, self._usual)
        check_driver(self)
        window = "time [s] by which a sample may be late and still be sorted in; later ones are dropped"
        self._window_s = float(self.option("reorder_window", WINDOW_S, window, (0.0, 1.0)))
        retire = "time [s] after the last sight of a vehicle at which its driver's filter is retired"
        self._retire_after_ns = round(self.option("retire_after", 5.0, retire, (0.0, 3600.0)) * NS)
        self._most = self.option("most_drivers", 1000, "drivers in view, at most", (1, 100_000))
        own = "whether each driver has topics of their own, such as vehicle_07/state, not `drivers`"
        self._has_vehicle_topics = bool(self.option("vehicle_topics", False, own))
        self._standard = StandardTopics(self)
        autostart = self.option("autostart", True, "whether the node configures and activates itself")
        self._feed: RoadFeed | None = None
        self._is_active = False
        self._road: RoadMessage | None = None
        self._arrivals: Arrivals | None = None
        #: The drivers who have a filter now, by the numbers of their vehicles.
        self.drivers: dict[int, _Followed] = {}
        #: What was learnt of drivers before, by the numbers of their vehicles.
        self.known: dict[int, Kept] = {}
        # effects that were added with their values, or removed (None)
        self._changes: dict[str, Mapping[str, float] | None] = {}
        self._topics: dict[int, _Topics] = {}
        self._told_of: dict[int, Told] = {}
        self._counts, self._visits = new_counts(), {"came": 0, "came again": 0, "retired": 0}
        self._failure = ""
        self._retired_ns = 0
        # vehicles of the last sample that are not followed, because there are too many
        self._left_out: set[int] = set()
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(AddEffect, "~/add_effect", self._on_add_effect)
        self.create_service(RemoveEffect, "~/remove_effect", self._on_remove_effect)
        self.on_clock_jump(self._on_clock_jump)
        self.add_post_set_parameters_callback(self._on_set)
        if autostart:
            self.trigger_configure()
            self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe, and offer the topics that are known by now, so that a recorder hears them from the beginning."""
        self._feed = RoadFeed(self, self._on_road, self._take_in)
        if not self._has_vehicle_topics:
            self.stream(DriverArray, "drivers")
            for kind, topic in _shared_topics(self._model):
                self.stream(kind, topic)
        for vehicle in self._only:
            self._topics[vehicle] = self._topics_of(vehicle)
        if self._asked:
            self._feed.hold()
            for vehicle in self._asked:
                topic = f"{namespace(vehicle)}/_kept_parameters"
                self.listen(DriverParameters, topic, self._on_kept, LATCHED)
            self._patience = self.create_timer(_PATIENCE_S, lambda: self._go_on(), clock=self.steady)
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
        self._retire(list(self.drivers))
        if self._feed is not None:
            self._feed.close()
        self._feed, self._road, self._arrivals = None, None, None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save what was learnt."""
        self._is_active = False
        self._save_all()
        return TransitionCallbackReturn.SUCCESS

    def health(self) -> Health:
        """ERROR after a failure of a filter; WARN without a road or a position, or with too many drivers in view."""
        if self._failure:
            return Health(ERROR, self._failure, self._counts)
        if not self._is_active:
            return Health(OK, "not active", self._counts)
        if self._arrivals is None:
            return Health(WARN, f"waiting for a road on {self.resolve_topic_name('road')}", self._counts)
        if self._arrivals.stamp_ns is None:
            return Health(OK, f"ready; nothing heard on {self.resolve_topic_name('measured')} yet", self._counts)
        values = {**self._counts, **self._arrivals.rhythm, **self._visits, "drivers": len(self.drivers)}
        if self._left_out:
            most = f"{len(self._left_out)} vehicles are not followed: there are more than most_drivers, {self._most}"
            return Health(WARN, most, values)
        missing = [(v, n) for v in self._only if v in self.drivers and (n := self.drivers[v].follower.missing_in_a_row)]
        if missing:
            vehicle, number = max(missing, key=lambda one: one[1])
            others = f", and of {len(missing) - 1} others" if len(missing) > 1 else ""
            return Health(WARN, f"vehicle {vehicle}: {number} samples missing in a row{others}", values)
        return Health(OK, f"following {len(self.drivers)} drivers", values)

    def finish(self) -> None:
        """Keep what was learnt, and send nothing more."""
        self._is_active = False
        self._save_all()
        super().finish()

    @property
    def told(self) -> dict[int, Told]:
        """What was told of each driver so far, by the numbers of their vehicles."""
        for topics in self._topics.values():
            topics.note()
        return self._told_of

    def _on_road(self, road: RoadMessage) -> None:
        """Begin with the first road, and anew with another one."""
        before, self._road = self._road, road
        if before is None or (before.circumference_m, before.period_s) != (road.circumference_m, road.period_s):
            if before is not None:
                self.known.clear()
            self._restart()
        self.announce()

    def _take_in(self, sample: Sample) -> None:
        """Do with a sample what its stamp asks for, if the node is active."""
        if not self._is_active:
            return
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
                self._follow_all(aside, late=False)
        if arrival in FOLLOWED:
            self._follow_all(sample, late=arrival is Arrival.LATE)
        self.taken(sample.step + 1, last=self._is_last(sample))

    def _is_last(self, sample: Sample) -> bool:
        """Whether a sample is the last one of the recording."""
        return self._road is not None and sample.step + 1 == self._road.steps

    def _follow_all(self, sample: Sample, late: bool) -> None:
        """Take in a sample that is next, or late, and publish what follows from it about each driver."""
        self._left_out.clear()
        known, missing = [], False
        controlled = self._feed.controlled if self._feed is not None else frozenset()
        for vehicle in self._only or sample.place:
            if vehicle in controlled:
                continue
            driver = self.drivers.get(vehicle)
            if driver is None and late:
                continue
            if driver is None and len(self.drivers) >= self._most:
                self._left_out.add(vehicle)
                continue
            driver = driver or self._meet(vehicle)
            if (what := self._follow(driver, sample, late)) is not None:
                known.append(what)
            missing |= driver.follower.missing_in_a_row > 0
        if known:
            self.send(self.stream(DriverArray, "drivers"), cdr_messages.driver_array(sample.stamp_ns, known))
        if not self._only and abs(sample.stamp_ns - self._retired_ns) >= _RETIRE_EVERY_NS:
            self._retired_ns = sample.stamp_ns
            before_ns = sample.stamp_ns - self._retire_after_ns
            self._retire([v for v, driver in self.drivers.items() if driver.seen_ns < before_ns])
        if missing or self._failure or self._left_out:
            self.report_if_worse()

    def _follow(self, driver: _Followed, sample: Sample, late: bool) -> KnownDriver | None:
        """Take in a sample, and publish what follows from it about one driver; return it for the message of all."""
        stamp_ns, vehicle, topics = sample.stamp_ns, driver.follower.vehicle, driver.topics
        try:
            estimate = driver.follower.sort_in(sample) if late else driver.follower.follow(sample)
        except Exception as error:
            estimate = UNKNOWN
            if isinstance(error, DivergedError):
                driver.follower = self._follower_of(vehicle, driver.row, None)
                driver.follower.stamp_ns = stamp_ns
                topics.show(driver.row, driver.follower.filter)
            if not self._failure:
                self._failure = f"vehicle {vehicle} at {stamp_ns / NS:.3f} s: {error!r}"
                self.get_logger().error(self._failure)
        driver.seen_ns = max(driver.seen_ns, stamp_ns)
        if not topics.told.follows and (place := sample.place.get(vehicle)) is not None:
            topics.told.follows = sample.leader[place] >= 0
        if estimate is None:
            return None
        change = driver.follower.filter.change_of_style
        self._counts["changes of style"] += change is not None
        known = topics.publish(stamp_ns, estimate, change, self._is_last(sample))
        if not late:
            self._standard.publish(self._lane, driver.follower, estimate, stamp_ns)
            if driver.saved_ns is None:
                driver.saved_ns = stamp_ns
            elif not 0 <= stamp_ns - driver.saved_ns < _SAVE_EVERY_NS:
                driver.saved_ns = stamp_ns
                self._save(driver.follower)
        return known

    def _restart(self) -> None:
        """Start all filters anew, from the node's parameters and what was learnt before."""
        if self._road is None:
            return
        self._lane = Road(self._road.circumference_m)
        self._arrivals = Arrivals(self._road.period_s, self._window_s, self._counts)
        self._retired_ns, self._failure = 0, ""
        self._visits = dict.fromkeys(self._visits, 0)
        self.drivers.clear()
        for vehicle in self._only:
            self._meet(vehicle)

    def _on_set(self, parameters: list[Parameter]) -> None:
        if any(parameter.name in NAMES for parameter in parameters):
            self._begin_anew()

    def _begin_anew(self) -> None:
        """Forget everything, also what an earlier run has learnt."""
        self.known.clear()
        self._resume = None
        self._restart()

    def _meet(self, vehicle: int) -> _Followed:
        """Follow a driver who may have been here before. A damaged file of an earlier run is told, and not used."""
        kept = self.known.get(vehicle)
        file = file_of(self._resume, vehicle) if self._resume is not None else None
        if kept is None and file is not None and file.exists():
            try:
                kept = read_learnt(file)
            except InputError as error:
                self.get_logger().warning(str(error))
        self._visits["came" if kept is None else "came again"] += 1
        if vehicle not in self._topics:
            self._topics[vehicle] = self._topics_of(vehicle)
        row = self._row_of(vehicle)
        driver = _Followed(row, self._follower_of(vehicle, row, kept), self._topics[vehicle])
        driver.topics.show(row, driver.follower.filter)
        self.drivers[vehicle] = driver
        return driver

    def _topics_of(self, vehicle: int) -> "_Topics":
        space = f"{namespace(vehicle)}/" if self._has_vehicle_topics else ""
        return _Topics(self, vehicle, self._model, space, self._told_of.setdefault(vehicle, Told()))

    def _row_of(self, vehicle: int) -> Array:
        """Row (WIDTH,) of a driver: what the model says, with the parameters that were given, and changed effects."""
        row = self._model.rows_of(np.array([vehicle]), "" if self._road is None else self._road.sha256)[0]
        given = driver_of(self)
        row[: len(NAMES)] = np.where(given == self._usual, row[: len(NAMES)], given)
        for effect, values in self._changes.items():
            row = _changed(row, effect, values)
        return row

    def _follower_of(self, vehicle: int, row: Array, kept: Kept | None) -> Follower:
        assert self._road is not None
        filter_ = self._online.filter_of(self._road.period_s, self._lane, row, self._standard.vehicles)
        return Follower(vehicle, filter_, self._road.period_s, kept, self._counts, self._window_s)

    def _retire(self, vehicles: list[int]) -> None:
        """Retire some drivers, and keep what was learnt of them."""
        for vehicle in vehicles:
            follower = self.drivers.pop(vehicle).follower
            topics = self._topics.pop(vehicle)
            topics.note()
            topics.close()
            self._standard.retire(vehicle)
            self._visits["retired"] += 1
            self.known[vehicle] = self._save(follower)

    def _save(self, follower: Follower) -> Kept:
        """What was learnt of a driver; it is saved, if there is a directory for it."""
        # without a stamp, nobody has seen the vehicle since time has jumped
        kept = Kept(follower.filter.learnt, follower.stamp_ns or 0)
        if self._save_state is not None:
            try:
                write_learnt(file_of(self._save_state, follower.vehicle), kept)
            except SugiyamaError as error:
                self.failure = error
        return kept

    def _save_all(self) -> None:
        for driver in self.drivers.values():
            if driver.follower.stamp_ns is not None:
                self._save(driver.follower)

    def _on_kept(self, message: DriverParameters) -> None:
        """Note the keeper's answer about a driver, and go on after the last one."""
        if message.vehicle not in self._asked:
            return
        self._asked.remove(message.vehicle)
        try:
            self.known[message.vehicle] = kept_in(message)
        except ValueError as error:
            self.refuse("_kept_parameters", error)
        if not self._asked:
            self._go_on()

    def _go_on(self) -> None:
        """Begin with the samples that wait: the keeper has answered, or not in time."""
        self._asked.clear()
        self._patience.cancel()
        self._restart()
        if self._feed is not None:
            self._feed.release()

    def _on_clock_jump(self) -> None:
        if self._arrivals is not None:
            self._arrivals.clock_has_jumped()

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._begin_anew()
        response.success = self._road is not None
        response.message = "" if response.success else "no road yet"
        return response

    def _on_add_effect(self, request: AddEffect.Request, response: AddEffect.Response) -> AddEffect.Response:
        try:
            self._change(request.effect, named_values(f"effect {request.effect}", request.name, request.value))
            response.success = True
        except (InputError, ValueError) as error:
            response.message = str(error)
        return response

    def _on_remove_effect(
        self, request: RemoveEffect.Request, response: RemoveEffect.Response
    ) -> RemoveEffect.Response:
        try:
            self._change(request.effect, None)
            response.success = True
        except (InputError, ValueError) as error:
            response.message = str(error)
        return response

    def _change(self, effect: str, values: Mapping[str, float] | None) -> None:
        """Add an effect to the models of all drivers, or remove it, and keep what was learnt of them.

        Raises InputError, RefusedError.
        """
        rows = [self._row_of(_EVERYBODY), *(driver.row for driver in self.drivers.values())]
        if values is None and not any(effect in active(row) for row in rows):
            raise RefusedError(f"effect {effect!r}: is not in the model")
        _, *changed = [_changed(row, effect, values) for row in rows]
        for driver, row in zip(self.drivers.values(), changed, strict=True):
            driver.follower.change(row)
            driver.row = row
            driver.topics.show(row, driver.follower.filter)
        self._changes[effect] = values


def _changed(row: Array, effect: str, values: Mapping[str, float] | None) -> Array:
    """A driver's row (WIDTH,) with one more effect, or without it. Raises InputError."""
    if values is not None:
        return switched_on(row, effect, values)
    without = row.copy()
    without[ROW.places[effect]] = 0.0
    return without


class _Topics:
    """Publishes what is known of one driver, on topics of their own; or returns it for the message of all drivers.

    space: namespace of the driver's own topics within the node's, such as ``vehicle_07/``; empty where all drivers are
    in one message, and share the topics beside it; told: notes what is published.
    """

    def __init__(self, node: PacedNode, vehicle: int, model: ModelFile, space: str, told: Told) -> None:
        self._node, self._vehicle, self._model, self._space, self.told = node, vehicle, model, space, told
        self._filter: OnlineFilter | None = None
        self._stamp_ns: int | None = None
        # the largest speed [m/s] so far
        self._fastest = 0.0
        self._own: list[str] = []
        if space:
            self._to_state = self._stream(VehicleState, "state")
            self._to_innovation = self._stream(Innovation, "innovation")
            self._to_parameters = self._stream(DriverParameters, "parameters", KEPT_STREAM)
        self._to_changes, *self._to_type = [self._stream(kind, topic) for kind, topic in _shared_topics(model)]

    def _stream(self, kind: type, topic: str, qos: QoSProfile = STREAM) -> Publisher:
        self._own.append(self._space + topic)
        return self._node.stream(kind, self._space + topic, qos)

    def close(self) -> None:
        """Take down the topics that are the driver's own."""
        if self._space:
            for topic in self._own:
                self._node.end_stream(topic)

    def note(self) -> None:
        """Note the parameters as they were last published."""
        if self._filter is not None:
            self.told.value = dict(zip(self._names.shown, self._value.tolist(), strict=True))
            self.told.identified = tuple(compress(self._names.shown, self._of_all()[1].tolist()))

    def show(self, row: Array, filter_: OnlineFilter) -> None:
        """Publish a filter from now on: the driver's parameters, and those of the law and the effects in a row."""
        law = ROW.law_places.get(name_of(float(filter_.parameters[ROW.law])), slice(0))
        blocks = [law, *(ROW.places[name] for name in active(row))]
        shown = [*range(len(NAMES)), *(k for block in blocks for k in range(ROW.width)[block])]
        names = [ROW.entries[k] for k in shown]
        self._shown, self._adapted = (
            np.array(shown),
            np.array([names.index(name) for name in filter_.adapted], np.int64),
        )
        self._v_star = filter_.adapted.index("v_star") if "v_star" in filter_.adapted else None
        self._names = ParameterNames(tuple(names), filter_.adapted)
        self._filter = filter_
        self._read(filter_)
        self.restart()

    def restart(self) -> None:
        """Publish the parameters with the next sample, whatever its stamp."""
        self._stamp_ns = None

    def publish(
        self, stamp_ns: int, estimate: Estimate, change: tuple[str, float] | None, is_last: bool
    ) -> KnownDriver | None:
        """Publish the estimate, a change of style (name and factor), and once a second of the data the parameters."""
        send, vehicle, filter_, told, known = self._node.send, self._vehicle, self._filter, self.told, None
        assert filter_ is not None, "a driver who is published has a filter"
        self._fastest = max(self._fastest, estimate.speed)
        is_due = is_last or self._stamp_ns is None or stamp_ns - self._stamp_ns >= _PARAMETERS_EVERY_NS
        if is_due or not self._space:
            self._read(filter_)
        if estimate.scored:
            told.scored += 1
            told.squares_m2 += estimate.innovation_m**2
            told.nis += estimate.nis
        if self._space:
            send(self._to_state, cdr_messages.state(stamp_ns, vehicle, estimate))
            send(self._to_innovation, cdr_messages.innovation(stamp_ns, vehicle, estimate))
        else:
            known = KnownDriver(vehicle, estimate, self._names, self._value, self._covariance, self._identified)
        if change is not None:
            message = StyleChange(vehicle=vehicle, name=change[0], factor=change[1])
            message.header.stamp, message.header.frame_id = time_message(stamp_ns), FRAME
            send(self._to_changes, message)
        if is_due:
            self._stamp_ns = stamp_ns
            if self._space:
                numbers = self._value, *self._of_all()
                send(self._to_parameters, cdr_messages.parameters(stamp_ns, vehicle, self._names, *numbers))
            if self._to_type:
                of_type, types, goals = DriverType(vehicle=vehicle), self._model.types, self._model.goals
                if types is not None:
                    of_type.probability = types.probabilities(filter_.learnt, filter_.prior).tolist()
                if goals is not None and isinstance(filter_, GoalFilter):
                    of_type.goals, of_type.goal_probability = goals.names, filter_.goal_probability.tolist()
                of_type.header.stamp, of_type.header.frame_id = time_message(stamp_ns), FRAME
                send(self._to_type[0], of_type)
        return known

    def _read(self, filter_: OnlineFilter) -> None:
        """Read what the filter knows. A desired speed beyond what these speeds can tell is not identified."""
        self._value, self._covariance = filter_.parameters[self._shown], filter_.adapted_covariance
        self._identified = filter_.is_identified
        if self._v_star is not None and self._value[V_STAR] > largest_v_star(self._fastest):
            self._identified[self._v_star] = False

    def _of_all(self) -> tuple[Array, Mask]:
        """Return the covariance of all that is shown, 0 where it is not adapted, and what of it is identified."""
        count = len(self._shown)
        covariance, identified = np.zeros((count, count)), np.zeros(count, np.bool_)
        covariance[np.ix_(self._adapted, self._adapted)] = self._covariance
        identified[self._adapted] = self._identified
        return covariance, identified


def _shared_topics(model: ModelFile) -> list[tuple[type, str]]:
    """Classes and names of the topics that each driver has also where they are in one message with other drivers."""
    return [(StyleChange, "style_change"), *([(DriverType, "driver_type")] if model.types or model.goals else [])]
