"""Measured or simulated trajectories of many vehicles on one road, on a regular time base."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.results import Result, space_time
from sugiyama_ros.road import Road

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

#: Length [m] of a vehicle if the file does not give the length: the mean of the paper's Table 1.
DEFAULT_LENGTH_M = 4.33
#: Largest number of samples, including missing samples: vehicles times time steps.
MAX_SAMPLES = 20_000_000
_RESAMPLE = "sugiyama convert FILE even.parquet --period SECONDS"


@dataclass(frozen=True, eq=False, repr=False)
class Trajectories(Result):
    """Positions of N vehicles at T regular times.

    Parameters
    ----------
    position_m : ndarray, shape (T, N)
        Positions [m] of the vehicles' centres, wrapped on a ring; NaN where a sample is missing.
    length_m : ndarray, shape (N,)
        Lengths [m] of the vehicles.
    vehicle : ndarray of int, shape (N,)
        Numbers of the vehicles, as in their file.
    road : Road
        The road.
    period_s : float
        Time [s] between two samples.
    start_s : float
        Time [s] of the first sample.
    source, sha256 : str
        Name and checksum of the file that the positions come from; empty if there is no file.

    Raises
    ------
    InputError
        If the shapes do not fit together, or a value is impossible.
    """

    position_m: Array
    length_m: Array
    vehicle: Ints
    road: Road
    period_s: float
    start_s: float = 0.0
    source: str = ""
    sha256: str = ""

    def __post_init__(self) -> None:
        samples, vehicles = self.position_m.shape
        if samples < 2 or vehicles < 1:
            raise InputError(f"{self.source or 'trajectories'}: need at least 2 samples of 1 vehicle")
        if self.length_m.shape != (vehicles,) or self.vehicle.shape != (vehicles,):
            raise InputError(f"{self.source or 'trajectories'}: give one length and one number for each vehicle")
        if not (self.period_s > 0.0 and np.isfinite(self.period_s)):
            raise InputError(f"{self.source or 'trajectories'}: the time between samples is {self.period_s} s")
        if len(np.unique(self.vehicle)) != vehicles:
            raise InputError(f"{self.source or 'trajectories'}: a vehicle's number occurs twice")
        if not (np.all(np.isfinite(self.length_m)) and np.all(self.length_m >= 0.0)):
            raise InputError(f"{self.source or 'trajectories'}: a vehicle's length is negative or not a number")

    def headline(self) -> str:
        """Say how many vehicles there are, for how long, and on what road."""
        road = f"a ring of {self.road.circumference_m:g} m" if self.road.is_ring else "an open road"
        vehicles, samples = len(self.vehicle), len(self.position_m)
        return (
            f"{vehicles} vehicles on {road}, {samples} samples of {self.period_s:.4g} s, from {self.source or 'memory'}"
        )

    def records(self) -> list[dict[str, Any]]:
        """List all known samples: time_s [s], vehicle, position_m [m] and length_m [m]."""
        samples, columns = np.nonzero(np.isfinite(self.position_m))
        return [
            {"time_s": time, "vehicle": vehicle, "position_m": position, "length_m": length}
            for time, vehicle, position, length in zip(
                self.time_s[samples].tolist(),
                self.vehicle[columns].tolist(),
                self.position_m[samples, columns].tolist(),
                self.length_m[columns].tolist(),
                strict=True,
            )
        ]

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw positions over time, coloured by speed."""
        moved = np.diff(self.road.unwrap(self.position_m), axis=0, append=np.nan)
        space_time(figure, self.time_s, self.position_m, moved / self.period_s)

    @property
    def time_s(self) -> Array:
        """Times [s] of the samples, shape (T,)."""
        return np.asarray(self.start_s + self.period_s * np.arange(len(self.position_m)), dtype=np.float64)

    @property
    def duration_s(self) -> float:
        """Time [s] from the first sample to the last."""
        return self.period_s * (len(self.position_m) - 1)

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """Whether each vehicle is on the road, from its first to its last known sample; shape (T, N)."""
        known = np.isfinite(self.position_m)
        seen = np.maximum.accumulate(known, axis=0)
        to_come = np.maximum.accumulate(known[::-1], axis=0)[::-1]
        return np.asarray(seen & to_come)

    @cached_property
    def leader(self) -> Ints:
        """Column of the vehicle directly ahead on the road, shape (T, N); -1 where there is none.

        The leader of a vehicle is the vehicle that is directly ahead in most samples, so that one bad measurement does
        not change the leader. Leaders change when a vehicle enters or leaves the road.
        """
        leader = np.full(self.position_m.shape, -1, dtype=np.int64)
        filled = self._filled
        changes = np.flatnonzero(np.any(self.present[1:] != self.present[:-1], axis=1)) + 1
        for first, last in zip([0, *changes], [*changes, len(leader)], strict=True):
            on_road = np.flatnonzero(self.present[first])
            if len(on_road) > 1:
                leader[first:last, on_road] = _leaders(filled[first:last][:, on_road], on_road, self.road)
        return leader

    def around(self, drivers: Sequence[int], ahead: int) -> "Trajectories":
        """Return the part of the recording that some drivers see: these drivers first, then those who drive ahead.

        Parameters
        ----------
        drivers : sequence of int
            Columns of the drivers.
        ahead : int
            How many vehicles ahead of each driver belong to the part. They keep their leaders within the part.
        """
        near = np.asarray(drivers)
        seen = near.tolist()
        for _ in range(ahead):
            near = np.unique(self.leader[:, near])
            near = near[near >= 0]
            seen += near.tolist()
        columns = np.array(list(dict.fromkeys(seen)))
        place = np.full(len(self.vehicle) + 1, -1)  # the last entry is that of nobody, -1
        place[columns] = np.arange(len(columns))
        part = replace(
            self,
            position_m=self.position_m[:, columns],
            length_m=self.length_m[columns],
            vehicle=self.vehicle[columns],
        )
        part.__dict__["leader"] = place[self.leader[:, columns]]  # found among all vehicles
        return part

    @cached_property
    def follower(self) -> Ints:
        """(T, N): index of the vehicle whose leader is the vehicle of this column, -1 where there is none.

        The first of several vehicles with the same leader counts. The table is made once for all drivers.
        """
        vehicles = self.leader.shape[1]
        follower = np.empty(self.leader.shape, dtype=np.int64)
        for behind, leader, present in zip(follower, self.leader, self.present, strict=True):
            followers = np.flatnonzero((leader >= 0) & present)
            first = np.full(vehicles, vehicles)
            np.minimum.at(first, leader[followers], followers)
            behind[:] = np.where(first < vehicles, first, -1)
        return follower

    @property
    def _filled(self) -> Array:
        """Continuous positions [m], with straight lines in place of missing samples; shape (T, N)."""
        filled = self.road.unwrap(self.position_m).copy()
        ticks = np.arange(len(filled))
        for column in filled.T:
            known = np.isfinite(column)
            if known.any():
                column[:] = np.interp(ticks, ticks[known], column[known])
        return filled


