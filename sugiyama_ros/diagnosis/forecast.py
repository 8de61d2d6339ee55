"""Forecasts: one step ahead by the filter, and up to ten seconds ahead by driving on from the filtered state.

A forecast is a distribution. It is judged by proper scores: the logarithm of its density at what was measured [nats],
and the continuous ranked probability score (CRPS) [m], which is in metres and does not punish a single surprise as
much. A driver drives on behind the recorded leader (``single``); on a whole road, all drivers also drive on together
(``road``). Each drives from states drawn from the filter's posterior, with noise, in pairs of opposite draws. All
models get the same draws.

References
----------
T. Gneiting and A. E. Raftery, J. Am. Stat. Assoc. 102 (2007) 359. T. Gneiting et al., Mon. Weather Rev. 133 (2005)
1098. J. M. Hammersley and K. W. Morton, Math. Proc. Camb. Philos. Soc. 52 (1956) 449.
"""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import SIGMA_NU, at_period, horizon_at, index
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.control import displacements, is_contaminated, noise_std_factors, weigh
from sugiyama_ros.filters.causal import ChainJob, filter_each
from sugiyama_ros.filters.chain import NO_LINE, adaptation_of
from sugiyama_ros.filters.state import STATE
from sugiyama_ros.filters.update import SETTLING
from sugiyama_ros.fit.model import (
    Model,
    PointwiseDensity,
    between_measurements,
    filtered_states,
    followed,
    jobs_of,
    states_of,
    together,
)
from sugiyama_ros.fit.recording import FOLDS, Recorded, Vicinity
from sugiyama_ros.simulation.drive import Order, Setting
from sugiyama_ros.simulation.free_run import run_coupled, run_single
from sugiyama_ros.statistics import student_log_density

#: Times [s] after the start at which forecasts are judged.
HORIZONS_S = (1.0, 2.0, 5.0, 10.0)
# Number of pairs of opposite draws; by so few members, the variance of a forecast has so many degrees of freedom.
_PAIRS = 4
_FREE = 2.0 * _PAIRS - 1.0


@dataclass(frozen=True, eq=False)
class Runs:
    """Forecasts by driving on, from S starts, at H horizons, of N drivers; NaN where nobody can be judged.

    log_score: Logarithm of the forecast's density at the measured position [nats], without the term of 2 pi, (S, H,
    N); crps: Continuous ranked probability score [m], (S, H, N); error: Mean of the forecast minus the measured
    position [m], (S, H, N); normal: The error over the standard deviation of the forecast, (S, H, N).
    """

    log_score: Array
    crps: Array
    error: Array
    normal: Array


@dataclass(frozen=True, eq=False)
class Forecasts:
    """Held-out forecasts of a model.

    one_step: Log-likelihood of each sample, given those before [nats], (N, T); innovation_m, innovation_var:
    Innovation [m] and its variance [m^2], (N, T); single: Drivers behind their recorded leaders; road: All drivers
    of a whole road together; start: Samples at which the runs start, (S,).
    """

    one_step: Array
    innovation_m: Array
    innovation_var: Array
    single: Runs
    road: Runs | None
    start: Ints

    @property
    def samples(self) -> PointwiseDensity:
        """Predictions one step ahead."""
        return PointwiseDensity(self.innovation_m, self.innovation_var, self.one_step)


class Starts(NamedTuple):
    """Where forecasts start, the same for all models.

    sample: samples (S,); who: drivers who start there, (S, N); steps: samples to each horizon.
    """

    sample: Ints
    who: Mask
    steps: Ints


def starts_of(data: Recorded) -> Starts:
    """Return where forecasts start: each half of the longest horizon."""
    around = data.vicinity
    steps = data.every * np.array([max(1, round(h / data.apart_s)) for h in HORIZONS_S])
    apart = data.every * max(1, round(0.5 * HORIZONS_S[-1] / data.apart_s))
    starts = np.arange(data.every * math.ceil((SETTLING + 4) / data.every), data.samples - steps[-1], apart)
    unbroken = data.segment[:, starts - SETTLING] == data.segment[:, starts + steps[-1]]
    unbroken &= data.scored[:, starts]
    lines = data.lines[:, :, 0]
    led = np.array([(around.leader[starts, i] >= 0) | np.isfinite(lines[starts, i]) for i in range(data.drivers)])
    if led.any():
        unbroken &= led
    some = unbroken.any(axis=0)
    return Starts(starts[some], unbroken[:, some].T, steps)


