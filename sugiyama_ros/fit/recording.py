"""A recording prepared for a fit: the chain of vehicles ahead of each driver, and blocks of time to hold out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.filters.chain import CHAIN, NO_LINE, NO_REAR, Chain
from sugiyama_ros.fit.smooth_positions import (
    Evenness,
)
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks


@dataclass(frozen=True)
class DriverName:
    """How documents and tables call a driver: the number of the vehicle, and names in the tracks, if they have any."""

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
    """Return the new number (drivers + 1,) of each driver if only those in ``who`` are left, and -1."""
    number = np.full(drivers + 1, -1)
    number[list(who)] = np.arange(len(who))
    return number


def columns_of(chains: Sequence[Chain]) -> tuple[Array, Array, Ints]:
    """Return positions, lengths [m] and leaders (T, V) of the vehicles of chains, as in a ``Vicinity`` of tracks."""
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


#: Length [s] of the blocks of time that are held out, and number of folds that the blocks are assigned to in turn.
BLOCK_S, FOLDS = 25.0, 5
#: Largest product of drivers and samples of which a diagnosis takes everything; of more, it takes some drivers.
MOST_SAMPLES = 200_000
#: Of many drivers on tracks, a diagnosis searches so many, or as many as have so many samples together.
SEARCHED_DRIVERS, SEARCHED_SAMPLES = 20, 25_000


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording prepared for the filter, N drivers at T samples.

    vicinity: the drivers and the vehicles around them; chains: each driver with the vehicles ahead; ahead: (N, M - 1),
    numbers of the drivers who are ahead in most samples; -1 for none, or for somebody who is no driver here; block: (N,
    T), number of the block of time; fold: (N, T), number of the fold in which the block is held out; segment: (N, T),
    number of the unbroken part of the driver's record; scored: (N, T), whether a sample counts; even: how evenly the
    vehicles move; speed: high speed in the data [m/s]; lower, upper: (WIDTH,), smallest sizes of parameters with a
    logarithmic coordinate, and upper bounds of the search; trajectories: the recording, where it is one road on which
    everybody is recorded; none for tracks; every: vehicles are measured in one sample of so many; decisions: number of
    decisions of the model's drivers from one sample of the recording to the next; smoothed_s: time [s] over which
    somebody has smoothed the positions; 0 if nobody has; left_out: number of drivers who were left out because there
    were too many; is_rough: whether filters have single precision where most of the work is, for screening: at fitted
    models, the log-likelihood of a driver is off by less than 1e-3 nats.
    """

    vicinity: Vicinity
    chains: tuple[Chain, ...]
    ahead: Ints
    block: Ints
    fold: Ints
    segment: Ints
    scored: Mask
    even: Evenness
    speed: float
    lower: Array
    upper: Array
    trajectories: DenseTracks | None = None
    every: int = 1
    decisions: int = 1
    smoothed_s: float = 0.0
    left_out: int = 0
    is_rough: bool = False

    @property
    def drivers(self) -> int:
        """Number of drivers."""
        return len(self.chains)

    @property
    def samples(self) -> int:
        """Number T of samples."""
        return self.fold.shape[1]

    @property
    def lines(self) -> Array:
        """The road ahead of each driver, (T, N, 4): position [m] of the line, two times [s] and the curvature [1/m]."""
        return np.stack([chain.around[:, len(NO_REAR) : -len(NO_LINE)] for chain in self.chains], axis=1)

    @property
    def apart_s(self) -> float:
        """Time [s] from one sample in which vehicles are measured to the next."""
        return self.every * self.vicinity.period_s

    @property
    def roughly(self) -> "Recorded":
        """The recording for screening; see ``is_rough``."""
        return replace(self, is_rough=True)

    @property
    def measured_samples(self) -> int:
        """Number of samples without those that came in between."""
        return len(range(0, self.samples, self.every))


def some_drivers(data: Recorded, who: Sequence[int]) -> Recorded:
    """Return the part of a recording that says how some drivers drive."""
    chosen = list(who)
    chains = tuple(data.chains[i] for i in chosen)
    return replace(
        data,
        vicinity=behind_measured(data.vicinity, chains, chosen),
        chains=chains,
        ahead=numbered(data.drivers, chosen)[data.ahead[chosen]],
        block=data.block[chosen],
        fold=data.fold[chosen],
        segment=data.segment[chosen],
        scored=data.scored[chosen],
        trajectories=None,
    )
