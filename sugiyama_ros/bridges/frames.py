"""Frames of positions, and how to get from one to another: a small buffer of the transforms on /tf and /tf_static."""

import math
from bisect import bisect_right, insort
from collections.abc import Iterable
from dataclasses import replace
from enum import Enum
from operator import attrgetter
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from sugiyama_ros.arrays import Array
from sugiyama_ros.bridges.bridge import NS, yaw
from sugiyama_ros.trajectories.placing import SeenVehicle

#: Names of the topics with transforms, and whether these stay for ever.
TF_TOPICS = {"/tf": False, "/tf_static": True}
TF_TYPE = "tf2_msgs/msg/TFMessage"
# How long [s] transforms are kept, as in tf2, and how many frames may hang from one another.
_CACHE_S, _DEEPEST = 10.0, 50
# Time [s] between two transforms of a frame beyond which nothing is interpolated, if it is not the frame's usual one;
# also the longest time for which a vehicle waits for a transform.
_LONGEST_HOLE_S = 1.0
# Periods of a frame that make a hole, and transforms from which the period follows.
_PERIODS, _USUAL = 1.5, 20

_stamp = attrgetter("stamp_ns")


class Waiting(Enum):
    """What is given instead of a vehicle whose transforms have not come yet."""

    EARLY = "early"


EARLY: Final = Waiting.EARLY


class _Pose(NamedTuple):
    """A frame in its parent: stamp [ns], parent, origin (3,) [m], and rotation."""

    stamp_ns: int
    parent: str
    origin: Array
    turn: Rotation


class Frames:
    """Brings vehicles into a frame by the transforms that are published; an empty frame leaves them where they are.

    Between two transforms, frames are interpolated as in tf2. So a vehicle waits for the transform after its stamp, but
    no longer than a second.
    """

    def __init__(self, frame: str = "") -> None:
        self._frame = frame
        self._moving: dict[str, list[_Pose]] = {}
        self._static: dict[str, _Pose] = {}
        self._waiting: list[SeenVehicle] = []
        #: Vehicles from whose frames no transform leads to the frame.
        self.lost = 0

    def take(self, seen: Iterable[SeenVehicle]) -> list[SeenVehicle]:
        """Take in what was seen; returns the vehicles that are in the frame now."""
        ready = []
        for one in seen:
            found = self.brought(one, self._frame)
            if isinstance(found, SeenVehicle):
                ready.append(found)
            elif found is EARLY:
                self._waiting.append(one)
            else:
                self.lost += 1
        since_ns = max(map(_stamp, self._waiting), default=0) - round(_LONGEST_HOLE_S * NS)
        waiting = [one for one in self._waiting if one.stamp_ns >= since_ns]
        self.lost += len(self._waiting) - len(waiting)
        self._waiting = waiting
        return ready

    def hear(self, message: Any, static: bool) -> list[SeenVehicle]:
        """Take in the transforms of a TFMessage; returns the vehicles that have waited for them."""
        self.add(message, static)
        waiting, self._waiting = self._waiting, []
        return self.take(waiting)

    def add(self, message: Any, static: bool) -> None:
        """Keep the transforms of a TFMessage. One that is no rotation is left out."""
        for one in message.transforms:
            q, t = one.transform.rotation, one.transform.translation
            origin = np.array([t.x, t.y, t.z])
            if math.isnan(yaw(q.x, q.y, q.z, q.w)) or not np.isfinite(origin).all():
                continue
            stamp_ns = int(one.header.stamp.sec) * NS + int(one.header.stamp.nanosec)
            turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
            pose = _Pose(stamp_ns, one.header.frame_id.lstrip("/"), origin, turn)
            child = one.child_frame_id.lstrip("/")
            if static:
                self._static[child] = pose
            else:
                self._keep(child, pose)

    def is_moving(self, frame: str) -> bool:
        """Whether a frame moves in its parent, as far as is known."""
        return frame in self._moving

    def brought(self, seen: SeenVehicle, frame: str) -> SeenVehicle | Waiting | None:
        """A vehicle as seen in another frame; None where no transform leads there."""
        if not frame or seen.frame == frame:
            return seen
        ours, theirs = self._to_root(seen.frame, seen.stamp_ns), self._to_root(frame, seen.stamp_ns)
        if ours is None or theirs is None:
            return None
        if isinstance(ours, Waiting) or isinstance(theirs, Waiting) or ours.parent != theirs.parent:
            return EARLY
        back = theirs.turn.inv()
        x, y, _ = back.apply(ours.turn.apply([seen.x_m, seen.y_m, 0.0]) + ours.origin - theirs.origin).tolist()
        heading = math.nan
        if not math.isnan(seen.heading):
            ahead = (back * ours.turn).apply([math.cos(seen.heading), math.sin(seen.heading), 0.0])
            heading = math.atan2(ahead[1], ahead[0])
        return replace(seen, x_m=x, y_m=y, heading=heading, frame=frame)

    def _keep(self, child: str, pose: _Pose) -> None:
        kept = self._moving.setdefault(child, [])
        if kept and pose.stamp_ns < kept[-1].stamp_ns - _CACHE_S * NS:
            kept.clear()  # time has begun anew
        insort(kept, pose, key=_stamp)
        old = bisect_right(kept, kept[-1].stamp_ns - round(_CACHE_S * NS), key=_stamp)
        # of a frame that moves seldom, the last two are kept
        del kept[: min(old, len(kept) - 2)]

    def _to_root(self, frame: str, stamp_ns: int) -> _Pose | Waiting | None:
        """A frame in the root of its tree."""
        found = _Pose(stamp_ns, frame, np.zeros(3), Rotation.identity())
        for _ in range(_DEEPEST):
            pose: _Pose | Waiting | None = self._static.get(found.parent)
            if pose is None and found.parent not in self._moving:
                return found
            pose = pose or self._at(found.parent, stamp_ns)
            if not isinstance(pose, _Pose):
                return pose
            origin = pose.turn.apply(found.origin) + pose.origin
            found = _Pose(stamp_ns, pose.parent, origin, pose.turn * found.turn)
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
        usual_ns = float(np.median(np.diff([pose.stamp_ns for pose in kept[-_USUAL:]])))
        if before.parent != after.parent or between_ns > max(_LONGEST_HOLE_S * NS, _PERIODS * usual_ns):
            return None
        part = (stamp_ns - before.stamp_ns) / between_ns
        turn = before.turn * Rotation.from_rotvec(part * (before.turn.inv() * after.turn).as_rotvec())
        return _Pose(stamp_ns, before.parent, before.origin + part * (after.origin - before.origin), turn)
