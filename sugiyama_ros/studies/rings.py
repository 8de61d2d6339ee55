"""Simulated rings, what happens on the whole road in the last part of a run, and cases that are compared."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.controllers.controller import Controlled
from sugiyama_ros.driver.parameters import SIGMA_A, defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.driver import SearchOptions, calibrate
from sugiyama_ros.simulation.collective import QUEUE_SPEED, Collective, collective
from sugiyama_ros.simulation.experiment import Experiment, carry_out
from sugiyama_ros.simulation.result import Simulation
from sugiyama_ros.studies.study import Answer, Asked
from sugiyama_ros.trajectories.dense import DenseTracks

#: The ring and the cars of the experiment, the duration of a run, and its last part, which is evaluated; SI units.
RING_M, CARS, LENGTH_M, _DURATION_S, _LAST_S = 230.0, 22, 4.33, 500.0, 150.0
#: Gap [m] between cars that start out of a jam.
JAM_GAP_M = 2.0
#: Factor of sigma_a in simulations with estimated drivers, of whom only a few collide.
FACTOR = 0.25
# A road has a wave if the slowest vehicle, in the mean over time, has less than this part of the speed of the fastest.
_SLOW = 0.5


@dataclass(frozen=True, eq=False)
class Ring:
    """One run on a ring.

    drivers: (N, P), parameters of the drivers; seed: seed of the random generator; jammed: whether the cars start as a
    platoon; otherwise they start with equal gaps; ring_m: circumference of the ring [m]; length_m: (N,), length of the
    cars [m]; period_s, duration_s: time between two samples, and duration of the run [s]; queue_speed: speed [m/s]
    below which a car is in a queue; jam_gap_m: gap [m] between cars that start out of a jam; controlled: cars that a
    controller drives.
    """

    drivers: Array
    seed: int
    jammed: bool = False
    ring_m: float = RING_M
    length_m: float | Array = LENGTH_M
    period_s: float = 1.0 / 3.0
    duration_s: float = _DURATION_S
    queue_speed: float = QUEUE_SPEED
    jam_gap_m: float = JAM_GAP_M
    controlled: Controlled | None = None


@dataclass(frozen=True)
class Outcome:
    """What happens in the last part of a run.

    road: collective measures of all vehicles; wave: whether there is a wave, and no collision; collided: whether cars
    collide; flow_per_h: vehicles that pass a point in an hour [1/h]; speed_std: standard deviation of the speeds over
    all vehicles and times [m/s]; kinetic: positive kinetic energy, the energy per mass that all cars together take up
    when they accelerate, per distance [m/s^2]; by_controlled: whether a controlled car has run into its leader.
    """

    road: Collective
    wave: bool
    collided: bool
    flow_per_h: float
    speed_std: float
    kinetic: float
    by_controlled: bool


def run(ring: Ring) -> Simulation:
    """Simulate one ring. The cars start from rest."""
    experiment = Experiment(
        ring.ring_m,
        ring.duration_s,
        ring.jam_gap_m if ring.jammed else Experiment.gap_m,
        ring.period_s,
        seed=ring.seed,
        start="jam" if ring.jammed else "equal",
        length_m=tuple(np.broadcast_to(ring.length_m, len(ring.drivers)).tolist()),
    )
    return carry_out(experiment, ring.drivers, ring.controlled)


def jams(spread: Mapping[int, float], runs: int, seed: int, duration_s: float) -> Iterator[Simulation]:
    """Simulate drivers who differ from each other, out of a jam.

    A run in which cars collide is left out. Raises InputError.
    """
    collided = 0
    for k in range(runs):
        rng = np.random.default_rng([seed, k])
        drivers = defaults(CARS)
        for place, std in spread.items():
            drivers[:, place] *= np.exp(std * rng.standard_normal(CARS))
        simulated = run(Ring(drivers, seed + k, jammed=True, duration_s=duration_s))
        if not simulated.collisions:
            yield simulated
        collided += bool(simulated.collisions)
    if collided == runs:
        raise InputError(f"study: cars collide in all simulated runs ({runs}); give more --runs, or another --seed")


def outcome(ring: Ring) -> Outcome:
    """Simulate one ring and evaluate the last part of the run.

    References
    ----------
    Watson, Milkins, Preston, Chittleborough and Alimoradian, SAE Technical Paper 830435 (1983), for the positive
    kinetic energy. Here it is worked out from accelerations, since the speeds of simulated drivers are noisy.
    """
    s = run(ring)
    last = max(2, round(_LAST_S / ring.period_s))
    speed, position = s.speed[-last:], s.position_m[-last:]
    leader = np.tile(np.roll(np.arange(len(ring.drivers)), -1), (len(speed), 1))
    headway = np.mod(np.roll(position, -1, axis=1) - position, ring.ring_m)
    road = collective(speed, headway, leader, ring.period_s, ring.queue_speed)
    wave = road.least_speed < _SLOW * road.largest_speed
    flow = 3600.0 * len(ring.drivers) / ring.ring_m * road.mean_speed
    kinetic = 2.0 * np.mean(speed * np.maximum(s.acceleration[-last:], 0.0)) / np.mean(speed)
    by_controlled = any(c.vehicle in s.dense.controlled for c in s.collisions)
    collided = bool(s.collisions)
    return Outcome(road, wave and not collided, collided, flow, float(speed.std()), float(kinetic), by_controlled)


def estimated(asked: Asked, factor: float = FACTOR, full_noise_at: float = 0.0) -> Array:
    """Rows (N, width) of drivers for simulations, with regularised estimates as in the paper (sections 5.1 and 6).

    factor: factor of the acceleration noise; full_noise_at: speed [m/s] up to which the acceleration noise grows with
    the speed; 0 for a noise that does not depend on the speed.
    """
    fits = calibrate(asked.measured, "paper", options=SearchOptions(is_regularised=True))
    rows = ROW.with_effects(np.array([fit.parameters for fit in fits]))
    rows[:, SIGMA_A] *= factor
    if full_noise_at:
        return switch_on(rows, "speed_dependent_noise_fading", {"full_speed": full_noise_at})
    return rows


def ring_of(measured: DenseTracks) -> partial[Ring]:
    """Make what makes runs where measured drivers drive, with their cars; of an open road, on the experiment's ring."""
    return partial(Ring, ring_m=measured.road.circumference_m or RING_M, length_m=measured.length_m)


