"""Samples of positions, recorded or simulated, which a source sends."""

from typing import NamedTuple, Protocol

from sugiyama_ros.road import Road


class Positions(NamedTuple):
    """One sample of all vehicles on the road, one entry for each vehicle.

    Attributes
    ----------
    vehicle, leader : list of int
        Number of the vehicle, and number of its leader (-1 without a leader).
    position_m, length_m : list of float
        Position [m] (NaN if missing) and length [m].
    """

    vehicle: list[int]
    leader: list[int]
    position_m: list[float]
    length_m: list[float]


class PositionSamples(Protocol):
    """The samples that a source sends.

    Attributes
    ----------
    road : Road
        The road.
    period_s, start_s : float
        Time [s] between two samples, and time of the first sample.
    steps : int
        Number of samples; 0 if there is no end.
    source, sha256 : str
        Where the samples come from, and the checksum of the file; empty without a file.
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
