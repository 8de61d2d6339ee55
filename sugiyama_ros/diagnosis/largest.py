"""The largest gain among all candidates, compared with what chance gives: a test of all candidates at once.

Gains of candidates are correlated, and many are limited by bounds, so no number of independent tests stands for them.
Here the scores of all starts have a joint normal distribution, whose covariance is the information of the starts while
the parameters of the model respond. Approximations of the filter shift the scores, of each driver differently, and more
in a jam than in free flow. The same drivers in a recording that the model simulates, with traffic like the measured
one, tell by how much. Now and then the filter is far off at one moment, such as hard braking, which makes the score of
this driver larger than chance does: so the score of each driver is limited.
"""

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm, wasserstein_distance

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidacy import Candidacy
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.chance import of_best
from sugiyama_ros.diagnosis.prescreen import Prescreen, Promise, prescreen
from sugiyama_ros.diagnosis.response import while_own_respond
from sugiyama_ros.fit.cross_validation import Gain
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.slopes import sums

# Draws from the distribution.
_DRAWS = 4000
# The variance of scores beyond their information: with it, the smallest p-values of 34 simulated recordings of 17
# conditions are uniform (Kolmogorov-Smirnov: p = 0.8; without it 0.03, with 1.4 0.01).
_WIDER = 1.2
# Largest score of a driver, as a multiple of its std by chance.
_LARGEST = 3.0
# A start whose information is a smaller part of the largest one says nothing.
_NOTHING = 1e-9
# Time [s] over which speeds are compared.
_SPEED_OVER_S = 1.0


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of the starts of all candidates.

    Parameters
    ----------
    score : ndarray, shape (E,)
        Slope of the log posterior along each start, while the parameters of the model respond.
    information : ndarray, shape (E, E)
        Covariance of the scores.
    """

    score: Array
    information: Array


def p_values(
    data: Recorded,
    base: JointFit,
    prescreens: Mapping[str, Prescreen],
    simulations: Sequence[tuple[Recorded, JointFit]],
    seed: int,
    work: Executor,
) -> dict[str, float]:
    """Return how probable it is that any candidate shows as much by chance as each mechanism does.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without the candidates.
    prescreens : mapping of str to Prescreen
        Prescreens of the candidates, beside this model.
    simulations : sequence of (Recorded, JointFit)
        Recordings that the model simulates, with the fits to them. The one counts whose drivers are most often as fast
        as the measured ones.
    seed : int
        Seed of the draws.
    work : Executor
        Runs the filters.

    Returns
    -------
    dict of str to float
        The probabilities, by the name of the mechanism, for those whose starts change what all drivers do or what is
        measured of it; not for noises. The smallest one is uniform by chance.
    """
    seen = [one for one in prescreens.values() if _is_shared(one.candidate)]
    if not seen:
        return {}
    measured = _speeds(data)
    simulated, fitted = min(simulations, key=lambda one: wasserstein_distance(measured, _speeds(one[0])))
    here = scores(data, base, seen)
    there = scores(simulated, fitted, [prescreen(simulated, fitted, one.candidate, work) for one in seen])
    shift, covariance = here.score - there.score, _WIDER * (here.information + there.information)
    # what goes beyond all bounds at a start says nothing of weak effects
    known = np.isfinite(shift) & np.isfinite(np.diag(covariance))
    mechanisms = [one.candidate.mechanism for one in seen for _ in one.starts]
    shift, covariance = shift[known], covariance[np.ix_(known, known)]
    variance = np.diag(covariance)
    spread = np.where(variance > _NOTHING * variance.max(initial=0.0), np.sqrt(np.maximum(variance, 0.0)), np.inf)
    values, vectors = np.linalg.eigh(covariance / np.outer(spread, spread))
    normal = np.random.default_rng(seed).standard_normal((_DRAWS, len(values)))
    by_chance = np.abs(normal * np.sqrt(np.maximum(values, 0.0)) @ vectors.T).max(axis=1, initial=0.0)
    largest: dict[str, float] = {}
    for name, z in zip(np.array(mechanisms)[known].tolist(), np.abs(shift) / spread, strict=True):
        largest[name] = max(largest.get(name, 0.0), float(z))
    return {name: float((1 + np.count_nonzero(by_chance >= z)) / (1 + _DRAWS)) for name, z in largest.items()}


def with_p_values(
    found: Mapping[str, float], scored: Sequence[Candidacy], heldout: Mapping[str, Gain], rest: Iterable[Promise]
) -> tuple[list[Candidacy], list[Promise]]:
    """Return candidates with p-values from one test of all of them.

    What is not part of the test, such as noises, keeps its own p-value, unless its held-out gain is more probable.

    Parameters
    ----------
    found : mapping of str to float
        Probabilities by the name of the mechanism, as ``p_values`` returns them.
    scored : sequence of Candidacy
        Candidates that were screened.
    heldout : mapping of str to Gain
        Their held-out gains, by name.
    rest : iterable of Promise
        Candidates that were not screened.

    Returns
    -------
    scored : list of Candidacy
    rest : list of Promise
    """
    several = len(found) + len(scored)

    def p_value(one: Candidacy) -> float:
        if one.candidate.mechanism in found:
            return found[one.candidate.mechanism]
        won = heldout[one.candidate.name]
        return max(one.p_value, of_best(float(norm.sf(won.nats / max(won.se, 1e-9))), several))

    return (
        [replace(one, p_value=p_value(one)) for one in scored],
        [one._replace(p_value=found.get(one.candidate.mechanism)) for one in rest],
    )


def scores(data: Recorded, base: JointFit, seen: Sequence[Prescreen]) -> Scores:
    """Return the scores of the starts of all candidates, for the drivers of the prescreens."""
    known, columns = len(base.model.shared), [change for one in seen for change in one.changes]
    left = []
    for i in seen[0].some:
        by = [*base.slopes[i].columns[: len(base.model.individual) + known], *(one[i] for one in columns)]
        score, information = while_own_respond(base, i, sums(base.samples.of(i), by, base.model.rows[i], data.fold[i]))
        largest = _LARGEST * np.sqrt(np.maximum(np.diag(information), 0.0))
        left.append((np.clip(score, -largest, largest), information))
    g, h = (np.sum(part, axis=0) for part in zip(*left, strict=True))
    shared = np.linalg.pinv(h[:known, :known]) @ h[:known, known:]
    h = h[known:, known:] - h[known:, :known] @ shared
    return Scores(g[known:] - g[:known] @ shared, 0.5 * (h + h.T))


def _is_shared(candidate: Candidate) -> bool:
    """Whether starts of a candidate change the samples, for all drivers in the same way, and not only their noise."""
    return any(candidate.starts) and not (candidate.individual or candidate.happens_once or candidate.is_noise)


def _speeds(data: Recorded) -> Array:
    """Speeds [m/s] of all drivers."""
    period_s = data.vicinity.period_s
    steps = data.every * max(1, round(_SPEED_OVER_S / data.apart_s))
    position = np.array([data.vicinity.road.unwrap(chain.position_m[:, 0]) for chain in data.chains])
    speed = (position[:, steps:] - position[:, :-steps]) / (steps * period_s)
    return np.asarray(speed[np.isfinite(speed)], dtype=np.float64)
