"""Samples of positions, recorded or simulated, which a source sends."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from sugiyama_ros.road import Road

#: Leader of a vehicle whose leader is not in view; nobody knows whether there is one.
UNKNOWN_LEADER = -2


class Positions(NamedTuple):
    """One sample of all vehicles on the road, one entry for each vehicle.

    vehicle, leader: number of the vehicle, and number of its leader: -1 without a leader, `UNKNOWN_LEADER` where it is
    not in view; position_m, length_m: position [m] (NaN if missing) and length [m]; lane, d_m, stamp_offset_s,
    position_var: lane, position [m] across the road, time [s] at which the vehicle was measured after the sample's own,
    and variance [m^2] of the position; each is empty where the source does not know it.
    """

    vehicle: list[int]
    leader: list[int]
    position_m: list[float]
    length_m: list[float]
    lane: Sequence[int] = ()
    d_m: Sequence[float] = ()
    stamp_offset_s: Sequence[float] = ()
    position_var: Sequence[float] = ()


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

    def at(self, step: int) -> Positions:
        """Sample number ``step``."""
        ...
