"""Messages that come one by one become samples of the whole road at regular times. Nothing waits for the future."""

import math
import re
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import median
from typing import NamedTuple

import numpy as np

from sugiyama_ros.trajectories.assemble import LONGEST_ABSENCE_S
from sugiyama_ros.trajectories.placing import NOBODY, OnLane, Placer, SeenVehicle, Unseen
from sugiyama_ros.trajectories.tracks import FREE, UNKNOWN

_NS = 1_000_000_000
# Time has begun anew when so many vehicles in a row were seen so long [ns] before the last sample.
_BACK_NS, _BACK_IN_A_ROW = _NS, 5
#: A vehicle is still where it drove to for so many of its own periods after its last sample.
CARRIED_PERIODS = 1.5
#: Speed [m/s] above which the way of a vehicle says in which direction it points.
MOVING = 1.0
# Stamps of a vehicle from which its own period follows.
_STAMPS = 6
# Time [s] from the beginning in which a vehicle may be ahead of which nothing was heard yet.
_SETTLED_S = 1.0
# A number at the end of a name, perhaps written as 5.0, and perhaps with something behind it.
_NUMBER = re.compile(r"(\d+)(?:\.0*)?\D*$")


class RoadMoment(NamedTuple):
    """The road at one time: number of the sample, its stamp [ns], and the vehicles on the road.

    ``carried`` are vehicles without a sample now, whose last one is not older than one and a half of their own periods.
    """

    step: int
    stamp_ns: int
    placed: list[OnLane]
    carried: list[OnLane]


class Numbers:
    """Numbers of vehicles: the last number in the name, if no other vehicle has it, or else the next free number."""

    def __init__(self) -> None:
        self.of: dict[str, int] = {}

    def __call__(self, name: str | None) -> int:
        """Number of a vehicle; `FREE` for nobody, and `UNKNOWN` for one that is not known."""
        if name is None:
            return UNKNOWN
        if name == NOBODY:
            return FREE
        if name not in self.of:
            digits = _NUMBER.search(name)
            wanted = int(digits[1]) if digits and len(digits[1]) <= 9 else -1
            taken = set(self.of.values())
            self.of[name] = wanted if wanted >= 0 and wanted not in taken else max(taken, default=-1) + 1
        return self.of[name]


@dataclass
class Counts:
    """What became of what was seen.

    taken: vehicles that are in a sample; beside, late, unknown_frame: vehicles that are not on the road; that were seen
    before the last sample; whose position is in a frame from which nothing leads to the road's; unnamed, doubled:
    vehicles without an id, or with the id of another one in the same message; unstamped, repeated: vehicles whose stamp
    is 0, and which count as seen when the message came; with the stamp that they had before; carried: rows of vehicles
    without a sample.
    """

    taken: int = 0
    beside: int = 0
    late: int = 0
    unknown_frame: int = 0
    unnamed: int = 0
    doubled: int = 0
    unstamped: int = 0
    repeated: int = 0
    carried: int = 0


@dataclass
class _Last:
    """Where a vehicle was last, and its speed [m/s]."""

    placed: OnLane
    speed: float = 0.0

    def ahead(self, stamp_ns: int) -> float:
        """Position [m] along the lane at a stamp [ns], if it drives on as before."""
        return self.placed.s_m + self.speed * (stamp_ns - self.placed.seen.stamp_ns) / _NS


