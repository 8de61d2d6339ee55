"""A quick, even-handed look at every candidate: one Newton step from the fitted model, and what it would predict.

The same look is taken at the data and at data simulated from the model without any effect (``bootstrap``), so that what
is approximate in it cancels.
"""

from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.criticism.candidates import Candidate, added
from sugiyama_ros.criticism.fitting import (
    FOLDS,
    OUTLIERS,
    Fit,
    Model,
    Recorded,
    Samples,
    Slopes,
    coordinate,
    difference_steps,
    evaluate,
    fit,
    moved,
    objective,
    solve,
    sums,
    value,
)
from sugiyama_ros.estimation import causal
from sugiyama_ros.road import Array

# Steps with the derivatives of the start, at most, and the log-likelihood that one must promise.
_LOOKS, _PROMISE = 3, 0.2
_ITERATIONS_OF_ROBUST = 3


@dataclass(frozen=True, eq=False)
class Glance:
    """A candidate added to a model, roughly fitted.

    gain: in log posterior [nats] over the model, in sample; loss: of the log posterior at the start ``loss_at`` of the
    search once the other parameters have given way, so what an effect of that strength would have gained if it existed.
    """

    candidate: Candidate
    fit: Fit
    gain: float
    loss: float
    loss_at: dict[int, float]


def glance(data: Recorded, base: Fit, candidate: Candidate, work: Executor) -> Glance:
    """Add a candidate to a fitted model by a step or two."""
    before = objective(base.slopes, base.model, range(FOLDS))
    starts = [added(base.model, candidate, start) for start in candidate.starts]
    samples = [evaluate(data, model, work) for model in starts]
    looks = [_promise(base, s) for s in samples]
    best, worst = int(np.argmax(looks)), int(np.argmin(looks))
    loss = base.log_likelihood - looks[worst], candidate.starts[worst]
    model, at = starts[best], samples[best]
    if OUTLIERS in candidate.places:
        fitted = fit(data, model, work, iterations=_ITERATIONS_OF_ROBUST)
        return Glance(candidate, fitted, objective(fitted.slopes, fitted.model, range(FOLDS)) - before, *loss)
    columns = [_column(data, model, at, k, work) for k in candidate.places]
    fresh = [k for k in candidate.places if k in model.individual]
    robust = bool(np.any(base.model.rows[:, OUTLIERS] > 0.0))
    first_shared = len(base.model.individual)

    def slopes_at(samples: Samples) -> list[Slopes]:
        found = []
        for i, s in enumerate(base.slopes):
            dy, dvar = (
                np.insert(old, len(old) if not fresh else first_shared, [c[i][j] for c in columns], axis=0)
                for j, old in enumerate((s.innovation, s.variance))
            )
            y, variance = samples.innovation_m[i], samples.innovation_var[i]
            now = (y, variance, samples.log_likelihood[i])
            # with outliers y counts as much as its density's slope says, which is 1/S without
            weight = np.ones_like(y)
            if robust:
                row = model.rows[i]
                weight = np.array([_weight(a, b, row) for a, b in zip(y, variance, strict=True)])
            density = -weight * (dy * (y / variance) + 0.5 * dvar * (1.0 - weight * y * y / variance) / variance)
            found.append(sums(now, dy, dvar, density, data.fold, robust=robust))
        return found

    everywhere = range(FOLDS)
    here = slopes_at(at)
    now, share = objective(here, model, everywhere), 1.0
    for _ in range(_LOOKS):
        step = solve(here, model, everywhere, 1e-3)
        if step.promise < _PROMISE:
            break
        tried = moved(data, model, step, share)
        samples_there = evaluate(data, tried, work)
        there = slopes_at(samples_there)
        then = objective(there, tried, everywhere)
        if then > now:
            model, at, here, now = tried, samples_there, there, then
        else:
            share *= 0.3
    return Glance(candidate, Fit(model, at, tuple(here)), now - before, *loss)


def _weight(y: float, variance: float, row: Array) -> float:
    """What the update with an innovation counts, of what it would count if no sample were an outlier."""
    return float(causal.robust(y, variance, row)[0]) * variance if np.isfinite(y) else 1.0


def _promise(base: Fit, samples: Samples) -> float:
    """Log-likelihood once the parameters of the base have given way to the candidate, to first order."""
    total = samples.total
    for s, y, variance, density in zip(
        base.slopes, samples.innovation_m, samples.innovation_var, samples.log_likelihood, strict=True
    ):
        scored = np.isfinite(density)
        y, variance = y[scored], variance[scored]
        own = len(base.model.individual)
        dy, dvar = s.innovation[:own, scored], s.variance[:own, scored]
        score = -(dy * (y / variance) + 0.5 * dvar * (1.0 - y * y / variance) / variance).sum(axis=1)
        information = s.information.sum(axis=0)[:own, :own] + np.diag(1.0 / np.array(base.model.prior_std) ** 2)
        total += 0.5 * float(score @ np.linalg.solve(information, score))
    return total


def _column(data: Recorded, model: Model, at: Samples, place: int, work: Executor) -> list[tuple[Array, Array]]:
    """Derivatives of every driver's innovations and variances by one parameter."""
    coordinates = coordinate(model.rows[:, [place]], [place])
    step = difference_steps(coordinates, [place]).max()
    rows = model.rows.copy()
    rows[:, place] = value(coordinates + step, [place])[:, 0]
    there = evaluate(data, replace(model, rows=rows), work)
    return [
        ((y - y0) / step, (s - s0) / step)
        for y, y0, s, s0 in zip(
            there.innovation_m, at.innovation_m, there.innovation_var, at.innovation_var, strict=True
        )
    ]
