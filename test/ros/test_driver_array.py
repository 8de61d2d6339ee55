"""All drivers in one message: it says what the topics of each vehicle say, and nothing is lost."""

from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from sugiyama_msgs.msg import DriverArray, DriverParameters, MeasuredPositions
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.filters.online import Estimate
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.cdr_messages import SEVEN_DIGITS, KnownDriver, ParameterNames, driver_array
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.run import RunResult, run
from sugiyama_ros.page.recording import read_recording
from sugiyama_ros.trajectories.placing import Positions

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]
STATE = ("position_m", "speed", "acceleration", "mean_action", "gap_m", "approach_rate")
INNOVATION = ("innovation_m", "innovation_var", "nis", "log_likelihood", "scored")


def a_driver(vehicle: int, seed: int, names: ParameterNames) -> KnownDriver:
    """A driver of whom arbitrary numbers are known."""
    rng = np.random.default_rng(seed)
    *numbers, _ = rng.normal(size=11).tolist()
    estimate = Estimate(*numbers[:3], rng.normal(size=(3, 3)), *numbers[3:], bool(seed % 2))
    adapted = len(names.adapted)
    covariance, identified = rng.normal(size=(adapted, adapted)), rng.integers(0, 2, adapted) > 0
    return KnownDriver(vehicle, estimate, names, rng.normal(size=len(names.shown)), covariance, identified)


def shown(name: str, value):
    """A field as the array has it: some fields have the digits of a float32."""
    return np.asarray(value, np.float32).astype(float) if name in SEVEN_DIGITS else value


@pytest.mark.parametrize("frame_shift", [0, 3, 6])
def test_a_message_holds_what_is_known_of_each_driver(frame_shift: int) -> None:
    """Names of all lengths, so that the numbers stand everywhere between two multiples of eight bytes."""
    first = "a" * (1 + frame_shift)
    some = ParameterNames((first, "b", "c"), ("b", first))
    other = ParameterNames(("b", "d", first), (first, "d"))
    names = [some, other, some]
    for seed in (10, 20):
        drivers = [a_driver(7 + k, seed + k, one) for k, one in enumerate(names)]
        message = driver_array(seed, drivers)
        assert message.header.stamp == cdr_messages.time_message(seed)
        assert message.header.frame_id == "road"
        assert message.vehicle.tolist() == [7, 8, 9]
        assert (message.name, message.estimated) == ([first, "b", "c", "d"], [True, True, False, True])
        adapted = [first, "b", "d"]
        value = np.reshape(message.value, (3, 4))
        covariance, identified = (
            np.reshape(message.parameter_covariance, (3, 3, 3)),
            np.reshape(message.identified, (3, 3)),
        )
        for k, driver in enumerate(drivers):
            for name in (*STATE, *INNOVATION):
                assert getattr(message, name)[k] == shown(name, getattr(driver.estimate, name))
            told = message.state_covariance[9 * k : 9 * k + 9]
            assert told.tolist() == shown("state_covariance", driver.estimate.covariance.ravel()).tolist()
            at = [message.name.index(name) for name in driver.names.shown]
            assert value[k, at].tolist() == driver.value.tolist()
            assert np.isnan(np.delete(value[k], at)).all()
            at = [adapted.index(name) for name in driver.names.adapted]
            expected = shown("parameter_covariance", driver.covariance)
            assert covariance[k][np.ix_(at, at)].tolist() == expected.tolist()
            assert np.count_nonzero(covariance[k]) == driver.covariance.size
            assert identified[k, at].tolist() == driver.identified.tolist()


