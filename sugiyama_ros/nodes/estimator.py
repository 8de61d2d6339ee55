"""One driver's estimator: measured positions in; state, innovation and parameters out."""

import re
from collections import deque
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import DriverParameters
from sugiyama_msgs.msg import Road as RoadMessage
from sugiyama_msgs.srv import AddEffect, RemoveEffect

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.errors import InputError, SugiyamaError
from sugiyama_ros.filters.online import OnlineFilter, warm_up
from sugiyama_ros.nodes.arrivals import FOLLOWED, Arrival, Arrivals, new_counts
from sugiyama_ros.nodes.base import incoming
from sugiyama_ros.nodes.base.cdr_messages import NS, Sample
from sugiyama_ros.nodes.base.measured_feed import MeasuredFeed, subscribe_measured
from sugiyama_ros.nodes.base.node import ERROR, OK, WARN, Health, PacedNode
from sugiyama_ros.nodes.base.qos import DEPTH, LATCHED
from sugiyama_ros.nodes.base.spin import run_node
from sugiyama_ros.nodes.driver_array import DriverArrayTopic
from sugiyama_ros.nodes.driver_parameters import (
    check_driver,
    declare_adapt,
    declare_driver,
    declare_model,
    declare_path,
    declare_window,
)
from sugiyama_ros.nodes.driver_topics import DriverTopics
from sugiyama_ros.nodes.effect_services import add_effect, remove_effect
from sugiyama_ros.nodes.follower import UNKNOWN, DivergedError, Follower
from sugiyama_ros.nodes.outputs.registry import StandardTopics
from sugiyama_ros.nodes.saved_state import Kept, file_of, kept_in, read_learnt, write_learnt
from sugiyama_ros.road import Road

# Time [s] in which a keeper may answer.
_PATIENCE_S = 5.0
_SAVED_EVERY_NS = 10 * NS


