"""Free runs: from a filtered state on, the model drives alone, and its way is compared with the measured one.

Coupled: all vehicles drive by the model. Single: one vehicle drives behind his leader as he was recorded.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numba import njit

from sugiyama_ros.driver.parameters import RHO, at_period, horizon_at
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.registry import PLACES
from sugiyama_ros.effects.sensor_eccentricity import displacement
from sugiyama_ros.filters import causal
from sugiyama_ros.filters.chain import Chain
from sugiyama_ros.fit.fitting import Model, Recorded, Samples, leaders
from sugiyama_ros.road import Array, Ints
from sugiyama_ros.simulation.simulator import drive

#: Times ahead [s] at which free runs are compared with the measurements, and time [s] between two starts.
HORIZONS_S = (2.0, 5.0, 10.0)
_EVERY_S = 2.5
_OFF_CENTRE = PLACES["sensor_eccentricity"]


@njit(nogil=True, cache=True)
def _coupled(
    x: Array,
    v: Array,
    n: Array,
    b: Array,
    leader: Ints,
    turn: Array,
    length: Array,
    rows: Array,
    actions: Array,
    time: float,
    period: float,
    horizon: int,
    circumference: float,
    out: Array,
) -> None:
    """Positions [m] and speeds into ``out`` (steps, N, 2), from positions, speeds, noises and what is held (N,)."""
    vehicles = len(x)
    # what drivers prefer is changed in place on the way, and other free runs share these rows
    rows = rows.copy()
    held, pushed = np.empty(vehicles), np.empty(vehicles)
    acceleration = b + rows[:, RHO] * n
    for k in range(len(out)):
        drive(
            x,
            v,
            b,
            acceleration,
            length,
            leader,
            turn,
            rows,
            actions,
            time,
            period,
            horizon,
            circumference,
            held,
            pushed,
        )
        for i in range(vehicles):
            acceleration[i] = held[i] + pushed[i] + n[i]
            x[i] += period * v[i]
            v[i] += period * acceleration[i]
            n[i] *= rows[i, RHO]
            b[i] = held[i]
        time += period
        out[k, :, 0], out[k, :, 1] = x, v


@njit(nogil=True, cache=True)
def _single(
    i: int,
    recorded: Array,
    leader: Ints,
    turn: Array,
    length: Array,
    rows: Array,
    actions: Array,
    time: float,
    period: float,
    horizon: int,
    circumference: float,
    out: Array,
) -> None:
    """Positions [m] and speeds of vehicle i into ``out`` (steps, N, 2); the others are as recorded, (steps, N, 4)."""
    near = np.array([i, leader[i], leader[leader[i]] if leader[i] >= 0 else -1, -1])
    for j in range(len(leader)):
        if leader[j] == i:
            near[3] = j
    # the vehicle, those ahead and the one behind, as a little road of their own
    count, place = 0, np.full(len(leader), -1)
    chosen: Ints = np.empty(4, np.int64)
    for j in near:
        if j >= 0 and place[j] < 0:
            place[j] = count
            chosen[count] = j
            count += 1
    ahead = np.full(count, -1)
    for k in range(count):
        if leader[chosen[k]] >= 0:
            ahead[k] = place[leader[chosen[k]]]
    near = chosen[:count]
    small_rows, small_turn, small_length = rows[near], turn[near], length[near]
    held, pushed = np.empty(1), np.empty(1)
    x, v, n, b = recorded[0, i, 0], recorded[0, i, 1], recorded[0, i, 2], recorded[0, i, 3]
    a = b + rows[i, RHO] * n
    for k in range(len(out)):
        xs, vs, bs = recorded[k, near, 0].copy(), recorded[k, near, 1].copy(), recorded[k, near, 3].copy()
        accelerations = bs + recorded[k, near, 2]
        xs[0], vs[0], bs[0], accelerations[0] = x, v, b, a
        drive(
            xs,
            vs,
            bs,
            accelerations,
            small_length,
            ahead,
            small_turn,
            small_rows,
            actions,
            time,
            period,
            horizon,
            circumference,
            held,
            pushed,
        )
        a = held[0] + pushed[0] + n
        x += period * v
        v += period * a
        n *= rows[i, RHO]
        b = held[0]
        time += period
        out[k, i, 0], out[k, i, 1] = x, v


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Errors of free runs, model minus measurement, (S, H, N) at HORIZONS_S; start: (S,) samples.

    coupled, single: of positions [m]; behind a leader as he was recorded, the error of the gap is that of the position
    with the other sign. coupled_speed, single_speed: of speeds [m/s], against the filtered ones; coupled_gap: of gaps
    [m]. gap, speed: measured and filtered there, NaN without a leader.
    """

    coupled: Array
    single: Array
    coupled_speed: Array
    single_speed: Array
    coupled_gap: Array
    gap: Array
    speed: Array
    start: Ints


