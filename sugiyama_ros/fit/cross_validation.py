"""Predictions of held-out samples, which the model was not fitted to, and the gain of one model over another."""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sugiyama_ros.arrays import Ints
from sugiyama_ros.filters.measurement import weigh_samples
from sugiyama_ros.fit.joint import JointFit, at_model, maximise, solve, start_fit
from sugiyama_ros.fit.model import Model, coordinate, moved
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import PointwiseDensity, evaluate, unknown

# Steps of the search from the fit to all folds to the fit without one fold, and the maximum number of times that a
# search from the fit itself computes the derivatives again: the fit is near.
_STEPS_WITHOUT, _RENEWALS_WITHOUT = 4, 2
# Factor of the information of drivers who are not to move.
_SURE = 1e15
# Limits of the change from fitted to held-out samples where the filter does not run again: innovations change by at
# most this many of their standard deviations, variances by at most this factor. Derivatives alone set no limit.
_MOST_OFF, _MOST_WIDER = 1.0, 2.0


def without_folds(data: Recorded, fitted: JointFit, work: Executor, *, searched: bool) -> tuple[Model, ...]:
    """Return a model for every fold, fitted to the other folds.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model fitted to all folds.
    work : Executor
        Runs the filters.
    searched : bool
        Whether to search for each model. Otherwise each model is one step away from ``fitted`` (infinitesimal
        jackknife).

    Returns
    -------
    tuple of Model
        One model for each fold.
    """
    models = []
    for f in range(FOLDS):
        model = _without(data, fitted, f)
        if searched:
            start = start_fit(data, model, work)
            model = maximise(data, start, work, folds=_others(f), iterations=_STEPS_WITHOUT).model
        models.append(model)
    return tuple(models)


def searched_without_folds(data: Recorded, fitted: JointFit, work: Executor) -> tuple[Model, ...]:
    """Return a model for every fold, fitted to the other folds by a search that starts from the fit to all folds."""
    steps, renewals = 2 * _STEPS_WITHOUT, _RENEWALS_WITHOUT
    return tuple(
        maximise(data, fitted, work, folds=_others(f), iterations=steps, renewals=renewals).model for f in range(FOLDS)
    )


def searched_by_some(
    data: Recorded, fitted: JointFit, model: Model, fold: int, who: Sequence[int], work: Executor
) -> Model:
    """Return a model without a fold, in which some drivers search for their individual parameters.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model fitted to all folds; the search starts from it.
    model : Model
        The model without the fold.
    fold : int
        Number of the fold.
    who : sequence of int
        Numbers of the drivers who search; the others stay as they are in ``model``.
    work : Executor
        Runs the filters.

    Returns
    -------
    Model
        The model without the fold.
    """
    own, searches = len(fitted.model.individual), np.isin(np.arange(data.drivers), who)[:, None]
    slopes = tuple(
        replace(s, score=s.score[:, :own], information=sure * s.information[:, :own, :own], columns=s.columns[:own])
        for s, sure in zip(fitted.slopes, np.where(searches[:, 0], 1.0, _SURE), strict=True)
    )
    rows, places = model.rows.copy(), list(fitted.model.individual)
    rows[:, places] = np.where(searches, fitted.model.rows[:, places], rows[:, places])
    alone = replace(model, rows=rows, shared=(), few=())
    start = at_model(data, JointFit(alone, fitted.samples, slopes), alone, work, searches[:, 0])
    found = maximise(data, start, work, folds=_others(fold), iterations=2 * _STEPS_WITHOUT)
    return replace(model, rows=np.where(searches, found.model.rows, model.rows))


def _others(fold: int) -> list[int]:
    """Numbers of all folds but one."""
    return [k for k in range(FOLDS) if k != fold]


def _without(data: Recorded, fitted: JointFit, fold: int) -> Model:
    """The model fitted to all folds but one, by the infinitesimal jackknife (Giordano et al. 2019).

    The step uses the information of all folds, scaled to the number of folds that remain. The remaining folds alone may
    say almost nothing about a parameter, and the step would then have no limit.
    """
    step = solve(fitted.slopes, fitted.model, _others(fold), 1e-6, curvature=range(FOLDS))
    return moved(data, fitted.model, step, FOLDS / (FOLDS - 1))


