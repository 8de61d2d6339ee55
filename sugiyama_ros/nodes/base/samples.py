"""What a source sends: samples of positions, recorded or simulated."""

from typing import NamedTuple, Protocol

from sugiyama_ros.road import Road


class Positions(NamedTuple):
    """One sample: number, number of the leader (-1 without one), position [m] (NaN if missing) and length [m] of each
    vehicle that is on the road.
    """

    vehicle: list[int]
    leader: list[int]
    position_m: list[float]
    length_m: list[float]


class Samples(Protocol):
    """What a source sends, sample by sample; ``steps`` is their number, 0 where there is no end."""

    road: Road
    period_s: float
    start_s: float
    steps: int
    source: str
    sha256: str

    def at(self, step: int) -> Positions:
        """Sample number ``step``."""
        ...
