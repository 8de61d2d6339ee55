"""What an output is: a standard message of each driver, made of what the driver's filter knows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, pi, remainder, sin
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseWithCovariance, Quaternion

from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.prediction import Prediction
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.centre_line import CentreLine

#: Variance of what the filter does not know, such as height and roll [SI]: not 0, which would mean that it is exact.
UNKNOWN_VAR = 1e6
# Std [rad] of the direction of a vehicle around that of the road: who changes lane at 10 m/s moves aside at 1 m/s.
_ASIDE_STD = 0.1


class Places:
    """Where positions along the road lie in the plane.

    Without a centre line, a ring is a circle around the origin, as in ``markers``, and an open road is the x axis.

    Parameters
    ----------
    road : Road
        The road.
    line : CentreLine, optional
        Its centre line.
    frame : str
        Frame of the plane.
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
        covariance[[2, 3, 4], [2, 3, 4]] = UNKNOWN_VAR
        covariance[5, 5] += _ASIDE_STD**2
        message.covariance = covariance.ravel()
        return message


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of a driver after a sample.

    stamp_ns: of the sample; vehicle: number; path: states of now and of the next seconds; places: of the road.
    """

    stamp_ns: int
    vehicle: int
    path: Prediction
    places: Places


@dataclass(frozen=True, eq=False)
class DriverOutput:
    """A standard message of each driver.

    Parameters
    ----------
    name : str
        Name of the topic in the vehicle's namespace, and in the parameter ``publish``.
    kind : type
        Class of the message.
    messages : callable
        Known -> messages.
    every_s : float
        Time [s] between two of them, at least; 0 for one with each sample.
    ahead_s : float
        How far ahead [s] it needs the path.
    """

    name: str
    kind: type
    messages: Callable[[Known], Sequence[Any]]
    every_s: float = 0.0
    ahead_s: float = 0.0
