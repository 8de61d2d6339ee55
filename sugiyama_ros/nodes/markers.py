"""The road and its vehicles as markers for RViz and Foxglove."""

from math import cos, isfinite, pi, sin

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.base.samples import Positions
from sugiyama_ros.road import Road

_WIDTH_M, _HEIGHT_M = 1.7, 1.5
_GREY = ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0)
_BLUE = ColorRGBA(r=0.2, g=0.5, b=0.9, a=1.0)
_CORNERS = 72


def markers(stamp: Time, road: Road, positions: Positions) -> MarkerArray:
    """Draw a box for each vehicle with a known position: on a circle for a ring, along the x axis for an open road.

    Each message replaces the message before.
    """
    array = MarkerArray(markers=[_marker(stamp, "", 0, Marker.DELETEALL)])
    if road.is_ring:
        line = _marker(stamp, "road", 0, Marker.ADD, Marker.LINE_STRIP, _GREY)
        line.scale.x = 0.3
        line.points = [_pose(road, k / _CORNERS * road.circumference_m).position for k in range(_CORNERS + 1)]
        array.markers.append(line)
    for number, position, length in zip(positions.vehicle, positions.position_m, positions.length_m, strict=True):
        if isfinite(position):
            box = _marker(stamp, "vehicles", number, Marker.ADD, Marker.CUBE, _BLUE)
            box.pose = _pose(road, position)
            box.scale = Vector3(x=length, y=_WIDTH_M, z=_HEIGHT_M)
            array.markers.append(box)
    return array


def _marker(stamp: Time, name: str, number: int, action: int, shape: int = 0, color: ColorRGBA | None = None) -> Marker:
    marker = Marker(ns=name, id=number, action=action, type=shape, color=color or ColorRGBA())
    marker.header.stamp, marker.header.frame_id = stamp, FRAME
    marker.pose.orientation.w = 1.0
    return marker


def _pose(road: Road, position_m: float) -> Pose:
    if not road.is_ring:
        return Pose(position=Point(x=position_m))
    angle = 2.0 * pi * position_m / road.circumference_m
    radius = road.circumference_m / (2.0 * pi)
    heading = angle + pi / 2.0
    return Pose(
        position=Point(x=radius * cos(angle), y=radius * sin(angle)),
        orientation=Quaternion(z=sin(heading / 2.0), w=cos(heading / 2.0)),
    )
