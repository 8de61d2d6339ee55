"""Frames of positions, and how to get from one to another: a small buffer of the transforms on /tf and /tf_static."""

import math
from bisect import bisect_right, insort
from dataclasses import replace
from enum import Enum
from operator import attrgetter
from typing import Any, Final, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.bridges.fields import NS, yaw
from sugiyama_ros.trajectories.placing import SeenVehicle

#: How long [s] transforms are kept, as in tf2, and how many frames may hang from one another.
CACHE_S, _DEEPEST = 10.0, 50
#: Time [s] between two transforms of a frame beyond which nothing is interpolated, if it is not the frame's usual one.
LONGEST_HOLE_S = 1.0
# Periods of a frame that make a hole, and transforms from which the period follows.
_PERIODS, _USUAL = 1.5, 20
# Angle [rad] between two rotations below which the way does not matter.
_SMALL = 1e-6

_stamp = attrgetter("stamp_ns")


class Waiting(Enum):
    """What is given instead of a vehicle whose transforms have not come yet."""

    EARLY = "early"


EARLY: Final = Waiting.EARLY


class _Pose(NamedTuple):
    """A frame in its parent: stamp [ns], parent, origin (3,) [m], and quaternion (4,) x, y, z, w."""

    stamp_ns: int
    parent: str
    origin: Array
    turn: Array


class Frames:
    """Transforms between frames, as they are published. Between two transforms, they are interpolated as in tf2."""

    def __init__(self) -> None:
        self._moving: dict[str, list[_Pose]] = {}
        self._static: dict[str, _Pose] = {}
        #: Stamp [ns] of the latest transform that moves.
        self.newest_ns = -1

    def add(self, message: Any, static: bool) -> None:
        """Take in the transforms of a TFMessage. One that is no rotation is left out."""
        for one in message.transforms:
            q, t = one.transform.rotation, one.transform.translation
            turn, origin = np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z])
            if math.isnan(yaw(q.x, q.y, q.z, q.w)) or not np.isfinite(origin).all():
                continue
            stamp_ns = int(one.header.stamp.sec) * NS + int(one.header.stamp.nanosec)
            pose = _Pose(stamp_ns, one.header.frame_id.lstrip("/"), origin, turn / np.linalg.norm(turn))
            child = one.child_frame_id.lstrip("/")
            if static:
                self._static[child] = pose
            else:
                self._keep(child, pose)

    def is_moving(self, frame: str) -> bool:
        """Whether a frame moves in its parent, as far as is known."""
        return frame.lstrip("/") in self._moving

    def brought(self, seen: SeenVehicle, frame: str) -> SeenVehicle | Waiting | None:
        """A vehicle as seen in another frame."""
        own = seen.frame.lstrip("/")
        if not frame or own == frame:
            return seen
        ours, theirs = self._to_root(own, seen.stamp_ns), self._to_root(frame, seen.stamp_ns)
        if ours is None or theirs is None:
            return None
        if isinstance(ours, Waiting) or isinstance(theirs, Waiting) or ours[0] != theirs[0]:
            return EARLY
        _, origin, rotation = ours
        _, base, turn = theirs
        point = turn.T @ (rotation @ np.array([seen.x_m, seen.y_m, 0.0]) + origin - base)
        ahead = turn.T @ rotation @ np.array([math.cos(seen.heading), math.sin(seen.heading), 0.0])
        heading = math.atan2(ahead[1], ahead[0])  # NaN stays NaN
        return replace(seen, x_m=float(point[0]), y_m=float(point[1]), heading=heading, frame=frame)

    def _keep(self, child: str, pose: _Pose) -> None:
        kept = self._moving.setdefault(child, [])
        if kept and pose.stamp_ns < kept[-1].stamp_ns - CACHE_S * NS:
            kept.clear()  # time has begun anew
            self.newest_ns = -1
        insort(kept, pose, key=_stamp)
        self.newest_ns = max(self.newest_ns, pose.stamp_ns)
        old = bisect_right(kept, kept[-1].stamp_ns - round(CACHE_S * NS), key=_stamp)
        # of a frame that moves seldom, the last two are kept
        del kept[: min(old, len(kept) - 2)]

    def _to_root(self, frame: str, stamp_ns: int) -> tuple[str, Array, Array] | Waiting | None:
        """The root of a frame's tree, and the frame's origin and rotation in it."""
        origin: Array = np.zeros(3)
        rotation: Array = np.eye(3)
        for _ in range(_DEEPEST):
            pose = self._static.get(frame)
            if pose is None and frame in self._moving:
                found = self._at(frame, stamp_ns)
                if not isinstance(found, _Pose):
                    return found
                pose = found
            if pose is None:
                return frame, origin, rotation
            turn = _rotation(pose.turn)
            origin, rotation, frame = turn @ origin + pose.origin, turn @ rotation, pose.parent
        return None

    def _at(self, frame: str, stamp_ns: int) -> _Pose | Waiting | None:
        """A frame at a stamp [ns]: between the transforms before and after it."""
        kept = self._moving[frame]
        k = bisect_right(kept, stamp_ns, key=_stamp)
        if k == 0:
            return None
        before = kept[k - 1]
        if before.stamp_ns == stamp_ns:
            return before
        if k == len(kept):
            return EARLY
        after = kept[k]
        between_ns = after.stamp_ns - before.stamp_ns
        if before.parent != after.parent or between_ns > self._longest_ns(kept):
            return None
        part = (stamp_ns - before.stamp_ns) / between_ns
        origin = before.origin + part * (after.origin - before.origin)
        return _Pose(stamp_ns, before.parent, origin, _between(before.turn, after.turn, part))

    def _longest_ns(self, kept: list[_Pose]) -> float:
        """Longest time [ns] between two transforms over which they are interpolated."""
        usual = float(np.median(np.diff([pose.stamp_ns for pose in kept[-_USUAL:]])))
        return max(LONGEST_HOLE_S * NS, _PERIODS * usual)


def _between(a: Array, b: Array, part: float) -> Array:
    """A quaternion on the shortest way from one to another, at a part of it (slerp)."""
    cos = float(a @ b)
    if cos < 0.0:
        b, cos = -b, -cos
    angle = math.acos(min(cos, 1.0))
    if angle < _SMALL:
        return a
    return np.asarray((math.sin((1.0 - part) * angle) * a + math.sin(part * angle) * b) / math.sin(angle))


def _rotation(quaternion: Array) -> Array:
    """Rotation (3, 3) of a quaternion of length 1."""
    x, y, z, w = quaternion.tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
