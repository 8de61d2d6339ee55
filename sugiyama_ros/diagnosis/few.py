"""Effects that only some drivers have.

A fit of something to all drivers raises the log posterior of each driver by some amount. Where a few drivers bring
nearly all of the gain, they may do something that the others do not do, and what was fitted may be only the nearest
name for it. Each mechanism is then fitted to these drivers alone. The choice of the drivers costs what it is worth by
chance: the logarithm of the number of choices.
"""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidacy import LEAST_GAIN
from sugiyama_ros.diagnosis.candidates import Candidate, added
from sugiyama_ros.diagnosis.chance import of_best
from sugiyama_ros.diagnosis.near import joined
from sugiyama_ros.diagnosis.response import predicted, predicted_by_driver
from sugiyama_ros.effects.registry import EFFECTS, index_of
from sugiyama_ros.fit.joint import JointFit, maximise, objectives, renewed, rise
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import PointwiseDensity, predict_drivers
from sugiyama_ros.fit.slopes import Column

# At most one driver in so many counts as a few, and at most so many drivers.
_PART, _MOST = 4, 8
# Gains by chance are larger than half a chi-squared variable, because the filter is an approximation.
_INFLATION = 2.0
# A driver shows something with this share of the largest gain of a driver, and with at least this gain [nats].
_SHARE_OF_LARGEST, _LEAST = 0.25, 4.0
# The others must lose this share of what a few drivers gain. If f of all that the data say of an effect is of the few
# who have it, a strength that all share costs the others (1 - f) / (2 - f) of what it brings the few: 0.46 for 3 of 22.
_LOST = 0.1
_STEPS, _RENEWALS = 10, 3

#: Level of significance: stricter than for all drivers, because no simulation says what the choice gains by chance.
LEVEL_OF_FEW = 0.001


@dataclass(frozen=True)
class Few:
    """Drivers who bring nearly all of a gain.

    Parameters
    ----------
    drivers : tuple of int
        Their columns.
    cost : float
        What the choice of the drivers gains by chance [nats].
    """

    drivers: tuple[int, ...]
    cost: float

    def p_value(self, rise: float, parameters: int, candidates: int) -> float:
        """Return the probability of a gain [nats] by chance, corrected for the choice among drivers and candidates."""
        alone = float(chi2.sf(2.0 * max(rise, 0.0) / _INFLATION, parameters))
        return of_best(alone, candidates * math.exp(self.cost / _INFLATION))


@dataclass(frozen=True, eq=False)
class FitOfFew:
    """An effect that only some drivers have.

    Parameters
    ----------
    candidate : Candidate
        The effect.
    few : Few
        The drivers.
    fit : JointFit
        The model with the effect.
    gain : float
        Rise of the log posterior [nats] over the model without the effect.
    p_value : float
        Probability of such a gain by chance, corrected for the choice among drivers and candidates.
    """

    candidate: Candidate
    few: Few
    fit: JointFit
    gain: float
    p_value: float


