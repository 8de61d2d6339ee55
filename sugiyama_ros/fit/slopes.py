"""Derivatives of the likelihood: score and expected information of every driver, from difference quotients of the
filter.

The causal log-likelihood is a sum over samples of log-densities of innovations y with variance S. Its expected
information is therefore sum(dy dy' / S + dS dS' / 2 S^2).
"""

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.effects.control import is_contaminated
from sugiyama_ros.filters.causal import ChainJob, Predicted, predict_samples
from sugiyama_ros.filters.update import weigh_samples
from sugiyama_ros.fit.coordinates import LONGEST_STEP, PART_OF_STD, coordinate, is_linear, value
from sugiyama_ros.fit.model import Model, PointwiseDensity, evaluate, jobs_of, reach, together
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.jit import kernel

# First step of the difference quotients in a logarithm, or as part of the longest search step in a linear coordinate.
_STEP = 0.01


class Derivatives(NamedTuple):
    """Derivatives (K, T) of the samples of one driver: innovation [m], its variance [m^2], and log-likelihood [nats].

    The last one is at fixed innovation and variance; it is zero without outliers.
    """

    innovation: Array
    variance: Array
    density: Array


#: Derivatives of the samples of one driver by one parameter: innovation, variance, density, (T,) each. A search keeps
#: very many of them, so difference quotients, which are not exact to seven digits, have single precision.
Column: TypeAlias = tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]], NDArray[np.floating[Any]]]


@cache
def no_density(samples: int) -> Array:
    """Return the derivative (T,) of the density without outliers: zeros, which all share and nobody changes."""
    return np.zeros(samples)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Score and information of one driver in each of F folds, by K parameters: individual ones first, then shared ones.

    columns: derivatives of the samples by each parameter; models that share parameters share their columns.
    """

    score: Array
    information: Array
    log_likelihood: Array
    columns: tuple[Column, ...]

    @property
    def derivatives(self) -> Derivatives:
        """Derivatives of the samples by all parameters, as new arrays."""
        return _stacked(self.columns)


def _stacked(columns: Sequence[Column]) -> Derivatives:
    return Derivatives(*(np.array([column[j] for column in columns], dtype=np.float64) for j in range(3)))


def sums(samples: Predicted, columns: Sequence[Column], row: Array, fold: Ints) -> Slopes:
    """Sum the score and the information of one driver over the samples of each fold (T,).

    With outliers, the slope of its density weights each innovation, and the information is the sum of products of
    slopes.
    """
    count = len(columns)
    score, information, total = np.zeros((FOLDS, count)), np.zeros((FOLDS, count, count)), np.zeros(FOLDS)
    _add_up(samples, _stacked(columns), row, fold, score, information, total)
    return Slopes(score, information, total, tuple(columns))


@kernel
def _add_up(
    samples: Predicted,
    derivatives: Derivatives,
    row: Array,
    fold: Ints,
    score: Array,
    information: Array,
    total: Array,
) -> None:
    """Add up score (F, K), information (F, K, K) and log-likelihood (F,) of every fold, over the samples that count."""
    y, variance, density = samples
    dy, dvar, direct = derivatives
    robust, places = is_contaminated(row), len(dy)
    slope = density_slope(y, variance, dy, dvar, row) + direct
    for t in range(len(fold)):
        if math.isnan(density[t]):
            continue
        f, s = fold[t], variance[t]
        total[f] += density[t]
        for i in range(places):
            score[f, i] += slope[i, t]
            for j in range(i + 1):
                if robust:
                    h = slope[i, t] * slope[j, t]
                else:
                    h = (dy[i, t] * dy[j, t] + 0.5 * dvar[i, t] * dvar[j, t] / s) / s
                information[f, i, j] += h
                if j < i:
                    information[f, j, i] += h


@kernel
def density_slope(y: Array, variance: Array, dy: Array, dvar: Array, row: Array) -> Array:
    """Return the derivatives (K, T) of the samples' log-likelihoods through the innovations and the variances."""
    slope = np.empty_like(dy)
    weight, density = np.ones_like(y), np.empty_like(y)
    if is_contaminated(row):
        weigh_samples(y, variance, row, weight, density)
    for t in range(len(y)):
        by_y = weight[t] * y[t] / variance[t]
        by_variance = 0.5 * weight[t] * (1.0 - by_y * y[t]) / variance[t]
        for k in range(len(dy)):
            slope[k, t] = -(dy[k, t] * by_y + dvar[k, t] * by_variance)
    return slope


