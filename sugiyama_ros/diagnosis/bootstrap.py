"""Recordings simulated by the fitted model: the parametric bootstrap, which says what chance alone does."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded, prepare
from sugiyama_ros.simulation.simulator import Clock, Simulator


def resample(data: Recorded, model: Model, states: Array, rng: np.random.Generator) -> Recorded:
    """Simulate a recording with the same road, vehicles and times, from the state in which the recording begins.

    Vehicles without a leader drive as they were recorded. After a collision, or where vehicles come, go or change their
    order, the simulation starts anew from the recorded state, and the recording counts as broken there.

    Parameters
    ----------
    data, model
        The recording and the model fitted to it.
    states
        (T, N, 4) filtered states, as ``fit.score.filtered_states`` gives them.
    rng
        Generator of all noises.
    """
    t = data.trajectories
    position, speed = states[:, :, 0], states[:, :, 1]
    samples, vehicles = position.shape
    measured, segment = np.full((samples, vehicles), np.nan), np.zeros(samples, dtype=np.int64)
    known = np.isfinite(position)
    simulator: Simulator | None = None
    order: Ints = np.zeros(0, dtype=np.int64)
    for k in range(samples):
        if simulator is not None and not np.array_equal(np.sort(order), np.flatnonzero(known[k] & t.present[k])):
            simulator = None
        collided = False
        if simulator is not None:
            collided = bool(simulator.step())
            _lead(simulator, order, position[k], speed[k])
        if simulator is None or collided:
            segment[k:] += 1
            simulator, order = _start(data, model, k, position[k], speed[k], known[k] & t.present[k], rng)
        if simulator is not None:
            measured[k, order] = simulator.measure()
    # where nothing could be simulated, what was recorded stands
    empty = np.all(np.isnan(measured), axis=1)
    measured[empty] = t.position_m[empty]
    return prepare(replace(t, position_m=measured, source="simulated from the fitted model"), segment)


def _lead(simulator: Simulator, order: Ints, position: Array, speed: Array) -> None:
    """Put vehicles without a leader where they were recorded."""
    for place in np.flatnonzero(simulator.leader < 0):
        simulator.position_m[place], simulator.speed[place] = position[order[place]], speed[order[place]]


def _start(
    data: Recorded, model: Model, k: int, position: Array, speed: Array, there: Array, rng: np.random.Generator
) -> tuple[Simulator | None, Ints]:
    """A simulator from the recorded state of sample k, None if too little is known, and the columns of its vehicles."""
    t = data.trajectories
    columns = np.flatnonzero(there)
    if len(columns) < max(1, int(0.5 * t.present[k].sum())):
        return None, columns
    road = t.road
    at = road.wrap(position[columns])
    order = columns[np.argsort(at, kind="stable")]
    at = road.wrap(position[order])
    length = t.length_m[order]
    # filtered gaps below a hand's breadth are measurement noise: nobody drives inside another
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
    """A generator for each run."""
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(runs)]
