"""Which fields of a message say what about a vehicle, one entry for each type of message."""

import math
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import read_yaml
from sugiyama_ros.trajectories.placing import SeenVehicle

#: A second [ns].
NS = 1_000_000_000
# Length [m] beyond which a vehicle is none.
_LONGEST_M = 100.0
# Names of fields that an error shows, at most.
_SHOWN = 12
_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
_STEP = r"[a-zA-Z_]\w*(\[-?\d+\])?"
_PATH = re.compile(rf"{_STEP}(\.{_STEP})*")
_TEXTS = {
    "type": (_TYPE, "type of a message"),
    "heading_known": (re.compile(rf"{_STEP}(\.{_STEP})*=\d+"), "path of a field and its value, such as state=2"),
}
#: Units of stamps [ns].
UNITS_NS = {"s": NS, "ms": 1_000_000, "us": 1000, "ns": 1}
_CHOICES = {
    "stamp_unit": tuple(UNITS_NS),
    "heading_unit": ("rad", "deg"),
    "orientation_order": ("", "xyzw", "wxyz"),
}


@dataclass(frozen=True)
class Bridge:
    """Where a message says what. Each field but the last three and ``type`` is a path; empty: nowhere.

    A path is such as ``pose.covariance[0]``.

    type: type of the message, such as ``nav_msgs/msg/Odometry``; objects: the list of objects in the message; empty if
    the message is one object; the other paths start at the object; ``stamp`` and ``frame`` start at the message if the
    object does not have them; id: name or number of the vehicle; if empty, each topic is one vehicle; x, y: position
    [m] of the vehicle; orientation, heading: quaternion, or angle, of the direction in which the vehicle points;
    heading_known: path and value, such as ``orientation_availability=2``: the direction counts only where the field has
    the value; length, vehicle_class: length [m] and class of the vehicle, or a list of classes with their
    probabilities; var: variance [m^2] of the position; stamp,
    frame: time stamp, and frame of the position; an empty ``stamp`` is the log time of a bag, or the time of receipt;
    stamp_unit: unit of a stamp that is a number; heading_unit: unit of ``heading``; orientation_order: order of a
    quaternion that is an array of four numbers.
    """

    type: str
    x: str
    y: str
    objects: str = ""
    id: str = ""
    orientation: str = ""
    heading: str = ""
    heading_known: str = ""
    length: str = ""
    vehicle_class: str = ""
    var: str = ""
    stamp: str = "header.stamp"
    frame: str = "header.frame_id"
    stamp_unit: str = "s"
    heading_unit: str = "rad"
    orientation_order: str = ""

    def seen(self, message: Any, topic: str, log_ns: int) -> Iterator[SeenVehicle]:
        """The vehicles in a message, from rclpy or from a bag.

        log_ns: log time, or time of receipt [ns]. Raises InputError.
        """
        objects = _look_up(message, self.objects, self) if self.objects else [message]
        if not isinstance(objects, Iterable):
            raise InputError(f"{self.type}: {self.objects} is no list; name the list, or leave out objects")
        for one in objects:
            name = _name(_look_up(one, self.id, self)) if self.id else ""
            yield SeenVehicle(
                stamp_ns=self._either(one, message, self.stamp, self._stamp_ns) if self.stamp else log_ns,
                name=f"{topic} {name}" if name else "" if self.id else topic,
                x_m=self._real(one, self.x),
                y_m=self._real(one, self.y),
                heading=self._heading(one),
                length_m=self._number(one, self.length, _LONGEST_M),
                var=self._number(one, self.var),
                vehicle_class=self._class(one) if self.vehicle_class else "",
                frame=self._either(one, message, self.frame, str).lstrip("/") if self.frame else "",
            )

    def _class(self, one: Any) -> str:
        """The class of an object, or the most probable one of a list; codes have names."""
        try:
            said = _look_up(one, self.vehicle_class, self)
        except InputError:
            # older versions of the messages that are known here do not say it
            if self is BRIDGES.get(self.type):
                return ""
            raise
        if isinstance(said, Iterable) and not isinstance(said, str):
            best = max((getattr(guess, "hypothesis", guess) for guess in said), key=_probability, default="")
            said = getattr(best, "label", getattr(best, "class_id", ""))
        names = _CLASSES.get(self.type, ())
        text = str(said).strip()
        return names[int(text)] if text.isdecimal() and int(text) < len(names) else text

    def _heading(self, one: Any) -> float:
        if self.heading_known:
            path, _, value = self.heading_known.partition("=")
            if self._real(one, path) != float(value):
                return math.nan
        if self.heading:
            angle = self._real(one, self.heading)
            return math.radians(angle) if self.heading_unit == "deg" else angle
        if not self.orientation:
            return math.nan
        quaternion = _look_up(one, self.orientation, self)
        if hasattr(quaternion, "x"):
            return yaw(*(self._real(quaternion, name) for name in "xyzw"))
        if not self.orientation_order:
            raise InputError(
                f"{self.type}: {self.orientation} is an array; add `orientation_order: wxyz` (or xyzw) to the bridge"
            )
        order = [self.orientation_order.index(name) for name in "xyzw"]
        return yaw(*(self._real(one, f"{self.orientation}[{k}]") for k in order))

    def _number(self, one: Any, path: str, most: float = math.inf) -> float:
        """A positive number below ``most``; NaN where the message does not know it, as it says with a 0."""
        value = self._real(one, path) if path else math.nan
        return value if 0.0 < value < most else math.nan

    def _real(self, one: Any, path: str) -> float:
        """A number. Raises InputError where the message has something else there."""
        try:
            return float(_look_up(one, path, self))
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{self.type}: {path} is no number; correct the bridge") from None

    def _stamp_ns(self, stamp: Any) -> int:
        """A stamp [ns]: a Time, or a number. Raises InputError for anything else."""
        try:
            if hasattr(stamp, "sec"):
                return int(stamp.sec) * NS + int(stamp.nanosec)
            unit_ns = UNITS_NS[self.stamp_unit]
            # a float cannot hold the nanoseconds since 1970
            return int(stamp) * unit_ns if float(stamp).is_integer() else round(float(stamp) * unit_ns)
        except (AttributeError, TypeError, ValueError, OverflowError):
            raise InputError(f"{self.type}: {self.stamp} is no time; correct the bridge") from None

    def _either(self, one: Any, message: Any, path: str, read: Callable[[Any], Any]) -> Any:
        """What the object says; what the message says where the object has no such field, or 0 or nothing in it."""
        found = []
        for source in (one, message):
            with suppress(InputError):
                found.append(_look_up(source, path, self))
        said = [read(value) for value in found or [_look_up(message, path, self)]]
        return said[0] or said[-1]


