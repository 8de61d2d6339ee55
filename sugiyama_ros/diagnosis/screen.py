"""Screening: a rough fit of every candidate, by a few Newton steps from the fitted model.

The search screens candidates on the data and on data simulated from the model without the candidate (``bootstrap``).
The approximations are the same in both cases, so they cancel.
"""

import math
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate, added
from sugiyama_ros.diagnosis.near import differences, joined
from sugiyama_ros.diagnosis.prescreen import Prescreen, prescreen, promised
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.measurement import weigh_samples
from sugiyama_ros.fit.joint import JointFit, maximise, objective, solve
from sugiyama_ros.fit.model import Model, coordinate, value
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import PointwiseDensity, evaluate
from sugiyama_ros.fit.slopes import Column, Slopes, difference_steps

# Maximum number of steps of a closer look, and smallest predicted gain [nats] of a further step.
_CLOSER, _LEAST_PREDICTED = 4, 0.4
# A candidate with a smaller predicted gain [nats] gets no closer look.
_HOPELESS = 1.0


@dataclass(frozen=True)
class Effort:
    """Limits of a search.

    Parameters
    ----------
    runs : int
        Number of simulated recordings.
    looks : int
        Steps of a first look.
    refuted : float
        Loss at the best start of a candidate [nats] from which on the candidate is not screened.
    shortlist, later : int
        Number of candidates that get a full fit, in the first round and in later rounds.
    steps, renewals : int
        Steps of a full fit, and how often it computes derivatives again.
    refits : int
        Number of simulated recordings to which the final model is fitted from nothing.
    """

    runs: int
    looks: int
    refuted: float
    shortlist: int
    later: int
    steps: int
    renewals: int
    refits: int


#: Effort of a diagnosis. Constants that compensate for a missing effect need many steps.
FULL = Effort(runs=6, looks=6, refuted=math.inf, shortlist=8, later=8, steps=20, renewals=6, refits=6)
#: Effort of a quick diagnosis. Of 80 candidates of 23 simulated recordings that lost 50 nats at their best start, three
#: gained anything after the first steps, and none of these was the right one.
QUICK = Effort(runs=2, looks=2, refuted=50.0, shortlist=4, later=2, steps=8, renewals=1, refits=2)


@dataclass(frozen=True, eq=False)
class Screened:
    """A rough fit of a model with one more candidate.

    Parameters
    ----------
    candidate : Candidate
        The candidate.
    fit : JointFit
        The model with the candidate.
    gain : float
        Rise of the log posterior [nats] over the model without the candidate, in sample.
    predicted_gain : float
        Further gain [nats] that the next step may add.
    """

    candidate: Candidate
    fit: JointFit
    gain: float
    predicted_gain: float


def screen(
    data: Recorded,
    base: JointFit,
    candidate: Candidate,
    work: Executor,
    effort: Effort = FULL,
    seen: Prescreen | None = None,
) -> Screened:
    """Add a candidate to a fitted model, by a few steps from the best of its starts.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without the candidate.
    candidate : Candidate
        What to add.
    work : Executor
        Runs the filters.
    effort : Effort
        Limits of the search.
    seen : Prescreen, optional
        An earlier prescreen of the candidate, beside the same model.

    Returns
    -------
    Screened
        The rough fit.
    """
    seen = seen or prescreen(data, base, candidate, work)

    def look_from(start: Model, there: PointwiseDensity) -> Screened:
        slopes = _slopes_at(data, base, candidate, start, there, work)
        return _first_steps(data, base, Screened(candidate, JointFit(start, there, slopes), 0.0, 0.0), work, effort)

    model = added(base.model, candidate, seen.best)
    if candidate.strengths:
        strongest = added(base.model, candidate, _strongest(data, base, seen))
        look = look_from(strongest, evaluate(data.roughly, strongest, work))
        if look.gain >= 0.0 or max(seen.rises(base)) <= 0.0:
            return look
        # what acts strongly was scaled too far: its samples are not proportional to its strength
        return max(look, look_from(model, _of_all(data, model, seen, work)), key=lambda one: one.gain)
    return look_from(model, _of_all(data, model, seen, work))


def _slopes_at(
    data: Recorded, base: JointFit, candidate: Candidate, model: Model, at: PointwiseDensity, work: Executor
) -> tuple[Slopes, ...]:
    """Slopes at a start: derivatives of ``base``, and new ones by the parameters of the candidate."""
    known = {*base.model.individual, *base.model.shared}
    new = {}
    if len(candidate.strengths) == 1:
        # between zero and the start, the change of the samples is proportional to the strength
        new = {k: differences(base.samples, at, float(model.rows[0, k]), model.rows) for k in candidate.strengths}
    for k in (*model.individual, *model.shared):
        if k not in known and k not in new:
            new[k] = _column(data, model, at, k, work)
    return joined(data, base, model, at, new)


def _of_all(data: Recorded, model: Model, seen: Prescreen, work: Executor) -> PointwiseDensity:
    """The samples of all drivers at the best start of a prescreen, which knows them for some drivers."""
    samples = evaluate(data.roughly, model, work, [i for i in range(data.drivers) if i not in seen.some])
    for i, known in seen.at.items():
        samples.put(i, known)
    return samples


def screen_again(
    data: Recorded, base: JointFit, before: JointFit, look: Screened, work: Executor, effort: Effort
) -> Screened:
    """Screen a candidate again from the end of an earlier look, which was taken with the model ``before``."""
    model = _carried_over(before, look, base)
    at = evaluate(data.roughly, model, work)
    again = replace(look, fit=JointFit(model, at, joined(data, base, model, at, _columns(look.fit))))
    return _first_steps(data, base, again, work, effort)


