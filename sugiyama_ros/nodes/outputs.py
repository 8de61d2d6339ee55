"""Standard messages of each driver, made of what the filter knows, and the parameter that chooses among them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, isnan, pi, remainder, sin
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovariance, Quaternion, TwistWithCovariance
from nav_msgs.msg import Odometry, Path

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.chain import CHAIN
from sugiyama_ros.filters.online import Estimate
from sugiyama_ros.formats.centre_line import read_lanes
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.formats.truth import namespace
from sugiyama_ros.nodes.base.cdr_messages import NS, time_message
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.follower import AHEAD_S, VEHICLES, Follower, Prediction
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.centre_line import CentreLine

# Variance of what the filter does not know, such as height and roll [SI]: not 0, which would mean that it is exact.
_UNKNOWN_VAR = 1e6
# Std [rad] of the direction of a vehicle around that of the road: who changes lane at 10 m/s moves aside at 1 m/s.
_ASIDE_STD = 0.1


class _Places:
    """Where positions along the road lie in the plane, ``frame``.

    Without a centre line, a ring is a circle around the origin, as in ``markers``, and an open road is the x axis.
    """

    def __init__(self, road: Road, line: CentreLine | None = None, frame: str = FRAME) -> None:
        self.frame, self._road, self._line = frame, road, line

    def of(self, position_m: float) -> tuple[float, float, float]:
        """Return x [m], y [m] and the direction of driving [rad] at a position [m]."""
        if self._line is not None:
            s = np.array([position_m])
            (x,), (y,) = self._line.at(s, np.zeros(1))
            return float(x), float(y), float(self._line.heading(s)[0])
        if not self._road.is_ring:
            return position_m, 0.0, 0.0
        angle, radius = 2.0 * pi * position_m / self._road.circumference_m, self._road.circumference_m / (2.0 * pi)
        return radius * cos(angle), radius * sin(angle), angle + pi / 2.0

    def curvature(self, position_m: float) -> float:
        """Return by how much the road turns [rad/m] at a position [m]."""
        if self._line is not None:
            before, after = self._line.heading(np.array([position_m - 0.5, position_m + 0.5])).tolist()
            return remainder(after - before, 2.0 * pi)
        return 2.0 * pi / self._road.circumference_m if self._road.is_ring else 0.0

    def pose(self, position_m: float, var: float) -> PoseWithCovariance:
        """Return the pose at a position [m] with a variance [m^2]: on the line, and pointing along it."""
        x, y, heading = self.of(position_m)
        message = PoseWithCovariance(
            pose=Pose(position=Point(x=x, y=y), orientation=Quaternion(z=sin(0.5 * heading), w=cos(0.5 * heading)))
        )
        # x, y and yaw change with the position along the road; the road turns by its curvature
        by_position = np.zeros(6)
        by_position[[0, 1, 5]] = cos(heading), sin(heading), self.curvature(position_m)
        covariance = np.asarray(var * np.outer(by_position, by_position), np.float64)
        covariance[[2, 3, 4], [2, 3, 4]] = _UNKNOWN_VAR
        covariance[5, 5] += _ASIDE_STD**2
        message.covariance = covariance.ravel()
        return message


@dataclass(frozen=True, eq=False)
class _DriverNow:
    """What is known of a driver after a sample; path: states of now and of the next seconds."""

    stamp_ns: int
    vehicle: int
    path: Prediction
    places: _Places


@dataclass(frozen=True, eq=False)
class _Output:
    """A standard message of each driver.

    name: of the topic in the vehicle's namespace, and in the parameter ``publish``; every_s: time [s] between two of
    them, at least; 0 for one with each sample; ahead_s: how far ahead [s] it needs the path.
    """

    name: str
    kind: type
    messages: Callable[[_DriverNow], Sequence[Any]]
    every_s: float = 0.0
    ahead_s: float = 0.0


def _odometry(known: _DriverNow, k: int = 0) -> Odometry:
    """State number k of the path, with the stamp of its time."""
    path = known.path
    message = Odometry(
        child_frame_id=namespace(known.vehicle),
        pose=known.places.pose(float(path.position_m[k]), float(path.covariance[k, 0, 0])),
        twist=TwistWithCovariance(),
    )
    message.header.stamp = time_message(known.stamp_ns + round(float(path.time_s[k]) * NS))
    message.header.frame_id = known.places.frame
    message.twist.twist.linear.x = float(path.speed[k])
    # of the speeds, the filter knows the one along the road
    covariance: Array = np.diag([float(path.covariance[k, 1, 1]), *[_UNKNOWN_VAR] * 5])
    message.twist.covariance = covariance.ravel()
    return message


def _predicted_odometry(known: _DriverNow) -> list[Odometry]:
    """One message for each second ahead."""
    times = known.path.time_s
    return [_odometry(known, int(np.abs(times - second).argmin())) for second in range(1, round(times[-1]) + 1)]


def _predicted_path(known: _DriverNow) -> list[Path]:
    """The path, whose poses have the stamps of their times."""
    message = Path()
    message.header.stamp, message.header.frame_id = time_message(known.stamp_ns), known.places.frame
    for time_s, position_m in zip(known.path.time_s.tolist(), known.path.position_m.tolist(), strict=True):
        pose = PoseStamped(pose=known.places.pose(position_m, 0.0).pose)
        pose.header.stamp, pose.header.frame_id = time_message(known.stamp_ns + round(time_s * NS)), known.places.frame
        message.poses.append(pose)
    return [message]


_OUTPUTS = (
    _Output("odometry", Odometry, lambda known: [_odometry(known)]),
    _Output("predicted_path", Path, _predicted_path, every_s=1.0, ahead_s=AHEAD_S),
    _Output("predicted_odometry", Odometry, _predicted_odometry, every_s=1.0, ahead_s=AHEAD_S),
)


class StandardTopics:
    """Publishes what the parameter ``publish`` asks for, of each driver, on topics such as ``vehicle_07/odometry``."""

    def __init__(self, node: PacedNode) -> None:
        self._node = node
        known = {one.name: one for one in _OUTPUTS}
        names = node.texts("publish", f"standard messages of each driver to publish: {', '.join(known)}")
        for name in names:
            if name not in known:
                raise InputError(f"publish: {name!r} is not known; give {', '.join(known)}")
        self._outputs = [known[name] for name in names]
        file = node.path("centre_line", "centre lines of the lanes (CSV), for published poses")
        self._line: CentreLine | None = None if file is None else read_lanes(file).lines[0]
        self._frame = str(node.option("frame", "road", "frame of published poses"))
        self._told_ns: dict[tuple[int, str], int] = {}

    @property
    def vehicles(self) -> int:
        """Vehicles that a driver's filter needs in its chain: more where a path is predicted."""
        return VEHICLES if any(one.ahead_s > 0.0 for one in self._outputs) else CHAIN

    def publish(self, road: Road, follower: Follower, estimate: Estimate, stamp_ns: int) -> None:
        """Publish what is due of a driver after a sample."""
        vehicle = follower.vehicle
        due = [one for one in self._outputs if self._is_due(vehicle, one, stamp_ns)]
        if not due or isnan(estimate.speed):
            return
        path = follower.predict(estimate, stamp_ns, max(one.ahead_s for one in due))
        known = _DriverNow(stamp_ns, vehicle, path, _Places(road, self._line, self._frame))
        for one in due:
            self._told_ns[vehicle, one.name] = stamp_ns
            publisher = self._node.stream(one.kind, f"{namespace(vehicle)}/{one.name}")
            for message in one.messages(known):
                self._node.send(publisher, message)

    def _is_due(self, vehicle: int, output: _Output, stamp_ns: int) -> bool:
        told_ns = self._told_ns.get((vehicle, output.name))
        return told_ns is None or not 0 <= stamp_ns - told_ns < output.every_s * NS

    def retire(self, vehicle: int) -> None:
        """Take down the topics of a driver who has gone."""
        for one in self._outputs:
            self._told_ns.pop((vehicle, one.name), None)
            self._node.end_stream(f"{namespace(vehicle)}/{one.name}")
