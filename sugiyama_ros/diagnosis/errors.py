"""Errors of a model on held-out samples."""

import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.block_runs import run_blocks
from sugiyama_ros.diagnosis.free_runs import HORIZONS_S, FreeRuns, first_known, free_runs, rmse
from sugiyama_ros.fit.cross_validation import of_folds, searched_by_some, searched_without_folds, without_folds
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import PointwiseDensity, follow, unknown

# The error of a free run may grow by this share without counting as worse: two starts differ by more.
_TOLERANCE = 0.05
# A fitted parameter costs about one held-out nat (Akaike); a loss of more than this [nats] is a failure of the fits.
_PER_PARAMETER = 4.0
# The same for one driver and one fold.
_PER_FOLD = 2.0
# A model, its predictions, and the filtered states (T, V, 4 + A), as of ``follow``.
_Followed = tuple[Model, PointwiseDensity, Array]
#: From this number of drivers on tracks, errors are paired over drivers alone.
MANY_DRIVERS = 5
# Smallest speed [m/s] at which a time gap is meaningful.
_MOVING = 1.0


@dataclass(frozen=True, eq=False)
class HeldOutErrors:
    """Held-out predictions of a model; the model for each sample was fitted without the fold of the sample.

    Parameters
    ----------
    samples : PointwiseDensity
        One-step predictions.
    runs : FreeRuns
        Free runs.
    block_position_m : ndarray, shape (T, N)
        Positions [m] in free runs through each block of time, as ``run_blocks`` returns them.
    is_searched : bool
        Whether the models of all folds were searched for, from the fit to all folds.
    """

    samples: PointwiseDensity
    runs: FreeRuns
    block_position_m: Array
    is_searched: bool = False

    @property
    def loglik_per_sample(self) -> float:
        """Mean log-likelihood of a sample [nats], without the 2 pi term."""
        return self.samples.total / max(int(np.isfinite(self.samples.log_likelihood).sum()), 1)

    @property
    def one_step_rmse_m(self) -> float:
        """Root mean square of the innovations [m] of the samples that gains count: of drivers who follow somebody."""
        counts = np.isfinite(self.samples.log_likelihood)
        return rmse(np.where(counts, self.samples.innovation_m, np.nan))

    def by_driver(self) -> list[tuple[float, float]]:
        """Return the log-likelihood [nats] and the single-car error after 10 s [m] of every driver."""
        totals = np.nansum(self.samples.log_likelihood, axis=1)
        return [(float(total), rmse(self.runs.single[:, -1, i])) for i, total in enumerate(totals)]

    @property
    def free_run_10s_m(self) -> float:
        """Error of position [m] after 10 s of free run, of coupled runs if there are any, else of single cars."""
        return self.free_run_10s_beside(self)[0]

    def free_run_10s_beside(self, other: "HeldOutErrors") -> tuple[float, float]:
        """Return ``free_run_10s_m`` of these and of other errors [m], over the runs that both have."""
        for ours, theirs in ((self.runs.coupled, other.runs.coupled), (self.runs.single, other.runs.single)):
            both = np.isfinite(ours[:, -1]) & np.isfinite(theirs[:, -1])
            if both.any():
                return rmse(ours[:, -1][both]), rmse(theirs[:, -1][both])
        return math.nan, math.nan

    @property
    def predicted_drivers(self) -> list[int]:
        """Numbers of the drivers who are predicted."""
        return [i for i, row in enumerate(self.samples.log_likelihood) if np.isfinite(row).any()]

    def among(self, others: "HeldOutErrors", who: Sequence[int]) -> "HeldOutErrors":
        """Return errors of some drivers as errors of all drivers, of whom the others are not predicted.

        Parameters
        ----------
        others : HeldOutErrors
            Errors of all drivers in the same recording, for their number and for the starts of their free runs.
        who : sequence of int
            Numbers of the drivers whose errors these are.

        Returns
        -------
        HeldOutErrors
            The errors, with NaN for all other drivers.
        """
        samples = unknown(*others.samples.log_likelihood.shape)
        for k, i in enumerate(who):
            samples.put(i, self.samples.of(k))
        block = np.full_like(others.block_position_m, np.nan)
        block[:, who] = self.block_position_m
        return HeldOutErrors(samples, self.runs.among(others.runs, who), block, self.is_searched)

    def no_worse_than(self, other: "HeldOutErrors") -> bool:
        """Whether the free runs are at most 5 % worse, or worse by at most two paired standard errors over starts.

        All horizons count together, coupled and single, each relative to the mean square error of the other model. A
        single horizon may be luck: a jam depends on small details.
        """
        pairs = ((self.runs.coupled, other.runs.coupled), (self.runs.single, other.runs.single))
        by_horizon: list[Array] = []
        for ours, theirs in pairs:
            if not np.isfinite(theirs).any():
                continue
            for k in range(len(HORIZONS_S)):
                change = np.square(ours[:, k]) - np.square(theirs[:, k])
                by_horizon.append(change / rmse(theirs[:, k]) ** 2)
        is_whole_road = len(by_horizon) > len(HORIZONS_S)
        mean, se = (_over_starts if is_whole_road else _over_runs)(by_horizon)
        return not mean > max(2.0 * se, (1.0 + _TOLERANCE) ** 2 - 1.0)

    def summary(self) -> dict[str, float]:
        """Return the main errors by name."""
        coupled, single = (
            [rmse(e[:, k]) for k in range(len(HORIZONS_S))] for e in (self.runs.coupled, self.runs.single)
        )
        return {
            "one_step_rmse_m": self.one_step_rmse_m,
            **{f"free_run_{h:g}s_m": e for h, e in zip(HORIZONS_S, coupled, strict=True)},
            **{f"single_car_{h:g}s_m": e for h, e in zip(HORIZONS_S, single, strict=True)},
            "loglik_per_sample": self.loglik_per_sample,
        }

    def details(self) -> dict[str, float]:
        """Return errors of speed, gap and time gap by name: rmse, rmse over the measured mean gap, and fit [%] of the
        gap.

        The time gap [s] counts where the car drives faster than 1 m/s. The fit is 100 (1 - rmse / std of the measured
        gaps): it is 100 for a perfect model, and 0 for a model that knows only the mean gap.
        """
        found: dict[str, float] = {}
        r = self.runs
        for name, gap_error, speed_error in (
            ("free_run", r.coupled_gap, r.coupled_speed),
            ("single_car", -r.single, r.single_speed),
        ):
            for k, h in enumerate(HORIZONS_S):
                gap, speed = r.gap[:, k], r.speed[:, k]
                error, speed_off = np.where(np.isfinite(gap), gap_error[:, k], np.nan), speed_error[:, k]
                moving = (speed > _MOVING) & (speed + speed_off > _MOVING)
                with np.errstate(divide="ignore", invalid="ignore"):
                    time_gap = np.where(moving, gap / speed, np.nan)
                    time_gap_off = np.where(moving, (gap + error) / (speed + speed_off), np.nan) - time_gap
                at = f"{name}_{h:g}s"
                found[f"{at}_speed_mps"] = rmse(speed_off)
                found[f"{at}_gap_m"] = rmse(error)
                found[f"{at}_time_gap_s"] = rmse(time_gap_off)
                known = gap[np.isfinite(gap) & np.isfinite(error)]
                if len(known) > 1:
                    found[f"{at}_gap_relative"] = rmse(error) / float(np.mean(known))
                    found[f"{at}_gap_fit_percent"] = 100.0 * (1.0 - rmse(error) / float(np.std(known)))
        return found


