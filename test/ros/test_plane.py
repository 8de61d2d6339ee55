"""From places in the plane to the heading of each vehicle and the way ahead of it."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from sugiyama_ros.nodes.base.qos import STREAM
from sugiyama_ros.nodes.tracks import TracksNode

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]
nav_msgs = pytest.importorskip("nav_msgs.msg", reason="nav_msgs is not installed")

RADIUS_M, SPEED, RATE_HZ, AHEAD_S = 50.0, 10.0, 10, 3.0
START_M = {1: 0.0, 2: 30.0}


def odometry(car: int, time_s: float, rng: np.random.Generator) -> Any:
    """What a car on a circle to the left says of itself."""
    angle = (START_M[car] + SPEED * time_s) / RADIUS_M
    message = nav_msgs.Odometry()
    message.header.frame_id = "map"
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(time_s * 1e9), 1_000_000_000)
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    orientation.z, orientation.w = float(np.sin(0.5 * angle + np.pi / 4.0)), float(np.cos(0.5 * angle + np.pi / 4.0))
    position.x, position.y = (RADIUS_M * np.array([np.cos(angle), np.sin(angle)]) + rng.normal(0, 0.1, 2)).tolist()
    message.pose.covariance[0] = 0.01
    return message


def heading_of(pose: Any) -> float:
    return 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)


def seconds(message: Any) -> float:
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def test_heading_and_way_ahead_are_published(stage, tmp_path: Path) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 201)
    x, y = RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle)
    line = tmp_path / "line.csv"
    line.write_text("x,y\n" + "\n".join(f"{a:.6f},{b:.6f}" for a, b in zip(x, y, strict=True)))
    given = {"centre_line": str(line), "topics": ["/car*/odom"], "ahead": AHEAD_S}
    node, world = TracksNode(parameter_overrides=[Parameter(k, value=v) for k, v in given.items()]), Node("world")
    to_car = {car: world.create_publisher(nav_msgs.Odometry, f"/car{car}/odom", 10) for car in START_M}
    heard: dict[str, list[Any]] = defaultdict(list)
    for car in START_M:
        for name, kind in (("plane_odometry", nav_msgs.Odometry), ("plane_path", nav_msgs.Path)):
            topic = f"/vehicle_0{car}/{name}"
            world.create_subscription(kind, topic, heard[topic].append, STREAM)
    stage.add(world, node)
    stage.until(lambda: all(p.get_subscription_count() == 1 for p in to_car.values()))
    rng, sent = np.random.default_rng(4), 0
    for k in range(120):
        for car, publisher in to_car.items():
            publisher.publish(odometry(car, k / RATE_HZ + 0.01 * car, rng))
            sent += 1
            stage.until(lambda n=sent: node.received == n)
    stage.until(lambda: seconds(heard["/vehicle_01/plane_odometry"][-1]) > 11.7)
    for car, start_m in START_M.items():
        states, paths = heard[f"/vehicle_0{car}/plane_odometry"], heard[f"/vehicle_0{car}/plane_path"]
        off = [
            np.angle(np.exp(1j * (heading_of(m.pose.pose) - (start_m + SPEED * seconds(m)) / RADIUS_M - np.pi / 2.0)))
            for m in states[50:]
        ]
        # the reference point lies before the rear axle, which is what points along the circle
        assert np.abs(np.array(off) + 1.4 / RADIUS_M).max() < 0.05
        last = states[-1]
        assert (last.header.frame_id, last.child_frame_id) == ("map", f"vehicle_0{car}")
        assert last.twist.twist.angular.z == pytest.approx(SPEED / RADIUS_M, abs=0.05)
        np.linalg.cholesky(np.reshape(last.pose.covariance, (6, 6)))
        assert np.diff([seconds(path) for path in paths]).tolist() == pytest.approx([1.0] * (len(paths) - 1))
        path = paths[-1]
        assert seconds(path.poses[-1]) - seconds(path) == pytest.approx(AHEAD_S)
        then = (start_m + SPEED * seconds(path.poses[-1])) / RADIUS_M
        end = path.poses[-1].pose.position
        assert np.hypot(end.x - RADIUS_M * np.cos(then), end.y - RADIUS_M * np.sin(then)) < 3.0
