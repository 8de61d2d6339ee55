"""What a model predicts of samples that it was not fitted to, and the gain of one model over another."""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sugiyama_ros.filters.measurement import weigh_samples
from sugiyama_ros.fit.joint import JointFit, maximise, solve, start_fit
from sugiyama_ros.fit.model import Model, coordinate, moved
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import PointwiseDensity, evaluate, unknown

# Steps from the fit to all folds to that without one.
_STEPS_WITHOUT = 4
# What held-out samples may differ from fitted ones where the filter is not run anew: innovations by this many of their
# standard deviations, variances by this factor. Derivatives do not know where a change ends.
_MOST_OFF, _MOST_WIDER = 1.0, 2.0


def without_folds(data: Recorded, fitted: JointFit, work: Executor, *, searched: bool) -> tuple[Model, ...]:
    """For every fold, the model fitted to the other folds.

    Parameters
    ----------
    data, fitted
        The recording and the model fitted to all folds.
    work
        Executor that runs the filters.
    searched
        Whether each model is searched for; else it is one step away from ``fitted`` (infinitesimal jackknife).
    """
    models = []
    for f in range(FOLDS):
        model = _without(data, fitted, f)
        if searched:
            others = [k for k in range(FOLDS) if k != f]
            model = maximise(data, start_fit(data, model, work), work, folds=others, iterations=_STEPS_WITHOUT).model
        models.append(model)
    return tuple(models)


def _without(data: Recorded, fitted: JointFit, fold: int) -> Model:
    """The model fitted to all folds but one, by the infinitesimal jackknife (Giordano et al. 2019).

    It is one step with the information of all folds in proportion: the other folds alone may say next to nothing about
    a parameter, and the step would have no end.
    """
    others = [k for k in range(FOLDS) if k != fold]
    step = solve(fitted.slopes, fitted.model, others, 1e-6, curvature=range(FOLDS))
    return moved(data, fitted.model, step, FOLDS / (FOLDS - 1))


def held_out(data: Recorded, models: Sequence[Model], work: Executor) -> PointwiseDensity:
    """Samples of every fold as predicted by the model fitted without the fold (see ``without_folds``)."""
    return of_folds(data, [evaluate(data, model, work) for model in models])


def of_folds(data: Recorded, by_model: Sequence[PointwiseDensity]) -> PointwiseDensity:
    """Samples put together: for every fold those of the model with the fold's number."""
    known = unknown(data.drivers, len(data.fold))
    for f, samples in enumerate(by_model):
        mask = data.fold == f
        known.innovation_m[:, mask] = samples.innovation_m[:, mask]
        known.innovation_var[:, mask] = samples.innovation_var[:, mask]
        known.log_likelihood[:, mask] = samples.log_likelihood[:, mask]
    return known


def held_out_nearly(data: Recorded, fitted: JointFit) -> PointwiseDensity:
    """Held-out samples from the samples' derivatives, without running the filter.

    Approximates ``held_out`` of the models of ``without_folds(searched=False)``.
    """
    places = [*fitted.model.individual, *fitted.model.shared]
    at = coordinate(fitted.model.rows[:, places], places)
    without = np.array([_without(data, fitted, f).rows[:, places] for f in range(FOLDS)])
    changes = (coordinate(without, places) - at)[data.fold]
    near = fitted.samples.copy()
    for i, (s, row) in enumerate(zip(fitted.slopes, fitted.model.rows, strict=True)):
        y, variance, density = near.of(i)
        off_y, off_variance, off_density = (np.einsum("tk,kt->t", changes[:, i], d) for d in s.derivatives)
        most = _MOST_OFF * np.sqrt(variance)
        y += np.clip(off_y, -most, most)
        variance[:] = np.clip(variance + off_variance, variance / _MOST_WIDER, variance * _MOST_WIDER)
        scored = np.isfinite(density)
        weigh_samples(y, variance, row, np.empty_like(y), density)
        density += np.where(scored, off_density, np.nan)
    return near


@dataclass(frozen=True)
class Gain:
    """Held-out log-likelihood of one model minus another's [nats].

    nats: sum over all samples; se: its standard error; drivers: sums over each driver's samples, N.
    """

    nats: float
    se: float
    drivers: tuple[float, ...]


def gain(data: Recorded, better: PointwiseDensity, than: PointwiseDensity) -> Gain:
    """Gain over the samples of another model, paired.

    Its standard error is the larger of two, by the jackknife over blocks of time and over drivers.
    """
    difference = better.log_likelihood - than.log_likelihood
    by_driver = np.nansum(difference, axis=1)
    blocks = np.array([np.nansum(difference[:, data.block == b]) for b in np.unique(data.block)])
    return Gain(float(by_driver.sum()), max(sum_error(by_driver), sum_error(blocks)), tuple(by_driver.tolist()))


def sum_error(parts: ArrayLike) -> float:
    """Standard error of the sum of exchangeable parts (N,), by the jackknife."""
    x = np.asarray(parts)
    return math.sqrt(len(x) * float(np.var(x, ddof=1))) if len(x) > 1 else 0.0
