"""Single samples, as files list them, put on a regular time base."""

import math
from array import array
from pathlib import Path

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.reading import shown_name
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.trajectories import Trajectories, regular_time_base

#: Largest number of samples, including missing samples: vehicles times time steps.
MAX_SAMPLES = 20_000_000
#: ROS counts seconds in 32 bits.
_MAX_TIME_S = 2.0**31


class Samples:
    """Samples of positions in the order of their file; each takes 24 bytes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._time = array("d")
        self._column = array("q")
        self._position = array("d")
        self._columns: dict[int, int] = {}
        self._last: dict[int, float] = {}
        # shortest time [s] between two samples of a vehicle, and where it is
        self._closest: tuple[float, str] = (math.inf, "")

    def add(self, time_s: float, vehicle: int, position_m: float, where: str) -> None:
        """Add one sample; NaN for a position that is missing.

        Raises InputError where the vehicle's times do not increase, or there are too many samples.
        """
        last = self._last.get(vehicle, -math.inf)
        if time_s == last:
            raise InputError(f"{where}: vehicle {vehicle} has a second sample at {time_s:g} s; remove one of them")
        if time_s < last:
            raise InputError(
                f"{where}: vehicle {vehicle}: time goes backward, from {last:g} s to {time_s:g} s; sort the lines"
            )
        if abs(time_s) >= _MAX_TIME_S:
            raise InputError(f"{where}: time {time_s:g} s is more than ROS can count; start the times near 0")
        if len(self._time) == MAX_SAMPLES:
            raise InputError(f"{where}: more than {MAX_SAMPLES} samples; split the file")
        if time_s - last < self._closest[0]:
            what = f"{where}: vehicle {vehicle} has samples at {last:.9g} s and {time_s:.9g} s"
            self._closest = (time_s - last, what)
        self._last[vehicle] = time_s
        self._time.append(time_s)
        self._column.append(self._columns.setdefault(vehicle, len(self._columns)))
        self._position.append(position_m)

    @property
    def vehicles(self) -> list[int]:
        """Numbers of the vehicles, in the order in which they appear."""
        return list(self._columns)

    def trajectories(self, length_m: list[float], road: Road, checksum: str) -> Trajectories:
        """All samples on their common time base; ``length_m`` [m] is in the order of ``vehicles``.

        Raises InputError where there are no samples, or no regular time base.
        """
        if not self._time:
            raise InputError(f"{self._path}: no samples; give a table of positions")
        time = np.frombuffer(self._time)
        # Times that differ by less than a microsecond are the same instant, written with a different rounding.
        _, distinct = np.unique(np.round(time, 6), return_index=True)
        start, period, _ = regular_time_base(time[distinct], str(self._path))
        if self._closest[0] < 0.5 * period:
            raise InputError(f"{self._closest[1]}, but the period is {period:.4g} s; remove one of them")
        row = np.round((time - start) / period).astype(np.int64)
        steps = int(row.max()) + 1
        if steps * len(self._columns) > MAX_SAMPLES:
            raise InputError(
                f"{self._path}: {steps} times of {len(self._columns)} vehicles are more than {MAX_SAMPLES} samples;"
                " split the file"
            )
        position = np.full((steps, len(self._columns)), np.nan)
        position[row, np.frombuffer(self._column, dtype=np.int64)] = np.frombuffer(self._position)
        return Trajectories(
            position_m=road.wrap(position),
            length_m=np.array(length_m),
            vehicle=np.array(self.vehicles),
            road=road,
            period_s=period,
            start_s=start,
            source=shown_name(self._path),
            sha256=checksum,
        )


def agreed_road(path: Path, said_m: float | None, ring_m: float | None) -> Road:
    """The road, from the file and from the caller. Raises InputError if the two contradict each other."""
    if said_m is not None and ring_m is not None and not math.isclose(said_m, ring_m, rel_tol=1e-9):
        raise InputError(f"{path}: says a ring of {said_m:g} m, but {ring_m:g} m was given; leave out --ring")
    return Road(said_m if said_m is not None else ring_m or 0.0)
