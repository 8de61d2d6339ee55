"""A quick, even-handed look at every candidate: one Newton step from the fitted model, and what it would predict.

The same look is taken at the data and at data simulated from the model without any effect (``bootstrap``), so that what
is approximate in it cancels.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate, added
from sugiyama_ros.effects.registry import DECLARED
from sugiyama_ros.effects.sensing import is_contaminated
from sugiyama_ros.filters.measurement import weigh_samples
from sugiyama_ros.fit.joint import Fit, climb, objective, solve
from sugiyama_ros.fit.model import Model, coordinate, value
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import Samples, evaluate
from sugiyama_ros.fit.slopes import Derivatives, Slopes, density_slope, difference_steps, sums

# Steps of a closer look at most, and the log-likelihood [nats] that one must promise.
_CLOSER, _PROMISE = 4, 0.4
# Drivers, or up to twice as many, on whom the starts of a search are compared.
_SOME_DRIVERS = 11
# A candidate that promises less than this [nats] is not looked at any closer.
_HOPELESS = 1.0


@dataclass(frozen=True)
class Effort:
    """How far a search goes, at most.

    runs: simulated recordings; looks: steps of a first look; shortlist, later: candidates that are fitted in full in
    the first round and in later ones; steps, renewals: of such a fit, and times that it takes the derivatives anew.
    """

    runs: int
    looks: int
    shortlist: int
    later: int
    steps: int
    renewals: int


#: Of a diagnosis, and of one in a hurry: constants that make up for much of what is missing climb slowly.
FULL, QUICK = Effort(6, 6, 8, 8, 20, 6), Effort(2, 2, 4, 2, 8, 1)


@dataclass(frozen=True, eq=False)
class Glance:
    """A candidate added to a model, roughly fitted.

    gain: in log posterior [nats] over the model, in sample; promise: what the next step may add to it; loss: of the
    log posterior at the start ``loss_at`` of the search once the other parameters have given way, so what an effect of
    that strength would have gained if it existed.
    """

    candidate: Candidate
    fit: Fit
    gain: float
    promise: float
    loss: float
    loss_at: dict[int, float]


def glance(data: Recorded, base: Fit, candidate: Candidate, work: Executor, effort: Effort = FULL) -> Glance:
    """Add a candidate to a fitted model by a few steps, from its starts."""
    model, at, loss, loss_at = _best_start(data, base, candidate, work)
    known = {*base.model.individual, *base.model.shared}
    new = {}
    if len(candidate.strengths) == 1:
        # from nothing to the start, what it changes is proportional to its strength
        new = {k: _differences(base.samples, at, float(model.rows[0, k]), model.rows) for k in candidate.strengths}
    for k in (*model.individual, *model.shared):
        if k not in known and k not in new:
            new[k] = _column(data, model, at, k, work)
    look = Glance(candidate, Fit(model, at, _joined(data, base, model, at, new)), 0.0, 0.0, loss, loss_at)
    return _first_steps(data, base, look, work, effort)


def _best_start(
    data: Recorded, base: Fit, candidate: Candidate, work: Executor
) -> tuple[Model, Samples, float, dict[int, float]]:
    """The start that promises most on some of the drivers, the samples there, and the loss as in ``Glance``."""
    is_only = len(candidate.starts) == 1
    some = range(0, data.drivers, 1 if is_only else max(1, data.drivers // _SOME_DRIVERS))
    here, tried = base.samples.only(some), []
    for start in candidate.starts:
        model = added(base.model, candidate, start)
        at = evaluate(data, model, work, some)
        tried.append((_promise(base, model, at), model, at))
    worst = int(np.argmin([promise for promise, _, _ in tried]))
    loss = (here.total - tried[worst][0]) * data.drivers / len(some)
    _, model, at = max(tried, key=lambda one: one[0])
    if candidate.strengths:
        model = added(base.model, candidate, _strongest(data, base, here, candidate, tried))
        at = evaluate(data, model, work)
    else:
        others = [i for i in range(data.drivers) if i not in some]
        rest = evaluate(data, model, work, others)
        for i in others:
            at.put(i, rest.of(i))
    return model, at, loss, candidate.starts[worst]


def glance_again(data: Recorded, base: Fit, before: Fit, look: Glance, work: Executor, effort: Effort) -> Glance:
    """Look again at a candidate that was looked at when the model was ``before``, from where that has ended."""
    model = _carried_over(before, look, base)
    at = evaluate(data, model, work)
    begun = replace(look, fit=Fit(model, at, _joined(data, base, model, at, _columns(look.fit))))
    return _first_steps(data, base, begun, work, effort)


def _first_steps(data: Recorded, base: Fit, look: Glance, work: Executor, effort: Effort) -> Glance:
    """A few steps from where a look begins, if it promises anything."""
    everywhere = range(FOLDS)
    gain = objective(look.fit.slopes, look.fit.model, everywhere) - objective(base.slopes, base.model, everywhere)
    promise = solve(look.fit.slopes, look.fit.model, everywhere, 1e-3).promise
    look = replace(look, gain=gain, promise=promise)
    return _further(data, look, work, effort.looks) if gain + promise > _HOPELESS else look


def closer(data: Recorded, look: Glance, work: Executor) -> Glance:
    """The same, looked at more closely."""
    return _further(data, look, work, _CLOSER) if look.gain + look.promise > _HOPELESS else look


def _further(data: Recorded, look: Glance, work: Executor, steps: int) -> Glance:
    """The same some steps further, with the derivatives as they were."""
    everywhere, fitted = range(FOLDS), climb(data, look.fit, work, iterations=steps, enough=_PROMISE, renewals=0)
    rise = objective(fitted.slopes, fitted.model, everywhere) - objective(look.fit.slopes, look.fit.model, everywhere)
    promise = solve(fitted.slopes, fitted.model, everywhere, 1e-3).promise
    return replace(look, fit=fitted, gain=look.gain + rise, promise=promise)


def refine(data: Recorded, look: Glance, work: Executor, effort: Effort = FULL) -> Fit:
    """Fit in full, from where a glance has come to."""
    return climb(data, look.fit, work, iterations=effort.steps, renewals=effort.renewals, fresh=False)


def with_candidate(data: Recorded, base: Fit, candidate: Candidate, work: Executor) -> Fit:
    """A fitted model with a candidate added, fitted in full."""
    return refine(data, glance(data, base, candidate, work), work)


def _carried_over(before: Fit, look: Glance, current: Fit) -> Model:
    """The current model with a candidate as it was looked at ``before``: what gave way to it then gives way again."""
    candidate = look.candidate
    model = added(current.model, candidate, candidate.starts[0])
    rows = model.rows.copy()
    rows[:, candidate.places] = look.fit.model.rows[:, candidate.places]
    own = list(before.model.individual)
    shift = coordinate(look.fit.model.rows[:, own], own) - coordinate(before.model.rows[:, own], own)
    rows[:, own] = value(coordinate(rows[:, own], own) + shift, own)
    return replace(model, rows=rows)


def forecast(data: Recorded, before: Fit, look: Glance, current: Fit) -> float:
    """Gain [nats] that a candidate, looked at when the model was ``before``, promises over ``current``.

    As if what it changes in every sample were the same now; costs no filter.
    """
    candidate = look.candidate
    model = added(current.model, candidate, {})
    rows = model.rows.copy()
    rows[:, candidate.places] = look.fit.model.rows[:, candidate.places]
    model = replace(model, rows=rows)
    now, then, with_it = current.samples, before.samples, look.fit.samples
    y = now.innovation_m + with_it.innovation_m - then.innovation_m
    variance = now.innovation_var * (with_it.innovation_var / then.innovation_var)
    density = np.empty_like(y)
    for i, row in enumerate(rows):
        weigh_samples(y[i], variance[i], row, np.empty_like(y[i]), density[i])
    density[np.isnan(now.log_likelihood)] = np.nan
    here = _joined(data, current, model, Samples(y, variance, density), _columns(look.fit))
    everywhere = range(FOLDS)
    reached = objective(here, model, everywhere) + solve(here, model, everywhere, 1e-3).promise
    return reached - objective(current.slopes, current.model, everywhere)


def _promise(base: Fit, model: Model, samples: Samples) -> float:
    """Log-likelihood once the parameters of the base have given way to the candidate, to first order.

    Of what they promise, half is believed: a start far off promises much.
    """
    own, total = len(base.model.individual), samples.total
    prior = np.diag(1.0 / np.array(base.model.prior_std) ** 2)
    for i, (s, row) in enumerate(zip(base.slopes, model.rows, strict=True)):
        y, variance, density = samples.of(i)
        slope = density_slope(y, variance, s.derivatives.innovation[:own], s.derivatives.variance[:own], row)
        score = slope[:, np.isfinite(density)].sum(axis=1)
        total += 0.25 * float(score @ np.linalg.solve(s.information.sum(axis=0)[:own, :own] + prior, score))
    return total


def _strongest(
    data: Recorded, base: Fit, here: Samples, candidate: Candidate, tried: Sequence[tuple[float, Model, Samples]]
) -> dict[int, float]:
    """The start that promises most once its strengths are scaled as the samples want it, so scaled.

    What a start changes in every sample is taken for a derivative, so that this costs no filter. here: samples of the
    base, of those drivers with whom the starts were tried.
    """
    steps, (ray, *_) = [], candidate.strengths
    model = replace(base.model, shared=(*base.model.shared, ray))
    for _, start, there in tried:
        new = {ray: _differences(here, there, 1.0, start.rows)}
        steps.append(solve(_joined(data, base, model, here, new), model, range(FOLDS), 1e-3))
    best = int(np.argmax([step.promise for step in steps]))
    scale = float(steps[best].shared[-1])
    return {
        k: float(np.clip(scale * v, DECLARED[k].lower, DECLARED[k].upper)) if k in candidate.strengths else v
        for k, v in candidate.starts[best].items()
    }


def _joined(
    data: Recorded, base: Fit, model: Model, at: Samples, new: dict[int, list[tuple[Array, Array, Array]]]
) -> tuple[Slopes, ...]:
    """Slopes at a model near ``base``: derivatives by its parameters are those that it has, those by others are new."""
    known, places = [*base.model.individual, *base.model.shared], (*model.individual, *model.shared)
    joined = []
    for i, (s, row) in enumerate(zip(base.slopes, model.rows, strict=True)):
        rows = [
            [old[known.index(k)] if k in known else new[k][i][j] for k in places] for j, old in enumerate(s.derivatives)
        ]
        joined.append(sums(at.of(i), Derivatives(*map(np.array, rows)), row, data.fold))
    return tuple(joined)


def _columns(fitted: Fit) -> dict[int, list[tuple[Array, Array, Array]]]:
    """Derivatives of every driver's samples by each parameter of a fit, as ``_column`` gives them."""
    places, derivatives = (*fitted.model.individual, *fitted.model.shared), [s.derivatives for s in fitted.slopes]
    return {k: [(d.innovation[j], d.variance[j], d.density[j]) for d in derivatives] for j, k in enumerate(places)}


