"""The truth about simulated vehicles in a bag: ``vehicle_NN/truth`` and ``vehicle_NN/true_parameters``."""

import struct
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Target
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.mcap_writer import LATCHED_TOPIC, BagWriter, Qos
from sugiyama_ros.formats.measured import FRAME, MEASURED_TYPE, channels_of, messages, stamp_ns
from sugiyama_ros.trajectories.dense import MAX_SAMPLES, DenseTracks
from sugiyama_ros.trajectories.truth import TrueDriver, Truth

TRUTH_TYPE, PARAMETERS_TYPE = "sugiyama_msgs/msg/Truth", "sugiyama_msgs/msg/TrueParameters"
_NS = 1_000_000_000
# Encapsulation (CDR, little endian); stamp, frame, vehicle; then four numbers.
_LAYOUT = struct.Struct(f"<4s i I I {len(FRAME) + 1}s 3x i 4d")


def namespace(vehicle: int) -> str:
    """Namespace of the topics of a vehicle, within that of the road: ``vehicle_07``."""
    return f"vehicle_{vehicle:02}"


def truth_message(time_ns: int, vehicle: int, motion: Iterable[float]) -> bytes:
    """A Truth message: position [m], speed [m/s], acceleration [m/s^2] and gap [m] of a vehicle at a stamp [ns]."""
    name = FRAME.encode() + b"\0"
    return _LAYOUT.pack(b"\0\1\0\0", *divmod(time_ns, _NS), len(name), name, vehicle, *motion)


def write_simulated(trajectories: DenseTracks, truth: Truth, target: Target) -> None:
    """Write a bag with the topics /road and /measured, and the truth about each vehicle.

    Raises InputError, OutputError.
    """
    from sugiyama_ros.formats.cdr import Encoder

    encode = Encoder(PARAMETERS_TYPE)
    with BagWriter(target, {"source": trajectories.source, "sha256": trajectories.sha256}) as bag:
        channels = channels_of(bag, trajectories)
        vehicles = truth.vehicle.tolist()
        true = {v: bag.topic(f"/{namespace(v)}/truth", TRUTH_TYPE, Qos()) for v in vehicles}
        driven = [v for v in vehicles if v not in trajectories.controlled]
        drives = {v: bag.topic(f"/{namespace(v)}/true_parameters", PARAMETERS_TYPE, LATCHED_TOPIC) for v in driven}
        for drive in truth.drivers:
            stamp = stamp_ns(drive.time_s)
            data = encode(PARAMETERS_TYPE, **parameters_fields(stamp, drive))
            bag.write(drives[drive.vehicle], data, stamp, stamp)
        step = 0
        for type_name, stamp, data in messages(trajectories):
            bag.write(channels[type_name], data, stamp, stamp)
            if type_name != MEASURED_TYPE:
                continue
            motion = np.stack(
                [a[step] for a in (truth.position_m, truth.speed, truth.acceleration, truth.gap_m)], axis=1
            )
            for vehicle, one in zip(true, motion.tolist(), strict=True):
                bag.write(true[vehicle], truth_message(stamp, vehicle, one), stamp, stamp)
            step += 1


def parameters_fields(time_ns: int, drive: TrueDriver) -> dict[str, Any]:
    """Fields of a TrueParameters message."""
    seconds, nanoseconds = divmod(time_ns, _NS)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": FRAME},
        "vehicle": drive.vehicle,
        "name": list(drive.parameters),
        "value": np.array(list(drive.parameters.values())),
    }


def read_truth(path: Path) -> Truth | None:
    """Read the truth about simulated vehicles from a bag. Raises InputError."""
    with Bag(path) as bag:
        kinds = {topic.name: topic.type for topic in bag.info().topics if topic.count}
        wanted = {name for name, kind in kinds.items() if kind in (TRUTH_TYPE, PARAMETERS_TYPE)}
        if TRUTH_TYPE not in kinds.values():
            return None
        motion: dict[tuple[int, int], tuple[float, ...]] = {}
        drives: list[TrueDriver] = []
        try:
            for _, kind, _, m in bag.messages(wanted):
                stamp = m.header.stamp.sec * _NS + m.header.stamp.nanosec
                if kind == TRUTH_TYPE:
                    motion[stamp, int(m.vehicle)] = (m.position_m, m.speed, m.acceleration, m.gap_m)
                else:
                    named = dict(zip(map(str, m.name), m.value.tolist(), strict=True))
                    drives.append(TrueDriver(stamp / _NS, int(m.vehicle), named))
        except (AttributeError, TypeError, ValueError):
            raise InputError(f"{path}: the truth has not the fields that this version knows; simulate again") from None
    return _truth(path, motion, drives)


def _truth(path: Path, motion: Mapping[tuple[int, int], tuple[float, ...]], drives: list[TrueDriver]) -> Truth:
    """The truth as arrays, from the motion by stamp and vehicle."""
    stamps = sorted({stamp for stamp, _ in motion})
    vehicles = sorted({vehicle for _, vehicle in motion})
    if len(stamps) * len(vehicles) > MAX_SAMPLES:
        raise InputError(f"{path}: the truth has more than {MAX_SAMPLES} samples; split the bag")
    row = {stamp: k for k, stamp in enumerate(stamps)}
    column = {vehicle: k for k, vehicle in enumerate(vehicles)}
    values = np.full((4, len(stamps), len(vehicles)), np.nan)
    for (stamp, vehicle), one in motion.items():
        values[:, row[stamp], column[vehicle]] = one
    position, speed, acceleration, gap = values
    return Truth(
        vehicle=np.array(vehicles, dtype=np.int64),
        time_s=np.array(stamps) / _NS,
        position_m=position,
        speed=speed,
        acceleration=acceleration,
        gap_m=gap,
        drivers=tuple(sorted(drives, key=lambda drive: drive.time_s)),
    )
