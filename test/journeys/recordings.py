"""Small recordings in the forms in which users have theirs, made of the same simulated drivers."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import sugiyama_ros as sg
from sugiyama_ros.trajectories.dense import DenseTracks

FOOT_M = 0.3048


@cache
def drivers(
    vehicles: int = 4, ring_m: float = 45.0, duration_s: float = 60.0, seed: int = 1, **settings: float
) -> DenseTracks:
    """What a camera measures of simulated drivers."""
    return sg.simulate(vehicles, ring_m=ring_m, duration_s=duration_s, seed=seed, **settings).dense


def table(measured: DenseTracks) -> pd.DataFrame:
    """A row for each time and vehicle."""
    steps, vehicles = measured.position_m.shape
    return pd.DataFrame(
        {
            "time_s": np.repeat(np.arange(steps) * measured.period_s, vehicles),
            "vehicle": np.tile(measured.vehicle, steps),
            "position_m": measured.position_m.ravel(),
            "length_m": np.tile(measured.length_m, steps),
        }
    )


def ring_csv(path: Path, **given: Any) -> Path:
    """A CSV file of cars on a ring, with positions that are wrapped, as a spreadsheet writes it."""
    measured = drivers(**given)
    rows = table(measured)
    rows["position_m"] %= given.get("ring_m", 45.0)
    rows.round({"time_s": 4, "position_m": 3}).to_csv(path, index=False)
    return path


def mstf(path: Path, **given: Any) -> Path:
    """A file as the Mathematical Society of Traffic Flow publishes them: a block of position and time for each car."""
    ring_m = given.get("ring_m", 45.0)
    measured = drivers(**given)
    times = np.arange(len(measured.position_m)) * measured.period_s
    head = f"# Data of Traffic experiment\n#   Total number of car is 4 and circuit length is {ring_m:g}m.\n"
    cars = ("".join(f"{s:.3f} {t:.3f}\n" for s, t in zip(car, times, strict=True)) for car in measured.position_m.T)
    path.write_text(head + "\n".join(cars))
    return path


def ngsim(path: Path, vehicles: int = 3, duration_s: float = 410.0) -> Path:
    """Text as NGSIM publishes it: feet, front bumpers, milliseconds; all vehicles on lane 2."""
    measured = drivers(vehicles, 0.0, duration_s, period_s=0.5)
    length = measured.length_m / FOOT_M
    front = measured.position_m / FOOT_M + 0.5 * length
    speed = np.gradient(front, measured.period_s, axis=0)
    order = np.argsort(-front[0])
    rows = []
    for place, k in enumerate(order):
        ahead, behind = (order[j] + 1 if 0 <= j < vehicles else 0 for j in (place - 1, place + 1))
        for i in range(len(front)):
            gap = front[i, order[place - 1]] - front[i, k] if place else 0.0
            rows.append(
                f"{k + 1} {i + 1} {len(front)} {1118846979700 + 500 * i} 18.000 {front[i, k]:.3f} 6042842.116"
                f" 2133117.662 {length[k]:.1f} 6.0 2 {speed[i, k]:.2f} 0.00 2 {ahead} {behind} {gap:.2f} 3.33"
            )
    path.write_text("\n".join(rows) + "\n")
    return path


def own_columns(path: Path) -> Path:
    """A table with names of its own: 25 frames a second, feet, front bumpers."""
    measured = drivers(3, 0.0, 60.0, period_s=0.2)
    rows = table(measured)
    named = pd.DataFrame(
        {
            "track": rows.vehicle,
            "frame": (rows.time_s / 0.04).round().astype(int),
            "x_ft": ((rows.position_m + 0.5 * rows.length_m) / FOOT_M).round(3),
            "lane_number": 1,
        }
    )
    named.to_csv(path, index=False)
    return path


def all_columns(path: Path) -> Path:
    """A table of tracks with every column that it may have: three cars on each of two lanes."""
    measured = drivers(3, 0.0, 60.0)
    lanes = [table(measured).assign(lane=lane, vehicle=lambda rows, k=lane: rows.vehicle + 3 * k) for lane in (1, 2)]
    rows = pd.concat(lanes).rename(columns={"position_m": "s_m"})
    rows = rows.assign(recording=1, road=1, d_m=0.0, width_m=1.8, driver=rows.vehicle, measured=1)
    rows["vehicle"] -= 2
    rows["class"] = np.where(rows.vehicle == 1, "truck", "car")
    rows.to_csv(path, index=False)
    return path


def centre_line(path: Path, length_m: float = 700.0) -> Path:
    """A straight road along x with one lane."""
    path.write_text("x,y\n" + "".join(f"{x:.1f},0.0\n" for x in np.arange(-50.0, length_m, 10.0)))
    return path


def in_plane(path: Path, road: Path) -> tuple[Path, Path]:
    """Two cars in the plane, one behind the other, in the form of INTERACTION; and their road, of one lane called 1."""
    road.write_text("lane,x_m,y_m\n1,0,0\n1,300,400\n")
    lines = ["case_id,track_id,timestamp_ms,agent_type,x,y,psi_rad,length,width"]
    for vehicle, start_m in ((1, 60.0), (2, 30.0)):
        for k in range(200):
            s = start_m + 1.0 * k
            lines.append(f"1,{vehicle},{100 * k},car,{0.6 * s:.3f},{0.8 * s:.3f},{np.arctan2(4.0, 3.0):.4f},4.5,1.8")
    path.write_text("\n".join(lines) + "\n")
    return path, road


def odometry_bag(folder: Path, duration_s: float = 40.0, storage: str = "mcap") -> Path:
    """A folder as rosbag2 records it: nav_msgs/Odometry of three cars on a straight road, at 10 Hz."""
    measured = drivers(3, 0.0, duration_s, period_s=0.1)
    places = measured.position_m - measured.position_m.min()
    store = get_typestore(Stores.ROS2_JAZZY)
    kinds: Mapping[str, Any] = store.types
    stamp, header = kinds["builtin_interfaces/msg/Time"], kinds["std_msgs/msg/Header"]
    point, turn, pose = (kinds[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion", "Pose"))
    vector, twist = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Twist"]
    seen_pose, seen_twist = (kinds[f"geometry_msgs/msg/{name}WithCovariance"] for name in ("Pose", "Twist"))
    odometry = kinds["nav_msgs/msg/Odometry"]
    covariance = np.zeros(36)
    covariance[[0, 7]] = 0.0625
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        topics = [
            writer.add_connection(f"/car{k}/odom", odometry.__msgtype__, typestore=store)
            for k in range(places.shape[1])
        ]
        for i, row in enumerate(places):
            nanoseconds = 1_700_000_000_000_000_000 + 100_000_000 * i
            for k, topic in enumerate(topics):
                message = odometry(
                    header(stamp(*divmod(nanoseconds, 1_000_000_000)), "map"),
                    f"car{k}",
                    seen_pose(pose(point(row[k], 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0)), covariance),
                    seen_twist(twist(vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0)), covariance),
                )
                raw = store.serialize_cdr(message, odometry.__msgtype__)
                writer.write(topic, nanoseconds + 1_000_000 * (k + 1), raw)
    return folder


def targets_bag(folder: Path, duration_s: float = 20.0) -> Path:
    """A folder of rosbag2 with messages of a type of its own: all cars that a radar sees, in one message."""
    measured = drivers(3, 0.0, duration_s, period_s=0.1)
    places = measured.position_m - measured.position_m.min()
    store = get_typestore(Stores.ROS2_JAZZY)
    target = "int32 number\ngeometry_msgs/Point at\nfloat64 yaw\nfloat64 length\n"
    store.register(get_types_from_msg(target, "radar_msgs/msg/Target"))
    store.register(get_types_from_msg("std_msgs/Header header\nTarget[] targets\n", "radar_msgs/msg/Targets"))
    kinds: Mapping[str, Any] = store.types
    stamp, header, point = (
        kinds[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Point")
    )
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/targets", "radar_msgs/msg/Targets", typestore=store)
        for i, row in enumerate(places):
            nanoseconds = 1_700_000_000_000_000_000 + 100_000_000 * i
            seen = [
                kinds["radar_msgs/msg/Target"](k + 1, point(row[k], 0.0, 0.0), 0.0, float(measured.length_m[k]))
                for k in range(len(row))
            ]
            message = kinds["radar_msgs/msg/Targets"](header(stamp(*divmod(nanoseconds, 1_000_000_000)), "map"), seen)
            writer.write(topic, nanoseconds, store.serialize_cdr(message, "radar_msgs/msg/Targets"))
    return folder
