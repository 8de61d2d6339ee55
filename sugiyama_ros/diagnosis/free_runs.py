"""Free runs from filtered states, compared with what was measured.

Coupled: all vehicles drive by the model. Single: one vehicle drives behind its leader as the leader was recorded.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import at_period, horizon_at
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.sensing import displacements
from sugiyama_ros.filters import causal
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.simulation.drive import Order, Setting
from sugiyama_ros.simulation.free_run import run_coupled, run_single

#: Times ahead [s] at which free runs are compared with the measurements, and time [s] between two starts.
HORIZONS_S = (2.0, 5.0, 10.0)
_EVERY_S = 2.5


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Errors of free runs, model minus measurement, (S, H, N) at HORIZONS_S; start: (S,) samples.

    coupled, single: of positions [m]; in a single run, the error of the gap is the error of the position with the other
    sign. coupled_speed, single_speed: of speeds [m/s], against the filtered speeds; coupled_gap: of gaps [m]. gap,
    speed: measured gap [m] and filtered speed [m/s] there, NaN without a leader.
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
    """Free runs that start every 2.5 s, each by the model fitted without the fold in which it starts.

    Parameters
    ----------
    data
        The recording.
    models
        For every fold, the model fitted without it.
    states
        (T, N, 4) filtered states by each of the models, as ``filtered_states`` gives them.
    work
        Executor that carries out the runs.
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
    """The fields of FreeRuns from one sample on, (H, N) each."""
    data, rows, state, k, steps = job
    t, ring = data.trajectories, data.trajectories.road.circumference_m
    leader = np.where(np.isfinite(state[k, t.leader[k], 0]), t.leader[k], -1)
    coupled, single = _drive_on(data, rows, state[k : k + steps[-1]], k, leader)
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


def _drive_on(data: Recorded, rows: Array, recorded: Array, k: int, leader: Ints) -> tuple[Array, Array]:
    """Positions [m] and speeds [m/s] of the coupled and the single runs from sample k on, (steps, N, 2) each.

    recorded: (steps, N, 4) filtered states from sample k on; leader: (N,).
    """
    t, ring = data.trajectories, data.trajectories.road.circumference_m
    headway = np.where(leader >= 0, recorded[0, leader, 0] - recorded[0, :, 0], 0.0)
    turn = np.nan_to_num(ring * np.floor(headway / ring)) if ring else np.zeros(data.drivers)
    order = Order(leader, turn, t.length_m)
    setting = Setting(t.period_s, horizon_at(t.period_s), ring)
    start_s = t.start_s + k * t.period_s
    coupled, single = (np.empty((len(recorded), data.drivers, 2)) for _ in range(2))
    run_coupled(recorded[0].T.copy(), order, rows, ACTIONS, start_s, setting, coupled)
    for i in range(data.drivers):
        run_single(i, recorded, order, rows, ACTIONS, start_s, setting, single)
    return coupled, single


def _as_measured(position: Array, rows: Array, ring: float) -> Array:
    """Where positions (H, N) [m] are measured, which effects may displace."""
    return np.asarray(position + np.array([displacements(at, ring, rows) for at in position]))


def rmse(errors: Array) -> float:
    """Root of the mean square of all finite errors; NaN if there are none."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else float("nan")
