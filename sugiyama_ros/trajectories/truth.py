"""What simulated drivers really did, to compare estimates with it."""

from collections.abc import Mapping
from dataclasses import dataclass

from sugiyama_ros.arrays import Array, Ints


@dataclass(frozen=True)
class TrueDriver:
    """From ``time_s`` [s] on, vehicle number ``vehicle`` drives with these parameters, by name, in SI units."""

    time_s: float
    vehicle: int
    parameters: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Truth:
    """The true motion of N simulated vehicles at T times.

    vehicle: (N,), numbers of the vehicles; time_s: (T,), times [s]; position_m, speed, acceleration, gap_m: (T, N),
    true positions [m], speeds [m/s], accelerations [m/s^2] and gaps [m] to the leaders; a gap is infinite without a
    leader, and NaN stands where a vehicle is not on the road; drivers: parameters of the drivers at the start, and each
    change, in the order of time.
    """

    vehicle: Ints
    time_s: Array
    position_m: Array
    speed: Array
    acceleration: Array
    gap_m: Array
    drivers: tuple[TrueDriver, ...]
