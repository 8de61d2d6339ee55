"""Some drivers only: who shows an effect, if a few drivers show it and the others do not.

A fit that gives an effect to all drivers says, for each of them, how strong the effect would be for this driver alone
and how well it is known. From these the gain of an effect that only some drivers have follows, for any choice of
drivers, without running the filter. The choice costs what it is worth by chance: the logarithm of the number of
choices.
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
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.effects.registry import EFFECTS, ROW, index_of
from sugiyama_ros.fit.joint import JointFit, maximise, objectives, start_fit
from sugiyama_ros.fit.model import Model, is_linear
from sugiyama_ros.fit.recording import FOLDS, Recorded

# At most one driver in so many counts as a few, among at least so many drivers.
_PART, _FEWEST = 3, 4
# Gains by chance are larger than half a chi-squared variable, because the filter is an approximation.
_INFLATION = 2.0
# The strength is at most so many times the strength of the fit to all drivers.
_FURTHEST = 10.0
_STEPS = 20


#: Level of significance: stricter than for all drivers, because no simulation says what the choice gains by chance.
LEVEL_OF_FEW = 0.001


@dataclass(frozen=True, eq=False)
class Few:
    """Drivers who may be the only ones with an effect.

    Parameters
    ----------
    drivers : tuple of int
        Their columns.
    gain : float
        Gain of the effect if only they have it [nats], to second order.
    all_gain : float
        Gain of the effect if all drivers have it [nats], to second order.
    cost : float
        What the choice of the drivers gains by chance [nats].
    strength : dict of int to float
        Strength of the effect that fits these drivers, by place.
    """

    drivers: tuple[int, ...]
    gain: float
    all_gain: float
    cost: float
    strength: dict[int, float]

    @property
    def is_better(self) -> bool:
        """Whether the effect gains more if only these drivers have it, beyond what the choice of the drivers costs."""
        return self.gain - self.cost > max(self.all_gain, 0.0) + LEAST_GAIN

    def p_value(self, rise: float, candidates: int) -> float:
        """Return the probability of a gain [nats] by chance, corrected for the choice among drivers and candidates."""
        alone = float(chi2.sf(2.0 * max(rise, 0.0) / _INFLATION, len(self.strength)))
        return min(1.0, candidates * math.exp(self.cost / _INFLATION) * alone)


def cost_of(chosen: int, drivers: int) -> float:
    """Return what a choice of some of the drivers gains by chance [nats]."""
    ways = gammaln(drivers + 1) - gammaln(chosen + 1) - gammaln(drivers - chosen + 1)
    return _INFLATION * float(ways)


def switches_of(candidate: Candidate) -> tuple[int, ...]:
    """Return the places of the strengths of an effect; none for what every driver has for themselves."""
    if candidate.individual or candidate.name not in EFFECTS:
        return ()
    return tuple(index_of(candidate.name, name) for name in EFFECTS[candidate.name].switches)


def who_shows(base: JointFit, look: JointFit, candidate: Candidate) -> Few | None:
    """Find the drivers who gain most by an effect that all drivers have in a fit.

    Along the strength of the effect, the log posterior of each driver is a parabola through three things that are
    known: its value without the effect, its value in the fit, and its slope there.

    Parameters
    ----------
    base : JointFit
        A fit without the effect.
    look : JointFit
        A fit with the effect.
    candidate : Candidate
        The effect.

    Returns
    -------
    Few or None
        The drivers; None if the effect gains more for all drivers, if it has no strength, or if there are too few
        drivers.
    """
    places, drivers = switches_of(candidate), len(look.model.rows)
    known = bool(places) and set(places) <= set(look.model.shared) and not look.model.few
    if not known or drivers < _FEWEST:
        return None
    pull, bend = _parabolas(base, look, places)
    has_signs = all(ROW.declared[k].lower < 0.0 for k in places)

    def best(chosen: Sequence[int]) -> tuple[float, float]:
        """Gain [nats] of some drivers, and the factor on the strength of the fit."""
        a, b = float(pull[list(chosen)].sum()), float(bend[list(chosen)].sum())
        factor = a / (2.0 * b) if b > 1e-9 else 1.0
        factor = float(np.clip(factor, -_FURTHEST if has_signs else 0.0, _FURTHEST))
        return a * factor - b * factor * factor, factor

    chosen: list[int] = []
    found: Few | None = None
    everybody = best(range(drivers))[0]
    for _ in range(max(1, drivers // _PART)):
        gains = {i: best([*chosen, i])[0] for i in range(drivers) if i not in chosen}
        chosen.append(max(gains, key=lambda i: gains[i]))
        (worth, factor), cost = best(chosen), cost_of(len(chosen), drivers)
        if found is None or worth - cost > found.gain - found.cost:
            strength = {k: factor * float(look.model.rows[0, k]) for k in places}
            found = Few(tuple(sorted(chosen)), worth, everybody, cost, strength)
    return found if found and found.is_better else None


def fit_few(data: Recorded, base: JointFit, look: JointFit, candidate: Candidate, few: Few, work: Executor) -> JointFit:
    """Fit an effect that only some drivers have.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The model without the effect.
    look : JointFit
        A model in which all drivers have the effect.
    candidate : Candidate
        The effect.
    few : Few
        The drivers.
    work : Executor
        Runs the filters.

    Returns
    -------
    JointFit
        The model with the effect.
    """
    places, rows = switches_of(candidate), base.model.rows.copy()
    rows[:, candidate.places] = look.model.rows[0, candidate.places]
    rows[:, places] = 0.0
    for k, strength in few.strength.items():
        least = 1e-3 if ROW.declared[k].lower >= 0.0 else ROW.declared[k].lower
        rows[list(few.drivers), k] = min(max(strength, least), 0.5 * ROW.declared[k].upper)
    new = tuple(k for k in candidate.places if k not in base.model.shared)
    model = replace(
        base.model,
        rows=rows,
        shared=base.model.shared + new,
        few=(*base.model.few, *((k, few.drivers) for k in places)),
    )
    return maximise(data, start_fit(data, model, work), work, iterations=_STEPS)


def _parabolas(base: JointFit, look: JointFit, places: tuple[int, ...]) -> tuple[Array, Array]:
    """Each driver's gain a t - b t² [nats] at t times the strength of a fit: a and b, (N,) each.

    The individual parameters of each driver respond; the place or the time of an effect stays.
    """
    model: Model = look.model
    own, everywhere = len(model.individual), range(FOLDS)
    at = [own + model.shared.index(k) for k in places]
    prior, std = np.diag(1.0 / np.array(model.prior_std) ** 2), np.array(model.prior_std)
    # a strength grows by itself; its logarithm grows by 1
    ray = np.where(is_linear(places), model.rows[0, list(places)], 1.0)
    rise = objectives(look.slopes, model, everywhere) - objectives(base.slopes, base.model, everywhere)
    slope = np.zeros_like(rise)
    for i, s in enumerate(look.slopes):
        g, h = s.score.sum(axis=0), s.information.sum(axis=0)
        towards = g[:own] - model.away[i] / std
        response = np.linalg.solve(h[:own, :own] + prior, towards)
        rise[i] += 0.5 * float(towards @ response)
        slope[i] = float(ray @ (g[at] - h[np.ix_(at, range(own))] @ response))
    return 2.0 * rise - slope, rise - slope
