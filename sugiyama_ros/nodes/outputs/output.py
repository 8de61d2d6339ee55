"""What an output is: a standard message of each driver, made of what the driver's filter knows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, pi, sin
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseWithCovariance, Quaternion

from sugiyama_ros.arrays import Array
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.prediction import Prediction
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.centre_line import CentreLine


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

    def pose(self, position_m: float, var: float) -> PoseWithCovariance:
        """Return the pose at a position [m], whose variance [m^2] lies along the road."""
        x, y, heading = self.of(position_m)
        message = PoseWithCovariance(
            pose=Pose(position=Point(x=x, y=y), orientation=Quaternion(z=sin(0.5 * heading), w=cos(0.5 * heading)))
        )
        along = np.array([cos(heading), sin(heading)])
        covariance: Array = np.zeros((6, 6))
        covariance[:2, :2] = var * np.outer(along, along)
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
