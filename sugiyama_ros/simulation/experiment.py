"""A simulated experiment: vehicles start from rest, one behind another, on a ring or an open road."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.controllers.controller import Controlled
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, index
from sugiyama_ros.effects.effect import NEEDS, RING
from sugiyama_ros.effects.needs import check_effect, check_parameter
from sugiyama_ros.effects.registry import ROW, active, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import LENGTHS_M, SIMULATED_S, Road
from sugiyama_ros.simulation.result import Simulation
from sugiyama_ros.simulation.simulator import Clock, Simulator, evenly, platoon, simulate
from sugiyama_ros.trajectories.about import DEFAULT_LENGTH_M
from sugiyama_ros.trajectories.dense import MAX_SAMPLES

#: Vehicles on a road, at most.
MAX_VEHICLES = 100_000


@dataclass(frozen=True)
class Experiment:
    """The setting of a simulated experiment.

    Parameters
    ----------
    ring_m : float
        Circumference [m] of the ring; 0 for an open road.
    duration_s : float
        Duration [s].
    gap_m : float
        Gap [m] between the vehicles at the start.
    period_s : float
        Time [s] between two samples.
    horizon : int, optional
        Periods that a driver looks ahead; if left out, the paper's look-ahead time.
    spread : float
        Standard deviation, over the drivers, of the logarithms of the desired speed and of the risk premium.
    seed : int
        Seed of all random numbers.
    start : {"jam", "equal"}
        Whether the vehicles start in a jam with gaps of ``gap_m``, or with equal gaps all around the ring.
    length_m : tuple of float
        Length [m] of each vehicle, or one length of all; the usual length if empty.
    """

    ring_m: float = 230.0
    duration_s: float = 250.0
    gap_m: float = 2.0
    period_s: float = 1.0 / 3.0
    horizon: int | None = None
    spread: float = 0.0
    seed: int = 0
    start: str = "jam"
    length_m: tuple[float, ...] = ()

    @property
    def road(self) -> tuple[str, ...]:
        """What the road has that effects may need."""
        return (RING,) if self.ring_m else ()

    @property
    def samples(self) -> int:
        """Number of samples of each vehicle."""
        return round(self.duration_s / self.period_s) + 1

    def check(self, vehicles: int) -> None:
        """Check that a number of vehicles can be simulated. Raises InputError."""
        if not 1 <= vehicles <= MAX_VEHICLES:
            raise InputError(
                f"vehicles: {vehicles} cannot be simulated; give 1 or more that have room on the road, and at most"
                f" {MAX_VEHICLES}"
            )
        for name, value, lower, upper in (
            ("period_s", self.period_s, *SIMULATED_S),
            ("gap_m", self.gap_m, 0.01, 1e6),
            ("spread", self.spread, 0.0, 10.0),
        ):
            if not lower <= value <= upper:
                raise InputError(f"{name}: {value:g} cannot be simulated; give {lower:g} to {upper:g}")
        longest_s = _rounded_down((MAX_SAMPLES / vehicles - 1.0) * self.period_s)
        if not 0.0 <= self.duration_s <= longest_s:
            raise InputError(
                f"duration_s: {self.duration_s:g} cannot be simulated, for {vehicles} vehicles every"
                f" {self.period_s:.3g} s; give {longest_s:g} at most"
            )
        if self.duration_s > 0.0 and self.samples < 2:
            raise InputError(
                f"period_s: {self.period_s:g} s, but duration_s is {self.duration_s:g} s; give at least 2 samples"
            )
        if self.start not in ("jam", "equal") or (self.start == "equal" and self.ring_m == 0.0):
            raise InputError(f"start: {self.start} is not possible here; give jam, or on a ring equal")
        if self.start == "equal" and self.gap_m != Experiment.gap_m:
            raise InputError("gap_m: is for the start in a jam, not with equal gaps all around the ring; leave it out")
        shortest, longest = LENGTHS_M
        if len(self.length_m) not in (0, 1, vehicles) or not all(shortest <= one <= longest for one in self.length_m):
            raise InputError(
                f"length_m: {len(self.length_m)} lengths of {vehicles} vehicles; give one each, or one for all,"
                f" {shortest:g} to {longest:g} m"
            )


def _rounded_down(value: float) -> float:
    """A positive number with two digits that count."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.floor(value / digit) * digit


def set_up(experiment: Experiment, rows: Array, controlled: Controlled | None = None) -> Simulator:
    """Put the vehicles of an experiment at their start; rows (N, width) at the reference period. Raises InputError.

    controlled: vehicles that a controller drives.
    """
    experiment.check(len(rows))
    vehicles, rows = len(rows), rows.copy()
    rng = np.random.default_rng(experiment.seed)
    spread_out(rows, experiment.spread, rng)
    length_m = np.full(vehicles, experiment.length_m or DEFAULT_LENGTH_M)
    road = Road(experiment.ring_m)
    start_m = evenly(length_m, road) if experiment.start == "equal" else platoon(length_m, experiment.gap_m)
    needed_m = float(start_m[-1] + 0.5 * (length_m[0] + length_m[-1]))
    if road.is_ring and needed_m > experiment.ring_m:
        raise InputError(
            f"ring of {experiment.ring_m:g} m: {vehicles} vehicles with gaps of {experiment.gap_m:g} m need"
            f" {math.ceil(needed_m)} m; give a ring of {math.ceil(needed_m)} m or more, or fewer vehicles"
        )
    clock = Clock(experiment.period_s, horizon=experiment.horizon)
    return Simulator(rows, length_m, start_m, road, rng, clock=clock, controlled=controlled)


def spread_out(rows: Array, spread: float, rng: np.random.Generator) -> None:
    """Let drivers differ: change, in place, v_star and kappa_v of rows (N, width) by factors of this relative std.

    Raises InputError where nobody has them.
    """
    if spread > 0.0:
        check_parameter("v_star", ROW.with_effects(rows), "spread")
        for k in (V_STAR, KAPPA_V):
            rows[:, k] *= np.exp(spread * rng.standard_normal(len(rows)))


def carry_out(experiment: Experiment, rows: Array, controlled: Controlled | None = None) -> Simulation:
    """Simulate an experiment; arguments as for ``set_up``. Raises InputError."""
    return simulate(set_up(experiment, rows, controlled), experiment.duration_s)


def changed(
    rows: Array,
    parameters: Mapping[str, float],
    effects: Mapping[str, Mapping[str, float]],
    road: Collection[str] = NEEDS,
) -> Array:
    """Return rows (N, width) with other parameters, and with effects switched on.

    road: what the road has that effects may need; everything if left out. Raises InputError, also for what would do
    nothing, such as an effect of a model file on another road.
    """
    rows = rows.copy()
    for name, value in parameters.items():
        check_parameter(name, rows)
        rows[:, index(name)] = value
    for name, values in effects.items():
        check_effect(name, rows, road)
        rows = switch_on(rows, name, values)
    for name in active(rows):
        check_effect(name, rows, road)
    return rows