def _leaders(position_m: Array, number: Ints, road: Road) -> Ints:
    """Find the most common leader of each vehicle in ``position_m`` (T, n), as entries of ``number`` (n,) or -1."""
    order = np.argsort(road.wrap(position_m), axis=1, kind="stable")
    ahead = np.empty_like(order)
    np.put_along_axis(ahead, order, np.roll(order, -1, axis=1), axis=1)
    if not road.is_ring:
        np.put_along_axis(ahead, order[:, -1:], -1, axis=1)
    found = np.empty(len(number), dtype=np.int64)
    for k, votes in enumerate(ahead.T):
        candidates, count = np.unique(votes, return_counts=True)
        winner = candidates[np.argmax(count)]
        found[k] = number[winner] if winner >= 0 else -1
    return found


def regular_time_base(time_s: Array, where: str) -> tuple[float, float, Ints]:
    """Find the regular time base of times that may be rounded and may skip samples.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing times [s].
    where : str
        Name of the times in an error message.

    Returns
    -------
    start_s, period_s : float
        Time [s] of the first sample, and time [s] between two samples.
    number : ndarray of int, shape (n,)
        Number of each sample on the time base, from 0.

    Raises
    ------
    InputError
        If there are too few times, or if they do not lie on a regular time base.
    """
    if len(time_s) < 2:
        raise InputError(f"{where}: only one time; need at least two samples")
    # A skipped sample makes a step larger, never smaller. So the lower quartile of the steps is the period, up to
    # rounding.
    step = np.diff(time_s)
    period = float(np.median(step[step <= 1.5 * np.quantile(step, 0.25)]))
    number = np.concatenate(([0], np.cumsum(np.round(step / period).astype(np.int64))))
    if number[-1] >= 2 * len(time_s):
        raise InputError(
            f"{where}: {len(time_s)} times are there; {number[-1] + 1} are expected at steps of {period:.4g} s;"
            f" resample: {_RESAMPLE}"
        )
    if len(time_s) > 2:
        period, start = (float(c) for c in np.polyfit(number, time_s, 1))
    else:
        start = float(time_s[0])
    off = np.abs(time_s - (start + period * number))
    worst = int(np.argmax(off))
    if off[worst] > 0.1 * period:
        raise InputError(
            f"{where}: time {time_s[worst]:g} s lies {off[worst]:.3g} s off the regular time base of {period:.4g} s;"
            f" resample: {_RESAMPLE}"
        )
    # The first time is the start. The start of the fitted line may lie before 0, where nothing can be recorded.
    return float(time_s[0]), _unrounded(time_s, number, period), number


def _unrounded(time_s: Array, number: Ints, period: float) -> float:
    """Guess the period [s] before the times were rounded: a simple number, if it explains all times."""
    fraction = float(Fraction(period).limit_denominator(100))
    noise = 8.0 * float(np.spacing(np.abs(time_s).max()))
    # The largest number of digits after the point in any time tells how far rounding may have moved the times.
    digits = next((d for d in range(9) if np.all(np.abs(time_s - np.round(time_s, d)) <= noise)), 9)
    for simple, moved in ((fraction, noise), (round(period, 9), noise), (fraction, 0.5 * 10.0**-digits + noise)):
        if simple > 0.0 and np.ptp(time_s - simple * number) <= 2.0 * moved:
            return simple
    return period
