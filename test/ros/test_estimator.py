"""The estimator node: how it handles stamps, missing samples and failures."""

from math import inf, isnan, nan
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from one_driver import OneDriver
from rclpy.node import Node
from sugiyama_msgs.msg import DriverParameters, DriverType, Innovation, MeasuredPositions, VehicleState
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.driver.parameters import NAMES, population
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.fit.driver_types import DriverTypes
from sugiyama_ros.fit.goals import Goal, KnownGoals
from sugiyama_ros.fit.model_file import Conditions, FittedDrivers, write_drivers
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.node import ERROR, OK, WARN
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.keeper import Keeper
from sugiyama_ros.road import Road as RingRoad

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]
PERIOD_S = 0.5


class Road(Node):
    """Sends the road and single samples, and keeps the answers of the estimator of vehicle 7."""

    def __init__(self) -> None:
        super().__init__("hand")
        self.states: list[VehicleState] = []
        self.innovations: list[Innovation] = []
        self.parameters: list[DriverParameters] = []
        self.health: list[tuple[bytes, str]] = []
        self.step = 0
        self.to_road = self.create_publisher(RoadMessage, "road", LATCHED)
        self.to_measured = self.create_publisher(MeasuredPositions, "measured", STREAM)
        self.create_subscription(VehicleState, "vehicle_07/state", self.states.append, STREAM)
        self.create_subscription(Innovation, "vehicle_07/innovation", self.innovations.append, STREAM)
        self.create_subscription(DriverParameters, "vehicle_07/parameters", self.parameters.append, STREAM)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, STREAM)
        self.to_road.publish(RoadMessage(circumference_m=100.0, period_s=PERIOD_S))

    def send(self, time_s: float, position_m: dict[int, float]) -> None:
        """Send a sample in which 7 follows 8, 8 follows 9, and 9 follows 7."""
        leader = {7: 8, 8: 9, 9: 7}
        message = MeasuredPositions(step=self.step, vehicle=list(position_m), leader=[leader[v] for v in position_m])
        message.header.stamp = cdr_messages.time_message(round(time_s * cdr_messages.NS))
        message.position_m, message.length_m = list(position_m.values()), [4.5] * len(position_m)
        self.to_measured.publish(message)
        self.step += 1

    def drive(self, first: int, last: int) -> None:
        """Send samples number ``first`` to ``last`` of a steady drive."""
        for k in range(first, last):
            self.send(k * PERIOD_S, {7: (5.0 * k * PERIOD_S) % 100.0, 8: (30.0 + 5.0 * k * PERIOD_S) % 100.0})

    def _on_health(self, array: DiagnosticArray) -> None:
        self.health += [(s.level, s.message) for s in array.status if s.name == "/drivers"]


@pytest.fixture
def pair(stage) -> tuple[Road, OneDriver]:
    """A `Road`, and the estimator of vehicle 7, which has received the road."""
    road, estimator = Road(), OneDriver(7)
    stage.add(road, estimator)
    stage.until(lambda: estimator.health().level == OK)
    return road, estimator


def values(estimator: OneDriver) -> dict[str, object]:
    """Counts in the estimator's health."""
    return dict(estimator.health().values)