def forecasts(data: Recorded, models: Sequence[Model], work: Executor) -> Forecasts:
    """Forecast every sample, each with the model that was fitted without the sample's fold; or all with one model.

    The traffic ahead is as the model's own filter sees it: a model that corrects the measured places corrects those of
    the driver and of the leader.
    """
    starts = starts_of(data)
    parts = [_Fold(data, starts, model, fold) for fold, model in enumerate(models)]
    left_out = data.fold if len(models) > 1 else np.zeros_like(data.fold)
    known = np.full((3, data.drivers, data.samples), np.nan)
    ends = np.full((2, 4, len(starts.sample), len(HORIZONS_S), data.drivers), np.nan)
    for part in parts:
        mask = left_out == part.fold
        who = starts.who & mask.T[starts.sample]
        chosen = np.flatnonzero(who.any(axis=1))
        predicted, states, traffic = part.filtered(starts.sample[chosen], work)
        known[:, mask] = predicted[:, mask]
        jobs = [(int(s), who[s], one) for s, one in zip(chosen, states, strict=True)]
        for s, found in zip(chosen, work.map(partial(part.driven_on, traffic), jobs), strict=True):
            ends[: len(found), :, s, :, who[s]] = np.moveaxis(found[..., who[s]], -1, 0)
    known[0][~data.scored] = np.nan
    one_step, innovation_m, innovation_var = known
    fold = data.fold.T[starts.sample]
    road = judged_runs(ends[1], fold) if data.vicinity.is_whole_road else None
    return Forecasts(one_step, innovation_m, innovation_var, judged_runs(ends[0], fold), road, starts.sample)


def judged_runs(ends: Array, fold: Ints) -> Runs:
    """Judge forecasts of S starts, H horizons and N drivers.

    Their spread is recalibrated before (ensemble model output statistics): it counts times a factor for each horizon
    that is fitted to the other folds. So a forecast is judged by its mean and by when it is uncertain, not by noises
    that are too large or too small on the whole; a check looks at those.
    """
    error, var, share, wide = ends
    normal = error / np.sqrt((1.0 - share) * var + share * wide)
    factor = np.ones_like(error)
    for f in range(FOLDS):
        mine = np.broadcast_to((fold == f)[:, None], error.shape)
        for h in range(error.shape[1]):
            others = np.square(error[:, h][~mine[:, h]]) / var[:, h][~mine[:, h]]
            factor[:, h][mine[:, h]] = _scale(others[np.isfinite(others)])
    good, bad = (factor * one for one in (var, wide))
    with np.errstate(invalid="ignore"):
        log_score = np.logaddexp(
            np.log1p(-share) + student_log_density(error, good, _FREE),
            np.log(share + 1e-300) + student_log_density(error, bad, _FREE),
        )
    z = error / np.sqrt(good)
    density = np.exp(-0.5 * np.square(z)) / math.sqrt(2.0 * math.pi)
    crps = np.sqrt(good) * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / math.sqrt(math.pi))
    return Runs(log_score, crps, error, normal)


def _scale(squares: Array) -> float:
    """The factor of the variance that makes squared errors (n,) most probable, by Student's t distribution; 1 of none.

    The fixed point is the EM algorithm's. Drivers of whom nothing is known do not count as much as a mean lets them.
    """
    factor = float(np.median(squares)) if len(squares) else 0.0
    # each turn halves the distance to the fixed point
    for _ in range(20 if factor > 0.0 else 0):
        factor = float(np.mean((_FREE + 1.0) * squares / (_FREE - 2.0 + squares / factor)))
    return factor or 1.0


