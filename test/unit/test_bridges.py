"""Bridges: fields of messages, frames, and samples at regular times."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest

from sugiyama_ros.bridges.fields import read_bridge, yaw
from sugiyama_ros.bridges.frames import Frames
from sugiyama_ros.bridges.moments import Moments, Numbers, RoadMoment
from sugiyama_ros.bridges.perception import PerceptionSettings
from sugiyama_ros.bridges.registry import BRIDGES
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.bag_folder import bag_files
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
        SeenVehicle(2_500_000_000, "17", 1.0, 2.0, math.pi / 2.0, 4.2, math.nan, "", "map"),
    ),
    "autoware_perception_msgs/msg/TrackedObjects": (
        Message(
            header=header(),
            objects=[
                Message(
                    object_id=Message(uuid=np.arange(16, dtype=np.uint8)),
                    kinematics=Message(pose_with_covariance=Message(pose=pose(1.0, 2.0), covariance=[0.09] * 36)),
                    shape=Message(dimensions=Message(x=5.0, y=2.0, z=1.5)),
                )
            ],
        ),
        SeenVehicle(2_500_000_000, bytes(range(16)).hex(), 1.0, 2.0, math.pi / 2.0, 5.0, 0.09, "", "map"),
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
        SeenVehicle(2_500_000_000, "3", 1.0, 2.0, math.pi / 2.0, 4.0, math.nan, "6", "map"),
    ),
}


@pytest.mark.parametrize("kind", BRIDGES)
def test_each_bridge(kind: str) -> None:
    message, expected = CASES[kind]
    (found,) = BRIDGES[kind].seen(message, "/car")
    for name, value in vars(expected).items():
        known = getattr(found, name)
        assert known == (pytest.approx(value, nan_ok=True) if isinstance(value, float) else value), name
    with pytest.raises(InputError, match="no field"):
        list(BRIDGES[kind].seen(Message(header=header(), detections=[1], objects=[1]), "/car"))


def test_a_bridge_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "bridge.yaml"
    path.write_text(
        "type: radar_msgs/msg/Targets\nobjects: targets\nid: number\nx: at[0]\ny: at[1]\nheading: yaw\n"
        "stamp: time\nframe: ''\n"
    )
    target = Message(number=4, at=[1.0, 2.0], yaw=0.5)
    (found,) = read_bridge(path).seen(Message(time=1.25, targets=[target]), "/radar")
    assert (found.stamp_ns, found.name, found.x_m, found.y_m, found.heading) == (1_250_000_000, "4", 1.0, 2.0, 0.5)
    for text, why in (
        ("type: a/msg/B\nx: x\n", "give type, x, y"),
        ("type: a/msg/B\nx: x\ny: y\nz: z\n", "give type, x, y"),
        ("type: B\nx: x\ny: y\n", "not the type of a message"),
        ("type: a/msg/B\nx: x\ny: __import__('os')\n", "not the path of a field"),
        ("type: a/msg/B\nx: 3\ny: y\n", "not the path of a field"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=why):
            read_bridge(path)


def test_fields_that_are_no_numbers_are_refused() -> None:
    message, _ = CASES["nav_msgs/msg/Odometry"]
    odometry = BRIDGES["nav_msgs/msg/Odometry"]
    for name, path in (("x", "header.frame_id"), ("y", "pose"), ("heading", "header.frame_id"), ("stamp", "pose.pose")):
        with pytest.raises(InputError, match=r"is no (number|time); correct the bridge"):
            list(replace(odometry, **{name: path}).seen(message, "/car"))
    assert math.isnan(yaw(1e308, 0.0, 0.0, 1.0))
    assert math.isnan(yaw(math.nan, 0.0, 0.0, 1.0))


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
    """A car at (10, 5) that points to the left sees another one 8 m ahead; the map is turned by 30 degrees."""
    frames = Frames()
    frames.add(transform("map", "odom", 0.0, 100.0, 0.0, math.pi / 6.0), static=True)
    frames.add(transform("odom", "car", 2.0, 10.0, 5.0, math.pi / 2.0), static=False)
    frames.add(transform("odom", "car", 3.0, 90.0, 90.0, 0.0), static=False)  # later than what was seen
    seen = frames.brought(SeenVehicle(2_500_000_000, "a", 8.0, 0.0, 0.0, frame="car"), "map")
    assert seen is not None
    cos, sin = math.cos(math.pi / 6.0), math.sin(math.pi / 6.0)
    assert seen.x_m == pytest.approx(100.0 + cos * 10.0 - sin * 13.0, abs=1e-12)
    assert seen.y_m == pytest.approx(sin * 10.0 + cos * 13.0, abs=1e-12)
    assert seen.heading == pytest.approx(math.pi / 2.0 + math.pi / 6.0)
    back = frames.brought(seen, "car")
    assert back is not None
    assert (back.x_m, back.y_m) == (pytest.approx(8.0), pytest.approx(0.0, abs=1e-12))
    for stamp_ns, frame in ((1_000_000_000, "car"), (9_000_000_000, "car"), (2_500_000_000, "elsewhere")):
        assert frames.brought(SeenVehicle(stamp_ns, "a", 8.0, 0.0, frame=frame), "map") is None


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
    assert named(list(moments.rest())) == [(3, "a")]
    assert [m.stamp_ns for m in found] == [5_000_000_000, 5_100_000_000, 5_200_000_000]


def test_time_may_begin_anew_but_one_stale_vehicle_is_left_out() -> None:
    moments, found = road(), []
    for k in range(20):
        found += list(moments.take([at(50.0 + 0.1 * k, "a"), at(40.0, "stale")]))
    assert named(found) == [(k, "a") for k in range(19)]
    assert moments.counts.late == 20
    for k in range(20):
        found += list(moments.take([at(0.1 * k, "a")]))
    assert [m.step for m in found] == sorted({m.step for m in found})
    assert found[-1].stamp_ns < 2_000_000_000


def test_numbers_of_vehicles() -> None:
    numbers = Numbers()
    assert [numbers(name) for name in ("/car7/odom", "bus", "/van7/odom", "/car3/odom", "", "bus")] == [
        7,
        8,
        9,
        3,
        -1,
        8,
    ]


def test_directories_of_rosbag2(tmp_path: Path) -> None:
    about = "rosbag2_bagfile_information:\n  storage_identifier: {}\n  relative_file_paths: [b_0.mcap, b_1.mcap]\n"
    (tmp_path / "metadata.yaml").write_text(about.format("mcap"))
    assert bag_files(tmp_path) == [tmp_path / "b_0.mcap", tmp_path / "b_1.mcap"]
    assert bag_files(tmp_path / "b_0.mcap") == [tmp_path / "b_0.mcap"]
    for text, why in ((about.format("sqlite3"), "not mcap"), ("a: 1\n", "is not of a bag")):
        (tmp_path / "metadata.yaml").write_text(text)
        with pytest.raises(InputError, match=why):
            bag_files(tmp_path)


@pytest.mark.parametrize("settings", [{"period_s": math.nan}, {"period_s": 0.0}, {"length_m": -1.0}])
def test_settings_with_which_nobody_can_be_followed(settings: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"is not"):
        PerceptionSettings(**settings)