def test_the_node_publishes_the_filters_results(stage, ring_csv: Path) -> None:
    trajectories = read_tracks(ring_csv, Choices(ring_m=100.0)).dense()
    chain = chain_behind(trajectories, 2)
    filter_ = OnlineFilter(trajectories.period_s, trajectories.road)
    road, estimator = Node("hand"), OneDriver(2)
    states: list[VehicleState] = []
    innovations: list[Innovation] = []
    road.create_subscription(VehicleState, "vehicle_02/state", states.append, STREAM)
    road.create_subscription(Innovation, "vehicle_02/innovation", innovations.append, STREAM)
    to_road = road.create_publisher(RoadMessage, "road", LATCHED)
    to_road.publish(RoadMessage(circumference_m=100.0, period_s=trajectories.period_s))
    stage.add(road, estimator)
    stage.until(lambda: estimator.health().level == OK)
    to_measured = road.create_publisher(MeasuredPositions, "measured", STREAM)
    for k in range(50):
        message = MeasuredPositions(step=k, vehicle=[0, 1, 2, 3], leader=[1, 2, 3, 0], length_m=[4.5] * 4)
        message.header.stamp = cdr_messages.time_message(round(k * trajectories.period_s * cdr_messages.NS))
        message.position_m = trajectories.position_m[k].tolist()
        to_measured.publish(message)
    stage.until(lambda: len(states) == len(innovations) == 50)
    for k in range(50):
        expected = filter_.step(chain.position_m[k].tolist(), chain.identity[k].tolist(), chain.length_m[k].tolist())
        if k == 0:
            # one position says nothing about the speed
            assert states[k].position_m == expected.position_m
            assert isnan(states[k].speed)
            continue
        for name in ("position_m", "speed", "acceleration", "mean_action", "gap_m", "approach_rate"):
            assert getattr(states[k], name) == getattr(expected, name), (k, name)
        np.testing.assert_array_equal(states[k].covariance, expected.covariance.ravel())
        np.testing.assert_equal(innovations[k].innovation_m, expected.innovation_m)
        np.testing.assert_equal(innovations[k].nis, expected.nis)
        assert innovations[k].scored == expected.scored


def test_a_missing_position_is_predicted_over(stage, pair) -> None:
    road, estimator = pair
    road.drive(0, 10)
    road.send(10 * PERIOD_S, {7: float("nan"), 8: 55.0})
    road.send(11 * PERIOD_S, {8: 57.5})  # vehicle 7 is not in the message at all
    stage.until(lambda: len(road.innovations) == 12)
    assert estimator.health().level == WARN
    assert estimator.health().message == "vehicle 7: 2 samples missing in a row"
    road.drive(12, 14)
    stage.until(lambda: len(road.innovations) == len(road.states) == 14)
    assert [isnan(i.innovation_m) for i in road.innovations[5:]] == [False] * 5 + [True] * 2 + [False] * 2
    assert not any(i.scored for i in road.innovations[10:12])
    # No sample came, so the position is less certain, but it went on at 5 m/s.
    assert road.states[11].position_m == pytest.approx(5.0 * 11 * PERIOD_S, abs=1.5)
    assert road.states[11].covariance[0] > 2.0 * road.states[9].covariance[0]
    assert estimator.health().level == OK


def test_a_sample_that_comes_again_or_late_is_left_out(stage, pair) -> None:
    road, estimator = pair
    road.drive(0, 10)
    road.drive(9, 10)
    road.drive(8, 9)
    road.drive(10, 12)
    stage.until(lambda: len(road.states) == 12)
    counted = values(estimator)
    assert [counted[name] for name in ("duplicates", "late", "resets", "samples")] == [1, 1, 0, 12]
    assert abs(road.innovations[-1].innovation_m) < 1.0


def test_a_position_that_is_no_number_is_missing(stage, pair) -> None:
    road, estimator = pair
    road.drive(0, 10)
    road.send(10 * PERIOD_S, {7: inf, 8: -inf})
    road.drive(11, 13)
    stage.until(lambda: len(road.states) == 13)
    assert isnan(road.innovations[10].innovation_m)
    # the state is what the filter makes of a missing position
    filter_ = OnlineFilter(PERIOD_S, RingRoad(100.0))
    for k in range(13):
        own = 5.0 * k * PERIOD_S
        position = [nan] * 3 if k == 10 else [own % 100.0, (30.0 + own) % 100.0, nan]
        expected = filter_.step(position, [7, 8, 9], [4.5, 4.5, 0.0])
    assert road.states[12].speed == expected.speed
    assert estimator.health().level == OK


