"""Classes of drivers who share their parameters, for recordings that are too short to fit each driver alone.

The classes are a mixture model (latent classes), fitted by the EM algorithm (Dempster, Laird and Rubin, J. R. Stat.
Soc. B 39 (1977) 1). Each maximisation is one step of Fisher scoring. The class of each driver is known with a
probability.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, index
from sugiyama_ros.filters.paper import Scored
from sugiyama_ros.fit.coordinates import coordinate, damped_step
from sugiyama_ros.fit.driver import STEPS, Fit, Job, carry_out, derivatives, untouched

if TYPE_CHECKING:
    # The online filter is not needed to keep or write the classes, and takes long to load.
    from sugiyama_ros.filters.online import Learnt

# The search ends when a step gains less than this [nats]; longest step of a logarithm.
_ENOUGH, _LONGEST = 0.05, 0.3
# Number of starts.
_STARTS = 4


@dataclass(frozen=True, eq=False)
class Classes:
    """K classes of N drivers, the largest class first.

    rows: (K, P), parameters of each class; std: (K, P), standard deviations of the parameters, as if the class of every
    driver were known; share: (K,), share of the drivers in each class; probability: (N, K), probability that a driver
    belongs to a class; log_likelihood: (N,), log-likelihood of each driver under the mixture [nats]; bic: bayesian
    information criterion.
    """

    rows: Array
    std: Array
    share: Array
    probability: Array
    log_likelihood: Array
    bic: float


def find_classes(jobs: Sequence[Job], count: int, samples: int, seed: int, work: Executor) -> Classes:
    """Divide drivers into classes."""
    # the search starts from the fits of the single drivers
    fits, places = list(work.map(carry_out, jobs)), jobs[0].places
    rows = max(
        (_divided(fits, jobs[0], count, seed + k) for k in range(_STARTS)),
        key=lambda start: float(_posterior(_scores(jobs, start, None, work), np.full(count, 1.0 / count))[0].sum()),
    )
    share = np.full(count, 1.0 / count)
    scores = _scores(jobs, rows, None, work)
    value, probability = _posterior(scores, share)
    shrink = 1.0
    for _ in range(STEPS):
        gradient, information = _expected(scores, probability)
        moved = np.array([_moved(jobs[0], *one, shrink) for one in zip(rows, gradient, information, strict=True)])
        shares = np.maximum(probability.mean(axis=0), 1e-6)
        scores_there = _scores(jobs, moved, information, work)
        value_there, probability_there = _posterior(scores_there, shares)
        rise = float(value_there.sum() - value.sum())
        if rise < 0.0 and shrink > 0.1:
            shrink *= 0.5
            continue
        if rise > 0.0:
            rows, share, scores, value, probability = moved, shares, scores_there, value_there, probability_there
        if rise < _ENOUGH:
            break
    std = np.zeros_like(rows)
    for k, information_of_class in enumerate(_expected(scores, probability)[1]):
        held = information_of_class[np.ix_(places, places)]
        found = np.sqrt(np.maximum(np.diag(np.linalg.pinv(held, hermitian=True)), 0.0))
        std[k, places] = np.where(untouched(held, rows[k, places]), np.inf, found)
    order = np.argsort(-share)
    free = count * len(places) + count - 1
    bic = -2.0 * float(value.sum()) + free * float(np.log(samples))
    return Classes(
        rows=rows[order],
        std=std[order],
        share=share[order],
        probability=probability[:, order],
        log_likelihood=value,
        bic=bic,
    )


def _expected(scores: Sequence[Sequence[Scored]], probability: Array) -> tuple[list[Array], list[Array]]:
    """Gradient (P,) and information (P, P) of each class; the probability of the class weights each driver."""
    pairs, classes = list(zip(probability, scores, strict=True)), range(probability.shape[1])
    gradient = [np.asarray(sum(r[k] * s[k].gradient for r, s in pairs)) for k in classes]
    return gradient, [np.asarray(sum(r[k] * s[k].information for r, s in pairs)) for k in classes]


def _moved(job: Job, row: Array, gradient: Array, information: Array, share: float) -> Array:
    """Parameters (P,) of a class after a ``share`` of a step of Fisher scoring."""
    slope, curvature = derivatives(Scored(0.0, gradient, information), row, job.places)
    # the ridge defines the step of a class without drivers
    step = np.clip(damped_step(curvature, slope, 0.0, 1e-6), -_LONGEST, _LONGEST)
    x = coordinate(row[job.places], job.places) + share * step
    return replace(job, start=row).parameters(np.clip(x, *job.ends))


def _scores(
    jobs: Sequence[Job], rows: Array, information: Sequence[Array] | None, work: Executor
) -> list[list[Scored]]:
    """Score of every driver's samples under every class."""
    return list(work.map(_score, [(job, rows, information) for job in jobs]))


