"""What chance gives in the same procedure: one null distribution for everything that is scored.

Recordings that the fitted model simulates are scored as the data are: the approximations of the filter shift scores
even where nothing is missing, and what they give on average is taken off. The rest is chance. Its distribution comes
from a multiplier bootstrap: the scores that are left in each block after the best strength is taken out, times random
signs and sizes. The largest gain of all candidates, in all their forms, starts and places, is compared with the largest
one of each draw, so no factor for the number of tests is needed.

References
----------
P. H. Westfall and S. S. Young, Resampling-Based Multiple Testing (1993). V. Chernozhukov, D. Chetverikov and K. Kato,
Ann. Statist. 41 (2013) 2786.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.stats import norm

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.score import Score
from sugiyama_ros.statistics import ALPHA, Tail

# Draws from the null distribution: the smallest p-value is a thousandth.
_DRAWS = 999
# The score of a block counts up to so many standard deviations by chance: a filter that is far off at one moment, as
# after hard braking, must not stand for all (Huber's psi function).
_LARGEST = 3.0


class Chance(NamedTuple):
    """What chance gives.

    p_values: How probable it is that any candidate shows as much by chance as each mechanism does; by chance, the
    smallest one is uniform; improbable: -ln p of each candidate alone, by name; needed: Gain [nats] that each
    candidate needs for a p-value of ``ALPHA``, by name.
    """

    p_values: dict[str, float]
    improbable: dict[str, float]
    needed: dict[str, float]

    @property
    def shows_something(self) -> bool:
        """Whether anything gains more than by chance."""
        return min(self.p_values.values(), default=1.0) < ALPHA


def chance_of(
    data_scores: Sequence[Score],
    simulated: Sequence[Sequence[Score]],
    seed: int,
    drawn: dict[Score, tuple[float, Array]] | None = None,
) -> Chance:
    """Return what chance gives in scores; simulated: those of simulated recordings; drawn: kept for the next call."""
    drawn = {} if drawn is None else drawn
    shifts = [{_key(one): one for one in each} for each in simulated]
    # what was chosen among many places has one block, and everything else those of the recording
    blocks = max((len(one.driver) for one in data_scores), default=0)
    multipliers = np.random.default_rng(seed).standard_normal((1 + len(simulated), _DRAWS, blocks))
    alone: dict[str, float] = {}
    largest: dict[str, float] = {}
    tails: dict[str, Tail] = {}
    by_chance = np.full(_DRAWS, -np.inf)
    for one in data_scores:
        there = [known[_key(one)] for known in shifts if _key(one) in known]
        if there or one not in drawn:
            drawn[one] = _observed_and_null(one, there, multipliers)
        observed, null = drawn[one]
        tail, name, mechanism = Tail.of(null), one.candidate.name, one.candidate.mechanism
        alone[name] = max(alone.get(name, -np.inf), float(tail.improbable(observed)))
        largest[mechanism] = max(largest.get(mechanism, -np.inf), alone[name])
        tails.setdefault(name, tail)
        by_chance = np.maximum(by_chance, tail.improbable(null))
    p = {name: float((1 + np.count_nonzero(by_chance >= z)) / (1 + _DRAWS)) for name, z in largest.items()}
    level = float(np.quantile(by_chance, 1.0 - ALPHA)) if largest else 0.0
    return Chance(p, alone, {name: tail.gain_at(level) for name, tail in tails.items()})


def _key(one: Score) -> tuple[object, ...]:
    """What identifies the score of a candidate at a start in another recording."""
    start = () if one.candidate.kind == "force" else tuple(repr(v) for v in one.starts)
    return one.candidate.name, *start


def _observed_and_null(one: Score, simulated: Sequence[Score], multipliers: Array) -> tuple[float, Array]:
    """The gain of a score, and the gains of draws by chance, (B,): the smaller one of two.

    A candidate must gain beside the model, and beyond what simulations give on average.
    """
    if one.information is None:
        # by chance, a likelihood ratio is at least e^g with a probability of at most e^-g (Markov)
        beyond = min((one.gain, *(one.gain - other.gain for other in simulated)))
        return max(beyond, 0.0), -norm.logsf(multipliers[0, :, 0])
    left, count = _left(one), len(simulated)
    total = one.summed(_limited(one))
    draws, *others = (one.summed(left, part) for part in multipliers[: 1 + len(simulated)])
    observed, null = one.gains(total), one.gains(draws)
    if simulated:
        shift = sum(other.summed(_limited(other)) / count for other in simulated)
        observed = np.minimum(observed, one.gains(total - shift))
        null = np.minimum(null, one.gains(draws - sum(other / count for other in others)))
    return float(observed[0]), null


def _left(one: Score) -> Array:
    """What is left of the scores of all blocks (G, K) after the best strength is taken out, as large as by chance."""
    assert one.information is not None
    information = np.maximum(np.einsum("gjj->gj", one.information), 1e-300)
    strength = one.strength[one.driver] if one.is_by_driver else np.broadcast_to(one.strength, one.score.shape)
    left = one.score - np.einsum("gjk,gk->gj", one.information, strength)
    if one.candidate.individual:
        # a block that says much of its driver leaves little (leverage)
        total = np.diagonal(one.total, axis1=-2, axis2=-1)[one.driver]
        left = left / np.sqrt(1.0 - information / total * (1.0 + 1.0 / total))
    limited = _limited(replace(one, score=left))
    size = _dispersion(one, left, information) * information.sum(axis=0)
    return np.asarray(limited * np.sqrt(size / np.maximum(np.square(limited).sum(axis=0), 1e-300)))


def _dispersion(one: Score, left: Array, information: Array) -> float:
    """By what factor scores vary more than the model says: the largest one over blocks, drivers and times, or 1.

    The same camera sees all drivers, leaders and followers see each other, and a driver is the same at all times. The
    median keeps out what few drivers or few moments have: that may be the effect. Where each driver has their own
    strength, only the blocks of a driver are added up.
    """
    factors, usual, blocks = [1.0], norm.ppf(0.75), np.arange(len(left))
    for unit in (blocks,) if one.candidate.individual else (blocks, one.driver, one.time):
        number = np.unique(unit, return_inverse=True)[1]
        sums, known = (np.stack([np.bincount(number, c) for c in values.T]) for values in (left, information))
        typical = np.median(np.abs(sums) / np.sqrt(np.maximum(known, 1e-300)), axis=1)
        factors.append(float(np.mean(np.square(typical / usual))))
    return max(factors)


def _limited(one: Score) -> Array:
    """Scores (G, K) whose size is limited to what a block gives by chance, a few times."""
    if one.information is None:
        return one.score
    std = np.sqrt(np.maximum(np.diagonal(one.information, axis1=1, axis2=2), 0.0))
    return np.asarray(np.clip(one.score, -_LARGEST * std, _LARGEST * std))