@pytest.mark.parametrize("jump", [0, 1000])
def test_after_a_jump_in_time_the_filter_keeps_what_it_has_learnt(stage, pair, jump: int) -> None:
    """Two successive samples from another time are a jump. Both are followed, and the stream goes on."""
    road, estimator = pair
    road.drive(0, 20)
    stage.until(lambda: len(road.states) == 20)
    learnt = estimator.follower.filter.learnt
    road.drive(jump, jump + 1)
    stage.until(lambda: estimator.steps == 21)
    assert values(estimator)["resets"] == 0
    road.drive(jump + 1, jump + 20)
    stage.until(lambda: len(road.states) == 40)
    assert values(estimator)["resets"] == 1
    assert [isnan(i.innovation_m) for i in road.innovations[20:24]] == [True, True, False, False]
    assert road.states[-1].speed == pytest.approx(5.0, abs=0.5)
    now = estimator.follower.filter.learnt
    if jump == 0:
        # the samples were learnt from already, so they tell nothing new
        assert now.mean == pytest.approx(learnt.mean, abs=1e-12)
    else:
        assert now.covariance[2, 2] < learnt.covariance[2, 2]


def test_one_stray_sample_changes_nothing(stage, pair) -> None:
    """One sample is 20 s old, and another one comes from the year 2033."""
    road, estimator = pair
    road.drive(0, 60)
    stage.until(lambda: len(road.states) == 60)
    road.drive(20, 21)
    road.drive(60, 61)
    road.drive(4_000_000_000, 4_000_000_001)
    road.drive(61, 63)
    stage.until(lambda: len(road.states) == 63)
    counted = values(estimator)
    assert (counted["late"], counted["resets"]) == (2, 0)
    never = OnlineFilter(PERIOD_S, RingRoad(100.0))
    for k in range(63):
        position = [(5.0 * k * PERIOD_S) % 100.0, (30.0 + 5.0 * k * PERIOD_S) % 100.0, nan]
        never.step(position, [7, 8, 9], [4.5, 4.5, 0.0], k * PERIOD_S)
    assert np.array_equal(estimator.follower.filter.learnt.covariance, never.learnt.covariance)


def test_swapped_samples_are_sorted_in(stage) -> None:
    """10 Hz; every tenth sample comes after the next one. The filter ends where it would have without that."""
    ends = []
    for swapped in (False, True):
        road, estimator = Road(), OneDriver(7)
        stage.add(road, estimator)
        road.to_road.publish(RoadMessage(circumference_m=0.0, period_s=0.1))
        stage.until(lambda e=estimator: e.health().level == OK)
        rng = np.random.default_rng(3)
        noise = rng.normal(0.0, 0.2, (100, 2))
        order = list(range(100))
        if swapped:
            for k in range(10, 99, 10):
                order[k], order[k + 1] = k + 1, k
        for k in order:
            road.send(0.1 * k, {7: 1.2 * k + noise[k, 0], 8: 30.0 + 1.2 * k + noise[k, 1]})
        stage.until(lambda r=road: len(r.states) == 100)
        counted = values(estimator)
        assert (counted["samples"], counted["sorted in"]) == (100, 9 if swapped else 0)
        assert counted["rate [Hz]"] == pytest.approx(10.0, rel=0.01 if not swapped else 0.2)
        ends.append((road.states[-1].speed, *estimator.follower.filter.learnt.mean))
        stage.kill(road)
        stage.nodes.remove(estimator)
        estimator.destroy_node()
    assert ends[0] == ends[1]


def test_parameters_are_published_once_a_second_of_the_data(stage, pair) -> None:
    road, _ = pair
    road.drive(0, 21)
    stage.until(lambda: len(road.states) == 21)
    stage.until(lambda: len(road.parameters) == 11)
    message = road.parameters[0]
    assert (message.vehicle, tuple(message.name)) == (7, NAMES)
    adapted = [n for n, e in zip(message.name, message.estimated, strict=True) if e]
    assert adapted == ["sigma_nu", "sigma_a", "v_star", "kappa_v"]
    assert len(message.covariance) == len(NAMES) ** 2


