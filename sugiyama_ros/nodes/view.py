"""The node behind the live page: it hears everything that the page shows, and calls the services behind its buttons."""

import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.node import Node
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import (
    DriverArray,
    DriverParameters,
    Innovation,
    MeasuredPositions,
    StyleChange,
    VehicleState,
    Verdict,
)
from sugiyama_msgs.msg import Road as RoadMessage
from sugiyama_msgs.srv import AddEffect, RemoveEffect

from sugiyama_ros.driver.parameters import population
from sugiyama_ros.effects.effect import Extent
from sugiyama_ros.effects.registry import EFFECTS, effect, read_effects
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.chain import CHAIN
from sugiyama_ros.filters.online import OnlineFilter, warm_up
from sugiyama_ros.formats.truth import namespace
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.incoming import receiver
from sugiyama_ros.nodes.base.node import AnyPublisher, clients_of, followers
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.base.samples import Sample
from sugiyama_ros.page.feed import KEPT, Log, Status
from sugiyama_ros.page.panels.base import MOVING_S
from sugiyama_ros.road import Road

# Number of events that are kept, and time [s] over which the real rate is measured.
_EVENTS, _RATE_S = 8, 5.0
# Samples that wait for the errors of all drivers, at most.
_OPEN = 128
# Entries of the state: position, speed, acceleration.
_STATE, _SPEED = 3, 1
# Attention, from 0 to 1, from which on a driver lets others pass.
_MUCH = 0.5
_WORDS = {"v_star": "desired speed", "kappa_v": "risk premium"}


def _milliseconds(time_s: float) -> int:
    return round(1000.0 * time_s) if math.isfinite(time_s) else -1


def _seconds(message: Any) -> float:
    """Time [s] of a message with a header."""
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


class _MovingError:
    """Root mean square of errors over the last ``MOVING_S`` seconds."""

    def __init__(self) -> None:
        self._squares: deque[tuple[float, float, int]] = deque(maxlen=10_000)

    def clear(self) -> None:
        """Forget everything."""
        self._squares.clear()

    def add(self, time_s: float, total: float, number: int) -> float:
        """Take in the sum of ``number`` squared errors at a time, and return the error [m]; NaN without any."""
        self._squares.append((time_s, total, number))
        while self._squares[0][0] < time_s - MOVING_S:
            self._squares.popleft()
        scored = sum(n for _, _, n in self._squares)
        return math.sqrt(sum(squares for _, squares, _ in self._squares) / scored) if scored else math.nan


class _Joined:
    """Rows of one driver, made of what three topics say at the same stamp: the topics arrive in any order.

    rows: gets the time [s] and the numbers of all parts of each sample, as soon as the last part is there.
    """

    #: The parts: the state, the innovation, and the measured position.
    STATE, INNOVATION, MEASURED = range(3)

    def __init__(self, rows: Log) -> None:
        self._rows = rows
        self._waiting: OrderedDict[int, dict[int, tuple[float, ...]]] = OrderedDict()

    def take(self, part: int, time_s: float, *numbers: float) -> None:
        """Take in a part of the sample at a time [s]."""
        key = _milliseconds(time_s)
        parts = self._waiting.setdefault(key, {})
        parts[part] = numbers
        if len(parts) == 3:
            del self._waiting[key]
            self._rows.add(time_s, *(number for k in range(3) for number in parts[k]))
        elif len(self._waiting) > KEPT:
            self._waiting.popitem(last=False)


