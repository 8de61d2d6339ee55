"""Parts of maps: what readers leave out, and how the lanes that are left go on."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
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


class LeftOut:
    """What a reader of a map leaves out: parts that cannot be read, and lanes that are not for cars.

    path: the map.
    """

    def __init__(self, path: Path) -> None:
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
            self.count(what, str(error))

    def count(self, what: str, why: str) -> None:
        """Count a part that cannot be read."""
        self._unreadable[what] += 1
        self._first.setdefault(what, why.removeprefix(f"{self._path}: "))

    def not_for_cars(self, kind: str) -> None:
        """Count a lane of a kind that is not for cars."""
        self._not_for_cars[kind] += 1

    def speed_limit(self, text: str, usual: str, where: str) -> float | None:
        """A speed limit [m/s] above 0; None for anything else, which is counted.

        usual: the unit of a number without one.
        """
        speed = _SPEED.fullmatch(text)
        unit = _UNITS.get((speed[2].lower() or usual) if speed else "")
        if speed is None or unit is None or not float(speed[1]) > 0.0:
            self.count("speed limits", f"{where}: speed limit {text[:40]!r} is no speed")
            return None
        return float(speed[1]) * unit

    def check_any(self, lanes: Mapping[str, Lanelet], cure: str) -> None:
        """Raise InputError if no lane is left, with the reason."""
        if not lanes:
            why = [f"the first cannot be read: {self._first[what]}" for what in self._unreadable] or [cure]
            raise InputError(f"{self._path}: no lanes for cars; {why[0]}")

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


def linked(lanes: Mapping[str, Lanelet], points: Mapping[str, Sequence[str]] | None = None) -> tuple[Lanelet, ...]:
    """Lanes that name only those that are there.

    lanes: the lanes by name, which may name others; points: the successors of lanes without any length, which are
    passed over: their successors follow the lanes before them.
    """
    over = points or {}

    def onward(names: Sequence[str], passed: frozenset[str] = frozenset()) -> Iterator[str]:
        for name in names:
            if name in lanes:
                yield name
            elif name in over and name not in passed:
                yield from onward(over[name], passed | {name})

    return tuple(
        replace(
            lane,
            successors=tuple(dict.fromkeys(onward(lane.successors))),
            left=lane.left if lane.left in lanes else "",
            right=lane.right if lane.right in lanes else "",
        )
        for lane in lanes.values()
    )


def middle_of(left: Array, right: Array) -> tuple[Array, Array, float]:
    """The middle of two bounds (N, 2) [m], and the mean width [m].

    The middle is x, y (P,) [m], halfway between places at the same part of the lengths of the bounds; P is 1 if the
    lane has no length.
    """
    lengths_m = [float(np.hypot(*np.diff(one, axis=0).T).sum()) for one in (left, right)]
    count = max(len(left), len(right), int(max(lengths_m) / _STEP_M) + 1)
    part: Array = np.linspace(0.0, 1.0, count, dtype=np.float64)
    points = [at_parts(one, part) for one in (left, right)]
    middle = 0.5 * (points[0] + points[1])
    kept = middle[np.concatenate(([True], np.hypot(*np.diff(middle, axis=0).T) > 0.0))]
    return kept[:, 0], kept[:, 1], float(np.clip(np.hypot(*(points[0] - points[1]).T).mean(), *_WIDTHS_M))


def at_parts(points: Array, part: Array) -> Array:
    """Places (K, 2) [m] at parts (K,) of the length of a line through points (N, 2) [m]."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    return np.stack([np.interp(part * way[-1], way, axis) for axis in points.T], axis=1)