def held_out(data: Recorded, models: Sequence[Model], work: Executor) -> PointwiseDensity:
    """Predict the samples of every fold with the model that was fitted without the fold.

    Parameters
    ----------
    data : Recorded
        The recording.
    models : sequence of Model
        One model for each fold, from ``without_folds``.
    work : Executor
        Runs the filters.

    Returns
    -------
    PointwiseDensity
        Predictions of all samples.
    """
    return of_folds(data, [evaluate(data, model, work) for model in models])


def of_folds(data: Recorded, by_model: Sequence[PointwiseDensity]) -> PointwiseDensity:
    """Combine predictions: take the samples of each fold from the model with the number of the fold.

    Parameters
    ----------
    data : Recorded
        The recording.
    by_model : sequence of PointwiseDensity
        Predictions of all samples by the model of each fold.

    Returns
    -------
    PointwiseDensity
        Predictions of all samples.
    """
    known = unknown(data.drivers, data.samples)
    for f, samples in enumerate(by_model):
        mask = data.fold == f
        known.innovation_m[mask] = samples.innovation_m[mask]
        known.innovation_var[mask] = samples.innovation_var[mask]
        known.log_likelihood[mask] = samples.log_likelihood[mask]
    return known


def held_out_nearly(data: Recorded, fitted: JointFit) -> PointwiseDensity:
    """Approximate the held-out predictions from the derivatives of the samples, without running the filter.

    The result approximates ``held_out`` with the models from ``without_folds(searched=False)``.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model fitted to all folds.

    Returns
    -------
    PointwiseDensity
        Predictions of all samples.
    """
    places = [*fitted.model.individual, *fitted.model.shared]
    at = coordinate(fitted.model.rows[:, places], places)
    without = np.array([_without(data, fitted, f).rows[:, places] for f in range(FOLDS)])
    changes = coordinate(without, places) - at
    near = fitted.samples.copy()
    for i, (s, row) in enumerate(zip(fitted.slopes, fitted.model.rows, strict=True)):
        y, variance, density = near.of(i)
        off_y, off_variance, off_density = (np.einsum("tk,kt->t", changes[data.fold[i], i], d) for d in s.derivatives)
        most = _MOST_OFF * np.sqrt(variance)
        y += np.clip(off_y, -most, most)
        variance[:] = np.clip(variance + off_variance, variance / _MOST_WIDER, variance * _MOST_WIDER)
        scored = np.isfinite(density)
        weigh_samples(y, variance, row, np.empty_like(y), density)
        density += np.where(scored, off_density, np.nan)
    return near


@dataclass(frozen=True)
class Gain:
    """Held-out log-likelihood of one model minus the held-out log-likelihood of another model.

    Parameters
    ----------
    nats : float
        Sum over all samples [nats].
    se : float
        Standard error of the sum [nats].
    drivers : tuple of float
        Sum over the samples of each driver who is predicted [nats].
    blocks : tuple of float
        Sum over the samples of each block of time [nats].
    """

    nats: float
    se: float
    drivers: tuple[float, ...]
    blocks: tuple[float, ...] = ()


def gain(data: Recorded, better: PointwiseDensity, than: PointwiseDensity) -> Gain:
    """Return the gain of one model over another, paired sample by sample.

    Parameters
    ----------
    data : Recorded
        The recording.
    better, than : PointwiseDensity
        Predictions of both models. Only what both predict counts.

    Returns
    -------
    Gain
        The standard error is the larger of two: a jackknife over blocks of time, and a jackknife over drivers.
    """
    return gain_of_samples(data.block, better, than)


def gain_of_samples(block_of: Ints, better: PointwiseDensity, than: PointwiseDensity) -> Gain:
    """Return the gain of one model over another, as ``gain``; ``block_of`` (N, T): number of each sample's block."""
    difference = better.log_likelihood - than.log_likelihood
    known = np.isfinite(difference)
    # who follows nobody is not predicted, and tells nothing of how drivers differ
    by_driver = np.nansum(difference[known.any(axis=1)], axis=1)
    # nor do blocks in which nothing is predicted
    where, block = np.unique(block_of[known], return_inverse=True)
    by_block = np.bincount(block, weights=difference[known], minlength=len(where))
    se = max(sum_error(by_driver), sum_error(by_block))
    return Gain(float(by_driver.sum()), se, tuple(by_driver.tolist()), tuple(by_block.tolist()))


def sum_error(parts: ArrayLike) -> float:
    """Return the standard error of the sum of exchangeable parts (N,), by the jackknife."""
    x = np.asarray(parts)
    return math.sqrt(len(x) * float(np.var(x, ddof=1))) if len(x) > 1 else 0.0