def _first_steps(data: Recorded, base: JointFit, look: Screened, work: Executor, effort: Effort) -> Screened:
    """Take the first steps of a look, if the predicted gain is large enough."""
    everywhere = range(FOLDS)
    gain = objective(look.fit.slopes, look.fit.model, everywhere) - objective(base.slopes, base.model, everywhere)
    predicted_gain = solve(look.fit.slopes, look.fit.model, everywhere, 1e-3).predicted_gain
    look = replace(look, gain=gain, predicted_gain=predicted_gain)
    return _further(data, look, work, effort.looks) if gain + predicted_gain > _HOPELESS else look


def closer(data: Recorded, look: Screened, work: Executor) -> Screened:
    """Take a few more steps of a look, if the predicted gain is large enough."""
    return _further(data, look, work, _CLOSER) if look.gain + look.predicted_gain > _HOPELESS else look


def _further(data: Recorded, look: Screened, work: Executor, steps: int) -> Screened:
    """Take more steps of a look, without new derivatives."""
    fitted = maximise(data.roughly, look.fit, work, iterations=steps, enough=_LEAST_PREDICTED, renewals=0)
    everywhere = range(FOLDS)
    rise = objective(fitted.slopes, fitted.model, everywhere) - objective(look.fit.slopes, look.fit.model, everywhere)
    predicted_gain = solve(fitted.slopes, fitted.model, everywhere, 1e-3).predicted_gain
    return replace(look, fit=fitted, gain=look.gain + rise, predicted_gain=predicted_gain)


def refine(data: Recorded, look: Screened, work: Executor, effort: Effort = FULL) -> JointFit:
    """Fit a model with a candidate in full, from the end of a look."""
    return maximise(data, look.fit, work, iterations=effort.steps, renewals=effort.renewals, fresh=False)


def with_candidate(data: Recorded, base: JointFit, candidate: Candidate, work: Executor) -> JointFit:
    """Add a candidate to a fitted model, and fit the new model in full."""
    return refine(data, screen(data, base, candidate, work), work)


def _carried_over(before: JointFit, look: Screened, current: JointFit) -> Model:
    """The current model with a candidate from an earlier look, and with the response of the other parameters then."""
    candidate = look.candidate
    model = added(current.model, candidate, candidate.starts[0])
    rows = model.rows.copy()
    rows[:, candidate.entries] = look.fit.model.rows[:, candidate.entries]
    own = list(before.model.individual)
    shift = coordinate(look.fit.model.rows[:, own], own) - coordinate(before.model.rows[:, own], own)
    rows[:, own] = value(coordinate(rows[:, own], own) + shift, own)
    return replace(model, rows=rows)


def forecast(data: Recorded, before: JointFit, look: Screened, current: JointFit) -> float:
    """Predict the gain of a candidate over the current model from an earlier look, without running a filter.

    The prediction assumes that the candidate changes every sample by the same amount as in the earlier look.

    Parameters
    ----------
    data : Recorded
        The recording.
    before : JointFit
        The model at the time of the look.
    look : Screened
        The earlier look.
    current : JointFit
        The current model.

    Returns
    -------
    float
        Predicted gain [nats].
    """
    candidate = look.candidate
    model = added(current.model, candidate, {})
    rows = model.rows.copy()
    rows[:, candidate.entries] = look.fit.model.rows[:, candidate.entries]
    model = replace(model, rows=rows)
    now, then, with_it = current.samples, before.samples, look.fit.samples
    y = now.innovation_m + with_it.innovation_m - then.innovation_m
    variance = now.innovation_var * (with_it.innovation_var / then.innovation_var)
    density = np.empty_like(y)
    for i, row in enumerate(rows):
        weigh_samples(y[i], variance[i], row, np.empty_like(y[i]), density[i])
    density[np.isnan(now.log_likelihood)] = np.nan
    here = joined(data, current, model, PointwiseDensity(y, variance, density), _columns(look.fit))
    everywhere = range(FOLDS)
    reached = objective(here, model, everywhere) + solve(here, model, everywhere, 1e-3).predicted_gain
    return reached - objective(current.slopes, current.model, everywhere)


def _strongest(data: Recorded, base: JointFit, seen: Prescreen) -> dict[int, float | Array]:
    """The start with the largest predicted gain, whose strengths are scaled to fit the samples; values by place."""
    strengths = seen.candidate.strengths
    return {
        k: float(np.clip(v, ROW.declared[k].lower, ROW.declared[k].upper)) if k in strengths else v
        for k, v in promised(data, base, seen)[1].items()
    }


def _columns(fitted: JointFit) -> dict[int, list[Column]]:
    """Derivatives of every driver's samples by each parameter of a fit, as ``_column`` returns them."""
    places = (*fitted.model.individual, *fitted.model.shared)
    return {k: [s.columns[j] for s in fitted.slopes] for j, k in enumerate(places)}


def _column(data: Recorded, model: Model, at: PointwiseDensity, place: int, work: Executor) -> list[Column]:
    """Derivatives of every driver's samples by one parameter."""
    coordinates = coordinate(model.rows[:, [place]], [place])
    step = float(difference_steps(data, [place])[0])
    rows = model.rows.copy()
    rows[:, place] = value(coordinates + step, [place])[:, 0]
    return differences(at, evaluate(data.roughly, replace(model, rows=rows), work), step, model.rows)
