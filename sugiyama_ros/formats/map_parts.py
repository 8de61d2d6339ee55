"""The lanes of a map as a reader finds them, and what it leaves out."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.roads.network import Lanelet

# A speed, and the units it may have [m/s].
_SPEED = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([a-z/]*)\s*", re.IGNORECASE)
_UNITS = {"km/h": 1.0 / 3.6, "kmh": 1.0 / 3.6, "kph": 1.0 / 3.6, "mph": 0.44704, "m/s": 1.0, "mps": 1.0}
# Way [m] between two points of a middle line, about.
_STEP_M = 2.0
# Widths [m] of lanes, at least and at most: some begin or end with no width at all.
_WIDTHS_M = (0.5, 50.0)


class MapLanes:
    """The lanes of a map as they are read, by name; they may name lanes that are not there.

    Parts that cannot be read and lanes that are not for cars are left out and counted.

    path: the map. lanes: the lanes; points: of lanes without any length, the names of those that follow.
    """

    def __init__(self, path: Path) -> None:
        self.lanes: dict[str, Lanelet] = {}
        self.points: dict[str, tuple[str, ...]] = {}
        self._path, self._first = path, dict[str, str]()
        self._unreadable, self._not_for_cars = Counter[str](), Counter[str]()

    @contextmanager
    def unreadable(self, what: str) -> Iterator[None]:
        """Leave out what the block reads, if it cannot be read.

        what: the name of such parts, such as "lanes".
        """
        try:
            yield
        except InputError as error:
            self._count(what, str(error))

    def _count(self, what: str, why: str) -> None:
        self._unreadable[what] += 1
        self._first.setdefault(what, why.removeprefix(f"{self._path}: "))

    def not_for_cars(self, kind: str) -> None:
        """Count a lane of a kind that is not for cars."""
        self._not_for_cars[kind] += 1

    def speed_limit(self, text: str, usual: str, where: str) -> float:
        """A speed limit [m/s] above 0; infinite for anything else, which is counted.

        usual: the unit of a number without one.
        """
        speed = _SPEED.fullmatch(text)
        unit = _UNITS.get((speed[2].lower() or usual) if speed else "")
        if speed is None or unit is None or not float(speed[1]) > 0.0:
            self._count("speed limits", f"{where}: speed limit {text[:40]!r} is no speed")
            return np.inf
        return float(speed[1]) * unit

    def linked(self, cure: str) -> tuple[Lanelet, ...]:
        """The lanes, naming only those that are there; those without length are passed over. Raises InputError if none.

        cure: what to do where the map has no lane.
        """
        if not self.lanes:
            why = [f"the first cannot be read: {self._first[what]}" for what in self._unreadable] or [cure]
            raise InputError(f"{self._path}: no lanes for cars; {why[0]}")
        return tuple(
            replace(
                lane,
                successors=tuple(dict.fromkeys(self._onward(lane.successors))),
                left=lane.left if lane.left in self.lanes else "",
                right=lane.right if lane.right in self.lanes else "",
            )
            for lane in self.lanes.values()
        )

    def _onward(self, names: Sequence[str], passed: frozenset[str] = frozenset()) -> Iterator[str]:
        """Names of the lanes that are there, in place of those without length the lanes after them."""
        for name in names:
            if name in self.lanes:
                yield name
            elif name in self.points and name not in passed:
                yield from self._onward(self.points[name], passed | {name})

    def notes(self) -> tuple[str, ...]:
        """What was left out, in words."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in self._not_for_cars.most_common())
        return (
            *(
                f"road: {count} {what} cannot be read and were left out; the first: {self._first[what]}"
                for what, count in self._unreadable.items()
            ),
            *([f"road: lanes that are not for cars were left out: {kinds}"] if kinds else []),
        )


def middle_of(left: Array, right: Array, in_pairs: bool = False) -> tuple[Array, Array, float]:
    """The middle of two bounds (N, 2) [m], and the mean width [m].

    The middle is x, y (P,) [m], halfway between places at the same part of the lengths of the bounds, or if their
    points come in pairs, halfway between these; P is 1 if the lane has no length.
    """
    lengths_m = [float(np.hypot(*np.diff(one, axis=0).T).sum()) for one in (left, right)]
    count = max(len(left), len(right), int(max(lengths_m) / _STEP_M) + 1)
    part: Array = np.linspace(0.0, 1.0, count, dtype=np.float64)
    points = [left, right] if in_pairs else [at_parts(one, part) for one in (left, right)]
    middle = 0.5 * (points[0] + points[1])
    kept = middle[np.concatenate(([True], np.hypot(*np.diff(middle, axis=0).T) > 0.0))]
    return kept[:, 0], kept[:, 1], float(np.clip(np.hypot(*(points[0] - points[1]).T).mean(), *_WIDTHS_M))


def at_parts(points: Array, part: Array) -> Array:
    """Places (K, 2) [m] at parts (K,) of the length of a line through points (N, 2) [m]."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    return np.stack([np.interp(part * way[-1], way, axis) for axis in points.T], axis=1)