def _column(data: Recorded, model: Model, at: Samples, place: int, work: Executor) -> list[tuple[Array, Array, Array]]:
    """Derivatives of every driver's samples by one parameter, as ``Slopes`` keeps them, (T,) each."""
    coordinates = coordinate(model.rows[:, [place]], [place])
    step = float(difference_steps(data, [place])[0])
    rows = model.rows.copy()
    rows[:, place] = value(coordinates + step, [place])[:, 0]
    return _differences(at, evaluate(data, replace(model, rows=rows), work), step, model.rows)


def _differences(at: Samples, there: Samples, step: float, rows: Array) -> list[tuple[Array, Array, Array]]:
    """Difference quotients of every driver's samples, as ``Slopes`` keeps them, (T,) each; rows: (N, WIDTH)."""
    found = []
    for i, row in enumerate(rows):
        y, variance = at.innovation_m[i], at.innovation_var[i]
        dy, dvar = (there.innovation_m[i] - y) / step, (there.innovation_var[i] - variance) / step
        direct = np.zeros_like(dy)
        if is_contaminated(row):
            direct = (there.log_likelihood[i] - at.log_likelihood[i]) / step
            direct -= density_slope(y, variance, dy[None], dvar[None], row)[0]
        found.append((dy, dvar, direct))
    return found