def test_who_comes_late_can_ask_for_the_last_parameters(stage, pair) -> None:
    """Volatile subscribers get what comes; who asks for the last messages gets them in order, also after the end."""
    road, _ = pair
    road.drive(0, 5)
    stage.until(lambda: len(road.parameters) == 3)
    late, told = Node("late"), []
    late.create_subscription(DriverParameters, "/vehicle_07/parameters", told.append, LATCHED)
    stage.suspend()
    stage.add(late)
    last = road.parameters[-1].header.stamp
    stage.until(lambda: bool(told) and told[-1].header.stamp == last)


def test_a_failure_is_reported_once_and_the_stream_continues(
    stage, pair, monkeypatch: pytest.MonkeyPatch, capfd
) -> None:
    road, _ = pair

    def fail(*_: object) -> None:
        raise FloatingPointError("no way")

    road.drive(0, 3)
    stage.until(lambda: len(road.states) == 3)
    monkeypatch.setattr(OnlineFilter, "step", fail)
    road.drive(3, 6)
    stage.until(lambda: len(road.states) == 6)
    assert [isnan(s.speed) for s in road.states] == [True, False, False] + [True] * 3
    # At once, not with the next report.
    stage.until(lambda: (ERROR, "vehicle 7 at 1.500 s: FloatingPointError('no way')") in road.health, 0.5)
    assert capfd.readouterr().err.count("no way") == 1


def test_the_filter_starts_from_the_nodes_parameters(stage) -> None:
    road = Road()
    estimator = OneDriver(7, v_star=15.0)
    stage.add(road, estimator)
    stage.until(lambda: estimator.health().level == OK)
    road.drive(0, 1)
    stage.until(lambda: bool(road.parameters))
    known = dict(zip(road.parameters[0].name, road.parameters[0].value, strict=True))
    assert known["v_star"] == pytest.approx(15.0)
    assert known["sigma_a"] == dict(zip(NAMES, population().tolist(), strict=True))["sigma_a"]


def test_the_type_of_the_driver_is_published(stage, tmp_path: Path) -> None:
    file = tmp_path / "types.yaml"
    kinds = np.array([population(), population()])
    kinds[1, NAMES.index("v_star")] *= 1.2
    types = DriverTypes(np.array([0.75, 0.25]), kinds)
    rows = ROW.with_effects(np.tile(population(), (4, 1)))
    goals = KnownGoals((Goal("exit", place=90.0, speed=2.0),), {"exit": 0.3})
    write_drivers(file, FittedDrivers([0, 1, 2, 3], "", "", rows, [{}] * 4, {}, 0.0), types, goals=goals)
    road, told = Road(), []
    estimator = OneDriver(7, model=str(file))
    road.create_subscription(DriverType, "vehicle_07/driver_type", told.append, STREAM)
    stage.add(road, estimator)
    stage.until(lambda: estimator.health().level == OK)
    road.drive(0, 21)
    stage.until(lambda: len(told) == 11)
    assert told[0].probability == pytest.approx([0.75, 0.25])
    assert told[0].goals == ["through", "exit"]
    assert told[0].goal_probability == pytest.approx([0.7, 0.3], abs=0.05)
    assert told[-1].goal_probability == pytest.approx(estimator.follower.filter.goal_probability)
    learnt, prior = estimator.follower.filter.learnt, estimator.follower.filter.prior
    assert told[-1].probability == pytest.approx(types.probabilities(learnt, prior))
    assert (told[-1].header.stamp.sec, told[-1].vehicle) == (10, 7)


