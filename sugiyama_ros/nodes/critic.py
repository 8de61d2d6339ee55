"""The critic: a bank of models follows all vehicles. The model that predicts best shows what the others lack."""

from collections.abc import Mapping
from functools import partial
from math import isfinite
from typing import Any

import numpy as np
from rclpy.client import Client
from sugiyama_msgs.msg import DriverArray, DriverParameters, Verdict
from sugiyama_msgs.msg import Road as RoadMessage
from sugiyama_msgs.srv import AddEffect

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, population
from sugiyama_ros.effects.registry import ROW, active, switched_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.bank import Bank
from sugiyama_ros.filters.chain import CHAIN
from sugiyama_ros.filters.online import warm_up
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.formats.truth import namespace
from sugiyama_ros.nodes.base import incoming
from sugiyama_ros.nodes.base.cdr_messages import NS, time_message
from sugiyama_ros.nodes.base.feed import RoadFeed
from sugiyama_ros.nodes.base.node import ERROR, OK, WARN, AnyPublisher, Health, PacedNode, clients_of, followers
from sugiyama_ros.nodes.base.parameters import check_driver, declare_driver, driver_of
from sugiyama_ros.nodes.base.qos import STREAM
from sugiyama_ros.nodes.base.samples import UNKNOWN_LEADER, Sample
from sugiyama_ros.road import Road

_VERDICT_EVERY_NS = 5 * NS
# Time after the last sight of a vehicle at which its filters are dropped.
_GONE_NS = 5 * NS
# Time [s] after which a sample counts less by a factor of e.
_FORGET_S = 120.0


