"""Parametric bootstrap: recordings simulated from the fitted model, which show what chance alone gives."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.signal import savgol_filter

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import at_period
from sugiyama_ros.fit.joint import NEAR_STEPS, JointFit, fit
from sugiyama_ros.fit.model import Model, between_measurements, filtered_states, moved
from sugiyama_ros.fit.preparation import driven_anew, prepare_road
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.progress import OnStage
from sugiyama_ros.simulation.behind import RecordedTraffic, drive_behind
from sugiyama_ros.simulation.simulator import Clock, Simulator
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.workers import parallel_map

# Time [s] over which the track of a vehicle without a leader is smoothed (Savitzky, Golay, Anal. Chem. 36 (1964) 1627).
_SMOOTHED_S = 2.0
# Samples of a driver do not count from so long [s] before a collision: real drivers do not get there, and the penalty
# is flat within another vehicle.
_BEFORE_COLLISION_S = 3.0


def resample(data: Recorded, model: Model, states: Array, rng: np.random.Generator) -> Recorded:
    """Simulate a recording with the road, the vehicles and the times of a given recording; states: filtered, (T, V, 4).

    On tracks, each driver drives anew behind the measured vehicles ahead. On a whole road, the simulation starts from
    the first state of the recording. Vehicles without a leader move as recorded. After a collision, or where vehicles
    enter, leave or change their order, the simulation restarts from the recorded state, and the new recording has a
    break there. The last seconds of vehicles that collide do not count.
    """
    t = data.trajectories
    if t is None:
        return _behind_measured(data, model, states, rng)
    position, speed = _led(t, states)
    samples, vehicles = position.shape
    measured, segment = np.full((samples, vehicles), np.nan), np.zeros(samples, dtype=np.int64)
    known, collided = np.isfinite(position), np.zeros((vehicles, samples), np.bool_)
    simulator: Simulator | None = None
    order: Ints = np.zeros(0, dtype=np.int64)
    for k in range(samples):
        if simulator is not None and not np.array_equal(np.sort(order), np.flatnonzero(known[k] & t.present[k])):
            simulator = None
        if simulator is not None:
            unled = np.flatnonzero(simulator.leader < 0)
            collisions = simulator.step((unled, position[k, order[unled]], speed[k, order[unled]]))
            collided[order[[i for one in collisions for i in (one.vehicle, one.leader)]], k] = True
        if simulator is None or collided[:, k].any():
            segment[k:] += 1
            simulator, order = _start(t, model, k, position[k], speed[k], known[k] & t.present[k], rng)
        if simulator is not None:
            measured[k, order] = simulator.measure()
    # keep the recorded positions of samples that could not be simulated, and miss what the recording misses
    empty = np.all(np.isnan(measured), axis=1)
    measured[empty] = t.position_m[empty]
    measured[np.isnan(t.position_m)] = np.nan
    simulated = prepare_road(replace(t, position_m=measured, source="simulated from the fitted model"), segment)
    return _without_collisions(simulated, collided)


def _behind_measured(data: Recorded, model: Model, states: Array, rng: np.random.Generator) -> Recorded:
    """Tracks on which each driver drives anew behind the measured vehicles ahead."""
    around, moved = data.vicinity, between_measurements(data, states)
    recorded = RecordedTraffic(
        moved, around.leader, around.length_m, data.segment, data.lines, around.road, around.period_s
    )
    simulated = driven_anew(data, *drive_behind(recorded, at_period(model.rows, around.period_s), rng))
    new, old = (np.diff(one.segment, axis=1, prepend=one.segment[:, :1]) != 0 for one in (simulated, data))
    return _without_collisions(simulated, new & ~old)


def _without_collisions(simulated: Recorded, collided: Mask) -> Recorded:
    """Leave out the samples just before drivers collide, (N, T)."""
    before = np.zeros_like(collided)
    for back in range(1, round(_BEFORE_COLLISION_S / simulated.vicinity.period_s) + 1):
        before[:, :-back] |= collided[:, back:]
    return replace(simulated, scored=simulated.scored & ~before)


def resampled_fits(
    data: Recorded,
    fitted: JointFit,
    rngs: Sequence[np.random.Generator],
    work: ThreadPoolExecutor,
    on_progress: OnStage,
) -> list[tuple[Recorded, JointFit]]:
    """Simulate recordings from a fit, and fit the model to each from the truth.

    The fits end at a maximum, as the fit to the data does: elsewhere scores have another mean. The drivers are drawn
    from what is known of each. Their estimates alone would differ less than drivers do, because they are draws from one
    population, and a fit to them would then be better than a fit to the data.
    """
    states = filtered_states(data, fitted.model, work)

    def one_run(rng: np.random.Generator) -> tuple[Recorded, JointFit]:
        truth = _drawn(data, fitted, rng)
        simulated = resample(data, truth, states, rng).roughly
        return simulated, fit(simulated, truth, work, iterations=NEAR_STEPS)

    return parallel_map(one_run, rngs, "simulating the current model", on_progress)


def _drawn(data: Recorded, fitted: JointFit, rng: np.random.Generator) -> Model:
    """The model with the individual parameters of each driver drawn from their posterior distribution."""
    own = len(fitted.model.individual)
    prior = np.diag(np.array(fitted.model.prior_std) ** -2.0)
    information = np.array([s.information.sum(axis=0)[:own, :own] + prior for s in fitted.slopes])
    root, shock = np.linalg.cholesky(information), rng.standard_normal((data.drivers, own, 1))
    away: Array = np.asarray(np.linalg.solve(root.transpose(0, 2, 1), shock), np.float64)
    return moved(data, fitted.model, away[:, :, 0], np.zeros(len(fitted.model.shared)))


def _led(t: DenseTracks, states: Array) -> tuple[Array, Array]:
    """Positions [m] and speeds [m/s] (T, N) to start from, smoothed where vehicles without a leader move as recorded.

    Who follows them would otherwise have to follow every jump of the filter.
    """
    position, speed = states[:, :, 0].copy(), states[:, :, 1].copy()
    window = 2 * max(2, round(0.5 * _SMOOTHED_S / t.period_s)) + 1
    for column in np.flatnonzero((t.leader < 0).any(axis=0)):
        known = np.isfinite(position[:, column])
        if known.sum() > window and not t.road.is_ring:
            fit = partial(savgol_filter, position[known, column], window, 2, delta=t.period_s)
            position[known, column], speed[known, column] = fit(), fit(deriv=1)
    return position, speed


def _start(
    t: DenseTracks, model: Model, k: int, position: Array, speed: Array, there: Array, rng: np.random.Generator
) -> tuple[Simulator | None, Ints]:
    """A simulator that starts from the recorded state of sample k, or None if too little is known; columns of its
    vehicles.
    """
    columns = np.flatnonzero(there)
    if len(columns) < max(1, int(0.5 * t.present[k].sum())):
        return None, columns
    road = t.road
    at = road.wrap(position[columns])
    order = columns[np.argsort(at, kind="stable")]
    at = road.wrap(position[order])
    length = t.length_m[order]
    # filtered gaps below 0.3 m are measurement noise: vehicles cannot overlap
    behind = at.copy()
    for j in range(len(order) - 2, -1, -1):
        behind[j] = min(behind[j], behind[j + 1] - 0.5 * (length[j] + length[j + 1]) - 0.3)
    if road.is_ring and behind[-1] - behind[0] + 0.5 * (length[0] + length[-1]) + 0.3 > road.circumference_m:
        return None, columns
    simulator = Simulator(
        model.rows[order],
        length,
        behind,
        road,
        rng,
        speed=np.maximum(speed[order], 0.0),
        clock=Clock(t.period_s, t.start_s + k * t.period_s),
    )
    return simulator, order


def seeds(seed: int, runs: int) -> Sequence[np.random.Generator]:
    """Return one random generator for each run."""
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(runs)]
