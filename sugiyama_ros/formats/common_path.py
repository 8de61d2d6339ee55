"""Positions along a path that several vehicles drive one behind the other, from their coordinates in the plane."""

import numpy as np

from sugiyama_ros.arrays import Array, Ints

#: Distance [m] between two points of a path.
_POINT_M = 1.0
# Distance [m] from the path within which a vehicle counts as on it when it is first seen.
_NEAR_M = 15.0
# Longest path [m] whose mean is taken.
_LONGEST_M = 1e6
# Rounds in which the mean path is taken: vehicles cut curves differently.
_ROUNDS = 2
# Points behind and ahead of the last one that are looked at, and more ahead for each sample that was missed.
_BACK, _AHEAD, _PER_MISSED = 8, 12, 5


class Path2d:
    """A path of straight pieces.

    point_m: (P, 2), points [m] along the path.
    """

    def __init__(self, point_m: Array) -> None:
        self.point_m = point_m
        self._way = np.diff(point_m, axis=0)
        self._length = np.hypot(self._way[:, 0], self._way[:, 1])
        self._start = np.concatenate(([0.0], np.cumsum(self._length)))

    @property
    def length_m(self) -> float:
        """Length [m] of the path."""
        return float(self._start[-1])

    def positions(self, place_m: Array) -> tuple[Array, Array]:
        """Follow a vehicle along the path.

        place_m: (T, 2), places [m] of the vehicle; naN where missing. Returns (T,), position [m] along the path, and
        distance [m] from it; naN where missing.
        """
        position, off = np.full(len(place_m), np.nan), np.full(len(place_m), np.nan)
        piece, before = -1, 0
        for t in np.flatnonzero(np.isfinite(place_m).all(axis=1)).tolist():
            if piece < 0:
                first, last = self._first(place_m[t]), 0
                last = first + _BACK
                first = max(0, first - _BACK)
            else:
                first, last = max(0, piece - _BACK), piece + _AHEAD + _PER_MISSED * (t - before - 1)
            some = slice(first, min(last, len(self._length)))
            from_start = place_m[t] - self.point_m[:-1][some]
            way, length = self._way[some], self._length[some]
            along = np.clip(np.sum(from_start * way, axis=1) / length**2, 0.0, 1.0)
            # The first and the last piece go on beyond their ends.
            if first == 0:
                along[0] = min(1.0, float(from_start[0] @ way[0]) / length[0] ** 2)
            if last >= len(self._length):
                along[-1] = max(0.0, float(from_start[-1] @ way[-1]) / length[-1] ** 2)
            miss = from_start - along[:, None] * way
            distance = np.hypot(miss[:, 0], miss[:, 1])
            best = int(np.argmin(distance))
            position[t] = self._start[first + best] + along[best] * length[best]
            off[t], piece, before = distance[best], first + best, t
        return position, off

    def _first(self, place_m: Array) -> int:
        """Where a vehicle is first seen: the first part of the path that comes near."""
        distance = np.hypot(*(self.point_m[:-1] - place_m).T)
        near = np.flatnonzero(distance <= max(_NEAR_M, float(distance.min())))
        end = np.flatnonzero(np.diff(near) > 1)
        part = near[: end[0] + 1] if len(end) else near
        return int(part[np.argmin(distance[part])])


def thinned(place_m: Array) -> Array:
    """Places (T, 2) that lie at least a metre apart, shape (P, 2); missing ones are left out."""
    known = place_m[np.isfinite(place_m).all(axis=1)]
    kept: list[int] = []
    for k, place in enumerate(known):
        if not kept or np.hypot(*(place - known[kept[-1]])) >= _POINT_M:
            kept.append(k)
    return np.asarray(known[kept])


def common_path(places_m: list[Array]) -> Path2d | None:
    """The path of vehicles that drive one behind the other.

    places_m: (T, 2), places [m] of the vehicles at the same times, the first vehicle first; naN where missing.
    """
    places_m = [place for place in places_m if np.isfinite(place).all(axis=1).any()]
    if not places_m:
        return None
    point = thinned(places_m[-1])
    for place in places_m[-2::-1]:
        if len(point) < 2:
            point = thinned(place)
            continue
        path = Path2d(point)
        position, _ = path.positions(place)
        beyond: Ints = np.flatnonzero(position > path.length_m + _POINT_M)
        if len(beyond):
            point = np.concatenate((point, thinned(place[beyond[0] :])))
    if len(point) < 2:
        return None
    path = Path2d(point)
    for _ in range(_ROUNDS):
        path = _mean_path(path, places_m)
    return path


def _mean_path(path: Path2d, places_m: list[Array]) -> Path2d:
    """The mean of the places at which vehicles pass each point of a path."""
    followed = [(position, place) for place in places_m for position in [path.positions(place)[0]]]
    low = min(float(np.nanmin(position)) for position, _ in followed)
    high = max(float(np.nanmax(position)) for position, _ in followed)
    if high - low > _LONGEST_M:
        return path
    point = np.arange(low, high, _POINT_M)
    total, passed = np.zeros((len(point), 2)), np.zeros(len(point))
    for position, place in followed:
        known = np.isfinite(position)
        way = np.maximum.accumulate(position[known])
        inside = (point >= way[0]) & (point <= way[-1])
        passed += inside
        for axis in (0, 1):
            total[:, axis] += np.where(inside, np.interp(point, way, place[known, axis]), 0.0)
    mean = thinned(total[passed > 0] / passed[passed > 0, None])
    return Path2d(mean) if len(mean) > 1 else path