def test_the_array_says_what_the_topics_of_each_vehicle_say(recorded: tuple[Path, RunResult], tmp_path: Path) -> None:
    (source, each), together = recorded, tmp_path / "together.mcap"
    alone = each.output
    result = run(source, together, ring_m=100.0, array=True)
    assert (result.steps, result.vehicles, result.messages_lost) == (200, 4, 0)
    assert result.messages_published == result.messages_recorded
    assert result.drivers == each.drivers
    with Bag(together) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
        arrays = [m.message for m in bag.messages(["/drivers"])]
    assert set(counts) == {"/clock", "/measured", "/drivers", "/road", "/markers", "/diagnostics", "/rosout"} | {
        "/style_change"
    }
    assert counts["/clock"] == counts["/measured"] == counts["/drivers"] == 200
    by_stamp = {(a.header.stamp.sec, a.header.stamp.nanosec): a for a in arrays}
    with Bag(alone) as bag:
        for topic, _, _, message in bag.messages(
            {f"/vehicle_0{v}/{t}" for v in range(4) for t in ("state", "innovation")}
        ):
            array = by_stamp[message.header.stamp.sec, message.header.stamp.nanosec]
            k = array.vehicle.tolist().index(message.vehicle)
            for name in STATE if topic.endswith("state") else INNOVATION:
                np.testing.assert_equal(getattr(array, name)[k], shown(name, getattr(message, name)))
            if topic.endswith("state"):
                told = array.state_covariance[9 * k : 9 * k + 9]
                np.testing.assert_array_equal(told, shown("state_covariance", message.covariance))
        parameters = [m.message for m in bag.messages({f"/vehicle_0{v}/parameters" for v in range(4)})]
    for message in parameters:
        assert_same_parameters(by_stamp[message.header.stamp.sec, message.header.stamp.nanosec], message)
    one, all_ = read_recording(alone), read_recording(together)
    for name, values in one.series.items():
        # the array has the parameters with every sample, the topics have them once a second
        is_parameter = name.removesuffix("_std") in one.identified
        told = values != np.roll(values, 1, axis=0) if is_parameter else slice(None)
        np.testing.assert_allclose(all_.series[name][told], values[told], rtol=1e-6)
    for name, identified in one.identified.items():
        np.testing.assert_array_equal(all_.identified[name], identified)


def assert_same_parameters(array: DriverArray, message: DriverParameters) -> None:
    """What the array says of a driver's parameters is what the message about this driver says."""
    count, k = len(message.name), array.vehicle.tolist().index(message.vehicle)
    at = np.flatnonzero(message.estimated)
    assert array.name == message.name
    assert np.array_equal(array.estimated, message.estimated)
    assert array.value[k * count : (k + 1) * count].tolist() == message.value.tolist()
    covariance = np.reshape(array.parameter_covariance, (-1, len(at), len(at)))[k]
    whole = np.zeros((count, count))
    whole[np.ix_(at, at)] = covariance
    assert whole.ravel().tolist() == shown("parameter_covariance", message.covariance).tolist()
    assert np.reshape(array.identified, (-1, len(at)))[k].tolist() == np.array(message.identified)[at].tolist()


class Hand(Node):
    """Sends samples of four vehicles on a ring, and keeps the arrays."""

    def __init__(self) -> None:
        super().__init__("hand")
        self.arrays: list[DriverArray] = []
        self.to_road = self.create_publisher(RoadMessage, "road", LATCHED)
        self.to_measured = self.create_publisher(MeasuredPositions, "measured", STREAM)
        self.create_subscription(DriverArray, "drivers", self.arrays.append, STREAM)

    def drive(self, *steps: int) -> None:
        """Send the samples with these numbers."""
        for k in steps:
            place = [(25.0 * v + 3.0 * k) % 100.0 for v in range(4)]
            positions = Positions([0, 1, 2, 3], [1, 2, 3, 0], place, [4.5] * 4)
            self.to_measured.publish(cdr_messages.measured_positions(k * cdr_messages.NS // 2, k, positions))

    def send_road(self) -> None:
        """Send the road."""
        self.to_road.publish(RoadMessage(circumference_m=100.0, period_s=0.5))


def test_samples_that_wait_for_the_road_come_in_their_order(stage) -> None:
    hand, drivers = Hand(), DriversNode(parameter_overrides=[Parameter("vehicles", value=[0, 1, 2])])
    stage.add(hand, drivers)
    stage.until(lambda: hand.count_subscribers("measured") == 1)
    hand.drive(*range(10))
    hand.send_road()
    stage.until(lambda: len(hand.arrays) == 10)
    stamps = [a.header.stamp.sec + 1e-9 * a.header.stamp.nanosec for a in hand.arrays]
    assert stamps == pytest.approx([0.5 * k for k in range(10)])
    assert all(a.vehicle.tolist() == [0, 1, 2] for a in hand.arrays)
    hand.drive(8, 9, 10)  # two of them came before
    stage.until(lambda: len(hand.arrays) == 11)
    assert hand.arrays[-1].header.stamp == cdr_messages.time_message(5 * cdr_messages.NS)