class _Asked(NamedTuple):
    """A driver whose slopes are asked for: the driver at a model, predictions there, steps (K,), and folds (T,)."""

    job: ChainJob
    at: Predicted
    steps: Array
    fold: Ints


def _slopes_of(individual: Sequence[int], shared: Sequence[int], drivers: Sequence[_Asked]) -> list[Slopes]:
    """Score and information of some drivers by difference quotients; all their filters run side by side."""
    moved = iter(predict_samples([job for asked in drivers for job in _moved(asked, individual, shared)]))
    found = []
    for job, at, steps, fold in drivers:
        columns = [column(at, next(moved), step, job.parameters) for step in steps]
        found.append(sums(at, columns, job.parameters, fold))
    return found


def column(at: Predicted, there: Predicted, step: float, row: Array) -> Column:
    """Return the difference quotients of a driver's samples; ``row``: the driver before the step."""
    dy, dvar = (there[0] - at[0]) / step, (there[1] - at[1]) / step
    if not is_contaminated(row):
        return _single(dy), _single(dvar), no_density(len(dy))
    direct = (there[2] - at[2]) / step - density_slope(at[0], at[1], dy[None], dvar[None], row)[0]
    return _single(dy), _single(dvar), _single(direct)


def _single(derivative: Array) -> NDArray[np.float32]:
    """Return a derivative in single precision; beyond its range the largest number."""
    largest = float(np.finfo(np.float32).max)
    return np.clip(derivative, -largest, largest).astype(np.float32)


def _moved(asked: _Asked, individual: Sequence[int], shared: Sequence[int]) -> list[ChainJob]:
    """Return the driver with each parameter moved by its step; shared parameters move for the drivers ahead, too."""
    (chain, row, ahead, is_rough), places, jobs = asked.job, [*individual, *shared], []
    assert ahead is not None
    coordinates, linear = coordinate(row[places], places), is_linear(places)
    for k, step in enumerate(asked.steps):
        changed, changed_ahead = row.copy(), ahead
        # a driver who does not have an effect stays without it: its logarithm has no step
        if linear[k] or row[places[k]] != 0.0:
            changed[places[k]] = value(coordinates[[k]] + step, [places[k]])[0]
        if k >= len(individual):
            changed_ahead = ahead.copy()
            # not for drivers ahead who do not have what only some drivers have
            has = ahead[:, places[k]] == row[places[k]]
            changed_ahead[has, places[k]] = changed[places[k]]
        jobs.append(ChainJob(chain, changed, changed_ahead, is_rough))
    return jobs


def slopes(
    data: Recorded, model: Model, work: Executor, known: Sequence[Slopes] | None = None
) -> tuple[list[Slopes], PointwiseDensity]:
    """Return the slopes of all drivers at a model, and the predictions of the samples."""
    if known is None:
        steps = np.tile(difference_steps(data, [*model.individual, *model.shared]), (data.drivers, 1))
    else:
        steps = informed_steps(data, model, known)
    samples = evaluate(data, model, work)
    return slopes_of(data, model, samples, steps, work), samples


def slopes_of(
    data: Recorded,
    model: Model,
    samples: PointwiseDensity,
    steps: Array,
    work: Executor,
    who: Iterable[int] | None = None,
) -> list[Slopes]:
    """Return the slopes of drivers whose predictions are known, from steps (N, K) in coordinates."""
    chosen = list(range(data.drivers) if who is None else who)
    jobs = jobs_of(data, model, chosen)
    asked = [_Asked(job, samples.of(i), steps[i], data.fold[i]) for i, job in zip(chosen, jobs, strict=True)]
    parts = work.map(partial(_slopes_of, model.individual, model.shared), together(asked))
    return [one for part in parts for one in part]


def informed_steps(data: Recorded, model: Model, all_slopes: Sequence[Slopes]) -> Array:
    """Return the steps (N, K) that the information suggests, of shared parameters the one of all drivers together."""
    places, own = [*model.individual, *model.shared], len(model.individual)
    information = np.array([np.diag(s.information.sum(axis=0)) for s in all_slopes])
    information[:, :own] += 1.0 / np.square(np.array(model.prior_std))
    information[:, own:] = information[:, own:].sum(axis=0)
    longest = difference_steps(data, places) * (LONGEST_STEP / _STEP)
    steps = PART_OF_STD / np.sqrt(np.maximum(information, 1e-12))
    return np.asarray(np.clip(steps, 0.02 * longest, longest))


def difference_steps(data: Recorded, places: Sequence[int]) -> Array:
    """Return the steps (K,) of difference quotients at ``places``, for use before the information is known."""
    return np.where(is_linear(places), _STEP * reach(data, places), _STEP)
