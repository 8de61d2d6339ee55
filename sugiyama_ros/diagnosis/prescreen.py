"""The prescreen of a candidate: what its starts alone promise on some drivers, before it is screened.

It predicts the gain of a fit well, because the changes of the samples at a start serve as derivatives by the
strength. Most candidates have nothing to do with the data, so most of them need nothing more.
"""

from collections import defaultdict
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate, added
from sugiyama_ros.diagnosis.near import joined
from sugiyama_ros.diagnosis.response import predicted
from sugiyama_ros.fit.joint import JointFit, solve
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import DriverDensity, PointwiseDensity, evaluate_each
from sugiyama_ros.fit.slopes import Column, column, no_density

#: A candidate is screened if its prescreen predicts more than this gain [nats].
PROMISE = 5.0

# Drivers of a prescreen, or up to twice as many.
_DRIVERS = 11


@dataclass(frozen=True, eq=False)
class Prescreen:
    """What the starts of a candidate show on some drivers.

    Parameters
    ----------
    candidate : Candidate
        The candidate.
    some : range
        Numbers of the drivers.
    starts : tuple of dict of int to float or ndarray
        The starts, each with one strength at a time if there are several strengths.
    changes : tuple of dict of int to Column
        Changes of the samples of each of these drivers at each start.
    likelihoods : tuple of float
        Predicted log-likelihood of these drivers at each start, after their parameters have responded [nats].
    at : dict of int to DriverDensity
        Samples of each of these drivers at the best start.
    """

    candidate: Candidate
    some: range
    starts: tuple[dict[int, float | Array], ...]
    changes: tuple[dict[int, Column], ...]
    likelihoods: tuple[float, ...]
    at: dict[int, DriverDensity]

    @property
    def best(self) -> dict[int, float | Array]:
        """The start with the largest likelihood."""
        return self.starts[int(np.argmax(self.likelihoods))]

    @property
    def together(self) -> list[list[int]]:
        """Numbers of starts that differ only in which of several strengths they have."""
        if len(self.candidate.strengths) < 2:
            return [[number] for number in range(len(self.starts))]
        groups = defaultdict(list)
        for number, start in enumerate(self.starts):
            groups[tuple(v for k, v in start.items() if k not in self.candidate.strengths)].append(number)
        return list(groups.values())

    def ray(self, number: int) -> int:
        """Return the place of the parameter that stands for all that a start changes."""
        return next((k for k in self.candidate.strengths if self.starts[number][k]), self.candidate.places[0])

    def rises(self, base: JointFit) -> list[float]:
        """Return the rise of the log-likelihood from a model to each start [nats]; some drivers stand for all."""
        here = base.samples.only(self.some).total
        return [(there - here) * len(base.slopes) / len(self.some) for there in self.likelihoods]

    def lost(self, base: JointFit) -> tuple[float, float]:
        """Return the first parameter of the start at which drivers lose most, and what all drivers lose there [nats].

        An effect of this strength would have gained as much if it existed.

        Parameters
        ----------
        base : JointFit
            The model beside which it was prescreened.

        Returns
        -------
        value, loss : float
            0 and 0 if no start has this parameter.
        """
        first = self.candidate.places[0]
        numbers = [k for k, start in enumerate(self.starts) if self.ray(k) == first and first in start]
        if not numbers:
            return 0.0, 0.0
        rises = self.rises(base)
        worst = min(numbers, key=lambda k: rises[k])
        return float(np.max(self.starts[worst][first])), -rises[worst]


def prescreen(data: Recorded, base: JointFit, candidate: Candidate, work: Executor) -> Prescreen:
    """Look at the starts of a candidate on some drivers.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without the candidate.
    candidate : Candidate
        What to look at.
    work : Executor
        Runs the filters.

    Returns
    -------
    Prescreen
        What the starts show.
    """
    # a push moves one driver alone
    some = range(data.drivers) if candidate.happens_once else data.spread(_DRIVERS)
    likelihoods, changes = [], []
    best: PointwiseDensity | None = None
    starts = _one_at_a_time(candidate)
    models = [added(base.model, candidate, start) for start in starts]
    # a parameter that only becomes free changes nothing yet
    is_same = not any(starts) and set(base.model.shared) <= set(models[0].shared)
    there = [base.samples.only(some)] if is_same else evaluate_each(data.roughly, models, work, some)
    for model, at in zip(models, there, strict=True):
        changes.append({i: column(base.samples.of(i), at.of(i), 1.0, model.rows[i]) for i in some})
        likelihoods.append(predicted(base, model, at))
        if best is None or likelihoods[-1] >= max(likelihoods):
            best = at
    assert best is not None
    # copies, because the arrays have places for all drivers
    samples = {i: DriverDensity(*(values.copy() for values in best.of(i))) for i in some}
    return Prescreen(candidate, some, starts, tuple(changes), tuple(likelihoods), samples)