class Estimator(PacedNode):
    """Follows the vehicle of its namespace, ``.../vehicle_07``.

    A late sample is sorted in. A sample whose stamp came before, or that comes too late, is left out. After a jump in
    time, the filter forgets where the vehicles are, and keeps what it has learnt.

    Parameters of the node: the parameters of a driver, ``model``, ``save_state``, ``resume``, ``ask_keeper``,
    ``array_topic``, ``reorder_window`` and ``adapt``. Services: ``~/reset``, ``~/add_effect``, ``~/remove_effect``.

    feed: where the samples come from, if several nodes of the process share one subscription; array: where the driver
    is in one message with the other drivers of the process, if ``array_topic`` asks for it; **options: options of the
    ROS node.
    """

    def __init__(self, feed: MeasuredFeed | None = None, array: DriverArrayTopic | None = None, **options: Any) -> None:
        super().__init__("estimator", **options)
        self.vehicle = self._vehicle_of_namespace()
        warm_up()
        model = declare_model(self)
        row, types = model.rows_of(np.array([self.vehicle]))[0], model.types
        self._save_state = declare_path(self, "save_state", "directory in which to keep what was learnt, for resume")
        resume = declare_path(self, "resume", "directory with what an earlier run has learnt, to go on from")
        saved = file_of(resume, self.vehicle) if resume is not None else None
        # nothing is known of a vehicle that was not there before
        self.kept: Kept | None = read_learnt(saved) if saved is not None and saved.exists() else None
        self._is_asking = self._declare_flag("ask_keeper", "whether to go on from what the keeper has last heard")
        in_array = self._declare_flag(
            "array_topic", "whether to publish on `drivers`, in one message with other drivers"
        )
        if self._is_asking:
            self.listen(DriverParameters, "_kept_parameters", incoming.parameters, self._on_kept, LATCHED)
            self._patience = self.create_timer(_PATIENCE_S, lambda: self._on_kept(), clock=self.steady)
        declare_driver(self, row)
        check_driver(self)
        self._window_s, self._adapted = declare_window(self), declare_adapt(self, row[None])
        self._standard = StandardTopics(self)
        self.add_post_set_parameters_callback(lambda _: self._begin_anew())
        self._effects = row
        self._road: RoadMessage | None = None
        self._follower: Follower | None = None
        self._arrivals: Arrivals | None = None
        self._waiting: deque[Sample] = deque(maxlen=DEPTH)
        self._saved_ns: int | None = None
        self._failure = ""
        self._counts = new_counts()
        self._topics = DriverTopics(self, self.vehicle, types, (array or DriverArrayTopic()) if in_array else None)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(AddEffect, "~/add_effect", self._on_add_effect)
        self.create_service(RemoveEffect, "~/remove_effect", self._on_remove_effect)
        self.hear(RoadMessage, self.shared("road"), incoming.road, self._on_road, LATCHED)
        subscribe_measured(self, self.take_in, feed)
        self.on_clock_jump(self._on_clock_jump)

    @property
    def filter(self) -> OnlineFilter | None:
        """The driver's filter; None before the road is known."""
        return self._follower.filter if self._follower is not None else None

    @property
    def stamp_ns(self) -> int | None:
        """Stamp [ns] of the last sample that was taken in."""
        return self._follower.stamp_ns if self._follower is not None else None

    def health(self) -> Health:
        """ERROR after a failure of the filter, WARN without a road or a position."""
        if self._failure:
            return Health(ERROR, self._failure, self._counts)
        if self._road is None or self._follower is None or self._arrivals is None:
            return Health(WARN, f"waiting for a road on {self.shared('road')}", self._counts)
        if self._arrivals.stamp_ns is None:
            return Health(OK, f"ready; nothing heard on {self.shared('measured')} yet", self._counts)
        values = {**self._counts, **self._arrivals.rhythm}
        if self._follower.missing_in_a_row:
            return Health(WARN, f"{self._follower.missing_in_a_row} samples missing in a row", values)
        unknown = self._topics.not_identified
        return Health(OK, f"following; not yet identified: {', '.join(unknown)}" if unknown else "following", values)

    def take_in(self, sample: Sample) -> None:
        """Take in a sample of the topic ``measured``."""
        self._waiting.append(sample)
        self._go_on()

    def finish(self) -> None:
        """Keep what was learnt, and send nothing more."""
        self._save()
        super().finish()

    def _vehicle_of_namespace(self) -> int:
        """Number of the vehicle. Raises InputError where the namespace has none."""
        found = re.search(r"/vehicle_(\d+)$", self.get_namespace())
        if found is None:
            raise InputError(
                f"estimator: the namespace {self.get_namespace()} names no vehicle; start it with -r __ns:=/vehicle_07"
            )
        return int(found[1])

    def _declare_flag(self, name: str, description: str) -> bool:
        about = ParameterDescriptor(description=description, read_only=True)
        return bool(self.declare_parameter(name, False, about).value)

    def _on_road(self, road: RoadMessage) -> None:
        known = self._road
        self._road = road
        if known is None or (known.circumference_m, known.period_s) != (road.circumference_m, road.period_s):
            self._restart()
        self._go_on()
        self.announce()

    def _on_kept(self, message: DriverParameters | None = None) -> None:
        """Go on from the keeper's answer; without a message, the keeper has not answered in time."""
        if self._is_asking:
            self._is_asking = False
            self._patience.cancel()
            if message is not None:
                try:
                    self.kept = kept_in(message)
                except ValueError as error:
                    self.refuse("_kept_parameters", error)
                self._restart()
            self._go_on()

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._begin_anew()
        response.success = self._follower is not None
        response.message = "" if response.success else "no road yet"
        return response

    def _on_add_effect(self, request: AddEffect.Request, response: AddEffect.Response) -> AddEffect.Response:
        return add_effect(request, response, self._effects, self._take_effects)

    def _on_remove_effect(
        self, request: RemoveEffect.Request, response: RemoveEffect.Response
    ) -> RemoveEffect.Response:
        return remove_effect(request, response, self._effects, self._take_effects)

    def _take_effects(self, effects: Array) -> None:
        """Go on with other effects (WIDTH,), and keep what was learnt about the driver."""
        if self._follower is not None and self.filter is not None:
            self._follower.change(effects)
            self._topics.choose_parameters(effects, self.filter)
        self._effects = effects

    def _begin_anew(self) -> None:
        """Forget everything, also what an earlier run has learnt."""
        self.kept = None
        self._restart()

    def _restart(self) -> None:
        """Start a new filter from the node's parameters and from what an earlier run has learnt."""
        if self._road is None:
            return
        row = self._effects.copy()
        row[: len(NAMES)] = [self.get_parameter(name).value for name in NAMES]
        self._lane = Road(self._road.circumference_m)
        filter_ = self._adapted.filter_of(self._road.period_s, self._lane, row, self._standard.vehicles)
        self._follower = Follower(self.vehicle, filter_, self.kept, self._counts, self._window_s)
        self._arrivals = Arrivals(self._road.period_s, self._window_s, self._counts)
        self._topics.choose_parameters(self._effects, filter_)
        self._forget()

    def _replace_filter(self) -> None:
        """Begin anew with another filter, and go on with the samples. A failure that was told stays."""
        failure, arrivals, self.kept = self._failure, self._arrivals, None
        self._restart()
        self._failure, self._arrivals = failure, arrivals

    def _forget(self) -> None:
        self._topics.restart()
        self._saved_ns = None
        self._failure = ""

    def _on_clock_jump(self) -> None:
        if self._arrivals is not None:
            self._arrivals.clock_has_jumped()

    def _go_on(self) -> None:
        """Take in what waits. A late node may hear samples before the road."""
        while self._waiting and self._arrivals is not None and not self._is_asking:
            self._arrive(self._waiting.popleft(), self._arrivals)

    def _arrive(self, sample: Sample, arrivals: Arrivals) -> None:
        """Do with a sample what its stamp asks for."""
        arrival = arrivals.judge(sample)
        if arrival is Arrival.LEFT_OUT:
            self._topics.publish_estimate(sample.stamp_ns, None, None)
        elif arrival is Arrival.JUMPED:
            assert self._follower is not None
            self._follower.restart()
            self._forget()
            if (aside := arrivals.taken_aside()) is not None:
                self._publish(aside, late=False)
        if arrival in FOLLOWED:
            self._publish(sample, late=arrival is Arrival.LATE)
        self.taken(sample.step + 1, last=self._is_last(sample))

    def _is_last(self, sample: Sample) -> bool:
        return self._road is not None and sample.step + 1 == self._road.steps

    def _publish(self, sample: Sample, late: bool) -> None:
        """Take in a sample and publish what follows from it."""
        follower = self._follower
        assert follower is not None
        try:
            estimate = follower.sort_in(sample) if late else follower.follow(sample)
        except Exception as error:
            if isinstance(error, DivergedError):
                self._replace_filter()
            self._fail(error, sample)
            estimate = UNKNOWN
        change = follower.filter.change_of_style if estimate is not None else None
        self._topics.publish_estimate(sample.stamp_ns, estimate, change)
        if estimate is not None:
            if not late:
                self._standard.publish(self._lane, follower, estimate, sample.stamp_ns, "")
            self._counts["changes of style"] += change is not None
            if self._topics.publish_parameters(sample.stamp_ns, follower.filter, self._is_last(sample)):
                self._save_if_due(sample.stamp_ns)
        if self._failure or follower.missing_in_a_row:
            self.report_if_worse()

    def _save_if_due(self, stamp_ns: int) -> None:
        if self._saved_ns is None:
            self._saved_ns = stamp_ns
        elif stamp_ns - self._saved_ns >= _SAVED_EVERY_NS:
            self._saved_ns = stamp_ns
            self._save()

    def _save(self) -> None:
        if self._save_state is None or self.filter is None or self.stamp_ns is None:
            return
        try:
            write_learnt(file_of(self._save_state, self.vehicle), Kept(self.filter.learnt, self.stamp_ns))
        except SugiyamaError as error:
            self.failure = error

    def _fail(self, error: Exception, sample: Sample) -> None:
        """Log a failure of the filter, once until the next restart."""
        if not self._failure:
            self._failure = f"vehicle {self.vehicle} at {sample.stamp_ns / NS:.3f} s: {error!r}"
            self.get_logger().error(self._failure)


def main() -> None:
    """Run one estimator."""
    run_node(Estimator)


if __name__ == "__main__":
    main()
