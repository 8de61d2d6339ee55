"""Heading and way ahead of vehicles that were seen in the plane: one filter for each vehicle (``filters.plane``)."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, isfinite, nan, sin

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Header

from sugiyama_ros.arrays import Array
from sugiyama_ros.bridges.perception import RoadSample
from sugiyama_ros.driver.bicycle import car_of, slip_and_turn
from sugiyama_ros.driver.parameters import SIGMA_NU, population
from sugiyama_ros.filters.chain import CHAIN
from sugiyama_ros.filters.plane import PlaneEstimates, PlaneFilter, PlaneTrack
from sugiyama_ros.filters.state import STATE
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.formats.truth import namespace
from sugiyama_ros.nodes.base.cdr_messages import NS, time_message
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.trajectories.centre_line import RoadLanes
from sugiyama_ros.trajectories.placing import OnLane

_ODOMETRY, _PATH = "plane_odometry", "plane_path"
# Time [ns] between two paths of a vehicle, at least; and time [s] without a sample after which its filter ends.
_PATH_EVERY_NS, _GONE_S = NS, 5.0
# Variance of what the filter does not know, such as height and roll [SI]: not 0, which would mean that it is exact.
_UNKNOWN_VAR = 1e6


@dataclass(eq=False)
class _InPlane:
    """A vehicle that is followed on a lane: its filter, its latest sample, what is known then, and its latest path."""

    filter: PlaneFilter
    lane: int
    step: int
    latest: PlaneEstimates | None = None
    chain: Sequence[int] = ()
    told_ns: int | None = None

    def speed_of(self, m: int, vehicle: int) -> float:
        """Speed [m/s] of vehicle number m of the chain; 0 if it is another vehicle, or not known."""
        if self.latest is None or self.chain[m] != vehicle:
            return 0.0
        return float(self.latest.mean[-1, STATE * m + 1])


class PlaneTopics:
    """Publishes ``vehicle_07/plane_odometry`` with each sample and ``vehicle_07/plane_path`` once a second.

    A vehicle that changes lane, or has not been seen for 5 s, gets a new filter.

    lanes: the road; period_s: time between two samples [s]; ahead_s: length of the path [s].
    """

    def __init__(self, node: PacedNode, lanes: RoadLanes, period_s: float, ahead_s: float) -> None:
        self._node, self._lanes, self._period_s, self._ahead_s = node, lanes, period_s, ahead_s
        self._car = car_of()
        self._known: dict[int, _InPlane] = {}
        # load or compile the code now, so that no sample has to wait for it
        PlaneFilter(lanes.lines[0], period_s, CHAIN).predicted_path(period_s)

    def publish(self, sample: RoadSample) -> None:
        """Follow the vehicles of a sample, and publish what is known of them."""
        numbers = sample.positions.vehicle
        seen = dict(zip(numbers, sample.placed, strict=False))
        leaders = dict(zip(numbers, sample.positions.leader, strict=True))
        for vehicle, one in seen.items():
            chain = [vehicle]
            while len(chain) < CHAIN:
                ahead = leaders.get(chain[-1], -1)
                chain.append(-1 if ahead in chain else ahead)
            known = self._follow(vehicle, one, sample)
            self._take_in(known, sample, [(number, seen.get(number)) for number in chain])
            if known.latest is not None and isfinite(known.latest.speed[-1]):
                self._tell(vehicle, known, one.seen.frame or FRAME, sample.stamp_ns)
        for vehicle in [v for v, known in self._known.items() if self._is_gone(known, sample.step)]:
            del self._known[vehicle]
            for topic in (_ODOMETRY, _PATH):
                self._node.end_stream(f"{namespace(vehicle)}/{topic}")

    def _is_gone(self, known: _InPlane, step: int) -> bool:
        return not 0 <= (step - known.step) * self._period_s <= _GONE_S

    def _follow(self, vehicle: int, one: OnLane, sample: RoadSample) -> _InPlane:
        """Return the filter of a vehicle, a new one where it cannot go on."""
        known = self._known.get(vehicle)
        is_lost = known is not None and known.latest is not None and not np.isfinite(known.latest.mean).all()
        if known is None or is_lost or known.lane != one.lane or self._is_gone(known, sample.step):
            driver = population()
            if isfinite(one.seen.var):
                driver[SIGMA_NU] = max(one.seen.var, 0.0) ** 0.5
            filter_ = PlaneFilter(self._lanes.lines[one.lane], self._period_s, CHAIN, driver, car=self._car)
            known = self._known[vehicle] = _InPlane(filter_, one.lane, sample.step - 1)
        return known

    def _take_in(self, known: _InPlane, sample: RoadSample, chain: list[tuple[int, OnLane | None]]) -> None:
        """Bring a filter to the time of a sample.

        chain: numbers of the vehicle and of those ahead, and where they were seen.
        """
        samples, line = sample.step - known.step, self._lanes.lines[known.lane]
        numbers = np.array([number for number, _ in chain])
        x_m, y_m, ahead = np.full(samples, nan), np.full(samples, nan), np.full((samples, CHAIN - 1), nan)
        for m, (number, one) in enumerate(chain):
            if one is None:
                continue
            # where the vehicle is at the time of the sample
            way_m = known.speed_of(m, number) * 1e-9 * (sample.stamp_ns - one.seen.stamp_ns)
            if m > 0:
                s_m = (
                    one.s_m
                    if known.lane == 0
                    else float(line.project(np.array([one.seen.x_m]), np.array([one.seen.y_m]))[0][0])
                )
                ahead[-1, m - 1] = float(line.road.wrap(np.array(s_m + way_m)))
                continue
            heading = 0.0 if known.latest is None or way_m == 0.0 else float(known.latest.heading[-1])
            x_m[-1], y_m[-1] = one.seen.x_m + way_m * cos(heading), one.seen.y_m + way_m * sin(heading)
        lengths = dict(zip(sample.positions.vehicle, sample.positions.length_m, strict=True))
        length_m = np.array([lengths.get(number, 0.0) for number in numbers.tolist()])
        track = PlaneTrack(x_m, y_m, None, ahead, np.tile(numbers, (samples, 1)), length_m)
        known.latest, known.step, known.chain = known.filter.run(track), sample.step, numbers.tolist()

    def _tell(self, vehicle: int, known: _InPlane, frame: str, stamp_ns: int) -> None:
        """Publish what is known of a vehicle."""
        assert known.latest is not None
        node, space = self._node, namespace(vehicle)
        header = Header(stamp=time_message(stamp_ns), frame_id=frame)
        node.send(node.stream(Odometry, f"{space}/{_ODOMETRY}"), self._odometry(space, known.latest, header))
        if known.told_ns is None or not 0 <= stamp_ns - known.told_ns < _PATH_EVERY_NS:
            known.told_ns = stamp_ns
            places = np.vstack([_places(known.latest)[-1:], _places(known.filter.predicted_path(self._ahead_s))])
            path = Path(header=header)
            for k, place in enumerate(places.tolist()):
                then = time_message(stamp_ns + round(k * self._period_s * NS))
                path.poses.append(PoseStamped(header=Header(stamp=then, frame_id=frame), pose=_pose(*place)))
            node.send(node.stream(Path, f"{space}/{_PATH}"), path)

    def _odometry(self, space: str, latest: PlaneEstimates, header: Header) -> Odometry:
        """Place, heading and speeds of a vehicle."""
        message = Odometry(header=header, child_frame_id=space)
        message.pose.pose = _pose(*_places(latest)[-1].tolist())
        slip, turn = slip_and_turn(float(latest.steering[-1]), self._car)
        speed, twist = float(latest.speed[-1]), message.twist.twist
        twist.linear.x, twist.linear.y, twist.angular.z = speed * cos(slip), speed * sin(slip), speed * turn
        pose_var, twist_var = np.diag([_UNKNOWN_VAR] * 6), np.diag([_UNKNOWN_VAR] * 6)
        entries = [0, latest.mean.shape[1] - 3, latest.mean.shape[1] - 2]
        pose_var[np.ix_([0, 1, 5], [0, 1, 5])] = latest.covariance[-1][np.ix_(entries, entries)]
        twist_var[0, 0] = latest.covariance[-1, 1, 1]
        message.pose.covariance, message.twist.covariance = pose_var.ravel(), twist_var.ravel()
        return message


def _places(estimates: PlaneEstimates) -> Array:
    """Places x, y [m] and headings [rad], (T, 3)."""
    return np.column_stack([estimates.x_m, estimates.y_m, estimates.heading])


def _pose(x_m: float, y_m: float, heading: float) -> Pose:
    """Pose at a place [m] with a heading [rad]."""
    return Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion(z=sin(0.5 * heading), w=cos(0.5 * heading)))