def _over_starts(by_horizon: Sequence[Array]) -> tuple[float, float]:
    """Mean change and its standard error over starts, which all drivers share; changes (S, N) at each horizon."""
    known = [np.maximum(np.isfinite(change).sum(axis=1), 1) for change in by_horizon]
    changes = np.mean([np.nansum(change, axis=1) / n for change, n in zip(by_horizon, known, strict=True)], axis=0)
    if len(changes) < 2:
        return 0.0, 0.0
    return float(np.mean(changes)), float(np.std(changes, ddof=1) / np.sqrt(len(changes)))


def _over_runs(by_horizon: Sequence[Array]) -> tuple[float, float]:
    """Mean change over all runs, and its standard error, over drivers or over the starts of a few drivers.

    Each driver has starts of their own. Changes (S, N) at each horizon.
    """
    if not by_horizon:
        return 0.0, 0.0
    changes: Array = np.mean(by_horizon, axis=0)
    axis = 0 if np.isfinite(changes).any(axis=0).sum() >= MANY_DRIVERS else 1
    count, total = np.isfinite(changes).sum(axis=axis), np.nansum(changes, axis=axis)
    count, total = count[count > 0], total[count > 0]
    if len(count) < 2:
        return 0.0, 0.0
    mean = float(total.sum() / count.sum())
    spread = float(np.square(total - mean * count).sum()) * len(count) / (len(count) - 1)
    return mean, math.sqrt(spread) / float(count.sum())


