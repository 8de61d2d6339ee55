"""Messages that come one by one become samples of the whole road at regular times. Nothing waits for the future."""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from sugiyama_ros.trajectories.placing import NOBODY, OnLane, Placer, SeenVehicle

_NS = 1_000_000_000
# Time has begun anew when so many vehicles in a row were seen so long [ns] before the last sample.
_BACK_NS, _BACK_IN_A_ROW = _NS, 5


class RoadMoment(NamedTuple):
    """The road at one time: number of the sample, its stamp [ns], and the vehicles on the road."""

    step: int
    stamp_ns: int
    placed: list[OnLane]


class Numbers:
    """Numbers of vehicles: the last number in the name, if no other vehicle has it, or else the next free number."""

    def __init__(self) -> None:
        self.of: dict[str, int] = {}

    def __call__(self, name: str) -> int:
        """Number of a vehicle; -1 for nobody."""
        if name == NOBODY:
            return -1
        if name not in self.of:
            digits = re.findall(r"\d+", name)
            wanted = int(digits[-1]) if digits and len(digits[-1]) <= 9 else 0
            taken = set(self.of.values())
            self.of[name] = wanted if digits and wanted not in taken else max(taken, default=-1) + 1
        return self.of[name]


@dataclass
class Counts:
    """What became of what was seen.

    Attributes
    ----------
    taken, beside, late, unknown_frame : int
        Vehicles that are in a sample; that are not on the road; that were seen before the last sample; whose position
        is in a frame from which nothing leads to the road's.
    """

    taken: int = 0
    beside: int = 0
    late: int = 0
    unknown_frame: int = 0


@dataclass
class Moments:
    """Collects what was seen, in the order in which it comes, and gives out one sample of the road for each period.

    What was seen nearest to the time of a sample, by at most half a period, belongs to it. The sample is given out as
    soon as something comes whose stamp is later than that by a quarter of a period. What comes later still is left out.
    If the stamps of several vehicles in a row are a second older than the last sample, time has begun anew.

    Parameters
    ----------
    placer : Placer
        Puts vehicles on lanes.
    period_s : float
        Time [s] between two samples.
    """

    placer: Placer
    period_s: float
    counts: Counts = field(default_factory=Counts)
    _seen: dict[int, dict[str, SeenVehicle]] = field(default_factory=dict)
    _first_ns: int | None = None
    _first_step: int = 0
    _given: int = -1
    _back: int = 0

    def take(self, seen: Iterable[SeenVehicle]) -> Iterator[RoadMoment]:
        """Take in what was seen; yields the samples that are complete with it."""
        for one in seen:
            if not (math.isfinite(one.x_m) and math.isfinite(one.y_m)):
                self.counts.beside += 1
                continue
            if self._first_ns is None or self._has_begun_anew(one.stamp_ns):
                self._first_ns, self._first_step = one.stamp_ns, self._given + 1
                self._seen = {}
            step = self._step(one.stamp_ns)
            if step <= self._given:
                self.counts.late += 1
                continue
            self._seen.setdefault(step, {})[one.name] = one
            yield from self._complete(one.stamp_ns)

    def rest(self) -> Iterator[RoadMoment]:
        """What is left at the end."""
        for step in sorted(self._seen):
            yield self._moment(step)

    def _step(self, stamp_ns: int) -> int:
        assert self._first_ns is not None
        return self._first_step + math.floor((stamp_ns - self._first_ns) / (self.period_s * _NS) + 0.5)

    def _has_begun_anew(self, stamp_ns: int) -> bool:
        self._back = self._back + 1 if stamp_ns < self._stamp_ns(self._given) - _BACK_NS else 0
        return self._back >= _BACK_IN_A_ROW

    def _stamp_ns(self, step: int) -> int:
        assert self._first_ns is not None
        return self._first_ns + round((step - self._first_step) * self.period_s * _NS)

    def _complete(self, newest_ns: int) -> Iterator[RoadMoment]:
        """The samples that lie far enough back."""
        until = self._step(newest_ns - round(0.25 * self.period_s * _NS))
        for step in sorted(step for step in self._seen if step < until):
            yield self._moment(step)

    def _moment(self, step: int) -> RoadMoment:
        self._given = step
        placed = self.placer.place(list(self._seen[step].values()))
        self.counts.taken += len(placed)
        self.counts.beside += len(self._seen.pop(step)) - len(placed)
        return RoadMoment(step, self._stamp_ns(step), placed)