class View(Node):
    """Subscribes to everything that the page shows, and calls the services behind its buttons.

    rate: rate of the replay that was asked for, in times real time; recording: file to which the topics are written;
    empty where nothing is written; expected: vehicles that will have topics of their own, to hear them from the first
    message on; of others, the node hears what comes after their first sample.
    """

    def __init__(self, rate: float, recording: str = "", expected: Sequence[int] = ()) -> None:
        super().__init__("view", start_parameter_services=False)
        self.rate, self._recorded_to = rate, recording
        self.road = Road()
        self.space, self.error = Log(0), Log(KEPT)
        self.critic: dict[str, Log] = {}
        self.best, self.is_settled = "", False
        self.gains: dict[str, float] = {}
        self.vehicles: list[int] = []
        self.driver: dict[int, Log] = {}
        self.learnt: dict[int, Log] = {}
        self.now: dict[int, tuple[float, float]] = {}
        self.lanes: dict[int, int] = {}
        self.yielding: set[int] = set()
        # whether drivers come to lines, and to curves
        self._has_lines = self._has_curves = False
        self.followers: set[int] = set()
        self.here: set[int] = set()
        self.led: set[int] = set()
        self.adapted: dict[int, tuple[float, float, float, float]] = {}
        self.added: list[str] = []
        self.changed_s: list[float] = []
        self.events: deque[str] = deque(maxlen=_EVENTS)
        self.said = ""
        self._road: RoadMessage | None = None
        self.effects = _can_be_added(self._recording())
        self.titles = {name: e.title for name, e in EFFECTS.items()}
        # the critic's values of all parameters of effects
        self._fitted: dict[str, float] = {}
        self._joined: dict[int, _Joined] = {}
        # by the stamp: positions, and the error of the base model up to then; topics arrive in any order
        self._measured: OrderedDict[int, tuple[dict[int, float], float]] = OrderedDict()
        self._moving, self._base_moving = _MovingError(), _MovingError()
        self._base: _BaseModel | None = None
        # squared errors of the drivers who have been heard, by the stamp, of samples that are not complete
        self._errors: dict[int, list[float]] = {}
        self._latest_s, self._first_s, self._step = -math.inf, math.nan, -1
        self._arrived: deque[tuple[float, float]] = deque(maxlen=2000)
        self._listen(RoadMessage, "/road", self._on_road, LATCHED)
        self._listen(MeasuredPositions, "/measured", self._on_measured)
        self._listen(Verdict, "/verdict", self._on_verdict)
        # from one node for all drivers, who then have no topics of their own
        self._are_together = False
        self._listen(DriverArray, "/drivers", self._on_drivers)
        self._listen(StyleChange, "/style_change", self._on_change)
        self._listen_to(expected)

    def _listen(self, kind: type, topic: str, take: Callable[[Any], None], qos: Any = STREAM) -> None:
        """Subscribe to a topic, whatever its publishers offer.

        A message that is not valid is left out; the nodes of the road tell of it.
        """
        AnyPublisher(self, kind, topic, receiver(kind, take), qos)

    def status(self) -> Status:
        """Where the recording is, and how fast it goes."""
        road, arrived = self._road, self._arrived
        silent_s = time.monotonic() - arrived[-1][0] if arrived else math.nan
        real_rate = math.nan
        if len(arrived) > 1 and arrived[-1][0] > arrived[0][0]:
            real_rate = (arrived[-1][1] - arrived[0][1]) / (arrived[-1][0] - arrived[0][0])
        steps = int(road.steps) if road is not None else 0
        return Status(
            source=str(road.source) if road is not None else "",
            time_s=arrived[-1][1] - self._first_s if arrived else 0.0,
            total_s=float(road.period_s) * max(steps - 1, 0) if road is not None else 0.0,
            real_rate=real_rate,
            silent_s=silent_s,
            ended=bool(steps) and self._step + 1 >= steps,
            domain=environment.domain(),
            recording=self._recorded_to,
        )

    def values(self, name: str) -> str:
        """Values of an effect: the critic's, or else the values where a search begins."""
        if name not in EFFECTS or not (starts := effect(name).starts(self._recording())):
            return ""
        values = {p: self._fitted.get(f"{name}.{p}", start) for p, start in starts[0].items()}
        return ", ".join(f"{k}={v:.4g}" for k, v in values.items())

    def pause(self, paused: bool) -> None:
        """Call the replay's ~/pause or ~/resume."""
        self._call(Trigger, [f"/replay/{'pause' if paused else 'resume'}"], Trigger.Request())

    def set_rate(self, rate: float) -> None:
        """Set the replay's parameter ``rate``."""
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=rate)
        request = SetParameters.Request(parameters=[Parameter(name="rate", value=value)])
        self._call(SetParameters, ["/replay/set_parameters"], request)
        self.rate = rate

    def add(self, name: str, values: str) -> None:
        """Call ~/add_effect of every node that follows drivers."""
        if not self.vehicles:
            return
        try:
            found = read_effects([f"{name}:{values}"], "add")[name]
        except InputError as error:
            self.said = str(error)
            return
        request = AddEffect.Request(effect=name, name=list(found), value=list(found.values()))

        def on_success() -> None:
            self.added = list(dict.fromkeys([*self.added, name]))
            self._changed(f"{self.titles.get(name, name)} added ({values})")

        self._call(AddEffect, [f"{node}/add_effect" for node in followers(self)], request, on_success)

    def remove(self, name: str) -> None:
        """Call ~/remove_effect of every node that follows drivers."""

        def on_success() -> None:
            self.added = [one for one in self.added if one != name]
            self._changed(f"{self.titles.get(name, name)} removed")

        services = [f"{node}/remove_effect" for node in followers(self)]
        self._call(RemoveEffect, services, RemoveEffect.Request(effect=name), on_success)

    def _changed(self, what: str) -> None:
        """Note that the models have other effects from now on."""
        self._happened(what)
        self.changed_s.append(self._latest_s)

    def _happened(self, what: str) -> None:
        self.events.appendleft(f"{self._latest_s:.0f} s: {what}" if math.isfinite(self._latest_s) else what)

    def _recording(self) -> Extent:
        ring_m = self.road.circumference_m
        duration_s = float(self._road.period_s * self._road.steps) if self._road is not None else 1.0
        return Extent(0.0, duration_s, ring_m, 0.0, ring_m, self._has_lines, self._has_curves)

    def _call(
        self, kind: type, services: Sequence[str], request: Any, on_success: Callable[[], None] = lambda: None
    ) -> None:
        """Call services, all with the same request. The first one that succeeds calls ``on_success``."""
        clients, missing = clients_of(self, kind, services)
        self.said = f"{missing[0]} is not there" if missing else "" if services else "no node follows drivers"
        first = [on_success]

        def done(client: Client, future: Any) -> None:
            answer = future.result() if future.exception() is None else None
            if answer is None:
                self.said = f"{client.srv_name} has failed"
            elif getattr(answer, "success", True):
                while first:
                    first.pop()()
            else:
                self.said = answer.message
            self.destroy_client(client)

        for client in clients:
            client.call_async(request).add_done_callback(partial(done, client))

    def _on_road(self, road: RoadMessage) -> None:
        self.road, self._road = Road(float(road.circumference_m)), road
        self._base = _BaseModel(road)

    def _on_measured(self, sample: Sample) -> None:
        time_s = sample.stamp_ns / NS
        if sample.step < self._step:
            self._happened("the recording begins anew")
            self._arrived.clear()
            self._base_moving.clear()
            self._moving.clear()
            self._errors.clear()
            self._latest_s, self._first_s = -math.inf, math.nan
            self._base = _BaseModel(self._road) if self._road is not None else None
        self._step = sample.step
        self._first_s = time_s if math.isnan(self._first_s) else self._first_s
        self._arrived.append((time.monotonic(), time_s))
        while self._arrived[-1][0] - self._arrived[0][0] > _RATE_S:
            self._arrived.popleft()
        for vehicle in [v for v in self.now if v not in sample.place]:
            del self.now[vehicle]
            self._happened(f"vehicle {vehicle} has left")
        if new := sorted(set(sample.place) - set(self.vehicles)):
            self._meet(new)
        self.here = set(sample.place)
        self.led.update(v for v, p in sample.place.items() if sample.leader[p] >= 0)
        for vehicle, place in sample.place.items():
            self._joined[vehicle].take(_Joined.MEASURED, time_s, sample.position_m[place])
        if sample.lane:
            self.lanes.update({v: sample.lane[p] for v, p in sample.place.items() if sample.lane[p] >= 0})
        if sample.line_m or sample.curvature_per_m:
            self._take_lines(sample)
        errors = self._base.follow(sample) if self._base is not None else []
        error = self._base_moving.add(time_s, sum(e * e for e in errors), len(errors))
        self._measured[_milliseconds(time_s)] = {v: sample.position_m[p] for v, p in sample.place.items()}, error
        while len(self._measured) > KEPT:
            self._measured.popitem(last=False)

    def _take_lines(self, sample: Sample) -> None:
        """Note who lets others pass, and which effects can be added on such a road."""
        self.yielding = {v for v, (_, speed) in self.now.items() if sample.attention(v, speed) > _MUCH}
        lines = self._has_lines or any(map(math.isfinite, sample.line_m))
        curves = self._has_curves or any(one > 0.0 for one in sample.curvature_per_m)
        if (lines, curves) != (self._has_lines, self._has_curves):
            self._has_lines, self._has_curves = lines, curves
            self.effects = _can_be_added(self._recording())

    def _meet(self, new: Sequence[int]) -> None:
        """Note vehicles that are seen for the first time, and subscribe to their topics."""
        if self.vehicles:
            self._happened(f"vehicle{'s' * (len(new) > 1)} {', '.join(map(str, new))} on the road")
        else:
            self.space = Log(KEPT * len(new))
        self._listen_to([v for v in new if v not in self.driver])
        self.vehicles = sorted([*self.vehicles, *new])

    def _listen_to(self, vehicles: Sequence[int]) -> None:
        """Subscribe to the topics of some vehicles."""
        for v in vehicles:
            space = f"/{namespace(v)}"
            self.driver[v], self.learnt[v] = Log(KEPT), Log(KEPT)
            self._joined[v] = _Joined(self.driver[v])
            if self._are_together:
                continue
            self._listen(VehicleState, f"{space}/state", self._on_state)
            self._listen(Innovation, f"{space}/innovation", self._on_innovation)
            self._listen(DriverParameters, f"{space}/parameters", self._on_parameters)
            self._listen(StyleChange, f"{space}/style_change", self._on_change)

    def _on_drivers(self, message: DriverArray) -> None:
        self._are_together = True
        time_s, count, names = _seconds(message), len(message.vehicle), list(message.name)
        speed_var = np.array(message.state_covariance).reshape(count, _STATE, _STATE)[:, _SPEED, _SPEED].tolist()
        value = np.array(message.value).reshape(count, len(names))
        learnt = [name for name, estimated in zip(names, message.estimated, strict=True) if estimated]
        var = np.array(message.parameter_covariance).reshape(count, len(learnt), len(learnt))
        for k, v in enumerate(map(int, message.vehicle)):
            if set(_WORDS) <= set(learnt):
                mean = value[k, [names.index(name) for name in _WORDS]].tolist()
                std = np.sqrt(np.maximum(np.diag(var[k])[[learnt.index(name) for name in _WORDS]], 0.0)).tolist()
                self._learn(time_s, v, (mean[0], std[0], mean[1], std[1]))
            self._take_state(time_s, v, message.position_m[k], message.speed[k], speed_var[k])
            innovation = message.innovation_m[k], message.innovation_var[k], message.scored[k]
            self._take_innovation(time_s, v, *innovation)

    def _on_state(self, m: VehicleState) -> None:
        self._take_state(_seconds(m), m.vehicle, m.position_m, m.speed, float(m.covariance[4]))

    def _take_state(self, time_s: float, v: int, position: float, speed: float, variance: float) -> None:
        if v not in self.driver:
            return
        self._joined[v].take(_Joined.STATE, time_s, speed, math.sqrt(max(variance, 0.0)))
        if v in self.here:  # estimates of who has left may come late
            self.now[v] = (position, speed)
        self.space.add(time_s, position, speed)

    def _on_parameters(self, message: DriverParameters) -> None:
        v, names = int(message.vehicle), list(message.name)
        if v not in self.driver or not {"v_star", "kappa_v"} <= set(names):
            return
        found: list[float] = []
        for k in (names.index("v_star"), names.index("kappa_v")):
            variance = float(message.covariance[k * len(names) + k])
            found += [float(message.value[k]), math.sqrt(max(variance, 0.0))]
        self._learn(_seconds(message), v, (found[0], found[1], found[2], found[3]))

    def _learn(self, time_s: float, v: int, adapted: tuple[float, float, float, float]) -> None:
        """Note v*, its std, kappa_v and its std of a driver at a time [s]."""
        if v in self.driver:
            self.adapted[v] = adapted
            self.learnt[v].add(time_s, *adapted)

    def _on_change(self, message: StyleChange) -> None:
        what = _WORDS.get(message.name, message.name)
        self._happened(f"vehicle {message.vehicle} has changed style: {what} times {message.factor:.2f}")

    def _on_innovation(self, m: Innovation) -> None:
        self._take_innovation(_seconds(m), m.vehicle, m.innovation_m, m.innovation_var, m.scored)

    def _take_innovation(self, time_s: float, v: int, innovation: float, variance: float, scored: bool) -> None:
        if v not in self.driver:
            return
        if scored and (v in self.led or not self.led):
            self.followers.add(v)
        if _milliseconds(time_s) > _milliseconds(self._latest_s):
            self._take_error(time_s, innovation**2 if scored else math.nan)
        self._joined[v].take(_Joined.INNOVATION, time_s, innovation, math.sqrt(max(variance, 0.0)))

    def _take_error(self, time_s: float, square: float) -> None:
        """Take in the squared error of one driver; NaN if it does not count. Drivers' topics arrive in any order."""
        key = _milliseconds(time_s)
        errors = self._errors.setdefault(key, [])
        errors.append(square)
        if len(errors) >= len(self._at(time_s)[0]) > 0:
            self._tell_errors(key)
        elif len(self._errors) > _OPEN:
            self._tell_errors(min(self._errors))

    def _tell_errors(self, last: int) -> None:
        """Tell the errors of all samples up to one, whose drivers have all been heard, or which has waited for long."""
        for key in sorted(key for key in self._errors if key <= last):
            squares = [square for square in self._errors.pop(key) if not math.isnan(square)]
            self._latest_s = key / 1000.0
            error = self._moving.add(self._latest_s, sum(squares), len(squares))
            if math.isfinite(error):
                self.error.add(self._latest_s, error, self._at(self._latest_s)[1])

    def _at(self, time_s: float) -> tuple[Mapping[int, float], float]:
        """Measured positions [m] at a time, and the error [m] of the base model up to then."""
        return self._measured.get(_milliseconds(time_s), ({}, math.nan))

    def _on_verdict(self, message: Verdict) -> None:
        self._fitted = dict(zip(message.parameter, message.value, strict=True))
        if len(message.log_likelihood) == len(message.model):
            self.gains = dict(zip(message.model, map(float, message.log_likelihood), strict=True))
            time_s = _seconds(message)
            for name, gain in self.gains.items():
                self.critic.setdefault(name, Log(KEPT)).add(time_s, gain)
        self.best, self.is_settled = str(message.best), bool(message.settled)


