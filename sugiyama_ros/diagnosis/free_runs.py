"""Free runs from filtered states, compared with the measurements.

In a coupled run all vehicles follow the model. In a single run one vehicle follows the model behind its recorded
leader. What is compared is the mean of two runs with acceleration noise, whose shocks are opposite (antithetic
variates). A run without noise would end too far ahead, because cars brake harder than they accelerate; the mean of a
pair differs little from the mean of many runs.

References
----------
J. M. Hammersley and K. W. Morton, A new Monte Carlo technique: antithetic variates, Math. Proc. Camb. Philos. Soc. 52
(1956) 449.
"""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, fields
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import at_period, horizon_at, index
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.sensing import displacements
from sugiyama_ros.filters.causal_kernel import SETTLING
from sugiyama_ros.filters.chain import adaptation_of
from sugiyama_ros.filters.state import STATE
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import between_measurements
from sugiyama_ros.simulation.drive import Order, Setting
from sugiyama_ros.simulation.free_run import run_coupled, run_single

#: Times after the start [s] at which free runs are compared with the measurements.
HORIZONS_S = (2.0, 5.0, 10.0)
# Time between two starts [s].
_EVERY_S = 2.5
# Gap [m] that counts as contact: positions are rounded.
_CONTACT_M = 1e-6
_Kind = TypeVar("_Kind", bound=np.generic)


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Errors of free runs, model minus measurement, for S starts, H horizons and N vehicles.

    Each is the error of the mean of a pair of runs. All models get the same shocks. Vehicles that lead others and
    follow nobody are not judged: their errors are NaN.

    Parameters
    ----------
    coupled, single : ndarray, shape (S, H, N)
        Errors of positions [m]; NaN where a driver does not start, and for coupled runs on tracks. In a single run, the
        error of the gap is the negative error of the position.
    coupled_speed, single_speed : ndarray, shape (S, H, N)
        Errors of speeds [m/s] against the filtered speeds.
    coupled_gap : ndarray, shape (S, H, N)
        Errors of gaps [m].
    gap : ndarray, shape (S, H, N)
        Measured gaps [m], NaN without a leader.
    touches : ndarray, shape (S, H, N)
        1 where a car touches its leader in the coupled run without noise, 0 where it does not; NaN without a leader.
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
    touches: Array
    speed: Array
    start: Ints

    @classmethod
    def of_folds(cls, by_fold: Sequence["FreeRuns"]) -> "FreeRuns":
        """Put together the runs of each fold, which have the same starts."""
        return cls(**{field.name: first_known([getattr(one, field.name) for one in by_fold]) for field in fields(cls)})

    def among(self, others: "FreeRuns", who: Sequence[int]) -> "FreeRuns":
        """Return the runs of some drivers, who are ``who``, with NaN for the runs that only ``others`` have."""
        starts, drivers, found = np.searchsorted(others.start, self.start)[:, None], np.array(who), {}
        for name in (field.name for field in fields(self) if field.name != "start"):
            found[name] = np.full_like(getattr(others, name), np.nan)
            for k in range(len(HORIZONS_S)):
                found[name][starts, k, drivers] = getattr(self, name)[:, k]
        return FreeRuns(**found, start=others.start)


def first_known(parts: Sequence[NDArray[_Kind]]) -> NDArray[_Kind]:
    """Return arrays (...) put together: each entry from the first array that knows it."""
    known = parts[0]
    for part in parts[1:]:
        known = np.where(np.isnan(known), part, known)
    return known


