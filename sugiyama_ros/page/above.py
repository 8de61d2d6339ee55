"""A network of lanes from above, and where the vehicles of a recording are on it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array, Ints


@dataclass(frozen=True, eq=False)
class Above:
    """Lanes from above, and the way of each vehicle.

    lanes: points (2, P) [m] of the middle of each lane; ways: places, x and y (3, P) [m] along the way of each vehicle,
    by its number.
    """

    lanes: tuple[Array, ...]
    ways: Mapping[int, Array]

    def at(self, vehicle: Ints, place_m: Array) -> tuple[Array, Array]:
        """Coordinates (T, N) [m] of places (T, N) [m] that N vehicles have on their ways; NaN for an unknown way."""
        x, y = (np.full(place_m.shape, np.nan) for _ in range(2))
        for column, number in enumerate(vehicle.tolist()):
            there = np.isfinite(place_m[:, column])
            if number in self.ways:
                along, *axes = self.ways[number]
                for out, axis in zip((x, y), axes, strict=True):
                    out[there, column] = np.interp(place_m[there, column], along, axis)
        return x, y