def mean(values: Array | Sequence[float]) -> float:
    """Mean of the finite values; NaN if there are none."""
    finite = np.asarray(values)[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else float("nan")


def summed_up(found: Sequence[Outcome]) -> dict[str, float]:
    """Count runs with a wave and with a collision, and average the runs without a collision."""
    complete = [o for o in found if not o.collided]
    return {
        "runs": len(found),
        "with a wave": sum(o.wave for o in found),
        "collided": len(found) - len(complete),
        "mean speed [m/s]": mean([o.road.mean_speed for o in complete]),
        "least [m/s]": mean([o.road.least_speed for o in complete]),
        "largest [m/s]": mean([o.road.largest_speed for o in complete]),
        "wave speed [m/s]": mean([o.road.wave_speed for o in complete]),
        "queue [cars]": mean([o.road.queue_vehicles for o in complete]),
        "flow [1/h]": mean([o.flow_per_h for o in complete]),
    }


def _space_time(axes: Any, simulation: Simulation) -> None:
    """Draw position over time, coloured by speed, into matplotlib's ``axes``."""
    s = simulation
    time = np.arange(len(s.position_m)) * s.dense.period_s
    for i in range(s.position_m.shape[1]):
        axes.scatter(time, s.position_m[:, i], c=s.speed[:, i], s=0.3, cmap="viridis", vmin=0.0, vmax=12.0)
    axes.set(xlabel="time [s]", ylabel="position [m]")


def _speeds(axes: Any, simulation: Simulation) -> None:
    """Draw the speeds of all vehicles, vehicle 0 marked, and the range between the fastest and the slowest."""
    time_s, speed = simulation.dense.time_s, simulation.speed
    axes.plot(time_s, speed, color="tab:gray", linewidth=0.3, alpha=0.5)
    axes.plot(time_s, speed[:, 0], color="tab:blue", linewidth=0.8, label="vehicle 0")
    axes.plot(time_s, np.ptp(speed, axis=1), color="tab:red", linewidth=0.8, label="fastest - slowest")
    axes.set(xlabel="time [s]", ylabel="speed [m/s]")


def compare(asked: Asked, cases: Mapping[str, Callable[[int], Ring]]) -> Answer:
    """Run all cases with the same seeds; the figure shows the first run of each, in space and time and as speeds.

    cases: what makes a run from a seed, by the name of the case.
    """
    seeds = [asked.seed + k for k in range(asked.runs)]
    found = list(asked.work.map(outcome, [make(seed) for make in cases.values() for seed in seeds]))
    rows = tuple(
        {"case": name, **summed_up(found[k * len(seeds) : (k + 1) * len(seeds)])} for k, name in enumerate(cases)
    )

    def draw(figure: Any) -> None:
        columns = min(3, len(cases))
        lines = -(-len(cases) // columns)
        parts = np.reshape(figure.subfigures(lines, columns), -1)
        for (name, make), part in zip(cases.items(), parts, strict=False):
            simulated = run(make(asked.seed))
            above, below = part.subplots(2, 1, sharex=True)
            _space_time(above, simulated)
            above.set(xlabel="")
            above.set_title(name, fontsize="small")
            _speeds(below, simulated)
        figure.axes[1].legend(loc="upper right", fontsize="x-small")

    return Answer(rows, draw)
