"""Samples of positions: what a source sends, and what those who follow the vehicles take in."""

from collections.abc import Sequence
from math import nan
from typing import NamedTuple, Protocol

from sugiyama_ros.filters.online import NOBODY
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.placing import Positions

#: Leader of a vehicle whose leader is not in view; nobody knows whether there is one.
UNKNOWN_LEADER = -2
#: Length [m] that no vehicle has.
LONGEST_M = 1000.0


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

    def sight(self, vehicle: int, chain: Sequence[int]) -> tuple[list[float], list[float], tuple[float, int, float]]:
        """Positions [m] and lengths [m] of a chain of vehicles, and the vehicle behind, as a filter takes them."""
        places = [self.place.get(v) for v in chain]
        position = [nan if p is None else self.position_m[p] for p in places]
        length = [0.0 if p is None else self.known_length_m(p) for p in places]
        rear = self.behind(vehicle)
        if rear < 0:
            return position, length, NOBODY
        p = self.place[rear]
        return position, length, (self.position_m[p], rear, self.known_length_m(p))


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