def held_out_errors(data: Recorded, fitted: JointFit, work: Executor, *, searched: bool) -> HeldOutErrors:
    """Return the held-out errors of a fitted model.

    One step away from the fit (``searched=False``) the held-out models are good where the fit is at a maximum that the
    data determine. Where they predict far worse than the fit itself, in all or for one driver, they are searched after
    all: a number that rests on a step along a ridge of the likelihood cannot be trusted.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model fitted to all folds.
    work : Executor
        Runs the filters.
    searched : bool
        Whether to search for the model without each fold.

    Returns
    -------
    HeldOutErrors
        Errors over all folds.
    """
    models = without_folds(data, fitted, work, searched=searched)
    found = _summed_up(data, _mended(data, fitted, models, work), work)
    own, shared = len(fitted.model.individual), len(fitted.model.shared)
    lost = fitted.samples.total - found.samples.total
    if lost > _PER_PARAMETER * (data.drivers * own + shared):
        return searched_errors(data, fitted, found, work)
    return found


def _mended(data: Recorded, fitted: JointFit, models: Sequence[Model], work: Executor) -> Iterator[_Followed]:
    """Follow the model of each fold; drivers for whom the step to it has failed search for their parameters.

    A single driver whose step failed may hide all that an addition gains, or feign it.
    """
    most = _PER_FOLD * (len(fitted.model.individual) + 1)
    for fold, model in enumerate(models):
        samples, states = follow(data, model, work)
        lost = np.where(data.fold == fold, fitted.samples.log_likelihood - samples.log_likelihood, 0.0)
        failed = np.flatnonzero(np.nansum(lost, axis=1) > most)
        if len(failed):
            model = searched_by_some(data, fitted, model, fold, failed.tolist(), work)
            samples, states = follow(data, model, work)
        yield model, samples, states


def searched_errors(
    data: Recorded, fitted: JointFit, found: HeldOutErrors, work: Executor, who: Sequence[int] | None = None
) -> HeldOutErrors:
    """Return the held-out errors after a search for each fold from the fit, or those ``found`` if they are better.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model fitted to all folds.
    found : HeldOutErrors
        Its held-out errors so far.
    work : Executor
        Runs the filters.
    who : sequence of int, optional
        Numbers of the drivers who search; all drivers by default.

    Returns
    -------
    HeldOutErrors
        The better errors. They are searched for once only.
    """
    if found.is_searched:
        return found
    if who is None:
        models = searched_without_folds(data, fitted, work)
    else:
        steps = without_folds(data, fitted, work, searched=False)
        models = tuple(searched_by_some(data, fitted, one, fold, who, work) for fold, one in enumerate(steps))
    again = errors_of(data, models, work)
    return replace(again if again.samples.total > found.samples.total else found, is_searched=True)


def errors_of(data: Recorded, models: Sequence[Model], work: Executor) -> HeldOutErrors:
    """Return the held-out errors of a model.

    Parameters
    ----------
    data : Recorded
        The recording.
    models : sequence of Model
        The model fitted without each fold, from ``cross_validation.without_folds``.
    work : Executor
        Runs the filters.

    Returns
    -------
    HeldOutErrors
        Errors over all folds.
    """
    return _summed_up(data, ((model, *follow(data, model, work)) for model in models), work)


def _summed_up(data: Recorded, models: Iterable[_Followed], work: Executor) -> HeldOutErrors:
    """The held-out errors of the models of all folds."""
    by_fold, runs, position = [], [], []
    # the states take most of the memory, so there are only those of one model at a time
    for fold, (model, samples, states) in enumerate(models):
        by_fold.append(samples)
        runs.append(free_runs(data, model, states, work, fold))
        position.append(run_blocks(data, model, states, fold))
    return HeldOutErrors(of_folds(data, by_fold), FreeRuns.of_folds(runs), first_known(position))