class _BaseModel:
    """One filter of the base model for each vehicle: what the one-step errors would be without added effects."""

    def __init__(self, road: RoadMessage) -> None:
        warm_up()
        self._road, self._period_s = Road(float(road.circumference_m)), float(road.period_s)
        self._filters: dict[int, OnlineFilter] = {}

    def follow(self, sample: Sample) -> list[float]:
        """Follow all vehicles of a sample, and return the one-step errors [m] that count."""
        errors = []
        for vehicle in sample.place:
            if vehicle not in self._filters:
                self._filters[vehicle] = OnlineFilter(self._period_s, self._road, population())
            chain = sample.chain(vehicle, CHAIN)
            position, length, behind, lines = sample.sight(vehicle, chain)
            try:
                time_s = sample.stamp_ns / NS
                found = self._filters[vehicle].step(position, chain, length, time_s, behind, lines=lines)
            except ArithmeticError:  # nobody drives like this; the filter begins anew
                del self._filters[vehicle]
                continue
            if found.scored:
                errors.append(float(found.innovation_m))
        return errors


def _can_be_added(extent: Extent) -> dict[str, str]:
    """Effects that can be added while drivers are followed; each with what it is, and what its parameters mean."""
    names = [name for name, e in EFFECTS.items() if e.function is not None and e.starts(extent)]
    return {name: _explained(name) for name in names}


def _explained(name: str) -> str:
    """What an effect is, and what its parameters mean, in their units."""
    effect_ = effect(name)
    means = [
        f"{p.name}{f' [{p.unit}]' if p.unit not in ('', '1') else ''}: {p.description.split(';')[0]}"
        for p in effect_.parameters
    ]
    text = f"{effect_.title}: {effect_.summary}. Strength: {'; '.join(means)}."
    return text.replace("^2", "²").replace("^3", "³")