def free_runs(data: Recorded, model: Model, states: Array, work: Executor, fold: int | None = None) -> FreeRuns:
    """Start a free run every 2.5 s.

    On tracks, the runs are of single cars behind their measured leaders, and end where the leader changes.

    Parameters
    ----------
    data : Recorded
        The recording.
    model : Model
        The model that drives.
    states : ndarray, shape (T, V, 4 + A)
        States filtered with this model, as ``follow`` returns them.
    work : Executor
        Carries out the runs.
    fold : int, optional
        Drivers start only in the blocks of this fold; by default everywhere.

    Returns
    -------
    FreeRuns
        Errors at the horizons. Its starts do not depend on ``fold``.
    """
    around = data.vicinity
    steps = data.every * np.array([max(1, round(h / data.apart_s)) for h in HORIZONS_S])
    apart = data.every * max(1, round(_EVERY_S / data.apart_s))
    starts = np.arange(data.every * math.ceil((SETTLING + 4) / data.every), data.samples - steps[-1], apart)
    unbroken = data.segment[:, starts - SETTLING] == data.segment[:, starts + steps[-1]]
    if not around.is_whole_road:
        unbroken &= data.scored[:, starts]
    starts, unbroken = starts[unbroken.any(axis=0)], unbroken[:, unbroken.any(axis=0)]
    who = unbroken if fold is None else unbroken & (data.fold[:, starts] == fold)
    rows, moved = at_period(model.rows, around.period_s), between_measurements(data, states)
    jobs = [_Start(data, rows, moved, int(k), steps, some) for k, some in zip(starts, who.T, strict=True)]
    errors = list(work.map(_from_start, jobs))
    empty = np.empty((0, len(steps), data.drivers))
    names = [field.name for field in fields(FreeRuns)][:-1]
    found = {name: np.array([e[j] for e in errors]) if errors else empty for j, name in enumerate(names)}
    return FreeRuns(**found, start=starts)


class _Start(NamedTuple):
    """A start of free runs: the sample k, the horizons in samples, and the drivers (N,) who start there.

    rows, states: of the model.
    """

    data: Recorded
    rows: Array
    states: Array
    k: int
    steps: Ints
    who: Mask


def _from_start(job: _Start) -> tuple[Array, ...]:
    """Fields of FreeRuns for the runs that start at one sample, (H, N) each; NaN for drivers who do not start there."""
    drivers, who = job.data.drivers, job.who
    errors = tuple(np.full((len(job.steps), drivers), np.nan) for _ in range(8))
    if who.any():
        for error, found in zip(errors, _errors(job), strict=True):
            error[:, who] = found[:, :drivers][:, who]
    return errors


def _errors(job: _Start) -> tuple[Array, ...]:
    """Fields of FreeRuns for the vehicles in all columns, (H, V) each; they hold for the drivers who start."""
    data, rows, state, k, steps, who = job
    rows, state = _rows_at(rows, state[k]), np.ascontiguousarray(state[:, :, :STATE])
    around, ring = data.vicinity, data.vicinity.road.circumference_m
    leader = np.where(np.isfinite(state[k, around.leader[k], 0]), around.leader[k], -1)
    silent, coupled, single = _drive_on(data, rows, state[k : k + steps[-1] + 1], k, leader, who)
    silent, coupled, single = silent[steps - 1], coupled[steps - 1], single[steps - 1]
    measured, speed = around.position_m[k + steps], state[k + steps, :, 1]
    everybody = np.resize(rows, (len(leader), rows.shape[1]))
    errors = around.road.difference(_as_measured(coupled[:, :, 0], everybody, ring), measured)
    led, length = leader >= 0, around.length_m[k]
    # On tracks it is known which of the drivers without a leader had a free road.
    judged = led if around.is_whole_road and led.any() else np.ones_like(led)
    half_lengths = 0.5 * (length[leader] + length)
    gap = around.road.space_headway(measured[:, leader], measured) - half_lengths
    silent_gap = silent[:, leader, 0] - silent[:, :, 0] - _order(data, state[k], k, leader).turn - half_lengths
    return (
        np.where(judged, errors, np.nan),
        np.where(judged, around.road.difference(_as_measured(single[:, :, 0], everybody, ring), measured), np.nan),
        np.where(judged, coupled[:, :, 1] - speed, np.nan),
        np.where(judged, single[:, :, 1] - speed, np.nan),
        np.where(led, errors[:, leader] - errors, np.nan),
        np.where(led, gap, np.nan),
        np.where(led, silent_gap <= _CONTACT_M, np.nan),
        speed,
    )


