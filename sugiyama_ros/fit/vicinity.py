"""What the drivers of a recording are, and which vehicles are around them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.filters.chain import CHAIN, Chain
from sugiyama_ros.road import Road


@dataclass(frozen=True)
class DriverName:
    """How documents and tables call a driver.

    number: number of the vehicle; no other driver of the recording has it; recording, vehicle, vehicle_class: names in
    the tracks; empty where the file has none.
    """

    number: int
    recording: str = ""
    vehicle: str = ""
    vehicle_class: str = ""

    @property
    def shown(self) -> str:
        """Name in tables."""
        return f"{self.recording} {self.vehicle}".strip() or str(self.number)

    def document(self) -> dict[str, int | str]:
        """Return what is known, for a JSON document."""
        if not self.vehicle:
            return {"vehicle": self.number}
        return {
            "vehicle": self.number,
            "recording": self.recording,
            "name": self.vehicle,
            "class": self.vehicle_class,
        }


@dataclass(frozen=True, eq=False)
class Vicinity:
    """N drivers at T samples, and the vehicles that they see, in V columns; the drivers come first.

    On one road where everybody is recorded, the drivers see one another, and V is N. On tracks, each driver has two
    further columns: the vehicles ahead, as measured. There each driver has their own samples, which skip the time
    between stretches.

    names: names of the drivers; position_m: (T, V), measured positions [m]; naN where missing; length_m: (T, V),
    lengths [m]; leader: (T, V), column of the vehicle ahead; -1 where there is none; time_s: (T, N), times [s] of each
    driver's samples; road: the road; period_s: time [s] between two samples; is_whole_road: whether the drivers are all
    vehicles of one road; has_places: whether equal positions are equal places: False for recordings of different roads;
    source, sha256: name and checksum of the file.
    """

    names: tuple[DriverName, ...]
    position_m: Array
    length_m: Array
    leader: Ints
    time_s: Array
    road: Road
    period_s: float
    is_whole_road: bool
    has_places: bool
    source: str
    sha256: str

    @property
    def drivers(self) -> int:
        """Number N of drivers."""
        return len(self.names)

    @property
    def numbers(self) -> list[int]:
        """Numbers of the drivers' vehicles."""
        return [one.number for one in self.names]

    def columns(self, driver: int, vehicles: int) -> list[int]:
        """Columns that the states of a driver's chain of ``vehicles`` vehicles fill, the driver first."""
        return [driver] if self.is_whole_road else [driver + m * self.drivers for m in range(vehicles)]

    @property
    def first_last_s(self) -> tuple[float, float]:
        """Times [s] of the first and the last sample."""
        return float(np.nanmin(self.time_s)), float(np.nanmax(self.time_s))


def behind_measured(around: Vicinity, chains: Sequence[Chain], who: Sequence[int]) -> Vicinity:
    """Return some drivers behind vehicles that drive as measured, whoever drives these."""
    chosen = list(who)
    position, length, leader = columns_of(chains)
    return replace(
        around,
        names=tuple(around.names[i] for i in chosen),
        position_m=position,
        length_m=length,
        leader=leader,
        time_s=around.time_s[:, chosen],
        is_whole_road=False,
    )


def numbered(drivers: int, who: Sequence[int]) -> Ints:
    """Return the new number of each driver if only those in ``who`` are left, (drivers + 1,).

    Nobody else has one: -1. The last entry is that of the number -1.
    """
    number = np.full(drivers + 1, -1)
    number[list(who)] = np.arange(len(who))
    return number


def columns_of(chains: Sequence[Chain]) -> tuple[Array, Array, Ints]:
    """Return the vehicles of chains in columns, as a ``Vicinity`` of tracks has them.

    Returns position_m, length_m: (T, V), measured positions and lengths [m]: the N drivers, the vehicles ahead of each,
    and those ahead of these; leader: (T, V), column of the vehicle ahead, or -1.
    """
    count, samples = len(chains), len(chains[0].position_m)
    columns = CHAIN * count
    position, length = np.full((samples, columns), np.nan), np.zeros((samples, columns))
    leader = np.full((samples, columns), -1)
    for i, chain in enumerate(chains):
        for m in range(chain.position_m.shape[1]):
            position[:, i + m * count], length[:, i + m * count] = chain.position_m[:, m], chain.length_m[:, m]
            if m > 0:
                leader[:, i + (m - 1) * count] = np.where(chain.identity[:, m] >= 0, i + m * count, -1)
    return position, length, leader
