"""The centre line of a road: where points of the plane lie along it and across it."""

from collections.abc import Sequence

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import RINGS_M, Road

# Two ends of a line that are nearer than this [m] are the same point: the road is a ring.
_CLOSED_M = 1e-3
# Steps of the search for the foot of a perpendicular; each divides its error by more than ten on any real road.
_STEPS = 8


class CentreLine:
    """A line through points of the plane, with a direction that turns steadily from point to point.

    x_m, y_m: (P,), points [m], in the direction of driving; if the last point is the first, the road is a ring; road:
    the road; its circumference [m] is the length of the line if the line is closed; length_m: length [m] of the line.
    Raises InputError.
    """

    def __init__(self, x_m: Array, y_m: Array) -> None:
        if len(x_m) < 2 or not (np.isfinite(x_m).all() and np.isfinite(y_m).all()):
            raise InputError(f"centre line: {len(x_m)} points; give at least two, all of them numbers")
        with np.errstate(over="ignore"):
            step_x, step_y = np.diff(x_m), np.diff(y_m)
            step = np.hypot(step_x, step_y)
            length_m = float(step.sum())
        if not (step > 0.0).all():
            raise InputError(f"centre line: point {int(np.argmin(step)) + 2} is the one before it; remove one of them")
        if not length_m <= RINGS_M[1]:
            raise InputError(f"centre line: is {length_m:.3g} m long; give points in metres, {RINGS_M[1]:g} m at most")
        self._x, self._y = x_m.astype(np.float64), y_m.astype(np.float64)
        self._s = np.concatenate([[0.0], np.cumsum(step)])
        self.length_m = float(self._s[-1])
        closed = len(x_m) > 3 and np.hypot(x_m[-1] - x_m[0], y_m[-1] - y_m[0]) < _CLOSED_M
        self.road = Road(self.length_m if closed else 0.0)
        self._angle, self._turn = self._directions(np.unwrap(np.arctan2(step_y, step_x)), step)

    def _directions(self, along: Array, step: Array) -> tuple[Array, Array]:
        """Angle [rad] of the line at each point, and its turn [rad/m] in each piece between two points."""
        angle = np.empty(len(step) + 1)
        angle[1:-1] = (along[:-1] * step[1:] + along[1:] * step[:-1]) / (step[:-1] + step[1:])
        if self.road.is_ring:
            full = 2.0 * np.pi * round((along[-1] - along[0]) / (2.0 * np.pi))
            # at the seam, the last piece is one turn ahead of the first
            full = full if full else 2.0 * np.pi * np.sign(along[-1] - along[0])
            seam = (along[-1] - full) * step[0] + along[0] * step[-1]
            angle[0] = seam / (step[0] + step[-1])
            angle[-1] = angle[0] + full
        else:
            angle[0] = along[0] if len(along) == 1 else 2.0 * along[0] - angle[1]
            angle[-1] = along[-1] if len(along) == 1 else 2.0 * along[-1] - angle[-2]
        return angle, np.diff(angle) / step

    def project(self, x_m: Array, y_m: Array) -> tuple[Array, Array]:
        """Find where points lie along the line and across it.

        x_m, y_m: (N,), points [m]. Returns s_m: (N,), position [m] along the line; on a ring from 0 to below its
        length, on an open road also before and after it; d_m: (N,), position [m] across the line, positive to its left.
        """
        s = self._nearest(x_m, y_m)
        for _ in range(_STEPS):
            piece, ahead, across = self._seen(s, x_m, y_m)
            # a point at the side of a bend moves faster along the line than in the plane
            s = s + ahead / np.maximum(1.0 - self._turn[piece] * across, 0.2)
        _, _, across = self._seen(s, x_m, y_m)
        return self.road.wrap(s), across

    def heading(self, s_m: Array) -> Array:
        """Angle [rad] of the line at positions (N,) [m]."""
        inside = self.road.wrap(s_m) if self.road.is_ring else np.clip(s_m, 0.0, self.length_m)
        return np.asarray(np.interp(inside, self._s, self._angle))

    def at(self, s_m: Array, d_m: Array) -> tuple[Array, Array]:
        """Points (N,) [m] of the plane at positions along and across the line (N,) [m]."""
        s, beyond = self._inside(s_m)
        angle = np.interp(s, self._s, self._angle)
        x = np.interp(s, self._s, self._x) + beyond * np.cos(angle) - d_m * np.sin(angle)
        y = np.interp(s, self._s, self._y) + beyond * np.sin(angle) + d_m * np.cos(angle)
        return np.asarray(x), np.asarray(y)

    def _inside(self, s_m: Array) -> tuple[Array, Array]:
        """Positions within the line, and how far [m] they lie beyond one of its ends."""
        s = self.road.wrap(s_m) if self.road.is_ring else np.clip(s_m, 0.0, self.length_m)
        return s, np.zeros_like(s) if self.road.is_ring else s_m - s

    def _seen(self, s_m: Array, x_m: Array, y_m: Array) -> tuple[Ints, Array, Array]:
        """Points seen from positions on the line: piece, and distance [m] ahead and to the left."""
        s, _ = self._inside(s_m)
        piece = np.clip(np.searchsorted(self._s, s, side="right") - 1, 0, len(self._turn) - 1)
        on_x, on_y = self.at(s_m, np.zeros_like(s_m))
        angle = np.interp(s, self._s, self._angle)
        off_x, off_y = x_m - on_x, y_m - on_y
        cos, sin = np.cos(angle), np.sin(angle)
        return piece, cos * off_x + sin * off_y, cos * off_y - sin * off_x

    def _nearest(self, x_m: Array, y_m: Array) -> Array:
        """Position [m] of the nearest point of the line; beyond the ends of an open road, along its last piece."""
        step_x, step_y, step = np.diff(self._x), np.diff(self._y), np.diff(self._s)
        off_x, off_y = np.subtract.outer(x_m, self._x[:-1]), np.subtract.outer(y_m, self._y[:-1])
        part = np.clip((off_x * step_x + off_y * step_y) / step**2, 0.0, 1.0)
        far = np.hypot(off_x - part * step_x, off_y - part * step_y)
        best = np.argmin(far, axis=1)
        return np.asarray(self._s[best] + part[np.arange(len(best)), best] * step[best])


class RoadLanes:
    """A road of one or more lanes, each with a centre line of its own; positions are along the line of the first.

    names: names of the lanes; lines: their centre lines; width_m: their widths [m].
    """

    def __init__(self, names: Sequence[str], lines: Sequence[CentreLine], width_m: Sequence[float]) -> None:
        self.names, self.lines = tuple(names), tuple(lines)
        self.width_m = np.array(width_m, dtype=np.float64)

    @property
    def road(self) -> Road:
        """The road, along the centre line of its first lane."""
        return self.lines[0].road

    def place(self, x_m: Array, y_m: Array) -> tuple[Array, Array]:
        """Find where points lie on the road.

        x_m, y_m: (N,), points [m]. Returns s_m: (N,), positions [m] along the line of the first lane; d_m: (L, N),
        positions [m] across the line of each lane, positive to its left.
        """
        projected = [line.project(x_m, y_m) for line in self.lines]
        return projected[0][0], np.array([d for _, d in projected])
