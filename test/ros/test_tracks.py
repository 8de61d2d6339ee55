"""From Odometry on a curved road with two lanes to `measured`: lanes, leaders, cars that come and go."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from sugiyama_msgs.msg import DriverArray, MeasuredPositions, Road
from typer.testing import CliRunner

from sugiyama_ros.bridges.from_bag import tracks_of_bag
from sugiyama_ros.bridges.perception import PerceptionSettings
from sugiyama_ros.cli.app import app
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.centre_line import read_lanes
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.nodes.base.node import OK
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.recorder import Recorder
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
    """Who is directly ahead of whom on the same lane; -1 for nobody, -2 where one was lost that may still be there."""
    here = [car for car, (begin, end) in SEEN_S.items() if begin <= time_s < end]
    lane = {car: across(car, time_s) > 0.5 * LANE_M for car in here}
    found = {}
    for car in here:
        ahead = [other for other in here if lane[other] == lane[car] and START_M[other] > START_M[car]]
        lost = car in (1, 4) and time_s >= SEEN_S[3][1]
        found[car] = min(ahead, key=START_M.__getitem__, default=-2 if lost else -1)
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
        self.drivers: list[DriverArray] = []
        self.create_subscription(MeasuredPositions, "measured", self.samples.append, STREAM)
        self.create_subscription(DriverArray, "drivers", self.drivers.append, STREAM)


def check_drivers(heard: list[DriverArray], node: DriversNode) -> None:
    """Drivers are made and retired; what 15 s tell of them is identified, and the truth lies within three stds."""
    came = {v: next(m for m in heard if v in m.vehicle).header.stamp.sec for v in START_M}
    assert came == {1: 0, 2: 0, 3: 0, 4: 0, 5: came[5]}
    assert came[5] in (7, 8)
    last = heard[-1]
    assert sorted(last.vehicle) == [1, 2, 4, 5]  # car 3 left at 13 s
    assert set(node.drivers) == {1, 2, 4, 5}
    names, estimated = list(last.name), np.flatnonzero(last.estimated)
    adapted = [names[k] for k in estimated]
    identified = np.reshape(last.identified, (len(last.vehicle), len(adapted)))
    value = np.reshape(last.value, (len(last.vehicle), len(names)))
    covariance = np.reshape(last.parameter_covariance, (len(last.vehicle), len(adapted), len(adapted)))
    noise = adapted.index("sigma_nu")
    assert identified[:, noise].all()
    # the positions are noisy by 0.1 m along the road
    std = np.sqrt(covariance[:, noise, noise])
    assert np.all(np.abs(value[:, names.index("sigma_nu")] - 0.1) < 3.0 * std + 0.02), (value[:, 0], std)
    # who drives alone at 10 m/s wants to
    free = list(last.vehicle).index(2)
    v_star = adapted.index("v_star")
    assert identified[free, v_star]
    assert abs(value[free, names.index("v_star")] - SPEED) < 3.0 * np.sqrt(covariance[free, v_star, v_star])


def drive(stage, world: World, node: TracksNode, recorder: Recorder) -> None:
    """Let the five cars tell where they are, each at stamps of its own, until all of it has been taken in."""
    rng, sent = np.random.default_rng(2), 0
    stage.until(lambda: all(p.get_subscription_count() == 2 for p in world.of.values()))
    for k in range(round(END_S * RATE_HZ)):
        for car, (begin, end) in SEEN_S.items():
            if begin <= k / RATE_HZ < end:
                world.of[car].publish(odometry(car, k / RATE_HZ + 0.003 * car, rng))
                sent += 1
                # what is seen first decides when samples are, so the messages reach all in the order of the bag
                stage.until(partial(lambda n: node.received == n == recorded(recorder, "/car"), sent))
    stage.until(lambda: len(world.samples) >= END_S * RATE_HZ - 1)
    stage.until(lambda: len(world.drivers) == len(world.samples) == recorded(recorder, "/drivers"))


def recorded(recorder: Recorder, begin: str) -> int:
    """Messages recorded so far on the topics whose names begin so."""
    return sum(count for topic, count in recorder.counts.items() if topic.startswith(begin))


def test_odometry_becomes_vehicles_on_lanes_with_leaders_in_one_bag(stage, tmp_path: Path) -> None:
    line, bag = write_line(tmp_path / "line.csv"), tmp_path / "drive.mcap"
    given = {"centre_line": str(line), "topics": ["/car*/odom"]}
    node = TracksNode(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    world = World()
    drivers = DriversNode(parameter_overrides=[Parameter("retire_after", value=0.8)])
    recorder = Recorder(parameter_overrides=[Parameter("output", value=str(bag))])
    stage.add(world, node, drivers, recorder)
    drive(stage, world, node, recorder)
    recorder.finish()
    recorder.close()
    with Bag(bag) as opened:
        kept = [deserialize_message(raw, DriverArray) for _, _, _, raw in opened.raw_messages({"/drivers"})]
    assert list(map(str, kept)) == list(map(str, world.drivers))
    check_drivers(kept, drivers)
    assert node.health().level == OK
    assert node._perception.counts.late == 0
    assert world.roads[0].period_s == 0.1
    live = check_samples(world.samples)
    check_converted(live, bag, line, tmp_path / "tracks.parquet")
    with pytest.raises(InputError, match="no topic /bus"):
        tracks_of_bag(bag, "/bus*", read_lanes(line), PerceptionSettings())


Rows = dict[tuple[float, str], tuple[float, int, int]]


def check_samples(samples: list[MeasuredPositions]) -> Rows:
    """Positions, lanes and leaders are right; position, lane and leader of each row, by time and vehicle."""
    live = {}
    for message in samples:
        stamp_s = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        allowed = [true_leaders(t) for t in np.arange(max(stamp_s - SOON_S, 0.0), stamp_s + 0.051, 0.05)]
        for k, car in enumerate(message.vehicle):
            time_s = stamp_s + message.stamp_offset_s[k]
            known = {leaders.get(car) for leaders in allowed}
            # in the first second somebody may be ahead of whom nothing was heard yet
            assert message.leader[k] in known or (message.leader[k] == -2 and known == {-1} and stamp_s < 1.0), car
            if np.isnan(message.position_m[k]):  # not seen now, and not taken for gone yet
                assert SEEN_S[car][1] <= stamp_s <= SEEN_S[car][1] + 0.15
                continue
            # noise of 0.1 m, and on the inner lane the line of the outer one is longer; six standard deviations
            assert message.position_m[k] == pytest.approx(START_M[car] + SPEED * time_s, abs=0.7)
            assert message.d_m[k] == pytest.approx(across(car, time_s) - LANE_M * message.lane[k], abs=0.7)
            assert abs(message.stamp_offset_s[k]) <= 0.05
            assert message.position_var[k] == 0.01
            position_m = message.position_m[k] - SPEED * message.stamp_offset_s[k]
            live[round(stamp_s, 6), str(car)] = position_m, message.lane[k], message.leader[k]
    leaders_of_1 = [live[key][2] for key in sorted(live) if key[1] == "1"]
    assert list(dict.fromkeys(leaders_of_1)) == [2, 3, 4]
    assert {key[1] for key in live} == {"1", "2", "3", "4", "5"}
    assert max(key[0] for key in live if key[1] == "3") < 13.1
    assert min(key[0] for key in live if key[1] == "5") >= 7.95

    return live


def check_converted(live: Rows, bag: Path, line: Path, output: Path) -> None:
    """`sugiyama convert` reads the same rows from the bag, with positions that are interpolated."""
    given = ["convert", str(bag), str(output), "--odometry", "/car*/odom", "--centerline", str(line)]
    said = CliRunner().invoke(app, given)
    assert said.exit_code == 0, said.output
    tracks = read_tracks(output)
    assert tracks.lane is not None
    leader = tracks.leader
    numbers = {NOBODY: -1, None: -2}
    offline = {
        (round(float(tracks.time_s[k]), 6), tracks.vehicle.at(k)): (
            tracks.s_m[k],
            int(tracks.lane.at(k)),
            numbers[name] if (name := leader.at(k) if leader.code[k] >= 0 else None) in numbers else int(name),
        )
        for k in range(len(tracks))
    }
    # a car whose samples lie behind the times has no row at its first one, and the last sample is complete at the end
    assert len(offline.keys() - live.keys()) <= 4
    assert len(live.keys() - offline.keys()) <= 5
    both = live.keys() & offline.keys()
    same = [live[key][1:] == offline[key][1:] or live[key][2] == -2 for key in both]
    assert np.mean(same) > 0.98  # noise decides when a car is on the other lane
    assert max(abs(live[key][0] - offline[key][0]) for key in both) < 0.6


def test_what_cannot_be_used_is_told(stage, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no centre line or no topics given"):
        TracksNode()
    given = {"centre_line": str(write_line(tmp_path / "line.csv")), "topics": ["/road", "/nothing"]}
    node = TracksNode(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    stage.add(node)
    stage.for_a_while(0.3)
    assert "no topic /road, /nothing of a known type" in node.health().message
