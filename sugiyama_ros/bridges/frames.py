"""Frames of positions, and how to get from one to another: a small buffer of the transforms on /tf and /tf_static."""

import math
from bisect import bisect_right, insort
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.bridges.fields import yaw
from sugiyama_ros.trajectories.placing import SeenVehicle

_NS = 1_000_000_000
#: Transforms that are kept of each frame, and how many frames may hang from one another.
_KEPT, _DEEPEST = 1000, 50
#: Age [s] at which a moving transform is too old to be used.
OLDEST_S = 1.0


class _Pose(NamedTuple):
    """A frame in its parent: stamp [ns], parent, origin (3,) [m], and rotation (3, 3)."""

    stamp_ns: int
    parent: str
    origin: Array
    rotation: Array


class Frames:
    """Transforms between frames, as they are published."""

    def __init__(self) -> None:
        self._moving: dict[str, list[_Pose]] = {}
        self._static: dict[str, _Pose] = {}

    def add(self, message: Any, static: bool) -> None:
        """Take in the transforms of a TFMessage. One that is no rotation is left out."""
        for one in message.transforms:
            q, t = one.transform.rotation, one.transform.translation
            rotation = _rotation(q)
            origin = np.array([t.x, t.y, t.z])
            if rotation is None or not np.isfinite(origin).all():
                continue
            stamp_ns = one.header.stamp.sec * _NS + one.header.stamp.nanosec
            pose = _Pose(stamp_ns, one.header.frame_id.lstrip("/"), origin, rotation)
            child = one.child_frame_id.lstrip("/")
            if static:
                self._static[child] = pose
                continue
            kept = self._moving.setdefault(child, [])
            insort(kept, pose, key=lambda p: p.stamp_ns)
            del kept[:-_KEPT]

    def brought(self, seen: SeenVehicle, frame: str) -> SeenVehicle | None:
        """A vehicle as seen in another frame; None where the transforms do not say how."""
        own = seen.frame.lstrip("/")
        if not frame or own == frame:
            return seen
        ours, theirs = self._to_root(own, seen.stamp_ns), self._to_root(frame, seen.stamp_ns)
        if ours is None or theirs is None or ours[0] != theirs[0]:
            return None
        _, origin, rotation = ours
        _, base, turn = theirs
        point = turn.T @ (rotation @ np.array([seen.x_m, seen.y_m, 0.0]) + origin - base)
        ahead = turn.T @ rotation @ np.array([math.cos(seen.heading), math.sin(seen.heading), 0.0])
        heading = math.atan2(ahead[1], ahead[0])  # NaN stays NaN
        return replace(seen, x_m=float(point[0]), y_m=float(point[1]), heading=heading, frame=frame)

    def _to_root(self, frame: str, stamp_ns: int) -> tuple[str, Array, Array] | None:
        """The root of a frame's tree, and the frame's origin and rotation in it."""
        origin: Array = np.zeros(3)
        rotation: Array = np.eye(3)
        for _ in range(_DEEPEST):
            pose = self._static.get(frame)
            if pose is None and frame in self._moving:
                pose = self._at(frame, stamp_ns)
                if pose is None:
                    return None
            if pose is None:
                return frame, origin, rotation
            origin, rotation, frame = pose.rotation @ origin + pose.origin, pose.rotation @ rotation, pose.parent
        return None

    def _at(self, frame: str, stamp_ns: int) -> _Pose | None:
        """The last transform that is not younger than a stamp [ns], unless it is too old."""
        kept = self._moving[frame]
        k = bisect_right(kept, stamp_ns, key=lambda p: p.stamp_ns) - 1
        found = kept[k] if k >= 0 else None
        return found if found is not None and stamp_ns - found.stamp_ns <= OLDEST_S * _NS else None


def _rotation(q: Any) -> Array | None:
    """Rotation (3, 3) of a quaternion; None for one that is no rotation."""
    if math.isnan(yaw(q.x, q.y, q.z, q.w)):
        return None
    n = math.sqrt(q.x**2 + q.y**2 + q.z**2 + q.w**2)
    x, y, z, w = q.x / n, q.y / n, q.z / n, q.w / n
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