def driven(data: Recorded, models: Sequence[Model], work: Executor) -> Array:
    """Let all vehicles of a road drive through each block of time, without noise, by the model that has not seen it."""
    around = data.vicinity
    position = np.full((data.samples, data.drivers), np.nan)
    if data.trajectories is None:
        return position
    ring = around.road.circumference_m
    setting = Setting(around.period_s, horizon_at(around.period_s), ring)
    # on one road, all drivers have the same blocks, folds and segments
    block, fold_at, segment = data.block[0], data.fold[0], data.segment[0]
    parts = np.flatnonzero(np.diff(block) | np.diff(segment)) + 1
    for fold, model in enumerate(models):
        states = filtered_states(data, model, work)
        rows = at_period(model.rows, around.period_s)
        for first, end in zip((0, *parts.tolist()), (*parts.tolist(), len(position)), strict=True):
            k = max(first, SETTLING + 4) if first == 0 else first
            if k + 1 >= end or fold_at[first] != fold:
                continue
            recorded = np.ascontiguousarray(states[k:end])
            order = _order(around, k, recorded[0])
            out = np.empty((end - k - 1, data.drivers, 2))
            start_s = float(around.time_s[k, 0])
            run_coupled(recorded, order, rows, ACTIONS, start_s, setting, np.zeros(out.shape[:2]), out)
            position[k] = recorded[0, :, 0]
            places = np.ascontiguousarray(out[:, :, 0])
            position[k + 1 : end] = places + [displacements(x, ring, rows) for x in places]
    return np.where(data.trajectories.present, around.road.wrap(position), np.nan)


class _States(NamedTuple):
    """States of all drivers at one sample: mean (4,) and covariance (4, 4) of each, and the preferences that wander."""

    mean: list[Any]
    covariance: list[Any]
    mood: list[Any]


class _Fold(NamedTuple):
    """The model that was fitted without a fold."""

    data: Recorded
    starts: Starts
    model: Model
    fold: int

    def filtered(self, at: Ints, work: Executor) -> tuple[Array, list[_States], Array]:
        """Predictions (3, N, T) of all samples, states of all drivers at some samples, and the traffic (T, V, 4)."""
        data = self.data
        predicted = np.full((3, data.drivers, data.samples), np.nan)
        states = [_States(*([None] * data.drivers for _ in range(3))) for _ in at]
        jobs = list(enumerate(jobs_of(data, self.model, range(data.drivers))))
        tracks: list[Array] = [np.empty(0)] * data.drivers
        for part in work.map(partial(_filtered, at), together(jobs)):
            for i, known, track, covariance in part:
                predicted[:, i], tracks[i] = known, track
                own, mood = track[at, :STATE], track[at, STATE * data.chains[i].position_m.shape[1] :]
                for k, one in enumerate(states):
                    one.mean[i], one.covariance[i], one.mood[i] = own[k], covariance[k], mood[k]
        traffic = states_of(data, predicted[2], tracks)[:, :, :STATE]
        return predicted, states, np.ascontiguousarray(between_measurements(data, traffic))

    def driven_on(self, traffic: Array, job: tuple[int, Mask, _States]) -> Array:
        """Ends (1 or 2, 4, H, N) of the runs of a start, as of ``judged_runs``: of single drivers, and of a road."""
        data, (number, who, states) = self.data, job
        k, steps, around = int(self.starts.sample[number]), self.starts.steps, data.vicinity
        recorded = traffic[k : k + steps[-1] + 1]
        order = _order(around, k, recorded[0])
        rows = _rows_at(at_period(self.model.rows, around.period_s), states.mood)
        vehicles = len(order.leader)
        everybody = np.resize(rows, (vehicles, rows.shape[1]))
        ring = around.road.circumference_m
        setting = Setting(around.period_s, horizon_at(around.period_s), ring)
        lines = data.lines[k : k + steps[-1] + 1]
        rng, start_s = np.random.default_rng(k), float(around.time_s[k, np.argmax(who)])
        mean, root = _posterior(states, recorded[0])
        shape = (int(steps[-1]), vehicles)
        both = (False, True) if around.is_whole_road else (False,)
        ends = np.full((len(both), 2 * _PAIRS, len(steps), vehicles), np.nan)
        out, begun = np.full((*shape, 2), np.nan), recorded.copy()
        for pair in range(_PAIRS):
            shock, off = rng.standard_normal(shape), rng.standard_normal((vehicles, STATE))
            for half, sign in enumerate((1.0, -1.0)):
                begun[0] = mean + sign * np.einsum("nij,nj->ni", root, off)
                begun[0, :, 1] = np.maximum(begun[0, :, 1], 0.0)
                for j, is_road in enumerate(both):
                    if is_road:
                        run_coupled(begun, order, everybody, ACTIONS, start_s, setting, sign * shock, out)
                    else:
                        told = everybody, ACTIONS, start_s, setting, lines, sign * shock
                        run_single(np.flatnonzero(who), begun, order, *told, out)
                    at = np.ascontiguousarray(out[steps - 1, :, 0])
                    ends[j, 2 * pair + half] = at + np.array([displacements(x, ring, everybody) for x in at])
        measured = around.position_m[k + steps]
        noise_var = np.square([everybody[:, SIGMA_NU] * noise_std_factors(x, ring, everybody) for x in measured])
        off = around.road.difference(ends, measured)
        var = off.var(axis=1, ddof=1) * (1.0 + 0.5 / _PAIRS) + noise_var
        share, wide = _bad(var, noise_var, everybody)
        return np.stack([off.mean(axis=1), var, share, wide], axis=1)[..., : data.drivers]


