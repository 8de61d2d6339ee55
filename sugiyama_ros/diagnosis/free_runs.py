"""Free runs from filtered states, compared with the measurements.

In a coupled run all vehicles follow the model. In a single run one vehicle follows the model behind its recorded
leader.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import at_period, horizon_at
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.sensing import displacements
from sugiyama_ros.filters.causal_kernel import SETTLING
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.simulation.drive import Order, Setting
from sugiyama_ros.simulation.free_run import run_coupled, run_single

#: Times after the start [s] at which free runs are compared with the measurements.
HORIZONS_S = (2.0, 5.0, 10.0)
# Time between two starts [s].
_EVERY_S = 2.5


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Errors of free runs, model minus measurement, for S starts, H horizons and N vehicles.

    Vehicles that lead others and follow nobody are not judged: their errors are NaN.

    Parameters
    ----------
    coupled, single : ndarray, shape (S, H, N)
        Errors of positions [m]. In a single run, the error of the gap is the negative error of the position.
    coupled_speed, single_speed : ndarray, shape (S, H, N)
        Errors of speeds [m/s] against the filtered speeds.
    coupled_gap : ndarray, shape (S, H, N)
        Errors of gaps [m].
    gap : ndarray, shape (S, H, N)
        Measured gaps [m], NaN without a leader.
    speed : ndarray, shape (S, H, N)
        Filtered speeds [m/s].
    start : ndarray of int, shape (S,)
        Samples at which the runs start.
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
    """Start a free run every 2.5 s, with the model that was fitted without the fold of the start.

    Parameters
    ----------
    data : Recorded
        The recording.
    models : sequence of Model
        For every fold, the model fitted without the fold.
    states : sequence of ndarray, shape (T, N, 4)
        Filtered states of each of the models, as ``filtered_states`` returns them.
    work : Executor
        Carries out the runs.

    Returns
    -------
    FreeRuns
        Errors at the horizons.
    """
    t = data.trajectories
    steps = np.array([max(1, round(h / t.period_s)) for h in HORIZONS_S])
    starts = np.arange(SETTLING + 4, len(t.position_m) - steps[-1], max(1, round(_EVERY_S / t.period_s)))
    starts = starts[data.segment[starts - SETTLING] == data.segment[starts + steps[-1]]]
    rows = [at_period(model.rows, t.period_s) for model in models]
    jobs = [(data, rows[f], states[f], int(k), steps) for k, f in zip(starts, data.fold[starts], strict=True)]
    errors = list(work.map(_from_start, jobs))
    empty = np.empty((0, len(steps), data.drivers))
    fields = [np.array([e[j] for e in errors]) if errors else empty for j in range(7)]
    coupled, single, coupled_speed, single_speed, coupled_gap, gap, speed = fields
    return FreeRuns(
        coupled=coupled,
        single=single,
        coupled_speed=coupled_speed,
        single_speed=single_speed,
        coupled_gap=coupled_gap,
        gap=gap,
        speed=speed,
        start=starts,
    )


def _from_start(job: tuple[Recorded, Array, Array, int, Ints]) -> tuple[Array, ...]:
    """Fields of FreeRuns for the run that starts at one sample, (H, N) each."""
    data, rows, state, k, steps = job
    t, ring = data.trajectories, data.trajectories.road.circumference_m
    leader = np.where(np.isfinite(state[k, t.leader[k], 0]), t.leader[k], -1)
    coupled, single = _drive_on(data, rows, state[k : k + steps[-1] + 1], k, leader)
    coupled, single = coupled[steps - 1], single[steps - 1]
    measured, speed = t.position_m[k + steps], state[k + steps, :, 1]
    errors = t.road.difference(_as_measured(coupled[:, :, 0], rows, ring), measured)
    led = leader >= 0
    judged = led if led.any() else ~led
    gap = t.road.space_headway(measured[:, leader], measured) - 0.5 * (t.length_m[leader] + t.length_m)
    return (
        np.where(judged, errors, np.nan),
        np.where(judged, t.road.difference(_as_measured(single[:, :, 0], rows, ring), measured), np.nan),
        np.where(judged, coupled[:, :, 1] - speed, np.nan),
        np.where(judged, single[:, :, 1] - speed, np.nan),
        np.where(led, errors[:, leader] - errors, np.nan),
        np.where(led, gap, np.nan),
        speed,
    )


def _drive_on(data: Recorded, rows: Array, recorded: Array, k: int, leader: Ints) -> tuple[Array, Array]:
    """Positions [m] and speeds [m/s] of the coupled and the single runs from sample k on, (steps, N, 2) each.

    recorded: (steps + 1, N, 4) filtered states from sample k on; leader: (N,).
    """
    t, ring = data.trajectories, data.trajectories.road.circumference_m
    headway = np.where(leader >= 0, recorded[0, leader, 0] - recorded[0, :, 0], 0.0)
    turn = np.nan_to_num(ring * np.floor(headway / ring)) if ring else np.zeros(data.drivers)
    order = Order(leader, turn, t.length_m)
    setting = Setting(t.period_s, horizon_at(t.period_s), ring)
    start_s = t.start_s + k * t.period_s
    coupled, single = (np.empty((len(recorded) - 1, data.drivers, 2)) for _ in range(2))
    run_coupled(recorded, order, rows, ACTIONS, start_s, setting, coupled)
    for i in range(data.drivers):
        run_single(i, recorded, order, rows, ACTIONS, start_s, setting, single)
    return coupled, single


def _as_measured(position: Array, rows: Array, ring: float) -> Array:
    """Measured positions for true positions (H, N) [m]; effects may displace the measurement."""
    # one layout, so that one version of the function is compiled
    position = np.ascontiguousarray(position)
    return np.asarray(position + np.array([displacements(at, ring, rows) for at in position]))


def rmse(errors: Array) -> float:
    """Return the root mean square of all finite errors; NaN if there are none."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else float("nan")
