"""Geometry of the road: a ring or an open road."""

from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array as Array
from sugiyama_ros.arrays import Ints as Ints
from sugiyama_ros.errors import InputError


@dataclass(frozen=True)
class Road:
    """A ring road, or an open road where ``circumference_m`` is 0.

    Raises InputError if the circumference is negative or not finite.
    """

    circumference_m: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.circumference_m) and self.circumference_m >= 0.0):
            raise InputError(
                f"ring: {self.circumference_m} m is not a circumference; give a positive length, or 0 for an open road"
            )

    @property
    def is_ring(self) -> bool:
        """Whether positions repeat after one circumference."""
        return self.circumference_m > 0.0

    def wrap(self, position_m: Array) -> Array:
        """Positions [m] brought into [0, circumference); unchanged on an open road."""
        if not self.is_ring:
            return position_m
        wrapped = np.mod(position_m, self.circumference_m)
        # a tiny negative number is rounded up to the circumference itself
        return np.where(wrapped >= self.circumference_m, 0.0, wrapped)

    def difference(self, ahead_m: Array, behind_m: Array) -> Array:
        """Signed shortest way [m] from ``behind_m`` to ``ahead_m``, within half a circumference."""
        way = ahead_m - behind_m
        if not self.is_ring:
            return way
        return way - self.circumference_m * np.round(way / self.circumference_m)

    def space_headway(self, leader_m: Array, own_m: Array) -> Array:
        """Way forward [m] from one's own centre to the leader's, in [0, circumference) on a ring."""
        return self.wrap(leader_m - own_m)

    def unwrap(self, position_m: Array) -> Array:
        """Positions [m] of shape (T, ...) made continuous along the first axis; NaN stays NaN.

        Between two known samples the vehicle is taken to have moved less than half a circumference.
        """
        if not self.is_ring:
            return position_m
        flat = position_m.reshape(len(position_m), -1).copy()
        for column in flat.T:
            known = np.flatnonzero(np.isfinite(column))
            column[known] = np.unwrap(column[known], period=self.circumference_m)
        return flat.reshape(position_m.shape)