def _probability(guess: Any) -> float:
    return float(getattr(guess, "probability", getattr(guess, "score", 0.0)))


def _look_up(message: Any, path: str, bridge: Bridge) -> Any:
    """A field of a message by its path. Raises InputError where there is none."""
    found = message
    for part in path.split("."):
        name, _, index = part.partition("[")
        try:
            inner = getattr(found, name)
            found = inner[int(index[:-1])] if index else inner
        except (AttributeError, IndexError, TypeError, KeyError):
            have = ", ".join(_fields_of(found)[:_SHOWN]) or "none"
            raise InputError(
                f"{bridge.type}: no field {path}, but {have}; give --bridge, a file with the right names"
            ) from None
    return found


def _fields_of(message: Any) -> list[str]:
    """Names of the fields of a message, from rclpy or from a bag."""
    if hasattr(message, "get_fields_and_field_types"):
        return list(message.get_fields_and_field_types())
    return [name for name in getattr(message, "__dataclass_fields__", ()) if not name.startswith("_")]


def yaw(x: float, y: float, z: float, w: float) -> float:
    """Direction [rad] of a quaternion in the plane; NaN for one that is no rotation."""
    if not 0.7 < math.hypot(x, y, z, w) < 1.4:
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2))


def read_bridge(path: Path) -> Bridge:
    """Read a bridge for another message type from a YAML file. Raises InputError."""
    document = read_yaml(path)
    known = {field.name for field in fields(Bridge)}
    if not isinstance(document, dict) or not {"type", "x", "y"} <= set(document) <= known:
        raise InputError(f"{path}: is no bridge; give type, x, y, and perhaps {', '.join(sorted(known - {'type'}))}")
    for name, value in document.items():
        _check(path, name, value)
    return Bridge(**document)


