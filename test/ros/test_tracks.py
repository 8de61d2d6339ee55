"""From Odometry on a curved road with two lanes to `measured`: lanes, leaders, cars that come and go."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import serialize_message
from sugiyama_msgs.msg import MeasuredPositions, Road

from sugiyama_ros.bridges.from_bag import tracks_of_bag
from sugiyama_ros.bridges.perception import PerceptionSettings
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.centre_line import read_lanes
from sugiyama_ros.formats.mcap_writer import BagWriter, Qos
from sugiyama_ros.nodes.base.node import OK
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.tracks import TracksNode
from sugiyama_ros.trajectories.tracks import NOBODY

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]
Odometry = pytest.importorskip("nav_msgs.msg", reason="nav_msgs is not installed").Odometry

RADIUS_M, LANE_M, SPEED, END_S, RATE_HZ = 200.0, 3.5, 10.0, 15.0, 10
#: Where each car starts [m], from when to when it is seen [s], and from when on it changes to the other lane, in 2 s.
START_M = {1: 100.0, 2: 140.0, 3: 180.0, 4: 120.0, 5: 60.0}
SEEN_S = {1: (0.0, END_S), 2: (0.0, END_S), 3: (0.0, 13.0), 4: (0.0, END_S), 5: (8.0, END_S)}
CHANGES_S = {2: 5.0, 4: 10.0}
SOON_S = 0.5


def across(car: int, time_s: float) -> float:
    """How far [m] a car is to the left of the right lane: car 2 goes to the left lane, car 4 cuts in from there."""
    begin = CHANGES_S.get(car, np.inf)
    done = float(np.clip((time_s - begin) / 2.0, 0.0, 1.0))
    part = 0.5 - 0.5 * np.cos(np.pi * done)
    return LANE_M * (1.0 - part if car == 4 else part)


def true_leaders(time_s: float) -> dict[int, int]:
    """Who is directly ahead of whom on the same lane; -1 for nobody."""
    here = [car for car, (begin, end) in SEEN_S.items() if begin <= time_s < end]
    lane = {car: across(car, time_s) > 0.5 * LANE_M for car in here}
    found = {}
    for car in here:
        ahead = [other for other in here if lane[other] == lane[car] and START_M[other] > START_M[car]]
        found[car] = min(ahead, key=START_M.__getitem__, default=-1)
    return found


def odometry(car: int, time_s: float, rng: np.random.Generator) -> Any:
    """What a car says of itself. The road bends to the left."""
    angle = (START_M[car] + SPEED * time_s) / RADIUS_M
    off = RADIUS_M - across(car, time_s)
    message = Odometry()
    message.header.frame_id = "map"
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(time_s * 1e9), 1_000_000_000)
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y = (float(v) for v in off * np.array([np.cos(angle), np.sin(angle)]) + rng.normal(0, 0.1, 2))
    orientation.z, orientation.w = float(np.sin(0.5 * angle + np.pi / 4.0)), float(np.cos(0.5 * angle + np.pi / 4.0))
    message.pose.covariance[0] = 0.01
    return message


def write_line(path: Path) -> Path:
    lines = ["x,y,lane,width"]
    for lane, radius in (("0", RADIUS_M), ("1", RADIUS_M - LANE_M)):
        for angle in np.arange(0.0, 3.0, 0.02):
            lines.append(f"{radius * np.cos(angle):.6f},{radius * np.sin(angle):.6f},{lane},{LANE_M}")
    path.write_text("\n".join(lines) + "\n")
    return path


class World(Node):
    """Five cars that publish their Odometry, one of them as a sensor does, and a listener to what becomes of it."""

    def __init__(self) -> None:
        super().__init__("world")
        self.of = {
            car: self.create_publisher(Odometry, f"/car{car}/odom", qos_profile_sensor_data if car == 5 else 10)
            for car in START_M
        }
        self.roads: list[Road] = []
        self.samples: list[MeasuredPositions] = []
        self.create_subscription(Road, "road", self.roads.append, LATCHED)
        self.create_subscription(MeasuredPositions, "measured", self.samples.append, STREAM)


def test_odometry_becomes_vehicles_on_lanes_with_leaders(stage, tmp_path: Path) -> None:
    line, rng = write_line(tmp_path / "line.csv"), np.random.default_rng(2)
    given = {"centre_line": str(line), "topics": ["/car*/odom"]}
    node = TracksNode(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    world = World()
    stage.add(world, node)
    stage.until(lambda: all(p.get_subscription_count() == 1 for p in world.of.values()))
    sent = 0
    with BagWriter(tmp_path / "seen.mcap") as bag:
        channel = {car: bag.topic(f"/car{car}/odom", "nav_msgs/msg/Odometry", Qos()) for car in START_M}
        for k in range(round(END_S * RATE_HZ)):
            for car, (begin, end) in SEEN_S.items():
                time_s = k / RATE_HZ + 0.003 * car  # each car has its own stamps
                if begin <= k / RATE_HZ < end:
                    message = odometry(car, time_s, rng)
                    world.of[car].publish(message)
                    bag.write(channel[car], serialize_message(message), round(time_s * 1e9), round(time_s * 1e9))
                    sent += 1
                    # what is seen first decides when samples are, so the messages come in the order of the bag
                    stage.until(partial(lambda n: node.received == n, sent))
    stage.until(lambda: len(world.samples) >= END_S * RATE_HZ - 1)
    assert node.health().level == OK
    assert vars(node._perception.moments.counts)["late"] == 0
    assert world.roads[0].period_s == 0.1

    live = {}
    for message in world.samples:
        stamp_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        allowed = [true_leaders(t) for t in np.arange(max(stamp_s - SOON_S, 0.0), stamp_s + 0.051, 0.05)]
        for k, car in enumerate(message.vehicle):
            time_s = stamp_s + message.stamp_offset_s[k]
            assert message.leader[k] in {leaders.get(car) for leaders in allowed}, (stamp_s, car)
            # noise of 0.1 m, and on the inner lane the line of the outer one is longer; six standard deviations
            assert message.position_m[k] == pytest.approx(START_M[car] + SPEED * time_s, abs=0.7)
            assert message.d_m[k] == pytest.approx(across(car, time_s) - LANE_M * message.lane[k], abs=0.7)
            assert abs(message.stamp_offset_s[k]) <= 0.05
            assert message.position_var[k] == 0.01
            live[round(stamp_s, 6), str(car)] = message.position_m[k], message.lane[k], message.leader[k]
    leaders_of_1 = [live[key][2] for key in sorted(live) if key[1] == "1"]
    assert list(dict.fromkeys(leaders_of_1)) == [2, 3, 4]
    assert {key[1] for key in live} == {"1", "2", "3", "4", "5"}
    assert max(key[0] for key in live if key[1] == "3") < 13.1
    assert min(key[0] for key in live if key[1] == "5") >= 7.95

    tracks = tracks_of_bag(tmp_path / "seen.mcap", "/car*/odom", read_lanes(line), PerceptionSettings())
    assert tracks.lane is not None
    leader = tracks.leader
    offline = {
        (round(float(tracks.time_s[k]), 6), tracks.vehicle.at(k)): (
            tracks.s_m[k],
            int(tracks.lane.at(k)),
            -1 if leader.at(k) == NOBODY else int(leader.at(k)),
        )
        for k in range(len(tracks))
    }
    assert live.items() <= offline.items()
    assert len(offline) - len(live) <= 4  # the last sample is complete only at the end of the bag
    with pytest.raises(InputError, match="no topic /bus"):
        tracks_of_bag(tmp_path / "seen.mcap", "/bus*", read_lanes(line), PerceptionSettings())


def test_what_cannot_be_used_is_told(stage, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no centre line or no topics given"):
        TracksNode()
    given = {"centre_line": str(write_line(tmp_path / "line.csv")), "topics": ["/road", "/nothing"]}
    node = TracksNode(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    stage.add(node)
    stage.for_a_while(0.3)
    assert "no topic /road, /nothing of a known type" in node.health().message