def _bad(var: Array, noise_var: Array, rows: Array) -> tuple[Array, Array]:
    """Share of bad measurements, and the variance [m^2] of a forecast of a bad one, of variances (K, H, N)."""
    share, wide = np.zeros_like(var), var.copy()
    for i in np.flatnonzero([is_contaminated(row) for row in rows]):
        for k, h in zip(*np.nonzero(np.isfinite(var[:, :, i])), strict=True):
            bad, wide[k, h, i], density = weigh(0.0, var[k, h, i], noise_var[h, i], rows[i])
            share[k, h, i] = bad * math.exp(density) * math.sqrt(wide[k, h, i])
    return share, wide


def _filtered(at: Ints, jobs: Sequence[tuple[int, ChainJob]]) -> list[tuple[int, Array, Array, Array]]:
    """Of some drivers: number, predictions (3, T), means of the state (T, ...), own covariance at some samples."""
    found = []
    for k, one in filter_each([job for _, job in jobs]):
        known = np.array([one.sample_log_likelihood, one.innovation_m, one.innovation_var])
        found.append((jobs[k][0], known, one.mean.copy(), one.covariance[at, :STATE, :STATE].copy()))
    return found


def _posterior(states: _States, recorded: Array) -> tuple[Array, Array]:
    """Mean (V, 4) and a root of the covariance (V, 4, 4) of all vehicles; others than drivers are as recorded."""
    mean, root = recorded.copy(), np.zeros((len(recorded), STATE, STATE))
    for i, (own, covariance) in enumerate(zip(states.mean, states.covariance, strict=True)):
        if np.isfinite(own).all() and np.isfinite(mean[i]).all():
            values, vectors = np.linalg.eigh(covariance)
            mean[i], root[i] = own, vectors * np.sqrt(np.maximum(values, 0.0))
    return mean, root


def _rows_at(rows: Array, moods: Sequence[Array]) -> Array:
    """Rows (N, WIDTH) with the preferences that the filter expects halfway through the longest run.

    Preferences that wander return to the driver's usual ones in their time constant.
    """
    now = rows.copy()
    for row, mood in zip(now, moods, strict=True):
        if len(mood) and np.isfinite(mood).all():
            wandering = adaptation_of(row)
            places = [index(name) for name in wandering.names]
            left = math.exp(-0.5 * HORIZONS_S[-1] / wandering.relaxation_s)
            row[places] *= np.exp(left * (mood - np.log(row[places])))
    return now


def _order(around: Vicinity, k: int, start: Array) -> Order:
    """Who follows whom from sample k on, from a state (V, 4)."""
    leader, turn = followed(around, slice(k, k + 1), start[None])
    return Order(leader[0], turn[0], around.length_m[k], np.full((len(start), len(NO_LINE)), np.nan))