@dataclass
class Moments:
    """Collects what was seen, in the order in which it comes, and gives out one sample of the road for each period.

    What was seen nearest to the time of a sample, by at most half a period, belongs to it. The sample is given out as
    soon as something comes whose stamp is later than that by a quarter of a period. What comes later still only says
    where the vehicle was. If the stamps of several vehicles in a row are a second older than the last sample, time has
    begun anew.

    A vehicle without a sample is not taken for gone. For one and a half of its own periods it drives on as before.
    After that it may be there or not, so whoever drove behind it has an unknown leader, for a minute at most. So has
    whoever sees nobody ahead in the first second.

    placer: puts vehicles on lanes; period_s: time [s] between two samples.
    """

    placer: Placer
    period_s: float
    counts: Counts = field(default_factory=Counts)
    _seen: dict[int, dict[str, SeenVehicle]] = field(default_factory=dict)
    _stamps: dict[str, deque[int]] = field(default_factory=dict)
    _newest: dict[str, SeenVehicle] = field(default_factory=dict)
    _last: dict[str, _Last] = field(default_factory=dict)
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
                for known in (self._seen, self._stamps, self._newest, self._last):
                    known.clear()
            if self._is_repeated(one):
                continue
            one = self._directed(one)
            step = self._step(one.stamp_ns)
            if step <= self._given:
                self.counts.late += 1
                self._remember([one], self.placer.place([one]))
                continue
            self._seen.setdefault(step, {})[one.name] = one
            yield from self._complete(one.stamp_ns)

    def rest(self) -> Iterator[RoadMoment]:
        """What is left at the end."""
        for step in sorted(self._seen):
            yield self._moment(step)

    @property
    def periods_s(self) -> list[float]:
        """Time [s] between two samples of each vehicle, as it was lately, from the shortest to the longest."""
        return sorted(self._own_period_s(name) for name, stamps in self._stamps.items() if len(stamps) > 1)

    def _is_repeated(self, one: SeenVehicle) -> bool:
        """Whether a vehicle has had this stamp already; notes the stamp."""
        stamps = self._stamps.setdefault(one.name, deque(maxlen=_STAMPS))
        if one.stamp_ns in stamps:
            self.counts.repeated += 1
            return True
        stamps.append(one.stamp_ns)
        return False

    def _own_period_s(self, name: str) -> float:
        stamps = sorted(self._stamps.get(name, ()))
        return median((b - a) / _NS for a, b in pairwise(stamps)) if stamps[1:] else self.period_s

    def _directed(self, one: SeenVehicle) -> SeenVehicle:
        """A vehicle that does not say in which direction it points, with the direction in which it moves."""
        before, self._newest[one.name] = self._newest.get(one.name), one
        if before is None or not math.isnan(one.heading) or one.stamp_ns <= before.stamp_ns:
            return one
        dx, dy = one.x_m - before.x_m, one.y_m - before.y_m
        speed = math.hypot(dx, dy) * _NS / (one.stamp_ns - before.stamp_ns)
        return replace(one, heading=math.atan2(dy, dx)) if speed > MOVING else one

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
        seen = list(self._seen.pop(step).values())
        placed = self.placer.place(seen)
        self.counts.taken += len(placed)
        self.counts.beside += len(seen) - len(placed)
        self._remember(seen, placed)
        stamp_ns = self._stamp_ns(step)
        carried, gone = self._absent(stamp_ns, {one.name for one in seen})
        self.counts.carried += len(carried)
        there = [*placed, *carried]
        leaders = self.placer.leaders([*(Unseen(one.seen.name, one.s_m, one.lane) for one in there), *gone])
        if step - self._first_step < _SETTLED_S / self.period_s:
            leaders = [None if leader == NOBODY else leader for leader in leaders]
        led = [one._replace(leader=leader) for one, leader in zip(there, leaders, strict=False)]
        return RoadMoment(step, stamp_ns, led[: len(placed)], led[len(placed) :])

    def _remember(self, seen: list[SeenVehicle], placed: list[OnLane]) -> None:
        """Note where vehicles are, and forget those that are not on the road."""
        on_road = {one.seen.name for one in placed}
        for vehicle in seen:
            if vehicle.name not in on_road:
                self._last.pop(vehicle.name, None)
        for one in placed:
            before = self._last.get(one.seen.name)
            if before is None:
                self._last[one.seen.name] = _Last(one)
            elif one.seen.stamp_ns > before.placed.seen.stamp_ns:
                elapsed_s = (one.seen.stamp_ns - before.placed.seen.stamp_ns) / _NS
                way_m = float(self.placer.road.difference(np.array(one.s_m), np.array(before.placed.s_m)))
                self._last[one.seen.name] = _Last(one, way_m / elapsed_s)

    def _absent(self, stamp_ns: int, seen: set[str]) -> tuple[list[OnLane], list[Unseen]]:
        """Vehicles without a sample: those that still count as being there, and those that may be gone."""
        carried, gone = [], []
        for name, last in list(self._last.items()):
            age_s = (stamp_ns - last.placed.seen.stamp_ns) / _NS
            if age_s > LONGEST_ABSENCE_S:
                del self._last[name]
            elif name not in seen:
                s_m = float(self.placer.road.wrap(np.array(last.ahead(stamp_ns))))
                if age_s <= CARRIED_PERIODS * max(self._own_period_s(name), self.period_s):
                    carried.append(last.placed._replace(s_m=s_m))
                else:
                    gone.append(Unseen(None, s_m, last.placed.lane))
        return carried, gone
