"""Samples of positions: what a source sends, and what those who follow the vehicles take in."""

from collections.abc import Sequence
from itertools import pairwise
from math import isnan, nan
from typing import NamedTuple, Protocol

from sugiyama_ros.driver.line import TIME_GAP_S, attention
from sugiyama_ros.filters.chain import NO_LINE
from sugiyama_ros.filters.online import NOBODY
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.about import LONGEST_M
from sugiyama_ros.trajectories.placing import Positions

#: Leader of a vehicle whose leader is not in view; nobody knows whether there is one.
UNKNOWN_LEADER = -2


class Sight(NamedTuple):
    """What a driver sees: positions [m] and lengths [m] of a chain of vehicles, the vehicle behind, and lines.

    lines: (8,), as ``OnlineFilter.step`` takes them.
    """

    position_m: list[float]
    length_m: list[float]
    behind: tuple[float, int, float]
    lines: tuple[float, ...]


class Sample(NamedTuple):
    """A message of `Positions`; ``place`` is the entry of each number."""

    stamp_ns: int
    step: int
    leader: list[int]
    position_m: list[float]
    length_m: list[float]
    place: dict[int, int]
    lane: Sequence[int] = ()
    d_m: Sequence[float] = ()
    stamp_offset_s: Sequence[float] = ()
    position_var: Sequence[float] = ()
    line_m: Sequence[float] = ()
    arrive_s: Sequence[float] = ()
    clear_s: Sequence[float] = ()
    curvature_per_m: Sequence[float] = ()
    leader_shift_m: Sequence[float] = ()

    def chain(self, vehicle: int, length: int) -> list[int]:
        """``length`` numbers: ``vehicle``, its leader, the leader's leader and so on; -1 where there is none."""
        numbers = [vehicle]
        while len(numbers) < length:
            place = self.place.get(numbers[-1])
            leader = -1 if place is None else self.leader[place]
            # on a ring with few vehicles, the chain ends before it comes back to the first vehicle
            numbers.append(-1 if leader in numbers else leader)
        return numbers

    def known_length_m(self, place: int) -> float:
        """Length [m] of the vehicle at a place; 0 if what was sent is no length."""
        length_m = self.length_m[place]
        return length_m if 0.0 <= length_m < LONGEST_M else 0.0

    def behind(self, vehicle: int) -> int:
        """Number of the vehicle whose leader is ``vehicle``; -1 if there is none."""
        return next((number for number, place in self.place.items() if self.leader[place] == vehicle), -1)

    def shifts(self, chain: Sequence[int]) -> list[float]:
        """What to add to the positions of a chain of vehicles to get them along the way of the first one [m].

        NaN from where it is not known on: the vehicle before does not follow this one in the sample.
        """
        if not self.leader_shift_m:
            return [0.0] * len(chain)
        shifts = [0.0]
        for behind, vehicle in pairwise(chain):
            place = self.place.get(behind)
            if place is None or self.leader[place] != vehicle:
                shifts.append(nan)
            else:
                shifts.append(shifts[-1] + self.leader_shift_m[place])
        return shifts

    def line(self, vehicle: int) -> tuple[float, float, float, float]:
        """Place [m] of the line that a driver comes to, its two times [s] and curvature [1/m], as a filter takes it."""
        place = self.place.get(vehicle)
        if place is None or not (self.line_m or self.curvature_per_m):
            return NO_LINE
        curvature = self.curvature_per_m[place] if self.curvature_per_m else nan
        if not self.line_m:
            return nan, nan, nan, curvature
        return self.line_m[place], self.arrive_s[place], self.clear_s[place], curvature

    def lines(self, chain: Sequence[int]) -> tuple[float, ...]:
        """The line of a driver and the line of the leader, along the driver's own way, as a filter takes them."""
        own = self.line(chain[0])
        if len(chain) < 2 or chain[1] < 0:
            return (*own, *NO_LINE)
        line_m, *rest = self.line(chain[1])
        return (*own, line_m + self.shifts(chain)[1], *rest)

    def attention(self, vehicle: int, speed: float) -> float:
        """Attention, from 0 to 1, that a driver at a speed [m/s] pays to the line that they come to."""
        line_m, arrive_s, clear_s, _ = self.line(vehicle)
        if isnan(line_m) or isnan(speed):
            return 0.0
        place = self.place[vehicle]
        gap = line_m - self.position_m[place] - 0.5 * self.known_length_m(place)
        return attention(gap, speed, arrive_s, clear_s, TIME_GAP_S)

    def rear(self, vehicle: int) -> tuple[float, int, float]:
        """Position [m] along the way of a vehicle, number and length [m] of whoever follows it."""
        rear = self.behind(vehicle)
        if rear < 0:
            return NOBODY
        place = self.place[rear]
        shift = self.leader_shift_m[place] if self.leader_shift_m else 0.0
        return self.position_m[place] - shift, rear, self.known_length_m(place)

    def sight(self, vehicle: int, chain: Sequence[int]) -> Sight:
        """What the driver of a vehicle sees, as a filter takes it."""
        places = [self.place.get(v) for v in chain]
        moved = zip(places, self.shifts(chain), strict=True)
        return Sight(
            [nan if p is None else self.position_m[p] + shift for p, shift in moved],
            [0.0 if p is None else self.known_length_m(p) for p in places],
            self.rear(vehicle),
            self.lines(chain),
        )


class PositionSamples(Protocol):
    """The samples that a source sends.

    road: the road; period_s, start_s: time [s] between two samples, and time of the first sample; steps: number of
    samples; 0 if there is no end; source, sha256: where the samples come from, and the checksum of the file; empty
    without a file.
    """

    road: Road
    period_s: float
    start_s: float
    steps: int
    source: str
    sha256: str

    @property
    def controlled(self) -> Sequence[int]:
        """Numbers of the vehicles that a controller drives."""
        ...

    def at(self, step: int) -> Positions:
        """Sample number ``step``."""
        ...
