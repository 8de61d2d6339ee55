"""What a simulation gives: measured and true motion, and collisions."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arguments import checked
from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import COUNT, NAMES
from sugiyama_ros.effects.registry import ROW, active
from sugiyama_ros.formats.table import write_csv
from sugiyama_ros.formats.truth import write_simulated
from sugiyama_ros.results import Result, space_time
from sugiyama_ros.trajectories.dense import DenseTracks, tracks_of
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.truth import TrueDriver, Truth

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


@dataclass(frozen=True)
class Collision:
    """Vehicle number ``vehicle`` ran into vehicle number ``leader``, ``time_s`` [s] after the start of the run."""

    time_s: float
    vehicle: int
    leader: int


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Result):
    """A simulated run of N drivers over T samples.

    Parameters
    ----------
    dense : DenseTracks
        Positions as a camera would have measured them, as arrays.
    parameters : ndarray, shape (N, width)
        Rows of the drivers at the reference period.
    position_m : ndarray, shape (T, N)
        True positions [m], wrapped on a ring.
    speed, acceleration : ndarray, shape (T, N)
        True speeds [m/s] and accelerations [m/s^2].
    collisions : tuple of Collision
        Collisions, in the order of time.
    """

    dense: DenseTracks
    parameters: Array
    position_m: Array
    speed: Array
    acceleration: Array
    collisions: tuple[Collision, ...]

    @cached_property
    def measured(self) -> Tracks:
        """What a camera would have measured, as `sugiyama_ros.read` returns it."""
        return tracks_of(self.dense)

    @property
    def truth(self) -> Truth:
        """What the drivers really did, and with which parameters."""
        t = self.dense
        leader = t.leader[0]
        ahead_m = t.road.space_headway(self.position_m[:, leader], self.position_m)
        gap_m = np.where(leader >= 0, ahead_m - 0.5 * (t.length_m + t.length_m[leader]), np.inf)
        drives = tuple(
            TrueDriver(t.start_s, vehicle, parameters_of(row))
            for vehicle, row in zip(t.vehicle.tolist(), self.parameters, strict=True)
            if vehicle not in t.controlled
        )
        return Truth(t.vehicle, t.time_s, self.position_m, self.speed, self.acceleration, gap_m, drives)

    def headline(self) -> str:
        """Say what was simulated, how fast the drivers drove, and how often they collided."""
        collisions = f"; {len(self.collisions)} collision{'s' * (len(self.collisions) > 1)}" if self.collisions else ""
        return f"{self.dense.headline()}; mean speed {self.speed.mean():.2f} m/s{collisions}"

    def records(self) -> list[dict[str, Any]]:
        """List all samples: measured position, and true position, speed and acceleration; SI units."""
        t = self.dense
        return [
            {
                "time_s": time,
                "vehicle": vehicle,
                "position_m": float(t.position_m[k, i]),
                "true_position_m": float(self.position_m[k, i]),
                "true_speed": float(self.speed[k, i]),
                "true_acceleration": float(self.acceleration[k, i]),
            }
            for k, time in enumerate(t.time_s.tolist())
            for i, vehicle in enumerate(t.vehicle.tolist())
        ]

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw the true positions over time, coloured by speed."""
        space_time(figure, self.dense.time_s, self.position_m, self.speed)

    @checked()
    def save(self, path: str | Path) -> None:
        """Write the simulation to a file.

        Parameters
        ----------
        path : str or Path
            ``.mcap`` for the measured positions and the truth, ``.csv`` for the measured positions, ``.json`` for all
            records, ``.png`` and ``.pdf`` for the picture.

        Raises
        ------
        InputError
            For any other suffix.
        OutputError
            If the file cannot be written.
        """
        if Path(path).suffix == ".mcap":
            write_simulated(self.dense, self.truth, Path(path))
        elif Path(path).suffix == ".csv":
            write_csv(self.dense, Path(path))
        else:
            super().save(path)


def parameters_of(row: Array) -> dict[str, float]:
    """Parameters of a driver by name, from a row (width,): the base model's, and those of the active effects."""
    places = [k for name in active(row) for k in range(*ROW.places[name].indices(ROW.width))]
    return dict(zip(NAMES, row[:COUNT].tolist(), strict=True)) | {ROW.entries[k]: float(row[k]) for k in places}
