"""What others can use: standard messages of each driver; and inputs from whoever publishes them."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from one_driver import OneDriver
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sugiyama_msgs.msg import MeasuredPositions, Road

from sugiyama_ros.errors import InputError
from sugiyama_ros.nodes.base.qos import STREAM
from sugiyama_ros.nodes.replay import Replay

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]
PERIOD_S = 0.5


def seconds(message: Any) -> float:
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def test_standard_messages_of_now_and_of_the_next_seconds(stage, ring_csv: Path) -> None:
    about = {"source": str(ring_csv), "ring": 100.0, "rate": 0.0, "wait_for": ["/drivers"]}
    replay = Replay(parameter_overrides=[Parameter(k, value=v) for k, v in about.items()])
    names = {"odometry": Odometry, "predicted_path": PathMessage, "predicted_odometry": Odometry}
    estimator = OneDriver(0, publish=[*names])
    heard: dict[str, list[Any]] = defaultdict(list)
    ears = Node("ears")
    for name, kind in names.items():
        ears.create_subscription(kind, f"/vehicle_00/{name}", heard[name].append, STREAM)
    stage.add(replay, estimator, ears)
    stage.until(lambda: bool(heard["odometry"]) and seconds(heard["odometry"][-1]) >= 99.5)
    stage.until(lambda: seconds(heard["predicted_path"][-1]) >= 99.0)

    radius = 100.0 / (2.0 * np.pi)
    last = heard["odometry"][-1]
    assert np.hypot(last.pose.pose.position.x, last.pose.pose.position.y) == pytest.approx(radius)
    assert last.twist.twist.linear.x == pytest.approx(estimator.follower.filter.kalman.x[1])
    covariance = np.reshape(last.pose.covariance, (6, 6))
    var = estimator.follower.filter.kalman.P[0, 0]
    assert np.trace(covariance[:2, :2]) == pytest.approx(var)
    # the road turns, so the direction is as uncertain as the place on the circle, and the driver may turn aside by 0.1;
    # a filter of positions along a road knows nothing of height, roll and pitch
    assert covariance[5, 5] == pytest.approx(var / radius**2 + 0.01)
    assert covariance.diagonal()[2:5].tolist() == [1e6] * 3
    np.linalg.cholesky(covariance + 1e-9 * np.eye(6))
    twist = np.reshape(last.twist.covariance, (6, 6))
    assert twist.diagonal().tolist() == pytest.approx([estimator.follower.filter.kalman.P[1, 1], *[1e6] * 5])
    # all of the variance of the place lies along the road
    across = np.array([last.pose.pose.position.x, last.pose.pose.position.y]) / radius
    assert across @ covariance[:2, :2] @ across == pytest.approx(0.0, abs=1e-9)

    path = heard["predicted_path"][-1]
    times = np.array([seconds(pose) for pose in path.poses]) - seconds(path)
    assert times == pytest.approx(PERIOD_S * np.arange(11))
    stage.until(lambda: seconds(heard["predicted_odometry"][-1]) == seconds(path) + 5.0)
    of_then = heard["predicted_odometry"][-5:]
    assert [seconds(m) - seconds(path) for m in of_then] == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0])
    spreads = [np.trace(np.reshape(m.pose.covariance, (6, 6))[:2, :2]) for m in of_then]
    assert np.all(np.diff(spreads) > 0.0)
    at = of_then[-1].pose.pose.position
    assert (at.x, at.y) == pytest.approx((path.poses[-1].pose.position.x, path.poses[-1].pose.position.y))


def test_an_unknown_output_is_refused(stage) -> None:
    with pytest.raises(InputError, match="'steering' is not known; give odometry, predicted_path"):
        OneDriver(0, publish=["steering"])


def test_an_estimator_hears_a_sensor_on_a_remapped_topic(stage) -> None:
    """Best effort and volatile, on another name; until then, the health says on which topic nothing was heard."""
    estimator = OneDriver(1, cli_args=["--ros-args", "-r", "measured:=/perception/seen"])
    world = Node("world")
    to_road = world.create_publisher(Road, "/road", qos_profile_sensor_data)
    to_measured = world.create_publisher(MeasuredPositions, "/perception/seen", qos_profile_sensor_data)
    stage.add(estimator, world)
    stage.until(lambda: estimator.health().message == "waiting for a road on /road")

    def tell_road() -> bool:
        to_road.publish(Road(circumference_m=0.0, period_s=0.1))
        return "nothing heard on /perception/seen yet" in estimator.health().message

    stage.until(tell_road)
    step = iter(range(100_000))

    def tell_positions() -> bool:
        k = next(step)
        message = MeasuredPositions(vehicle=[1, 2], leader=[2, -1], position_m=[1.0 * k, 1.0 * k + 30.0])
        message.step, message.length_m = k, [4.5, 4.5]
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(k * 100_000_000, 1_000_000_000)
        to_measured.publish(message)
        return estimator.health().message.startswith("following")

    stage.until(tell_positions)