def free_runs(data: Recorded, models: Sequence[Model], states: Sequence[Array], work: Executor) -> FreeRuns:
    """Free runs from every ``_EVERY_S`` seconds, each by the model fitted without the fold in which it starts.

    states: filtered states of all drivers by each of the models, (T, N, 4), as ``filtered_states`` gives them.
    """
    t = data.trajectories
    steps = np.array([max(1, round(h / t.period_s)) for h in HORIZONS_S])
    starts = np.arange(causal.SETTLING + 4, len(t.position_m) - steps[-1], max(1, round(_EVERY_S / t.period_s)))
    starts = starts[data.segment[starts - causal.SETTLING] == data.segment[starts + steps[-1]]]
    rows = [at_period(model.rows, t.period_s) for model in models]
    jobs = [(data, rows[f], states[f], int(k), steps) for k, f in zip(starts, data.fold[starts], strict=True)]
    errors = list(work.map(_from_start, jobs))
    empty = np.empty((0, len(steps), data.drivers))
    fields = [np.array([e[j] for e in errors]) if errors else empty for j in range(7)]
    coupled, single, coupled_speed, single_speed, coupled_gap, gap, speed = fields
    return FreeRuns(coupled, single, coupled_speed, single_speed, coupled_gap, gap, speed, starts)


def _from_start(job: tuple[Recorded, Array, Array, int, Ints]) -> tuple[Array, ...]:
    """The fields of FreeRuns from one sample on, (H, N) each."""
    data, rows, state, k, steps = job
    t, ring = data.trajectories, data.trajectories.road.circumference_m
    about = (t.length_m, rows, ACTIONS)
    leader = np.where(np.isfinite(state[k, t.leader[k], 0]), t.leader[k], -1)
    headway = np.where(leader >= 0, state[k, leader, 0] - state[k, :, 0], 0.0)
    turn = np.nan_to_num(ring * np.floor(headway / ring)) if ring else np.zeros(data.drivers)
    scene = (t.start_s + k * t.period_s, t.period_s, horizon_at(t.period_s), ring)
    x, v, n, b = state[k].T.copy()
    coupled, single = (np.empty((steps[-1], data.drivers, 2)) for _ in range(2))
    _coupled(x, v, n, b, leader, turn, *about, *scene, coupled)  # type: ignore[arg-type]
    recorded = state[k : k + steps[-1]]
    for i in range(data.drivers):
        _single(i, recorded, leader, turn, *about, *scene, single)  # type: ignore[arg-type]
    coupled, single = coupled[steps - 1], single[steps - 1]
    measured, speed = t.position_m[k + steps], state[k + steps, :, 1]
    errors = t.road.difference(_as_measured(coupled[:, :, 0], rows, ring), measured)
    led = leader >= 0
    gap = t.road.space_headway(measured[:, leader], measured) - 0.5 * (t.length_m[leader] + t.length_m)
    return (
        errors,
        t.road.difference(_as_measured(single[:, :, 0], rows, ring), measured),
        coupled[:, :, 1] - speed,
        single[:, :, 1] - speed,
        np.where(led, errors[:, leader] - errors, np.nan),
        np.where(led, gap, np.nan),
        speed,
    )


def _as_measured(position: Array, rows: Array, ring: float) -> Array:
    """Where positions (H, N) [m] are measured: with an eccentric camera, not where they are."""
    if not rows[:, _OFF_CENTRE].any():
        return position
    off = [[displacement(x, ring, row[_OFF_CENTRE])[0] for x, row in zip(at, rows, strict=True)] for at in position]
    return np.asarray(position + np.array(off))


def filtered_states(data: Recorded, model: Model, work: Executor) -> Array:
    """Filtered position, speed, noise and held acceleration of every driver, (T, N, 4); NaN where unknown."""
    return follow(data, model, work)[1]


def follow(data: Recorded, model: Model, work: Executor) -> tuple[Samples, Array]:
    """What the model says of every sample, and the filtered states as in ``filtered_states``."""
    jobs = [(data.chains[i], model.rows[i], leaders(data, model, i)) for i in range(data.drivers)]
    outputs = list(work.map(_follow_driver, jobs))
    y, variance, density = (np.array([o[k] for o in outputs]) for k in range(3))
    states = np.stack([o[3] for o in outputs], axis=1)
    states[~np.isfinite(variance.T)] = np.nan
    return Samples(y, variance, density), states


def _follow_driver(job: tuple[Chain, Array, Array]) -> tuple[Array, Array, Array, Array]:
    chain, row, ahead = job
    return causal.predict_states(chain, row, ahead)


def rmse(errors: Array) -> float:
    """Root of the mean square of all that are known."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else float("nan")
