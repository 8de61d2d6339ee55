"""One driver's estimator: measured positions in; state, innovation and parameters out."""

import re
from collections import deque
from math import isfinite, isnan, nan
from pathlib import Path
from typing import Any

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import DriverParameters, DriverType, Innovation, MeasuredPositions, StyleChange, VehicleState
from sugiyama_msgs.msg import Road as RoadMessage
from sugiyama_msgs.srv import AddEffect, RemoveEffect

from sugiyama_ros.driver.parameters import NAMES, PARAMETERS, population
from sugiyama_ros.effects.registry import ENTRIES, PLACES, active, effect, switch_on, whole
from sugiyama_ros.errors import InputError, SugiyamaError
from sugiyama_ros.filters.online import NOBODY, Estimate, OnlineFilter, warm_up
from sugiyama_ros.fit.driver_types import DriverTypes
from sugiyama_ros.fit.model_file import read_model
from sugiyama_ros.nodes.base import cdr_messages as wire
from sugiyama_ros.nodes.base.node import ERROR, OK, WARN, Health, PacedNode
from sugiyama_ros.nodes.base.qos import DEPTH, LATCHED, STREAM
from sugiyama_ros.nodes.base.spin import run_node
from sugiyama_ros.nodes.saved_state import Kept, file_of, kept_in, read_learnt, write_learnt
from sugiyama_ros.road import Array, Road

#: A prediction over more periods than this means nothing: the filter starts anew.
_LONGEST_GAP = 100
# A sample that comes at most so many periods late is left out; one from further back says that time has jumped.
_LATE = 3
# Length [m] of a vehicle beyond which it is none.
_LONGEST_M = 1000.0
# Time [s] in which a keeper may answer.
_PATIENCE_S = 5.0
_PARAMETERS_EVERY_NS, _SAVED_EVERY_NS = wire.NS, 10 * wire.NS
#: What is published where nothing is known, so that every topic has a message for every step.
_UNKNOWN = Estimate(
    position_m=nan,
    speed=nan,
    acceleration=nan,
    covariance=np.full((3, 3), nan),
    mean_action=nan,
    gap_m=nan,
    approach_rate=nan,
    innovation_m=nan,
    innovation_var=nan,
    nis=nan,
    log_likelihood=nan,
    scored=False,
)


