"""Many simulated rings at once, each summed up by what its whole road does at the end."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import SIGMA_A, defaults
from sugiyama_ros.fit.driver import SearchOptions, calibrate
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.collective import Collective, collective
from sugiyama_ros.simulation.simulator import Simulation, Simulator, evenly, platoon, simulate
from sugiyama_ros.trajectories.trajectories import Trajectories

#: The ring and the cars of the experiment, duration of a run and its last part, which is summed up; SI units.
RING_M, CARS, LENGTH_M, DURATION_S, LAST_S = 230.0, 22, 4.33, 500.0, 150.0
#: Gap [m] of a start out of a jam.
JAM_GAP_M = 2.0
#: Factor of sigma_a in simulations with estimated drivers: the paper's (section 6), and one with which few collide.
PAPERS_FACTOR, FACTOR = 0.5, 0.25
# A road has a wave where, in the mean over time, the slowest vehicle is slower than this part of the fastest's speed.
_SLOW = 0.5


@dataclass(frozen=True, eq=False)
class Ring:
    """One run: drivers (N, P), how they start, and with what seed; jammed: from a platoon, else from equal gaps."""

    drivers: Array
    seed: int
    jammed: bool = False
    ring_m: float = RING_M
    length_m: float = LENGTH_M
    period_s: float = 1.0 / 3.0
    duration_s: float = DURATION_S


@dataclass(frozen=True)
class Outcome:
    """What a run came to: collective measures of its last part, whether there is a wave, and collisions."""

    road: Collective
    wave: bool
    collided: bool
    flow_per_h: float


def run(ring: Ring) -> Simulation:
    """Simulate one ring, from rest."""
    cars = len(ring.drivers)
    length, road = np.full(cars, ring.length_m), Road(ring.ring_m)
    start = platoon(length, JAM_GAP_M) if ring.jammed else evenly(length, road)
    rng = np.random.default_rng(ring.seed)
    return simulate(Simulator(ring.drivers, length, start, road, rng, period_s=ring.period_s), ring.duration_s)


def jams(spread: Mapping[int, float], runs: int, seed: int, duration_s: float) -> Iterator[tuple[Array, Trajectories]]:
    """Drivers (N, P) who differ, and what is measured of them out of a jam; a run in which cars collide is left out.

    spread: std of the logarithm over the drivers, by parameter.
    """
    for k in range(runs):
        rng = np.random.default_rng([seed, k])
        drivers = alike()
        for place, std in spread.items():
            drivers[:, place] *= np.exp(std * rng.standard_normal(CARS))
        simulated = run(Ring(drivers, seed + k, jammed=True, duration_s=duration_s))
        if not simulated.collisions:
            yield drivers, simulated.measured


def outcome(ring: Ring) -> Outcome:
    """Simulate one ring and sum it up."""
    s = run(ring)
    last = max(2, round(LAST_S / ring.period_s))
    speed, position = s.speed[-last:], s.position_m[-last:]
    leader = np.tile(np.roll(np.arange(len(ring.drivers)), -1), (len(speed), 1))
    headway = np.mod(np.roll(position, -1, axis=1) - position, ring.ring_m)
    road = collective(speed, headway, leader, ring.period_s)
    wave = road.least_speed < _SLOW * road.largest_speed
    flow = 3600.0 * len(ring.drivers) / ring.ring_m * road.mean_speed
    return Outcome(road, wave and not s.collisions, bool(s.collisions), flow)


def outcomes(rings: Sequence[Ring], work: Executor) -> list[Outcome]:
    """Outcomes of all, in order."""
    return list(work.map(outcome, rings))


def alike(cars: int = CARS) -> Array:
    """Drivers (N, P) at the paper's mean parameters."""
    return defaults(cars)


def estimated(trajectories: Trajectories, factor: float = FACTOR) -> Array:
    """Drivers (N, P) as the paper finds them, regularised, with part of the acceleration noise (sections 4.4 and 6)."""
    fits = calibrate(trajectories, "paper", options=SearchOptions(is_regularised=True))
    rows = np.array([fit.parameters for fit in fits])
    rows[:, SIGMA_A] *= factor
    return rows


def changed(drivers: Array, place: int, value: float | Array, first_only: bool = False) -> Array:
    """Give one parameter of all drivers, or of the first driver only, another value.

    Parameters
    ----------
    drivers : ndarray, shape (N, P)
        Drivers, which stay as they are.
    place : int
        Place of the parameter in a row.
    value : float or ndarray, shape (N,)
        New value.
    first_only : bool
        Whether only the first driver changes.

    Returns
    -------
    ndarray, shape (N, P)
        Changed drivers.
    """
    rows = drivers.copy()
    rows[: 1 if first_only else None, place] = value
    return rows


def mean_driver(drivers: Array) -> Array:
    """Make N drivers alike, each with the mean parameters of ``drivers``, shape (N, P)."""
    return np.tile(drivers.mean(axis=0), (len(drivers), 1))


def summed_up(found: Sequence[Outcome]) -> dict[str, float]:
    """Share of runs with a wave and with a collision, and means over the runs without one."""
    whole = [o for o in found if not o.collided]

    def mean(values: list[float]) -> float:
        finite = [v for v in values if np.isfinite(v)]
        return float(np.mean(finite)) if finite else float("nan")

    return {
        "runs": len(found),
        "with a wave": sum(o.wave for o in found),
        "collided": len(found) - len(whole),
        "mean speed [m/s]": mean([o.road.mean_speed for o in whole]),
        "least [m/s]": mean([o.road.least_speed for o in whole]),
        "largest [m/s]": mean([o.road.largest_speed for o in whole]),
        "wave speed [m/s]": mean([o.road.wave_speed for o in whole]),
        "queue [cars]": mean([o.road.queue_vehicles for o in whole]),
        "flow [1/h]": mean([o.flow_per_h for o in whole]),
    }


def space_time(axes: Any, simulation: Simulation) -> None:
    """Draw trajectories, coloured by speed."""
    s = simulation
    time = np.arange(len(s.position_m)) * s.measured.period_s
    for i in range(s.position_m.shape[1]):
        axes.scatter(time, s.position_m[:, i], c=s.speed[:, i], s=0.3, cmap="viridis", vmin=0.0, vmax=12.0)
    axes.set(xlabel="time [s]", ylabel="position [m]")