def _check(path: Path, name: str, value: Any) -> None:
    """Raise InputError for a line of a bridge that cannot be used."""
    if name in _CHOICES:
        if value not in _CHOICES[name]:
            raise InputError(
                f"{path}: {name}: {value!r} is not known; give {' or '.join(filter(None, _CHOICES[name]))}"
            )
        return
    wanted, what = _TEXTS.get(name, (_PATH, "path of a field"))
    if not isinstance(value, str) or (value and not wanted.fullmatch(value)):
        raise InputError(f"{path}: {name}: {value!r} is not the {what}")


def _name(value: Any) -> str:
    """Name of a vehicle from a text, a number, or the bytes of a UUID; empty for a UUID of zeros."""
    if hasattr(value, "uuid"):
        value = value.uuid
    if isinstance(value, (bytes, list, np.ndarray)):
        return bytes(value).hex() if any(bytes(value)) else ""
    if isinstance(value, (float, np.floating)) and value.is_integer():
        return str(int(value))
    return str(value).strip()


# Names of the classes that messages give by their numbers, from 0, by the type of message.
_CLASSES = {
    "autoware_perception_msgs/msg/TrackedObjects": (
        *("unknown", "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian"),
        *("animal", "hazard", "over_drivable", "under_drivable"),
    ),
    "derived_object_msgs/msg/ObjectArray": (
        *("unknown", "unknown_small", "unknown_medium", "unknown_big", "pedestrian", "bicycle", "car", "truck"),
        *("motorcycle", "other_vehicle", "barrier", "sign"),
    ),
}

#: What the messages of other packages say, by their type.
BRIDGES = {
    bridge.type: bridge
    for bridge in (
        # One vehicle on each topic, as robots and simulators publish it.
        Bridge(
            type="nav_msgs/msg/Odometry",
            x="pose.pose.position.x",
            y="pose.pose.position.y",
            orientation="pose.pose.orientation",
            var="pose.covariance[0]",
        ),
        # Boxes of a detector that also tracks: the ids stay with their objects.
        Bridge(
            type="vision_msgs/msg/Detection3DArray",
            objects="detections",
            id="id",
            x="bbox.center.position.x",
            y="bbox.center.position.y",
            orientation="bbox.center.orientation",
            length="bbox.size.x",
            vehicle_class="results",
        ),
        # Objects that Autoware tracks. Their direction does not count where its sign is unknown.
        Bridge(
            type="autoware_perception_msgs/msg/TrackedObjects",
            objects="objects",
            id="object_id",
            x="kinematics.pose_with_covariance.pose.position.x",
            y="kinematics.pose_with_covariance.pose.position.y",
            orientation="kinematics.pose_with_covariance.pose.orientation",
            heading_known="kinematics.orientation_availability=2",
            var="kinematics.pose_with_covariance.covariance[0]",
            length="shape.dimensions.x",
            vehicle_class="classification",
        ),
        # Objects of derived_object_msgs, as CARLA publishes them.
        Bridge(
            type="derived_object_msgs/msg/ObjectArray",
            objects="objects",
            id="id",
            x="pose.position.x",
            y="pose.position.y",
            orientation="pose.orientation",
            length="shape.dimensions[0]",
            vehicle_class="classification",
        ),
    )
}
