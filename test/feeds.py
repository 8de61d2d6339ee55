"""Bags as others record them, made for tests: three cars that drive behind one another on a straight road."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

Array = NDArray[np.float64]
CARS, BEGIN_S, LASTS_S = 3, 100.0, 40.0
LENGTH_M = 4.6
ODOMETRY, DETECTIONS = "nav_msgs/msg/Odometry", "vision_msgs/msg/Detection3DArray"
TRACKED, PX4 = "autoware_perception_msgs/msg/TrackedObjects", "px4_msgs/msg/VehicleOdometry"
TF = "tf2_msgs/msg/TFMessage"
_TEXTS = {
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\n"
        "string id\n"
    ),
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    TRACKED: "std_msgs/Header header\nautoware_perception_msgs/TrackedObject[] objects\n",
    "autoware_perception_msgs/msg/TrackedObject": (
        "unique_identifier_msgs/UUID object_id\n"
        "autoware_perception_msgs/ObjectClassification[] classification\n"
        "autoware_perception_msgs/TrackedObjectKinematics kinematics\n"
        "autoware_perception_msgs/Shape shape\n"
    ),
    "autoware_perception_msgs/msg/TrackedObjectKinematics": (
        "uint8 UNAVAILABLE=0\nuint8 SIGN_UNKNOWN=1\nuint8 AVAILABLE=2\n"
        "geometry_msgs/PoseWithCovariance pose_with_covariance\nuint8 orientation_availability\n"
    ),
    "autoware_perception_msgs/msg/ObjectClassification": "uint8 label\nfloat32 probability\n",
    "autoware_perception_msgs/msg/Shape": "geometry_msgs/Vector3 dimensions\n",
    PX4: "uint64 timestamp\nfloat32[3] position\nfloat32[4] q\n",
    "test_msgs/msg/Radar": "float64 time\nint32[] number\n",
    "test_msgs/msg/Target": "float64 time\nfloat32 number\nfloat64[2] at\nfloat64 course\n",
}


def _made_store(which: Stores) -> Any:
    store = get_typestore(which)
    for name, text in _TEXTS.items():
        store.register(get_types_from_msg(text, name))
    return store


STORE, STORE1 = _made_store(Stores.LATEST), get_typestore(Stores.ROS1_NOETIC)


def _driven() -> tuple[Array, Array]:
    """Times [s] from the beginning, and positions (T, CARS) [m]: the first is free, the others follow it."""
    dt = 1e-3
    time = np.arange(-2.0, LASTS_S + 2.0, dt)
    x, v = np.empty((len(time), CARS)), np.full(CARS, 17.0)
    now = 300.0 - 22.0 * np.arange(CARS)
    for k, t in enumerate(time):
        x[k] = now
        ahead, gap = v[:-1], now[:-1] - now[1:] - LENGTH_M
        push = 0.5 * (ahead - v[1:]) + 0.3 * (gap - 1.0 * v[1:])
        now = now + dt * v
        v = v + dt * np.concatenate([[0.9 * np.cos(0.45 * t) - 0.7 * np.sin(0.17 * t)], np.clip(push, -4.0, 3.0)])
    return time, x


TIME_S, X_M = _driven()


def at(car: int, time_s: Array | float) -> Any:
    """Position [m] of a car, at times [s] from the beginning."""
    return np.interp(time_s, TIME_S, X_M[:, car])


def every(period_s: float, phase_s: float = 0.0, until_s: float = LASTS_S) -> Array:
    """Times [s] from the beginning."""
    return phase_s + period_s * np.arange(int((until_s - phase_s) / period_s + 1e-9) + 1)


@dataclasses.dataclass
class Recorded:
    """One message: topic, type, log time [s] from the beginning, and a function that makes it with a type store."""

    topic: str
    kind: str
    log_s: float
    make: Callable[[Any], Any]


def build(store: Any, kind: str, **fields: Any) -> Any:
    """A message with nested messages as dictionaries, lists and numbers; what is left out is 0."""
    made = {}
    for name, desc in store.fielddefs[kind][1]:
        made[name] = _value(store, desc, fields.get(name))
    return store.types[kind](**made)


def _value(store: Any, desc: Any, given: Any) -> Any:
    node, about = int(desc[0]), desc[1]
    if node == 1:
        return given if given is not None else "" if about[0] == "string" else False if about[0] == "bool" else 0
    if node == 2:
        return build(store, about, **(given or {}))
    inner, size = about[0], about[1]
    if int(inner[0]) == 2 or inner[1][0] == "string":
        return [_value(store, inner, one) for one in (given or [])]
    filled = given if given is not None else np.zeros(size if node == 3 else 0)
    return np.array(filled, dtype=inner[1][0].replace("octet", "uint8").replace("bool", "bool"))


def stamp(time_s: float) -> dict[str, int]:
    """A stamp, of a time [s] from the beginning."""
    sec, nanosec = divmod(round((BEGIN_S + time_s) * 1e9), 1_000_000_000)
    return {"sec": sec, "nanosec": nanosec}


NO_STAMP = {"sec": 0, "nanosec": 0}


def header(time_s: float, frame: str = "map", given: dict[str, int] | None = None) -> dict[str, Any]:
    return {"stamp": stamp(time_s) if given is None else given, "frame_id": frame}


def facing(yaw: float = 0.0) -> dict[str, float]:
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2.0)), "w": float(np.cos(yaw / 2.0))}


def place(x: float, y: float = 0.0, yaw: float = 0.0) -> dict[str, Any]:
    return {"position": {"x": float(x), "y": float(y), "z": 0.0}, "orientation": facing(yaw)}


def odometry(
    car: int,
    times: Array,
    stamps: Callable[[float], dict[str, int]] = stamp,
    late_s: float = 0.005,
    frame: str = "map",
    topic: str = "",
) -> list[Recorded]:
    """One car on a topic of its own."""
    name = topic or f"/car{car}/odom"

    def make(t: float) -> Callable[[Any], Any]:
        head, pose = header(t, frame, stamps(t)), {"pose": place(at(car, t))}
        return lambda store: build(store, ODOMETRY, header=head, pose=pose)

    return [Recorded(name, ODOMETRY, t + late_s, make(t)) for t in times.tolist()]


def detections(
    times: Array,
    name_of: Callable[[int], str] = str,
    cars: Sequence[int] = range(CARS),
    topic: str = "/det",
    seen: Callable[[int, float], dict[str, Any]] = lambda car, t: place(at(car, t)),
    frame: str = "map",
    kind_of: Callable[[int], str] = lambda car: "car",
) -> list[Recorded]:
    """All cars in each message."""

    def make(t: float) -> Callable[[Any], Any]:
        each = [
            {
                "header": header(t, frame),
                "id": name_of(car),
                "results": [{"hypothesis": {"class_id": k, "score": p}} for k, p in (("", 0.2), (kind_of(car), 0.8))],
                "bbox": {"center": seen(car, t), "size": {"x": LENGTH_M, "y": 2.0, "z": 1.5}},
            }
            for car in cars
        ]
        return lambda store: build(store, DETECTIONS, header=header(t, frame), detections=each)

    return [Recorded(topic, DETECTIONS, t + 0.005, make(t)) for t in times.tolist()]


def transforms(
    times: Array,
    pose: Callable[[float], tuple[float, float, float]],
    parent: str = "map",
    child: str = "base_link",
    late_s: float = 0.002,
    topic: str = "/tf",
) -> list[Recorded]:
    """Where a frame is: x, y [m] and yaw [rad] at each time."""

    def make(t: float) -> Callable[[Any], Any]:
        x, y, yaw = pose(t)
        one = {
            "header": header(t, parent),
            "child_frame_id": child,
            "transform": {"translation": {"x": float(x), "y": float(y), "z": 0.0}, "rotation": facing(yaw)},
        }
        return lambda store: build(store, TF, transforms=[one])

    return [Recorded(topic, TF, t + late_s, make(t)) for t in times.tolist()]


def text_of(kind: str, store: Any = STORE, ros: int = 2) -> bytes:
    return store.generate_msgdef(kind, ros_version=ros)[0].encode()


@dataclasses.dataclass(frozen=True)
class Style:
    """How a bag is written.

    ``order`` is by log time, topic after topic, or from the last message to the first; ``encoding`` is that of the
    schemas; ``packed`` compresses each message.
    """

    order: str = "log"
    encoding: str = "ros2msg"
    packed: bool = False
    definition: bytes | None = None
    options: tuple[tuple[str, Any], ...] = (("chunk_size", 8192), ("compression", CompressionType.ZSTD))


def write(path: Path, *feeds: list[Recorded], style: Style = Style()) -> Path:
    """Write a bag of some feeds."""
    everything = [one for feed in feeds for one in feed]
    if style.order != "topic":
        everything.sort(key=lambda one: one.log_s, reverse=style.order == "back")
    is_ros1 = style.encoding == "ros1msg"
    store = STORE1 if is_ros1 else STORE
    with path.open("wb") as stream:
        writer = Writer(stream, **dict(style.options))
        writer.start(profile="ros1" if is_ros1 else "ros2")
        channels: dict[str, int] = {}
        for one in everything:
            if one.topic not in channels:
                text = (
                    style.definition if style.definition is not None else text_of(one.kind, store, 1 if is_ros1 else 2)
                )
                name = one.kind.replace("/msg/", "/") if is_ros1 else one.kind
                schema = writer.register_schema(name, style.encoding, text)
                channels[one.topic] = writer.register_channel(one.topic, "ros1" if is_ros1 else "cdr", schema)
            message = one.make(store)
            data = bytes(store.serialize_ros1(message, one.kind) if is_ros1 else store.serialize_cdr(message, one.kind))
            if style.packed:
                data = zstandard.compress(data)
            log_ns = round((BEGIN_S + one.log_s) * 1e9)
            writer.add_message(channels[one.topic], log_ns, data, log_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def folder(path: Path, files: dict[str, Path | None], mode: str = "") -> Path:
    """A directory of rosbag2 with files, or with names of files that are not there."""
    path.mkdir(exist_ok=True)
    names = "".join(f"    - {name}\n" for name in files)
    (path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n"
        f"  compression_format: {'zstd' if mode else ''}\n  compression_mode: {mode}\n  relative_file_paths:\n{names}"
    )
    for name, file in files.items():
        if file is not None:
            data = file.read_bytes()
            (path / name).write_bytes(zstandard.compress(data) if name.endswith((".zst", ".zstd")) else data)
    return path


def line(path: Path) -> Path:
    """The centre line."""
    path.write_text("x,y\n0,0\n2000,0\n")
    return path