def at_most(drivers: int) -> int:
    """How many drivers count as a few."""
    return min(drivers // _PART, _MOST)


def cost_of(chosen: int, drivers: int) -> float:
    """Return what a choice of some of the drivers gains by chance [nats]."""
    ways = gammaln(drivers + 1) - gammaln(chosen + 1) - gammaln(drivers - chosen + 1)
    return _INFLATION * float(ways)


def rises(base: JointFit, fitted: JointFit) -> Array:
    """Return how much larger the log posterior of each driver is in ``fitted`` than in ``base`` (N,) [nats]."""
    everywhere = range(FOLDS)
    return objectives(fitted.slopes, fitted.model, everywhere) - objectives(base.slopes, base.model, everywhere)


def who_shows(base: JointFit, fitted: JointFit, least: float = LEAST_GAIN) -> Few | None:
    """Find the few drivers who bring the gain of a fit over another, if the others lose by it.

    Others whose data hardly say anything neither gain nor lose, and may have what was added, too.

    Parameters
    ----------
    base, fitted : JointFit
        A model, and the model with something added for all drivers.
    least : float
        Smallest gain [nats] beyond what the choice of the drivers costs.

    Returns
    -------
    Few or None
        The drivers; None if many drivers bring the gain, if the others do not lose, or if there are too few drivers.
    """
    gains = rises(base, fitted)
    total, drivers = float(gains.sum()), len(gains)
    chosen = np.flatnonzero(gains > max(_SHARE_OF_LARGEST * gains.max(), _LEAST))
    if not 0 < len(chosen) <= at_most(drivers):
        return None
    theirs, cost = float(gains[chosen].sum()), cost_of(len(chosen), drivers)
    is_clear = theirs - cost > least and total - theirs < -_LOST * theirs
    return Few(tuple(chosen.tolist()), cost) if is_clear else None


def switches_of(candidate: Candidate) -> tuple[int, ...]:
    """Return the places of the strengths of an effect; none for what every driver has for themselves."""
    if candidate.individual or candidate.happens_once or candidate.name not in EFFECTS:
        return ()
    return tuple(index_of(candidate.name, name) for name in EFFECTS[candidate.name].switches)


def fit_few(
    data: Recorded, base: JointFit, candidate: Candidate, few: Few, candidates: int, work: Executor
) -> FitOfFew:
    """Fit an effect to the drivers who show it, without those who gain nothing, and with further ones who then gain.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The model without the effect.
    candidate : Candidate
        The effect; ``switches_of`` returns its strengths.
    few : Few
        The drivers.
    candidates : int
        Number of candidates, for the correction of the p-value.
    work : Executor
        Runs the filters.

    Returns
    -------
    FitOfFew
        The model with the effect.
    """
    alone = _alone(data, base)

    def better(one: FitOfFew, others: Sequence[Few]) -> FitOfFew:
        """The best of a fit and fits to other drivers, which begin where the fit ended."""
        row = one.fit.model.rows[one.few.drivers[0]]
        there = replace(candidate, starts=({k: float(row[k]) for k in candidate.entries},))
        again = [_fit(data, alone, there, who, candidates, work) for who in others]
        return max((one, *again), key=lambda f: f.gain - f.few.cost)

    found = _fit(data, alone, candidate, few, candidates, work)
    if found.p_value <= LEVEL_OF_FEW:
        found = better(found, _narrowed(data, alone, found))
        found = better(found, _widened(data, alone, found, work))
    found = replace(found, candidate=candidate)
    return replace(found, fit=_together(data, base, found.fit))


def _alone(data: Recorded, base: JointFit) -> JointFit:
    """A fit whose shared parameters are held: what a few drivers have then moves nobody else."""
    model, shared = base.model, list(base.model.shared)
    ahead = model.ahead.copy()
    ahead[:, shared] = model.rows[:, shared]
    held = replace(model, shared=(), few=(), ahead=ahead)
    return JointFit(held, base.samples, joined(data, base, held, base.samples, {}))


def _together(data: Recorded, base: JointFit, fitted: JointFit) -> JointFit:
    """A fit in which the shared parameters of ``base`` may move again."""
    model = replace(fitted.model, shared=base.model.shared + fitted.model.shared, few=base.model.few + fitted.model.few)
    new = {k: [s.columns[len(model.individual) + j] for s in fitted.slopes] for j, k in enumerate(fitted.model.shared)}
    return JointFit(model, fitted.samples, joined(data, base, model, fitted.samples, new))


def _fit(data: Recorded, base: JointFit, candidate: Candidate, few: Few, candidates: int, work: Executor) -> FitOfFew:
    """Fit an effect that only some drivers have."""
    starts = [_start(data, base, candidate, few, k, work) for k in range(len(candidate.starts))]
    model, samples = max(starts, key=lambda start: predicted(base, *start))
    nothing: list[Column] = [(np.zeros(data.samples),) * 3] * data.drivers
    new = {k: nothing for k in model.shared}
    start = JointFit(model, samples, joined(data, base, model, samples, new))
    start = renewed(data, start, work, np.isin(np.arange(data.drivers), few.drivers))
    fitted = maximise(data, start, work, iterations=_STEPS, renewals=_RENEWALS)
    gained = rise(base, fitted)
    return FitOfFew(candidate, few, fitted, gained, few.p_value(gained, len(candidate.places), candidates))


def _start(
    data: Recorded, base: JointFit, candidate: Candidate, few: Few, number: int, work: Executor
) -> tuple[Model, PointwiseDensity]:
    """One of the starts of an effect of a few drivers, and the samples there."""
    model, places = added(base.model, candidate, candidate.starts[number]), switches_of(candidate)
    rows = model.rows.copy()
    others = [i for i in range(data.drivers) if i not in few.drivers]
    rows[np.ix_(others, list(places))] = 0.0
    model = replace(model, rows=rows, few=(*model.few, *((k, few.drivers) for k in places)))
    return model, _anew(data, base, model, few.drivers, work)


def _anew(data: Recorded, base: JointFit, model: Model, who: Sequence[int], work: Executor) -> PointwiseDensity:
    """The samples of ``base``, and of some drivers those at a model."""
    samples = base.samples.copy()
    for i, one in zip(who, predict_drivers(data, model, who, work), strict=True):
        samples.put(i, one)
    return samples


def _narrowed(data: Recorded, base: JointFit, one: FitOfFew) -> list[Few]:
    """The drivers of a fit who gain by it, if some do and some do not."""
    gains = rises(base, one.fit)
    left = tuple(i for i in one.few.drivers if gains[i] > _LEAST)
    return [Few(left, cost_of(len(left), data.drivers))] if 0 < len(left) < len(one.few.drivers) else []


def _widened(data: Recorded, base: JointFit, one: FitOfFew, work: Executor) -> list[Few]:
    """The drivers of a fit, and others who gain by the effect at this strength, if there are some and not too many."""
    has = set(one.few.drivers)
    others = [i for i in range(data.drivers) if i not in has]
    rows, places = one.fit.model.rows.copy(), list(one.candidate.places)
    rows[np.ix_(others, places)] = rows[one.few.drivers[0], places]
    model = replace(one.fit.model, rows=rows, few=base.model.few)
    promised = predicted_by_driver(base, model, _anew(data, base, model, others, work))
    gains = promised - np.nansum(base.samples.log_likelihood, axis=1)
    more = [i for i in others if gains[i] > _LEAST]
    if not more or len(has) + len(more) > at_most(data.drivers):
        return []
    return [Few(tuple(sorted((*has, *more))), cost_of(len(has) + len(more), data.drivers))]
