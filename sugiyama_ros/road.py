"""Geometry of the road: a ring or an open road."""

from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError

#: For which the model makes sense: time [s] between samples, circumference [m] of a ring, length [m] of a vehicle.
PERIODS_S, RINGS_M, LENGTHS_M = (1e-3, 1e3), (1.0, 1e7), (0.01, 100.0)
#: Time [s] between two samples of a simulation. A driver weighs what an action changes within one period (phi1 of the
#: paper), so in shorter periods all actions seem alike: at 5 m/s, 10 m behind a car as fast, the usual driver means to
#: accelerate by 2.0 m/s^2 at 0.2 s, by 1.0 at 0.05 s, and to brake at 0.02 s.
SIMULATED_S = (0.05, PERIODS_S[1])
#: Time [s] from one decision of a driver to the next, of whom a file tells: ten times as often as anybody decides.
DECISIONS_S = (0.01, PERIODS_S[1])


@dataclass(frozen=True)
class Road:
    """A ring road or an open road.

    Parameters
    ----------
    circumference_m : float
        Length [m] once around the ring; 0 for an open road.

    Raises
    ------
    InputError
        If the circumference is negative, or longer than any ring.
    """

    circumference_m: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.circumference_m <= RINGS_M[1]:
            raise InputError(
                f"ring: {self.circumference_m} m is not a circumference; give a positive length, {RINGS_M[1]:.0f} m at"
                " most, or 0 for an open road"
            )

    @property
    def is_ring(self) -> bool:
        """Whether the road is a ring, so that positions repeat after one circumference."""
        return self.circumference_m > 0.0

    def wrap(self, position_m: Array) -> Array:
        """Bring positions [m] into one turn of a ring, from 0 to below the circumference; nothing on an open road."""
        if not self.is_ring:
            return position_m
        wrapped = np.mod(position_m, self.circumference_m)
        # np.mod rounds a tiny negative number up to the circumference itself
        return np.where(wrapped >= self.circumference_m, 0.0, wrapped)

    def difference(self, ahead_m: Array, behind_m: Array) -> Array:
        """Compute the signed distance [m] from ``behind_m`` to ``ahead_m``; on a ring, the shorter way around."""
        way = ahead_m - behind_m
        if not self.is_ring:
            return way
        return way - self.circumference_m * np.round(way / self.circumference_m)

    def space_headway(self, leader_m: Array, own_m: Array) -> Array:
        """Compute the distance [m] forward from a vehicle to its leader; on a ring, below the circumference."""
        return self.wrap(leader_m - own_m)

    def unwrap(self, position_m: Array) -> Array:
        """Make positions [m] of T samples, shape (T, ...), continuous in time, so that they grow from turn to turn.

        Between two known samples, a vehicle is assumed to move less than half a circumference. NaN stays NaN.
        """
        if not self.is_ring:
            return position_m
        flat = position_m.reshape(len(position_m), -1).copy()
        is_known = np.isfinite(flat)
        complete = is_known.all(axis=0)
        flat[:, complete] = np.unwrap(flat[:, complete], axis=0, period=self.circumference_m)
        for k in np.flatnonzero(~complete):
            known = is_known[:, k]
            flat[known, k] = np.unwrap(flat[known, k], period=self.circumference_m)
        return flat.reshape(position_m.shape)