def _score(task: tuple[Job, Array, Sequence[Array] | None]) -> list[Scored]:
    job, rows, information = task
    return [job.score(row, information[k] if information is not None else None) for k, row in enumerate(rows)]


def _posterior(scores: Sequence[Sequence[Scored]], share: Array) -> tuple[Array, Array]:
    """Log-likelihood (N,) of the mixture, and probabilities (N, K) of the classes."""
    # Imported here, and kmeans2 below too: only a search for classes needs scipy, which takes long to load.
    from scipy.special import logsumexp

    joint = np.array([[s.log_likelihood for s in one] for one in scores]) + np.log(share)
    value = logsumexp(joint, axis=1)
    return value, np.exp(joint - value[:, None])


def _divided(fits: Sequence[Fit], job: Job, count: int, seed: int) -> Array:
    """Parameters (K, P) of the classes at the start: centres of clusters of the fits of single drivers."""
    from scipy.cluster.vq import kmeans2

    points = np.log(np.abs([fit.parameters[job.places] for fit in fits]))
    middle, spread = np.median(points, axis=0), np.maximum(np.std(points, axis=0), 1e-6)
    # a fit that is far from all others must not be a class of its own
    clipped = np.clip((points - middle) / spread, -2.0, 2.0)
    centres, _ = kmeans2(clipped, count, minit="++", rng=np.random.default_rng(seed), missing="warn")
    rows = np.tile(fits[0].parameters, (count, 1))
    rows[:, job.places] = np.sign(fits[0].parameters[job.places]) * np.exp(middle + spread * centres)
    return rows


@dataclass(frozen=True, eq=False)
class DriverTypes:
    """Classes of drivers, as ``fit.classes`` finds them.

    share: (K,), share of all drivers in each class; rows: (K, P), parameters of each class.
    """

    share: Array
    rows: Array

    def probabilities(self, learnt: "Learnt", prior: "Learnt") -> Array:
        """Return the probability (K,) of each class for one driver.

        Both arguments are normal distributions of logarithms. Their ratio is the likelihood that the samples give to
        the parameters of a class.
        """
        # Imported here: commands that only read or write classes start sooner without scipy.
        from scipy.special import softmax

        # the classes say nothing of parameters of effects
        of_driver = [k for k, name in enumerate(learnt.names) if name in NAMES]
        logs = np.log(self.rows[:, [index(learnt.names[k]) for k in of_driver]])
        gain = _log_density(logs, learnt, of_driver) - _log_density(logs, prior, of_driver)
        return np.asarray(softmax(np.log(self.share) + gain))


def _log_density(logs: Array, learnt: "Learnt", chosen: list[int]) -> Array:
    """Log-density (K,) of the chosen parameters at points (K, A), without the terms that are equal for all points."""
    off, covariance = logs - learnt.mean[chosen], learnt.covariance[np.ix_(chosen, chosen)]
    return np.asarray(-0.5 * np.sum(off * np.linalg.solve(covariance, off.T).T, axis=1))