class Estimator(PacedNode):
    """Follows the vehicle of its namespace, ``.../vehicle_07``.

    A step without a position of the vehicle is predicted over. The stamps tell how many periods have passed; a stamp
    that comes again, or too late, is ignored, a jump in time starts the filter anew.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("estimator", **options)
        found = re.search(r"/vehicle_(\d+)$", self.get_namespace())
        if found is None:
            raise InputError(
                f"estimator: the namespace {self.get_namespace()} names no vehicle; start it with -r __ns:=/vehicle_07"
            )
        self.vehicle = int(found[1])
        warm_up()
        row, self._types = self._start()
        self._save_state = self._directory("save_state", "directory in which to keep what was learnt, for resume")
        resume = self._directory("resume", "directory with what an earlier run learnt, to go on from")
        kept = file_of(resume, self.vehicle) if resume is not None else None
        # of a vehicle that was not there before nothing is known
        self._kept = read_learnt(kept) if kept is not None and kept.exists() else None
        about = ParameterDescriptor(description="whether to go on from what a keeper has last heard", read_only=True)
        self._is_asking = bool(self.declare_parameter("ask_keeper", False, about).value)
        if self._is_asking:
            self.create_subscription(DriverParameters, "_kept_parameters", self._on_kept, LATCHED)
            self._patience = self.create_timer(_PATIENCE_S, self._on_kept, clock=self.steady)
        declare_driver(self, row)
        self.add_post_set_parameters_callback(lambda _: self._begin_anew())
        self._effects = row
        self._road: RoadMessage | None = None
        self._filter: OnlineFilter | None = None
        self._waiting: deque[bytes] = deque(maxlen=DEPTH)
        self._stamp_ns: int | None = None
        self._parameters_ns: int | None = None
        self._saved_ns: int | None = None
        self._missing_in_a_row = 0
        self._unknown: list[str] = []
        self._failure = ""
        self._count = {
            "samples": 0,
            "missing": 0,
            "duplicates": 0,
            "late": 0,
            "resets": 0,
            "skipped": 0,
            "changes of style": 0,
        }
        self._to_state = self.create_publisher(VehicleState, "state", STREAM)
        self._to_innovation = self.create_publisher(Innovation, "innovation", STREAM)
        self._to_changes = self.create_publisher(StyleChange, "style_change", STREAM)
        self._to_parameters = self.create_publisher(DriverParameters, "parameters", STREAM)
        if self._types is not None:
            self._to_type = self.create_publisher(DriverType, "driver_type", STREAM)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(AddEffect, "~/add_effect", self._on_add_effect)
        self.create_service(RemoveEffect, "~/remove_effect", self._on_remove_effect)
        self.create_subscription(RoadMessage, self.shared("road"), self._on_road, LATCHED)
        self.create_subscription(MeasuredPositions, self.shared("measured"), self._on_measured, STREAM, raw=True)

    def _start(self) -> tuple[Array, DriverTypes | None]:
        """The driver's row, and types of drivers, from the model file if one is given; else nothing is known of him."""
        about = ParameterDescriptor(description="model file (YAML) with drivers and effects", read_only=True)
        file = str(self.declare_parameter("model", "", about).value)
        if not file:
            return whole(population()), None
        model = read_model(Path(file))
        return model.rows_of(np.array([self.vehicle]))[0], model.types

    def _directory(self, name: str, description: str) -> Path | None:
        """A directory that a parameter names, if one does."""
        about = ParameterDescriptor(description=description, read_only=True)
        given = str(self.declare_parameter(name, "", about).value)
        return Path(given) if given else None

    def health(self) -> Health:
        """ERROR after a failure of the filter, WARN without a road or a position."""
        if self._failure:
            return Health(ERROR, self._failure, self._count)
        if self._road is None:
            return Health(WARN, "waiting for the road", self._count)
        if self._missing_in_a_row:
            return Health(WARN, f"{self._missing_in_a_row} samples missing in a row", self._count)
        told = f"following; not yet identified: {', '.join(self._unknown)}" if self._unknown else "following"
        return Health(OK, told, self._count)

    def _on_road(self, road: RoadMessage) -> None:
        known = self._road
        self._road = road
        if known is None or (known.circumference_m, known.period_s) != (road.circumference_m, road.period_s):
            self._restart()
        self._go_on()
        self.announce()

    def _on_kept(self, message: DriverParameters | None = None) -> None:
        """The keeper's answer, or none in time."""
        if self._is_asking:
            self._is_asking = False
            self._patience.cancel()
            if message is not None:
                self._kept = kept_in(message)
                self._restart()
            self._go_on()

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._begin_anew()
        response.success = self._filter is not None
        response.message = "" if response.success else "no road yet"
        return response

    def _on_add_effect(self, request: AddEffect.Request, response: AddEffect.Response) -> AddEffect.Response:
        try:
            if len(request.name) != len(request.value):
                raise InputError(f"effect {request.effect}: {len(request.name)} names, {len(request.value)} values")
            values = dict(zip(request.name, request.value, strict=True))
            effects = switch_on(self._effects, request.effect, values)
            if not any(values.get(name) for name in effect(request.effect).switches):
                raise InputError(f"effect {request.effect}: give {' or '.join(effect(request.effect).switches)}")
            self._take_effects(effects)
            response.success = True
        except InputError as error:
            response.message = str(error)
        return response

    def _on_remove_effect(
        self, request: RemoveEffect.Request, response: RemoveEffect.Response
    ) -> RemoveEffect.Response:
        if request.effect in active(self._effects):
            without = self._effects.copy()
            without[PLACES[request.effect]] = 0.0
            self._take_effects(without)
            response.success = True
        else:
            response.message = f"effect {request.effect!r}: is not in the model"
        return response

    def _take_effects(self, effects: Array) -> None:
        """Go on with other effects (WIDTH,), and keep what was learnt of the driver."""
        if self._filter is not None:
            self._filter.change(effects)
        self._effects = effects
        self._show()

    def _show(self) -> None:
        """Publish the driver's parameters, and those of the effects that act."""
        if self._filter is None:
            return
        places = [k for name in active(self._effects) for k in range(PLACES[name].start, PLACES[name].stop)]
        self._shown = [*range(len(NAMES)), *places]
        names = [ENTRIES[k] for k in self._shown]
        self._parameter_bytes = wire.Parameters(self.vehicle, names, self._filter.adapted)

    def _begin_anew(self) -> None:
        """Forget what an earlier run has learnt, too."""
        self._kept = None
        self._restart()

    def _restart(self) -> None:
        """A new filter, from the node's parameters, and from what an earlier run has learnt."""
        if self._road is None:
            return
        row = self._effects.copy()
        row[: len(NAMES)] = [self.get_parameter(name).value for name in NAMES]
        self._filter = OnlineFilter(self._road.period_s, Road(self._road.circumference_m), row)
        if self._kept is not None:
            self._filter.recall(self._kept.learnt)
        self._show()
        self._forget()

    def _forget(self) -> None:
        self._stamp_ns = self._parameters_ns = self._saved_ns = None
        self._chain: list[int] = []
        self._behind = -1
        self._length_m: dict[int, float] = {}
        self._missing_in_a_row = 0
        self._failure = ""

    def _on_measured(self, raw: bytes) -> None:
        self._waiting.append(raw)
        self._go_on()

    def _go_on(self) -> None:
        """Take in what waits: what the road has latched for one who comes late may be heard before the road itself."""
        while self._waiting and self._filter is not None and self._road is not None and not self._is_asking:
            self._take_in(wire.measured(self._waiting.popleft()), self._filter, self._road)

    def _take_in(self, sample: wire.Sample, filter_: OnlineFilter, road: RoadMessage) -> None:
        try:
            estimate = self._follow(sample, filter_)
        except Exception as error:
            self._fail(error, sample)
            estimate = _UNKNOWN
        if estimate is not None:
            self._publish(sample, estimate)
            self._publish_parameters(sample, filter_, road)
        self.taken(sample.step + 1, last=sample.step + 1 == road.steps)
        self.report_if_worse()

    def _follow(self, sample: wire.Sample, filter_: OnlineFilter) -> Estimate | None:
        """Bring the filter to the time of the sample; None if it is there already."""
        periods = 1
        if self._stamp_ns is not None and self._road is not None:
            periods = round((sample.stamp_ns - self._stamp_ns) / (wire.NS * self._road.period_s))
        if periods == 0:
            self._count["duplicates"] += 1
            return None
        if -_LATE <= periods < 0:
            self._count["late"] += 1
            return None
        if not 0 < periods <= _LONGEST_GAP:
            self._count["resets"] += 1
            filter_.reset()
            self._forget()
            periods = 1
        self._stamp_ns = sample.stamp_ns
        self._count["samples"] += 1
        if self.vehicle in sample.place:
            self._chain = sample.chain(self.vehicle, filter_.vehicles)
        if not self._chain:
            self._missing_in_a_row += 1
            return _UNKNOWN
        position, length = [], []
        for vehicle in self._chain:
            place = sample.place.get(vehicle)
            measured = nan if place is None else sample.position_m[place]
            position.append(measured if isfinite(measured) else nan)
            if place is not None and 0.0 <= sample.length_m[place] < _LONGEST_M:
                self._length_m[vehicle] = sample.length_m[place]
            length.append(self._length_m.get(vehicle, 0.0))
        self._missing_in_a_row = self._missing_in_a_row + 1 if isnan(position[0]) else 0
        self._count["missing"] += isnan(position[0])
        time_s = sample.stamp_ns / wire.NS
        for skipped in range(periods - 1, 0, -1):
            self._count["skipped"] += 1
            before_s = time_s - skipped * filter_.period_s
            filter_.step([nan] * len(position), self._chain, length, before_s, (nan, self._behind, 0.0))
        estimate = filter_.step(position, self._chain, length, time_s, self._look_back(sample, filter_))
        if self._kept is not None and self._is_known(sample.stamp_ns, self._kept, filter_.period_s):
            filter_.recall(self._kept.learnt)
        return estimate

    def _is_known(self, stamp_ns: int, kept: Kept, period_s: float) -> bool:
        """Whether an earlier run has learnt from the sample: the road holds the last ones for those who come late."""
        return kept.until_ns - DEPTH * period_s * wire.NS < stamp_ns <= kept.until_ns

    def _look_back(self, sample: wire.Sample, filter_: OnlineFilter) -> tuple[float, int, float]:
        """Position, number and length of the vehicle behind, where the effects need it."""
        if not filter_.looks_back:
            return NOBODY
        if self.vehicle in sample.place:
            self._behind = sample.behind(self.vehicle)
        place = sample.place.get(self._behind)
        if place is None:
            return nan, self._behind, self._length_m.get(self._behind, 0.0)
        self._length_m[self._behind] = sample.length_m[place]
        return sample.position_m[place], self._behind, sample.length_m[place]

    def _publish(self, sample: wire.Sample, estimate: Estimate) -> None:
        self.send(self._to_state, wire.state(sample.stamp_ns, self.vehicle, estimate))
        self.send(self._to_innovation, wire.innovation(sample.stamp_ns, self.vehicle, estimate))
        change = self._filter.change_of_style if self._filter is not None else None
        if change is not None:
            self._count["changes of style"] += 1
            self.send(self._to_changes, wire.style_change(sample.stamp_ns, self.vehicle, *change))

    def _publish_parameters(self, sample: wire.Sample, filter_: OnlineFilter, road: RoadMessage) -> None:
        """Publish the parameters once a second of the data's time, and with the last sample."""
        due = self._parameters_ns is None or sample.stamp_ns - self._parameters_ns >= _PARAMETERS_EVERY_NS
        if not due and sample.step + 1 != road.steps:
            return
        self._parameters_ns = sample.stamp_ns
        shown = self._shown
        value, covariance = filter_.parameters[shown], filter_.parameter_covariance[np.ix_(shown, shown)]
        identified = filter_.identified
        self._unknown = [name for name in filter_.adapted if name not in identified]
        known = [ENTRIES[k] in identified for k in shown]
        self.send(self._to_parameters, self._parameter_bytes.message(sample.stamp_ns, value, covariance, known))
        if self._types is not None:
            probability = self._types.probabilities(filter_.learnt, filter_.prior)
            self.send(self._to_type, wire.driver_type(sample.stamp_ns, self.vehicle, probability))
        if self._saved_ns is None:
            self._saved_ns = sample.stamp_ns
        elif sample.stamp_ns - self._saved_ns >= _SAVED_EVERY_NS:
            self._saved_ns = sample.stamp_ns
            self._save()

    def _save(self) -> None:
        if self._save_state is None or self._filter is None or self._stamp_ns is None:
            return
        try:
            write_learnt(file_of(self._save_state, self.vehicle), Kept(self._filter.learnt, self._stamp_ns))
        except SugiyamaError as error:
            self.failure = error

    def finish(self) -> None:
        """Keep what was learnt, and send nothing more."""
        self._save()
        super().finish()

    def _fail(self, error: Exception, sample: wire.Sample) -> None:
        """Log a failure of the filter, once until the next restart."""
        if not self._failure:
            self._failure = f"vehicle {self.vehicle} at {sample.stamp_ns / wire.NS:.3f} s: {error!r}"
            self.get_logger().error(self._failure)


def declare_driver(node: Node, default: Array) -> None:
    """Declare a driver's parameters, with defaults from a row (P,) or longer, as the code describes them."""
    for p, value in zip(PARAMETERS, default[: len(PARAMETERS)].tolist(), strict=True):
        node.declare_parameter(
            p.name,
            value,
            ParameterDescriptor(
                description=f"{p.symbol} [{p.unit}] {p.description}",
                floating_point_range=[FloatingPointRange(from_value=p.lower, to_value=p.upper)],
            ),
        )


def main() -> None:
    """Run one estimator."""
    run_node(Estimator)


if __name__ == "__main__":
    main()
