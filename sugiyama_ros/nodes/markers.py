"""The road and its vehicles as markers for RViz and Foxglove."""

from math import pi

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Vector3
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.samples import Positions
from sugiyama_ros.road import Road

_WIDTH_M, _HEIGHT_M = 1.7, 1.5
_GREY = ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0)
_BLUE = ColorRGBA(r=0.2, g=0.5, b=0.9, a=1.0)
_CORNERS = 72
# Special numbers, which nothing else in a message has, show where the bytes of a number stand.
_SEC, _NANOSEC, _ID = 0x5EC0_5EC0, 0x7A0_7A07, 0x1D1D_1D1D
_REAL = {name: (k + 1.2345) * 1e-300 for k, name in enumerate(("x", "y", "z", "w", "length"))}
_MARK = {"sec": _SEC, "nanosec": _NANOSEC, "id": _ID, **_REAL}
_DTYPES = {"sec": "<i4", "nanosec": "<u4", "id": "<i4", **dict.fromkeys(_REAL, "<f8")}
# Bytes before the count of the markers, and behind it.
_COUNT_AT, _FIRST_AT = 4, 8


class Markers:
    """Messages with a box for each vehicle with a known position.

    The vehicles are on a circle for a ring, and along the x axis for an open road. Each message replaces the message
    before. A message object of 22 boxes takes longer to make than the filters of 22 drivers take for a step, so the
    bytes are made once and filled with new numbers.

    road: the road.
    """

    def __init__(self, road: Road) -> None:
        self._road = road
        first = [_marker(Marker.DELETEALL), *([_line(road)] if road.is_ring else [])]
        box = _marker(Marker.ADD, "vehicles", _ID, Marker.CUBE, _BLUE)
        box.pose.position = Point(x=_REAL["x"], y=_REAL["y"])
        box.pose.orientation = Quaternion(z=_REAL["z"], w=_REAL["w"])
        box.scale = Vector3(x=_REAL["length"], y=_WIDTH_M, z=_HEIGHT_M)
        # where a box stands decides how many bytes align its numbers; after two boxes, this begins anew
        *_, a, b, c = (_bytes_of([*first, *[box] * count]) for count in range(3))
        self._first = np.frombuffer(a, np.uint8).copy()
        self._stamps = [_places(a, name) for name in ("sec", "nanosec")]
        self._boxes = [_Box(b[len(a) :]), _Box(c[len(b) :])]

    def message(self, stamp_ns: int, positions: Positions) -> bytes:
        """Bytes of the message for a sample at a stamp [ns]."""
        position, length = np.array(positions.position_m), np.array(positions.length_m)
        known = np.isfinite(position)
        x, y, heading = _on_the_plane(self._road, position[known])
        sec, nanosec = divmod(stamp_ns, NS)
        columns = {
            "sec": np.full(len(x), sec),
            "nanosec": np.full(len(x), nanosec),
            "id": np.array(positions.vehicle)[known],
            "x": x,
            "y": y,
            "z": np.sin(0.5 * heading),
            "w": np.cos(0.5 * heading),
            "length": length[known],
        }
        first = self._first.copy()
        first[_COUNT_AT:_FIRST_AT] = np.frombuffer(np.uint32(self._markers_before + len(x)).tobytes(), np.uint8)
        for places, number in zip(self._stamps, (np.int32(sec), np.uint32(nanosec)), strict=True):
            for at in places:
                first[at : at + 4] = np.frombuffer(number.tobytes(), np.uint8)
        even, odd = (
            box.filled({name: column[k::2] for name, column in columns.items()}) for k, box in enumerate(self._boxes)
        )
        pairs = np.hstack([even[: len(odd)], odd]).ravel()
        return bytes(np.concatenate([first, pairs, even[len(odd) :].ravel()]))

    @property
    def _markers_before(self) -> int:
        return 2 if self._road.is_ring else 1


class _Box:
    """The bytes of a box, with the places of its numbers."""

    def __init__(self, template: bytes) -> None:
        offsets = {name: _places(template, name)[0] for name in _MARK}
        self._dtype = np.dtype(
            {
                "names": list(_MARK),
                "formats": [_DTYPES[name] for name in _MARK],
                "offsets": [offsets[name] for name in _MARK],
                "itemsize": len(template),
            }
        )
        self._template = np.frombuffer(template, np.uint8)

    def filled(self, columns: dict[str, Array]) -> NDArray[np.uint8]:
        """Bytes (N, B) of N boxes with the numbers of ``columns``."""
        count = len(columns["x"])
        filled = np.tile(self._template, (count, 1))
        boxes = filled.view(self._dtype)[:, 0] if count else np.empty(0, self._dtype)
        for name, column in columns.items():
            boxes[name] = column
        return filled


def _bytes_of(markers: list[Marker]) -> bytes:
    """Bytes of a message with markers, up to where the next marker would begin."""
    raw = bytes(serialize_message(MarkerArray(markers=markers)))
    return raw.ljust(-(-len(raw) // 4) * 4, b"\0")


def _places(raw: bytes, name: str) -> list[int]:
    """Where a special number stands."""
    mark = np.array(_MARK[name], _DTYPES[name]).tobytes()
    found = [raw.find(mark)]
    while found[-1] >= 0:
        found.append(raw.find(mark, found[-1] + 1))
    return found[:-1]


def _marker(action: int, name: str = "", number: int = 0, shape: int = 0, color: ColorRGBA | None = None) -> Marker:
    marker = Marker(ns=name, id=number, action=action, type=shape, color=color or ColorRGBA())
    marker.header.stamp = Time(sec=_SEC, nanosec=_NANOSEC)
    marker.header.frame_id = FRAME
    marker.pose.orientation.w = 1.0
    return marker


def _line(road: Road) -> Marker:
    """The road as a line."""
    line = _marker(Marker.ADD, "road", 0, Marker.LINE_STRIP, _GREY)
    line.scale.x = 0.3
    x, y, _ = _on_the_plane(road, np.asarray(np.linspace(0.0, road.circumference_m, _CORNERS + 1)))
    line.points = [Point(x=x_m, y=y_m) for x_m, y_m in zip(x.tolist(), y.tolist(), strict=True)]
    return line


def _on_the_plane(road: Road, position_m: Array) -> tuple[Array, Array, Array]:
    """Coordinates x, y [m] and heading [rad] of positions [m], each (N,)."""
    if not road.is_ring:
        return position_m, np.zeros_like(position_m), np.zeros_like(position_m)
    angle, radius = 2.0 * pi * position_m / road.circumference_m, road.circumference_m / (2.0 * pi)
    return radius * np.cos(angle), radius * np.sin(angle), angle + 0.5 * pi
