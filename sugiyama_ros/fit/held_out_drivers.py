"""How well a model of many drivers predicts a driver whom nobody has seen.

The drivers are divided into folds, and each fold is predicted by models that were fitted to all other drivers. A model
says how probable it is that a driver has parameters theta. So it predicts the samples of a driver with the mean of
exp L(theta) over the drivers that it expects, and later samples with ln p(all) - ln p(earlier). The models are classes
of drivers, one population, and each driver alone. The last one knows nothing of a driver without samples, so it is
fitted to the earlier samples of the driver, and predicts only the later ones.

References
----------
Laplace's approximation of the mean over a population: Tierney and Kadane, J. Am. Stat. Assoc. 81 (1986) 82.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.fit.classes import predicted_by, search_of
from sugiyama_ros.fit.coordinates import LONGEST, Damping, coordinate, limits, value
from sugiyama_ros.fit.driver_types import Predictions, gain
from sugiyama_ros.fit.joint import LARGEST_STD, JointFit, fit_base, fit_nearly
from sugiyama_ros.fit.model import Model, evaluate
from sugiyama_ros.fit.recording import FOLDS, Recorded, some_drivers
from sugiyama_ros.fit.slopes import difference_steps, slopes_of
from sugiyama_ros.results import CLEARLY

# Damping of the search for these parameters.
_DAMPING = Damping(least=0.0, least_after_failure=0.0, most=np.inf, start=1e-2)
# Steps towards the likeliest parameters of a driver who is a draw from a population.
_STEPS = 6


def chosen(found: Sequence[Predictions]) -> int:
    """Return the number of classes beyond which one more class does not predict clearly better."""
    by_count = {one.classes: one for one in found if one.classes}
    count = 1
    while count + 1 in by_count:
        more, error = gain(by_count[count + 1].whole, by_count[count].whole)
        if more <= CLEARLY * error:
            break
        count += 1
    return count


def predict_held_out(
    data: Recorded,
    estimated: Sequence[int],
    most_classes: int,
    work: Executor,
    seed: int,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Predictions]:
    """Predict every driver by classes, from one up to ``most_classes`` of them, by one population, and alone.

    More classes are tried as long as one more predicts clearly better. ``estimated``: places of the parameters.
    """
    fold = np.random.default_rng(seed).permutation(data.drivers) % FOLDS
    folds = [_HeldOut(data, np.flatnonzero(fold == f), estimated, work, seed) for f in range(FOLDS)]
    found: list[Predictions] = []
    for count in range(1, most_classes + 1):
        name = f"{count} class{'es' if count > 1 else ''}"
        found.append(_gathered(name, count, data.drivers, [(f.out, *f.by_classes(count)) for f in folds]))
        on_progress(count, most_classes + 2)
        if chosen(found) < count:
            break
    found.append(_gathered("population", 0, data.drivers, [(f.out, *f.by_population()) for f in folds]))
    on_progress(most_classes + 1, most_classes + 2)
    alone = _gathered("each alone", 0, data.drivers, [(f.out, *f.alone()) for f in folds])
    on_progress(most_classes + 2, most_classes + 2)
    return [*found, replace(alone, whole=np.full(data.drivers, np.nan))]


def _gathered(name: str, classes: int, drivers: int, parts: Sequence[tuple[Ints, Array, Array]]) -> Predictions:
    """Put together what was predicted of the drivers of each fold: who, all samples, and the first half of them."""
    whole, later = np.full(drivers, np.nan), np.full(drivers, np.nan)
    for out, every, first in parts:
        whole[out], later[out] = every, every - first
    return Predictions(name, classes, whole, later)


class _HeldOut:
    """Some drivers who are held out, and models fitted to the others."""

    def __init__(self, data: Recorded, out: Ints, estimated: Sequence[int], work: Executor, seed: int) -> None:
        self.data, self.out, self.estimated, self.work, self.seed = data, out, list(estimated), work, seed
        counts = np.cumsum(data.scored, axis=1)
        self.first = replace(data, scored=data.scored & (counts <= 0.5 * counts[:, -1:]))
        self.seen = np.setdiff1d(np.arange(data.drivers), out)
        self.known = some_drivers(data, self.seen.tolist())
        self.base: JointFit = fit_base(self.known, self.estimated, work)

    def by_classes(self, count: int) -> tuple[Array, Array]:
        """Log-densities (n,) of all samples and of the first half of them, by classes."""
        search = search_of(self.known, count, self.estimated, self.work)
        at = search.maximise(search.start(self.base.model.rows, self.seed))
        every, first = (predicted_by(search, at, data, self.seen, self.out) for data in (self.data, self.first))
        return every, first

    def by_population(self) -> tuple[Array, Array]:
        """Log-densities (n,) of all samples and of the first half of them, by a population."""
        every, first = (self._marginal(data) for data in (self.data, self.first))
        return every, first

    def alone(self) -> tuple[Array, Array]:
        """Log-densities (n,) of all samples and of the first half of them, fitted to the first half."""
        near = fit_nearly(some_drivers(self.first, self.out.tolist()), self.estimated, self.work)
        rows = self._rows()
        rows[self.out] = near.model.rows
        model = self._model(rows, np.full(len(self.estimated), LARGEST_STD))
        every, first = (
            np.nansum(evaluate(data, model, self.work, self.out.tolist()).log_likelihood[self.out], axis=1)
            for data in (self.data, self.first)
        )
        return every, first

    def _rows(self) -> Array:
        """Rows (N, width): of the drivers who are seen, and of the median driver."""
        rows = np.tile(np.median(self.base.model.rows, axis=0), (self.data.drivers, 1))
        rows[self.seen] = self.base.model.rows
        return rows

    def _model(self, rows: Array, std: Array) -> Model:
        return Model(rows, tuple(self.estimated), (), tuple(std.tolist()), self._rows())

    def _marginal(self, data: Recorded) -> Array:
        """Log-density (n,) of the samples of drivers who are draws from the population, by Laplace's approximation."""
        out, places, std = self.out, self.estimated, np.array(self.base.model.prior_std)
        rows, count = self._rows(), len(self.estimated)
        centre = coordinate(rows[out[0], places], places)
        low, high = np.sort(coordinate(limits(places, data.lower, data.upper), places), axis=0)
        steps = np.tile(difference_steps(data, places), (data.drivers, 1))
        best, here, damping = (
            np.full(len(out), -np.inf),
            np.tile(centre, (len(out), 1)),
            np.full(len(out), _DAMPING.start),
        )
        there, score, information = here.copy(), np.zeros_like(here), np.zeros((len(out), count, count))
        for _ in range(_STEPS):
            rows[out[:, None], places] = value(there, places)
            model = self._model(rows, std)
            samples = evaluate(data, model, self.work, out.tolist())
            prior = -0.5 * np.square((there - centre) / std).sum(axis=1)
            height = prior + np.nansum(samples.log_likelihood[out], axis=1)
            is_better = height > best
            better = np.flatnonzero(is_better)
            known = slopes_of(data, model, samples, steps, self.work, out[better].tolist())
            for i, s in zip(better, known, strict=True):
                best[i], here[i] = height[i], there[i]
                score[i], information[i] = s.score.sum(axis=0), s.information.sum(axis=0)
            damping = _DAMPING.updated(damping, is_better, ~is_better)
            posterior = information + np.diag(std**-2.0)
            ridge = damping[:, None, None] * posterior * np.eye(count)
            gradient = score - (here - centre) / std**2
            step = np.linalg.solve(posterior + ridge, gradient[:, :, None])[:, :, 0]
            there = np.clip(here + np.clip(step, -LONGEST, LONGEST), low, high)
        narrower = np.linalg.slogdet(np.eye(count) + information * std**2)[1]
        return np.asarray(best - 0.5 * narrower)
