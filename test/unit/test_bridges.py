"""Bridges: fields of messages, frames, and samples at regular times."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest

from sugiyama_ros.bridges.bridge import BRIDGES, read_bridge
from sugiyama_ros.bridges.frames import EARLY, Frames
from sugiyama_ros.bridges.perception import Moments, Perception, PerceptionSettings, RoadMoment
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.centre_line import CentreLine, RoadLanes
from sugiyama_ros.trajectories.placing import Placer, SeenVehicle

HALF = math.sqrt(0.5)


def header(time_s: float = 2.5, frame: str = "map") -> Any:
    return Message(stamp=Message(sec=int(time_s), nanosec=round(time_s % 1 * 1e9)), frame_id=frame)


def pose(x: float, y: float) -> Any:
    """A pose that points to the left of x."""
    return Message(position=Message(x=x, y=y, z=0.0), orientation=Message(x=0.0, y=0.0, z=HALF, w=HALF))


CASES = {
    "nav_msgs/msg/Odometry": (
        Message(header=header(), pose=Message(pose=pose(1.0, 2.0), covariance=[0.04] + [0.0] * 35)),
        SeenVehicle(2_500_000_000, "/car", 1.0, 2.0, math.pi / 2.0, math.nan, 0.04, "", "map"),
    ),
    "vision_msgs/msg/Detection3DArray": (
        Message(
            header=header(),
            detections=[Message(header=header(), id="17", bbox=Message(center=pose(1.0, 2.0), size=Message(x=4.2)))],
        ),
        SeenVehicle(2_500_000_000, "/car 17", 1.0, 2.0, math.pi / 2.0, 4.2, math.nan, "", "map"),
    ),
    "autoware_perception_msgs/msg/TrackedObjects": (
        Message(
            header=header(),
            objects=[
                Message(
                    object_id=Message(uuid=np.arange(16, dtype=np.uint8)),
                    kinematics=Message(
                        pose_with_covariance=Message(pose=pose(1.0, 2.0), covariance=[0.09] * 36),
                        orientation_availability=2,
                    ),
                    shape=Message(dimensions=Message(x=5.0, y=2.0, z=1.5)),
                    classification=[Message(label=1, probability=0.3), Message(label=6, probability=0.6)],
                )
            ],
        ),
        SeenVehicle(
            2_500_000_000, "/car " + bytes(range(16)).hex(), 1.0, 2.0, math.pi / 2.0, 5.0, 0.09, "bicycle", "map"
        ),
    ),
    "derived_object_msgs/msg/ObjectArray": (
        Message(
            header=header(),
            objects=[
                Message(
                    header=header(),
                    id=3,
                    pose=pose(1.0, 2.0),
                    shape=Message(dimensions=[4.0, 2.0, 1.5]),
                    classification=6,
                )
            ],
        ),
        SeenVehicle(2_500_000_000, "/car 3", 1.0, 2.0, math.pi / 2.0, 4.0, math.nan, "car", "map"),
    ),
}


@pytest.mark.parametrize("kind", BRIDGES)
def test_each_bridge(kind: str) -> None:
    message, expected = CASES[kind]
    (found,) = BRIDGES[kind].seen(message, "/car", 0)
    for name, value in vars(expected).items():
        known = getattr(found, name)
        assert known == (pytest.approx(value, nan_ok=True) if isinstance(value, float) else value), name
    with pytest.raises(InputError, match="no field"):
        list(BRIDGES[kind].seen(Message(header=header(), detections=[1], objects=[1]), "/car", 0))


def test_a_bridge_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "bridge.yaml"
    path.write_text(
        "type: radar_msgs/msg/Targets\nobjects: targets\nid: number\nx: at[0]\ny: at[1]\nheading: yaw\n"
        "stamp: time\nframe: ''\n"
    )
    target = Message(number=4, at=[1.0, 2.0], yaw=0.5)
    (found,) = read_bridge(path).seen(Message(time=1.25, targets=[target]), "/radar", 0)
    assert (found.stamp_ns, found.name, found.x_m, found.y_m, found.heading) == (
        1_250_000_000,
        "/radar 4",
        1.0,
        2.0,
        0.5,
    )
    with pytest.raises(InputError, match="time is no list; name the list, or leave out objects"):
        list(replace(read_bridge(path), objects="time").seen(Message(time=1.25, targets=[target]), "/radar", 0))
    for text, why in (
        ("type: a/msg/B\nx: x\n", "give type, x, y"),
        ("type: a/msg/B\nx: x\ny: y\nz: z\n", "give type, x, y"),
        ("type: B\nx: x\ny: y\n", "not the type of a message"),
        ("type: a/msg/B\nx: x\ny: __import__('os')\n", "not the path of a field"),
        ("type: a/msg/B\nx: 3\ny: y\n", "not the path of a field"),
        ("type: a/msg/B\nx: x\ny: y\nstamp_unit: minutes\n", "give s or ms or us or ns"),
        ("type: a/msg/B\nx: x\ny: y\norientation_order: zyxw\n", "give xyzw or wxyz"),
        ("type: a/msg/B\nx: x\ny: y\nheading_known: state\n", "path of a field and its value"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=why):
            read_bridge(path)


def transform(parent: str, child: str, time_s: float, x: float, y: float, angle: float) -> Any:
    one = Message(
        header=header(time_s, parent),
        child_frame_id=child,
        transform=Message(
            translation=Message(x=x, y=y, z=0.0),
            rotation=Message(x=0.0, y=0.0, z=math.sin(angle / 2.0), w=math.cos(angle / 2.0)),
        ),
    )
    return Message(transforms=[one])


def test_frames_against_closed_forms() -> None:
    """A car that turns from left to right drives from (10, 5) to (12, 6), and sees another one 8 m ahead."""
    frames = Frames()
    frames.add(transform("map", "odom", 0.0, 100.0, 0.0, math.pi / 6.0), static=True)
    frames.add(transform("odom", "car", 2.0, 10.0, 5.0, math.pi / 2.0), static=False)
    seen = SeenVehicle(2_250_000_000, "a", 8.0, 0.0, 0.0, frame="car")
    assert frames.brought(seen, "map") is EARLY
    frames.add(transform("odom", "car", 3.0, 12.0, 6.0, 0.0), static=False)
    found = frames.brought(seen, "map")
    assert isinstance(found, SeenVehicle)
    # a quarter of the way: at (10.5, 5.25), 67.5 degrees to the left, on a map that is turned by 30 degrees
    angle = 0.75 * math.pi / 2.0
    x, y = 10.5 + 8.0 * math.cos(angle), 5.25 + 8.0 * math.sin(angle)
    cos, sin = math.cos(math.pi / 6.0), math.sin(math.pi / 6.0)
    assert (found.x_m, found.y_m) == pytest.approx((100.0 + cos * x - sin * y, sin * x + cos * y), abs=1e-12)
    assert found.heading == pytest.approx(angle + math.pi / 6.0)
    back = frames.brought(found, "car")
    assert isinstance(back, SeenVehicle)
    assert (back.x_m, back.y_m) == pytest.approx((8.0, 0.0), abs=1e-12)
    at = partial(SeenVehicle, name="a", x_m=8.0, y_m=0.0)
    assert frames.brought(at(1_000_000_000, frame="car"), "map") is None
    assert frames.brought(at(9_000_000_000, frame="car"), "map") is EARLY
    assert frames.brought(at(2_500_000_000, frame="elsewhere"), "map") is EARLY


def road() -> Moments:
    line = CentreLine(np.array([0.0, 1000.0]), np.zeros(2))
    return Moments(Placer(RoadLanes(["0"], [line], [3.5])), 0.1)


def at(time_s: float, name: str, x_m: float = 0.0) -> SeenVehicle:
    return SeenVehicle(round(time_s * 1e9), name, x_m, 0.0)


def named(moments: list[RoadMoment]) -> list[tuple[int, str]]:
    return [(m.step, "".join(one.seen.name for one in m.placed)) for m in moments]


def test_moments_are_regular_and_wait_for_nothing() -> None:
    moments, found = road(), []
    for time_s, name in ((5.0, "a"), (5.02, "b"), (5.11, "a"), (5.09, "b"), (5.21, "a"), (5.12, "b"), (5.3, "a")):
        found += list(moments.take([at(time_s, name)]))
    # 5.12 belongs to the sample at 5.1, which was given out when 5.21 came
    assert named(found) == [(0, "ab"), (1, "ab"), (2, "a")]
    assert moments.counts.late == 1
    assert [m.stamp_ns for m in found] == [5_000_000_000, 5_100_000_000, 5_200_000_000]


def test_time_may_begin_anew_but_one_stale_vehicle_is_left_out() -> None:
    moments, found = road(), []
    for k in range(20):
        found += list(moments.take([at(50.0 + 0.1 * k, "a"), at(40.0, "stale")]))
    assert named(found) == [(k, "a") for k in range(19)]
    assert (moments.counts.late, moments.counts.repeated) == (1, 19)
    for k in range(20):
        found += list(moments.take([at(0.1 * k, "a")]))
    assert [m.step for m in found] == sorted({m.step for m in found})
    assert found[-1].stamp_ns < 2_000_000_000


def test_a_vehicle_without_a_sample_is_not_gone() -> None:
    """b is seen every 0.2 s between a and c, is lost at 3 s, and comes back at 4 s; c is lost for good at 5 s."""
    moments, leaders = road(), {}
    for k in range(70):
        t = 0.1 * k
        seen = [at(t, "a", 10.0 * t)]
        seen += [at(t, "b", 20.0 + 10.0 * t)] * (k % 2 == 0 and not 30 < k < 40)
        seen += [at(t, "c", 40.0 + 10.0 * t)] * (k <= 50)
        for moment in moments.take(seen):
            leaders[moment.step] = {one.seen.name: one.leader for one in (*moment.placed, *moment.carried)}
    settled = range(12, 69)
    assert all(leaders[k]["a"] == ("b" if not 33 < k < 40 else None) for k in settled), leaders
    assert all(leaders[k]["b"] == ("c" if k < 52 else None) for k in settled if not 33 < k < 40)
    assert all(leaders[k]["c"] == "" for k in settled if k < 52)
    assert all(leaders[k]["a"] != "c" for k in settled)
    assert moments.counts.carried > 20


def test_nobody_follows_a_walker() -> None:
    moments, found = road(), []
    for k in range(30):
        t = 0.1 * k
        walker = SeenVehicle(round(t * 1e9), "w", 30.0, 0.0, vehicle_class="pedestrian")
        found += list(moments.take([at(t, "a", 10.0 * t), walker, at(t, "b", 40.0 + t), at(t, "c", 60.0 + t)]))
    last = {one.seen.name: one.leader for one in (*found[-1].placed, *found[-1].carried)}
    assert last == {"a": None, "b": "c", "c": ""}
    assert moments.counts.no_driver == len(found)


def perceived(frame: str = "") -> Perception:
    line = CentreLine(np.array([0.0, 1000.0]), np.zeros(2))
    return Perception(RoadLanes(["0"], [line], [3.5]), PerceptionSettings(frame=frame))


def odometry(time_s: float, x: float, frame: str = "map") -> Any:
    straight = Message(position=Message(x=x, y=0.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))
    return Message(header=header(time_s, frame), pose=Message(pose=straight, covariance=[0.0] * 36))


ODOMETRY = BRIDGES["nav_msgs/msg/Odometry"]


def test_live_positions_wait_for_the_transform_after_them() -> None:
    """A car at 10 m/s sees another one 30 m ahead; transforms come at half the times."""
    perception, found = perceived("map"), []
    for k in range(40):
        t = 5.0 + 0.1 * k
        found += list(perception.take(odometry(t, 30.0, "car"), ODOMETRY, "/other", 0))
        found += list(perception.hear(transform("map", "car", t + 0.05, 10.0 * t + 0.5, 0.0, 0.0), static=False))
    assert len(found) >= 37
    for sample in found:
        assert sample.positions.position_m[0] == pytest.approx(1e-8 * sample.stamp_ns + 30.0, abs=1e-6)
    assert perception.counts.unknown_frame == 1  # before the first transform
    assert perception.problem().startswith("1 of 40 vehicles seen are in a frame")
    moving = perceived()
    list(moving.take(odometry(5.0, 30.0, "car"), ODOMETRY, "/other", 0))
    list(moving.hear(transform("map", "car", 5.0, 0.0, 0.0, 0.0), static=False))
    assert "car, which moves; set the parameter frame" in moving.problem()