def test_drivers_of_a_file_decide_live_as_often_as_in_its_fit(stage, tmp_path: Path) -> None:
    file, row = tmp_path / "model.yaml", ROW.with_effects(population())
    conditions = Conditions(decision_period_s=0.5 * PERIOD_S)
    write_drivers(file, FittedDrivers([7], "", "", row[None], [{}], {}, 0.0, conditions))
    road, estimator, found = Road(), OneDriver(7, model=str(file)), []
    road.create_subscription(Innovation, "vehicle_07/innovation", found.append, STREAM)
    stage.add(road, estimator)
    stage.until(lambda: estimator.health().level == OK)
    road.drive(0, 20)
    stage.until(lambda: len(found) == 20)
    filter_ = OnlineFilter(0.5 * PERIOD_S, RingRoad(100.0), row)
    chain = [7, 8, -1][: filter_.vehicles]
    for k in range(20):
        position = [5.0 * k * PERIOD_S % 100.0, (30.0 + 5.0 * k * PERIOD_S) % 100.0, nan][: filter_.vehicles]
        expected = filter_.step(position, chain, [4.5, 4.5, 0.0], k * PERIOD_S, elapsed_s=PERIOD_S if k else None)
    assert found[-1].innovation_m == pytest.approx(expected.innovation_m, rel=1e-9)
    assert values(estimator)["skipped"] == 0


def test_a_killed_node_continues_from_the_keeper(stage) -> None:
    """The node is killed after 30 s. After 10 s more its successor agrees with an uninterrupted node."""
    noise = np.random.default_rng(1).normal(0.0, 0.26, (80, 2))
    position = (np.array([0.0, 30.0]) + 5.0 * PERIOD_S * np.arange(80)[:, None] + noise) % 100.0
    road, keeper = Road(), Keeper()
    kept: list[DriverParameters] = []
    road.create_subscription(DriverParameters, "vehicle_07/_kept_parameters", kept.append, LATCHED)
    first = OneDriver(7, ask_keeper=True)

    def drive(estimator: OneDriver, begin: int, end: int) -> None:
        for k in range(begin, end):
            road.send(k * PERIOD_S, dict(zip((7, 8), position[k].tolist(), strict=True)))
        last_ns = round((end - 1) * PERIOD_S * cdr_messages.NS)
        stage.until(lambda: estimator.follower is not None and estimator.follower.stamp_ns == last_ns)

    stage.add(road, keeper, first)
    stage.until(lambda: first.health().level == OK and dict(keeper.health().values)["drivers"] == 1)
    for begin in range(0, 60, 20):
        drive(first, begin, begin + 20)
    stage.until(lambda: bool(kept) and kept[-1].header.stamp.sec == 29)
    stage.kill(first)
    again = OneDriver(7, ask_keeper=True)
    stage.add(again)
    drive(again, 60, 80)
    assert again.known[7].until_ns == 29 * cdr_messages.NS
    never = OnlineFilter(PERIOD_S, RingRoad(100.0))
    for k in range(80):
        never.step([*position[k], nan], [7, 8, 9], [4.5, 4.5, 0.0], k * PERIOD_S)
    off = again.follower.filter.learnt.mean - never.learnt.mean
    assert np.all(np.abs(off) < np.sqrt(np.diag(never.learnt.covariance)))


def test_without_a_keeper_an_estimator_soon_begins(stage) -> None:
    road = Road()
    estimator = OneDriver(7, ask_keeper=True)
    road.drive(0, 20)
    stage.add(road, estimator)
    stage.until(lambda: values(estimator)["samples"] == 20)


def test_samples_that_come_before_the_road_are_not_lost(stage, ring_csv: Path) -> None:
    road = Road()
    road.destroy_publisher(road.to_road)
    estimator = OneDriver(7)
    road.drive(0, 20)
    stage.add(road, estimator)
    stage.for_a_while(0.5)
    assert values(estimator)["samples"] == 0
    road.create_publisher(RoadMessage, "road", LATCHED).publish(RoadMessage(circumference_m=100.0, period_s=PERIOD_S))
    stage.until(lambda: values(estimator)["samples"] == 20)