def _one_at_a_time(candidate: Candidate) -> tuple[dict[int, float | Array], ...]:
    """The starts of a candidate, each with one of its strengths at a time."""
    if len(candidate.strengths) < 2:
        return candidate.starts
    return tuple(
        start | {other: 0.0 for other in candidate.strengths if other != k}
        for start in candidate.starts
        for k in candidate.strengths
        if np.any(start[k])
    )


def promised(data: Recorded, base: JointFit, seen: Prescreen) -> tuple[float, dict[int, float | Array]]:
    """Predict the gain of a candidate, and the start that gains it, from its prescreen.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without the candidate, or a later model.
    seen : Prescreen
        The prescreen of the candidate, whose values all drivers share.

    Returns
    -------
    gain : float
        Predicted gain of all drivers [nats].
    start : dict of int to float or ndarray
        The start with the largest predicted gain, with its strengths scaled to fit the samples; values by place.
    """
    here, nothing = base.samples.only(seen.some), (no_density(data.samples),) * 3
    # the prior alone moves the drivers whose samples are left out
    anyway = solve(joined(data, base, base.model, here, {}), base.model, range(FOLDS), 1e-3).predicted_gain
    found = []
    for numbers in seen.together:
        rays = {seen.ray(number): number for number in numbers}
        known = len(base.model.shared)
        model = replace(base.model, shared=(*base.model.shared, *rays))
        new = {k: [seen.changes[number].get(i, nothing) for i in range(data.drivers)] for k, number in rays.items()}
        step = solve(joined(data, base, model, here, new), model, range(FOLDS), 1e-3)
        start = dict(seen.starts[numbers[0]])
        for (k, number), scale in zip(rays.items(), step.shared[known:].tolist(), strict=True):
            start[k] = scale * seen.starts[number][k]
        found.append((step.predicted_gain - anyway, start))
    gain, start = max(found, key=lambda one: one[0])
    return gain * data.drivers / len(seen.some), start


def beyond_chance(data: Recorded, base: JointFit, seen: Prescreen) -> float:
    """Predict the gain of a candidate from its prescreen, less what the choice of its place brings by chance [nats].

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without the candidate, or a later model.
    seen : Prescreen
        The prescreen of the candidate.

    Returns
    -------
    float
        Predicted gain of all drivers [nats]. It has no limit for individual values, of which a start says little, and
        where the starts change nothing yet.
    """
    if seen.candidate.individual or not any(seen.candidate.starts):
        return float("inf")
    return max(promised(data, base, seen)[0], *seen.rises(base)) - seen.candidate.elsewhere


class Promise(NamedTuple):
    """A candidate with its predicted gain [nats], and the probability that chance shows as much in any candidate."""

    candidate: Candidate
    gain: float
    p_value: float | None = None


def worth_screening(
    data: Recorded, base: JointFit, prescreens: Mapping[str, Prescreen], refuted: float
) -> tuple[list[Candidate], list[Promise]]:
    """Return the candidates that promise something, or the most promising one, and what the others promise.

    A candidate that loses more than ``refuted`` [nats] at its best start promises no more than that, unless its
    strength is scaled.
    """

    def promise(seen: Prescreen) -> Promise:
        most = max(seen.rises(base))
        is_refuted = most < -refuted and not (seen.candidate.strengths or seen.candidate.individual)
        return Promise(seen.candidate, most if is_refuted else beyond_chance(data, base, seen))

    all_ = [promise(seen) for seen in prescreens.values()]
    best = max(all_, key=lambda one: one.gain)
    is_worth = [one.gain > PROMISE or one is best for one in all_]
    chosen = [one.candidate for one, worth in zip(all_, is_worth, strict=True) if worth]
    return chosen, [one for one, worth in zip(all_, is_worth, strict=True) if not worth]
