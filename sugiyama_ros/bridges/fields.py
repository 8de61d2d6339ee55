"""Which fields of a message say what about a vehicle: the whole of a bridge."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.documents import read_yaml
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.placing import SeenVehicle

_NS = 1_000_000_000
_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
_PATH = re.compile(r"[a-zA-Z_]\w*(\[-?\d+\])?(\.[a-zA-Z_]\w*(\[-?\d+\])?)*")


@dataclass(frozen=True)
class Bridge:
    """Where a message says what. Each field but ``type`` is a path, such as ``pose.covariance[0]``; empty: nowhere.

    Attributes
    ----------
    type : str
        Type of the message, such as ``nav_msgs/msg/Odometry``.
    objects : str
        The list of objects in the message; empty if the message is one object. The other paths start at the object;
        ``stamp`` and ``frame`` start at the message if the object does not have them.
    id : str
        Name or number of the vehicle; if empty, each topic is one vehicle.
    x, y : str
        Position [m] of the vehicle.
    orientation, heading : str
        Quaternion, or angle [rad], of the direction in which the vehicle points.
    length, vehicle_class : str
        Length [m] and class of the vehicle.
    var : str
        Variance [m^2] of the position.
    stamp, frame : str
        Time stamp, and frame of the position.
    """

    type: str
    x: str
    y: str
    objects: str = ""
    id: str = ""
    orientation: str = ""
    heading: str = ""
    length: str = ""
    vehicle_class: str = ""
    var: str = ""
    stamp: str = "header.stamp"
    frame: str = "header.frame_id"

    def seen(self, message: Any, topic: str) -> Iterator[SeenVehicle]:
        """The vehicles in a message, from rclpy or from a bag.

        Raises
        ------
        InputError
            For a message that does not have one of the fields.
        """
        objects = look_up(message, self.objects, self) if self.objects else [message]
        for one in objects:
            name = _name(look_up(one, self.id, self)) if self.id else topic
            yield SeenVehicle(
                stamp_ns=self._stamp_ns(self._either(one, message, self.stamp)),
                name=name,
                x_m=self._real(one, self.x),
                y_m=self._real(one, self.y),
                heading=self._heading(one),
                length_m=self._number(one, self.length),
                var=self._number(one, self.var),
                vehicle_class=str(look_up(one, self.vehicle_class, self)) if self.vehicle_class else "",
                frame=str(self._either(one, message, self.frame)) if self.frame else "",
            )

    def _heading(self, one: Any) -> float:
        if self.heading:
            return self._real(one, self.heading)
        if not self.orientation:
            return math.nan
        quaternion = look_up(one, self.orientation, self)
        return yaw(*(self._real(quaternion, name) for name in "xyzw"))

    def _number(self, one: Any, path: str) -> float:
        """A positive number; NaN where the message does not know it, as it says with a 0."""
        value = self._real(one, path) if path else math.nan
        return value if value > 0.0 else math.nan

    def _real(self, one: Any, path: str) -> float:
        """A number. Raises InputError where the message has something else there."""
        try:
            return float(look_up(one, path, self))
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{self.type}: {path} is no number; correct the bridge") from None

    def _stamp_ns(self, stamp: Any) -> int:
        """A stamp [ns]: a Time, or a number of seconds. Raises InputError for anything else."""
        try:
            if hasattr(stamp, "sec"):
                return int(stamp.sec) * _NS + int(stamp.nanosec)
            return round(float(stamp) * 1e9)
        except (AttributeError, TypeError, ValueError, OverflowError):
            raise InputError(f"{self.type}: {self.stamp} is no time; correct the bridge") from None

    def _either(self, one: Any, message: Any, path: str) -> Any:
        try:
            return look_up(one, path, self)
        except InputError:
            return look_up(message, path, self)


def look_up(message: Any, path: str, bridge: Bridge) -> Any:
    """A field of a message by its path. Raises InputError where there is none."""
    found = message
    try:
        for part in path.split("."):
            name, _, index = part.partition("[")
            found = getattr(found, name)
            if index:
                found = found[int(index[:-1])]
    except (AttributeError, IndexError, TypeError, KeyError):
        raise InputError(f"{bridge.type}: no field {path}; correct the bridge") from None
    return found


def yaw(x: float, y: float, z: float, w: float) -> float:
    """Direction [rad] of a quaternion in the plane; NaN for one that is no rotation."""
    if not 0.7 < math.hypot(x, y, z, w) < 1.4:
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2))


def read_bridge(path: Path) -> Bridge:
    """Read a bridge for another message type from a YAML file.

    Parameters
    ----------
    path : Path
        YAML file with the attributes of `Bridge`.

    Raises
    ------
    InputError
        For a file that is no bridge.
    """
    document = read_yaml(path)
    known = {field.name for field in fields(Bridge)}
    if not isinstance(document, dict) or not {"type", "x", "y"} <= set(document) <= known:
        raise InputError(f"{path}: is no bridge; give type, x, y, and perhaps {', '.join(sorted(known - {'type'}))}")
    for name, value in document.items():
        if not isinstance(value, str) or (value and not (_TYPE if name == "type" else _PATH).fullmatch(value)):
            raise InputError(
                f"{path}: {name}: {value!r} is not the {'type of a message' if name == 'type' else 'path of a field'}"
            )
    return Bridge(**document)


def _name(value: Any) -> str:
    """Name of a vehicle from a text, a number, or the bytes of a UUID."""
    if hasattr(value, "uuid"):
        value = value.uuid
    if isinstance(value, (bytes, list, np.ndarray)):
        return bytes(value).hex()
    return str(value)