class Critic(PacedNode):
    """Publishes a verdict every 5 s of the recording. ``~/add_effect`` adds an effect to the models of all nodes that
    follow drivers.

    A jump back in time starts the bank anew, and so does an effect that the models of all drivers get or lose: the bank
    looks for what is missing beyond them. Vehicles may come and go. While nobody knows whom a driver follows, the
    driver is not followed: what they do then tells nothing of a model. Parameters of the node: the parameters of a
    driver, from which every model of the bank starts.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("critic", **options)
        warm_up()
        declare_driver(self, population())
        check_driver(self)
        self._road: RoadMessage | None = None
        self._bank: Bank | None = None
        self._chains: dict[int, list[int]] = {}
        self._seen_ns: dict[int, int] = {}
        self._heard: dict[int, AnyPublisher] = {}
        # parameters of effects that each driver's model has, by vehicle, and the latest message about all drivers
        self._effects_of: dict[int, Mapping[str, float]] = {}
        self._drivers: DriverArray | None = None
        self._stamp_ns: int | None = None
        self._told_ns = 0
        self._failure = ""
        self._to_verdict = self.create_publisher(Verdict, "verdict", STREAM)
        self.create_service(AddEffect, "~/add_effect", self._on_add_effect)
        self.listen(DriverArray, "drivers", self._on_drivers, STREAM)
        self._feed = RoadFeed(self, self._on_road, self._take_in)

    def health(self) -> Health:
        """ERROR after a failure of a filter, WARN without a road."""
        if self._failure:
            return Health(ERROR, self._failure, {})
        if self._road is None:
            return Health(WARN, f"waiting for a road on {self.resolve_topic_name('road')}", {})
        if self._bank is None:
            return Health(WARN, f"nothing heard on {self.resolve_topic_name('measured')} yet", {})
        said = "settled" if self._bank.is_settled else "not settled"
        return Health(OK, f"comparing; {said}", {"samples": self._bank.samples, "added": ", ".join(self._bank.effects)})

    def _on_road(self, road: RoadMessage) -> None:
        """Begin with a road, and anew with each road that comes."""
        self._road, self._bank = road, None
        self.announce()

    def _take_in(self, sample: Sample) -> None:
        """Let all models follow the vehicles of a sample."""
        assert self._road is not None, "the feed hands samples over once there is a road"
        try:
            self._follow(sample, self._road)
        except Exception as error:
            if not self._failure:
                self._failure = f"at {sample.stamp_ns / NS:.3f} s: {error!r}"
                self.get_logger().error(self._failure)
        self.taken(sample.step + 1, last=sample.step + 1 == self._road.steps)
        self.report_if_worse()

    def _follow(self, sample: Sample, road: RoadMessage) -> None:
        jumped = self._stamp_ns is not None and sample.stamp_ns < self._stamp_ns
        if (self._bank is None or jumped) and not sample.place:
            return
        if self._bank is None or jumped:
            row = self._with_added(driver_of(self))
            self._bank = Bank(road.period_s, Road(road.circumference_m), row, _FORGET_S)
            self._chains, self._seen_ns, self._failure = {}, {}, ""
            self._told_ns = sample.stamp_ns
        if self._stamp_ns == sample.stamp_ns:
            return
        self._stamp_ns = sample.stamp_ns
        self._bank.forget()
        self._meet_and_leave(sample, self._bank)
        for vehicle, chain in self._chains.items():
            position, length, behind, lines = sample.sight(vehicle, chain)
            self._bank.step(vehicle, position, chain, length, sample.stamp_ns / NS, behind, lines)
        if sample.stamp_ns - self._told_ns >= _VERDICT_EVERY_NS or sample.step + 1 == road.steps:
            self._told_ns = sample.stamp_ns
            self._publish(sample, self._bank)

    def _meet_and_leave(self, sample: Sample, bank: Bank) -> None:
        """Follow the drivers in view of whom it is known whom they follow, and nobody else."""
        for vehicle, place in sample.place.items():
            if sample.leader[place] != UNKNOWN_LEADER and vehicle not in self._feed.controlled:
                if vehicle not in self._chains:
                    bank.meet(vehicle)
                    self._listen_to(vehicle)
                self._chains[vehicle], self._seen_ns[vehicle] = sample.chain(vehicle, CHAIN), sample.stamp_ns
            elif vehicle in self._chains:
                self._seen_ns[vehicle] = sample.stamp_ns - _GONE_NS
        for vehicle in [v for v, seen_ns in self._seen_ns.items() if seen_ns <= sample.stamp_ns - _GONE_NS]:
            bank.leave(vehicle)
            del self._chains[vehicle], self._seen_ns[vehicle]
            self._effects_of.pop(vehicle, None)
            if vehicle in self._heard:
                self._heard.pop(vehicle).close()

    def _listen_to(self, vehicle: int) -> None:
        """Listen to which effects the model of a driver has, unless one message says it of all drivers."""
        if vehicle not in self._heard and not self.count_publishers("drivers"):
            topic = f"{namespace(vehicle)}/parameters"
            self._heard[vehicle] = self.listen(DriverParameters, topic, self._on_parameters, STREAM)

    def _on_parameters(self, message: DriverParameters) -> None:
        """Note the effects of a driver's model."""
        values = zip(message.name, message.value, strict=True)
        self._effects_of[message.vehicle] = {name: value for name, value in values if name not in NAMES}
        self._begin_anew_with_added()

    def _on_drivers(self, message: DriverArray) -> None:
        """Note the effects of the models of all drivers."""
        before, self._drivers = self._drivers, message
        if before is None or before.name != message.name:
            self._begin_anew_with_added()

    def _begin_anew_with_added(self) -> None:
        """Let the bank begin anew once all drivers have other effects than the bank."""
        if self._bank is not None and active(self._with_added(self._bank.row)) != self._bank.effects:
            self._bank = None

    def _with_added(self, row: Array) -> Array:
        """Row (WIDTH,) with the effects that the models of all drivers have, at the means of their values."""
        row = ROW.with_effects(row[: len(NAMES)])
        known = list(self._effects_of.values()) if self._drivers is None else _effects_of(self._drivers)
        if known and (self._drivers is not None or len(known) >= len(self._chains)):
            for name in set.intersection(*map(set, known)) & set(ROW.entries):
                row[ROW.entries.index(name)] = float(np.mean([values[name] for values in known]))
        return row

    def _publish(self, sample: Sample, bank: Bank) -> None:
        weights, fitted = bank.weights, bank.fitted
        values = {f"{name}.{p}": value for name, found in fitted.items() for p, value in found.items()}
        message = Verdict(
            best=bank.names[int(weights.argmax())],
            model=list(bank.names),
            weight=weights.tolist(),
            log_likelihood=bank.gains.tolist(),
            strength=[next(iter(found.values()), 0.0) for found in fitted.values()],
            parameter=list(values),
            value=list(values.values()),
            samples=bank.samples,
            settled=bank.is_settled,
            added=list(bank.effects),
        )
        message.header.stamp = time_message(sample.stamp_ns)
        message.header.frame_id = FRAME
        self.send(self._to_verdict, message)

    def _on_add_effect(self, request: AddEffect.Request, response: AddEffect.Response) -> AddEffect.Response:
        """Pass the request on to every node that follows drivers. A node that refuses it is logged."""
        try:
            values = incoming.named_values(f"effect {request.effect}", request.name, request.value)
            switched_on(ROW.with_effects(population()), request.effect, values)
        except (incoming.RefusedError, InputError) as error:
            response.message = str(error)
            return response
        clients, missing = clients_of(self, AddEffect, [f"{name}/add_effect" for name in followers(self)])
        for client in clients:
            client.call_async(request).add_done_callback(partial(self._on_answer, client))
        response.success = bool(clients) and not missing
        if not response.success:
            response.message = f"no answer from {missing[0]}" if missing else "no node follows drivers"
        return response

    def _on_answer(self, client: Client, done: Any) -> None:
        self.destroy_client(client)
        answer = done.result() if done.exception() is None else None
        if answer is None or not answer.success:
            self.get_logger().error(answer.message if answer is not None else str(done.exception()))


def _effects_of(message: DriverArray) -> list[dict[str, float]]:
    """Return the parameters of the effects that the model of each driver has, N mappings from name to value."""
    value = np.array(message.value).reshape(len(message.vehicle), len(message.name)).tolist()
    named = [k for k, name in enumerate(message.name) if name not in NAMES]
    return [{message.name[k]: row[k] for k in named if isfinite(row[k])} for row in value]