def _drive_on(
    data: Recorded, rows: Array, recorded: Array, k: int, leader: Ints, who: Mask
) -> tuple[Array, Array, Array]:
    """Positions [m] and speeds [m/s] from sample k on, (steps, V, 2) each: of the coupled run without noise, and means
    of the two coupled and of the two single runs with noise.

    recorded: (steps + 1, V, 4) filtered states from sample k on; leader: (V,); who: (N,). Coupled runs need a whole
    road.
    """
    around = data.vicinity
    order = _order(data, recorded[0], k, leader)
    setting = Setting(around.period_s, horizon_at(around.period_s), around.road.circumference_m)
    start_s = float(around.time_s[k, np.argmax(who)])
    everybody = np.resize(rows, (len(leader), rows.shape[1]))
    shape = (len(recorded) - 1, len(leader))
    silent, coupled, single = (np.full((*shape, 2), np.nan), *np.full((2, 2, *shape, 2), np.nan))
    shock = np.random.default_rng(k).standard_normal(shape)
    if around.is_whole_road:
        run_coupled(recorded, order, everybody, ACTIONS, start_s, setting, np.zeros(shape), silent)
    for run, sign in enumerate((1.0, -1.0)):
        if around.is_whole_road:
            run_coupled(recorded, order, everybody, ACTIONS, start_s, setting, sign * shock, coupled[run])
        run_single(
            np.flatnonzero(who), recorded, order, everybody, ACTIONS, start_s, setting, sign * shock, single[run]
        )
    return silent, coupled.mean(axis=0), single.mean(axis=0)


def drive_all(data: Recorded, model: Model, state: Array, k: int, steps: int) -> Array:
    """Let all vehicles of a road drive by a model, without noise, from the state of one sample on.

    Parameters
    ----------
    data : Recorded
        The recording.
    model : Model
        The model.
    state : ndarray, shape (T, N, 4 + A)
        Filtered states, as ``follow`` returns them.
    k : int
        Sample of the start.
    steps : int
        Number of samples to drive.

    Returns
    -------
    ndarray, shape (steps, N)
        Positions [m] as they would be measured, not wrapped.
    """
    around, ring = data.vicinity, data.vicinity.road.circumference_m
    recorded = np.ascontiguousarray(state[k : k + steps + 1, :, :STATE])
    leader = np.where(np.isfinite(recorded[0, around.leader[k], 0]), around.leader[k], -1)
    setting = Setting(around.period_s, horizon_at(around.period_s), ring)
    rows = _rows_at(at_period(model.rows, around.period_s), state[k])
    out = np.empty((steps, data.drivers, 2))
    order = _order(data, recorded[0], k, leader)
    run_coupled(recorded, order, rows, ACTIONS, float(around.time_s[k, 0]), setting, np.zeros(out.shape[:2]), out)
    return _as_measured(out[:, :, 0], rows, ring)


def _rows_at(rows: Array, state: Array) -> Array:
    """Rows (N, WIDTH) with the preferences that the filter expects halfway through the longest run; state: (V, 4 + A).

    Preferences that wander return to the driver's usual ones in their time constant.
    """
    if state.shape[1] == STATE:
        return rows
    now = rows.copy()
    for row, preferences in zip(now, state[: len(rows), STATE:], strict=True):
        wandering = adaptation_of(row)
        places, mood = [index(name) for name in wandering.names], preferences[: len(wandering.names)]
        if np.isfinite(mood).all():
            left = math.exp(-0.5 * HORIZONS_S[-1] / wandering.relaxation_s)
            row[places] *= np.exp(left * (mood - np.log(row[places])))
    return now


def _order(data: Recorded, start: Array, k: int, leader: Ints) -> Order:
    """Who follows whom from a state (V, 4) at sample k on, and how many turns of the ring the leader is ahead."""
    ring = data.vicinity.road.circumference_m
    headway = np.where(leader >= 0, start[leader, 0] - start[:, 0], 0.0)
    turn = np.nan_to_num(ring * np.floor(headway / ring)) if ring else np.zeros(len(leader))
    return Order(leader, turn, data.vicinity.length_m[k])


def _as_measured(position: Array, rows: Array, ring: float) -> Array:
    """Measured positions for true positions (H, N) [m]; effects may displace the measurement."""
    # one layout, so that one version of the function is compiled
    position = np.ascontiguousarray(position)
    return np.asarray(position + np.array([displacements(at, ring, rows) for at in position]))


def rmse(errors: Array) -> float:
    """Return the root mean square of all finite errors; NaN if there are none."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else float("nan")
