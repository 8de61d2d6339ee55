"""Predictions of a model for every sample: innovations, their variances, log-likelihoods and filtered states."""

import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.filters import causal
from sugiyama_ros.filters.abreast import ABREAST
from sugiyama_ros.filters.chain import Chain
from sugiyama_ros.filters.state import STATE
from sugiyama_ros.fit.model import Model, leaders
from sugiyama_ros.fit.recording import Recorded

_Any = TypeVar("_Any")


class DriverDensity(NamedTuple):
    """Innovations [m], their variances [m^2] and log-likelihoods [nats] of one driver's samples, (T,) each.

    The log-likelihood is NaN if the sample does not count.
    """

    innovation_m: Array
    innovation_var: Array
    log_likelihood: Array


@dataclass(frozen=True, eq=False)
class PointwiseDensity:
    """Predictions of all samples of all drivers, (N, T) each, as those of one driver in ``DriverDensity``."""

    innovation_m: Array
    innovation_var: Array
    log_likelihood: Array

    @property
    def total(self) -> float:
        """Log-likelihood of all samples together [nats]."""
        return float(np.nansum(self.log_likelihood))

    def copy(self) -> "PointwiseDensity":
        """Return a copy that shares no arrays."""
        return PointwiseDensity(self.innovation_m.copy(), self.innovation_var.copy(), self.log_likelihood.copy())

    def only(self, who: Sequence[int]) -> "PointwiseDensity":
        """Return the samples of some drivers, and NaN for the other drivers."""
        some = unknown(*self.log_likelihood.shape)
        for i in who:
            some.put(i, self.of(i))
        return some

    def of(self, driver: int) -> DriverDensity:
        """Return the samples of one driver."""
        return DriverDensity(self.innovation_m[driver], self.innovation_var[driver], self.log_likelihood[driver])

    def put(self, driver: int, samples: DriverDensity) -> None:
        """Replace the samples of one driver."""
        self.innovation_m[driver], self.innovation_var[driver], self.log_likelihood[driver] = samples


def unknown(drivers: int, samples: int) -> PointwiseDensity:
    """Return samples without any predictions yet: NaN everywhere."""
    return PointwiseDensity(*(np.full((drivers, samples), np.nan) for _ in range(3)))


def evaluate(data: Recorded, model: Model, work: Executor, who: Sequence[int] | None = None) -> PointwiseDensity:
    """Predict every sample."""
    return next(evaluate_each(data, [model], work, who))


def evaluate_each(
    data: Recorded, models: Sequence[Model], work: Executor, who: Sequence[int] | None = None
) -> Iterator[PointwiseDensity]:
    """Yield the predictions by each model, as of ``evaluate``; all filters may run side by side."""
    chosen = range(data.drivers) if who is None else who
    for found in predict_each(data, models, chosen, work):
        samples = unknown(data.drivers, data.samples)
        for i, at in zip(chosen, found, strict=True):
            samples.put(i, at)
        yield samples


def predict_drivers(data: Recorded, model: Model, who: Iterable[int], work: Executor) -> list[DriverDensity]:
    """Predict the samples of the drivers in ``who``; returns one result for each, in this order."""
    return predict_each(data, [model], list(who), work)[0]


def predict_each(
    data: Recorded, models: Sequence[Model], who: Sequence[int], work: Executor
) -> list[list[DriverDensity]]:
    """Predict the samples of the drivers in ``who`` by each model; all filters may run side by side."""
    parts = work.map(predict_jobs, together([job for model in models for job in jobs_of(data, model, who)]))
    found, drivers = [one for part in parts for one in part], len(who)
    for k, one in enumerate(found):
        one.log_likelihood[~data.scored[who[k % drivers]]] = np.nan
    return [found[k * drivers : (k + 1) * drivers] for k in range(len(models))]


def together(drivers: Sequence[_Any]) -> list[Sequence[_Any]]:
    """Divide drivers into parts, whose filters run side by side: full ones, or two equal ones if there are few."""
    size = min(ABREAST, -(-len(drivers) // 2))
    return [drivers[first : first + size] for first in range(0, len(drivers), size)] if drivers else []


def predict_jobs(jobs: Sequence[causal.ChainJob]) -> list[DriverDensity]:
    """Predict the samples of some drivers; returns one result for each job."""
    return [DriverDensity(*predicted) for predicted in causal.predict_samples(jobs)]


def jobs_of(data: Recorded, model: Model, who: Sequence[int]) -> list[causal.ChainJob]:
    """Return the jobs of filtering the drivers in ``who`` at a model."""
    return [
        causal.ChainJob(data.chains[i], model.rows[i], ahead, data.is_rough)
        for i, ahead in zip(who, leaders(data, model, who), strict=True)
    ]


def filtered_states(data: Recorded, model: Model, work: Executor) -> Array:
    """Return position [m], speed [m/s], noise and held acceleration [m/s^2] of all vehicles, (T, V, 4)."""
    return np.ascontiguousarray(follow(data, model, work)[1][:, :, :STATE])


def follow(data: Recorded, model: Model, work: Executor) -> tuple[PointwiseDensity, Array]:
    """Predict every sample, and filter the states (T, V, 4 + A).

    The states are those of ``filtered_states``, then the logarithms of A preferences that wander in the model, in the
    order of their ``Adaptation``; NaN for vehicles that are no drivers.
    """
    jobs = jobs_of(data, model, range(data.drivers))
    outputs = [one for part in work.map(causal.predict_states, together(jobs)) for one in part]
    y, variance, density = (np.array([o[k] for o in outputs]) for k in range(3))
    tracks = [o[3] for o in outputs]
    preferences = [track[:, STATE * c.position_m.shape[1] :] for c, track in zip(data.chains, tracks, strict=True)]
    wandering = max(one.shape[1] for one in preferences)
    states = np.full((*data.vicinity.leader.shape, STATE + wandering), np.nan)
    for i, (chain, track) in enumerate(zip(data.chains, tracks, strict=True)):
        states[:, i, STATE : STATE + preferences[i].shape[1]] = preferences[i]
        for m, column in enumerate(data.vicinity.columns(i, chain.position_m.shape[1])):
            known = np.isfinite(variance[i]) & _moves(chain, m)
            states[known, column, :STATE] = track[known, STATE * m : STATE * (m + 1)]
    if data.vicinity.is_whole_road:
        _see_first(data, tracks, states)
    density[~data.scored] = np.nan
    return PointwiseDensity(y, variance, density), states


def between_measurements(data: Recorded, states: Array) -> Array:
    """Return how vehicles have moved, from filtered states (T, V, 4), also between two measurements.

    What a filter expects between measurements that are far apart jumps at the next measurement. A vehicle that is to
    drive as it was recorded must not.
    """
    if data.every == 1:
        return states
    moved, ends = states.copy(), np.arange(0, len(states), data.every)
    for i, chain in enumerate(data.chains):
        for m, column in enumerate(data.vicinity.columns(i, chain.position_m.shape[1])):
            identity = chain.identity[ends, m]
            same = np.flatnonzero((identity[1:] == identity[:-1]) & (identity[1:] >= 0))
            start, end = states[ends[same], column], states[ends[same + 1], column]
            way = (end[:, 0] - start[:, 0]) / data.apart_s
            for j in range(1, data.every):
                w = j / data.every
                between = (1.0 - w) * start + w * end
                bend = (1.0 - w) * (start[:, 1] - way) - w * (end[:, 1] - way)
                between[:, 0] += w * (1.0 - w) * data.apart_s * bend
                moved[ends[same] + j, column] = between
    return moved


def _see_first(data: Recorded, tracks: Sequence[Array], states: Array) -> None:
    """Fill in the states of vehicles without a leader as those behind them see them.

    Such a vehicle does what nobody knows: as a driver on a free road it would be seen too fast or too slow.
    """
    leader, samples = data.vicinity.leader, np.arange(data.samples)
    for i, track in enumerate(tracks):
        ahead = leader[:, i]
        seen = (ahead >= 0) & (leader[samples, ahead] < 0) & np.isfinite(track[:, STATE]) & _moves(data.chains[i], 1)
        states[seen, ahead[seen], :STATE] = track[seen, STATE : 2 * STATE]


def _moves(chain: Chain, m: int) -> Mask:
    """Whether the speed of vehicle m of a chain is known at each sample: there are two positions of this vehicle."""
    identity, seen = chain.identity[:, m], np.cumsum(np.isfinite(chain.position_m[:, m]))
    is_new = np.diff(identity, prepend=-2) != 0
    before = np.maximum.accumulate(np.where(is_new, np.concatenate(([0], seen[:-1])), 0))
    return np.asarray((identity >= 0) & (seen - before >= 2))


@dataclass(frozen=True)
class Gain:
    """Log-likelihood of one model minus the log-likelihood of another, over all samples, and its standard error."""

    nats: float
    se: float


def gain(data: Recorded, better: PointwiseDensity, than: PointwiseDensity) -> Gain:
    """Return the gain of one model over another, paired sample by sample."""
    difference = better.log_likelihood - than.log_likelihood
    known = np.isfinite(difference)
    # who follows nobody is not predicted, and tells nothing of how drivers differ
    by_driver = np.nansum(difference[known.any(axis=1)], axis=1)
    # nor do blocks in which nothing is predicted
    where, block = np.unique(data.block[known], return_inverse=True)
    by_block = np.bincount(block, weights=difference[known], minlength=len(where))
    se = max(sum_error(by_driver), sum_error(by_block))
    return Gain(float(by_driver.sum()), se)


def sum_error(parts: ArrayLike) -> float:
    """Return the standard error of the sum of exchangeable parts (N,), by the jackknife."""
    x = np.asarray(parts)
    return math.sqrt(len(x) * float(np.var(x, ddof=1))) if len(x) > 1 else 0.0
