"""A glance at a candidate: what its starts alone promise on some drivers, before it is screened.

A glance predicts the gain of a fit well, because the changes of the samples at a start serve as derivatives by the
strength. Most candidates have nothing to do with the data, so most of them need nothing more.
"""

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate, added
from sugiyama_ros.diagnosis.near import joined
from sugiyama_ros.diagnosis.response import predicted
from sugiyama_ros.fit.joint import JointFit, solve
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import DriverDensity, PointwiseDensity, evaluate
from sugiyama_ros.fit.slopes import Column, column, no_density

# A candidate is screened if a glance at it predicts more than this gain [nats].
_PROMISE = 5.0

# Drivers on whom a glance falls, or up to twice as many.
_DRIVERS = 11


@dataclass(frozen=True, eq=False)
class Glance:
    """What the starts of a candidate show on some drivers.

    Parameters
    ----------
    candidate : Candidate
        The candidate.
    some : range
        Numbers of the drivers.
    changes : tuple of dict of int to Column
        Changes of the samples of each of these drivers at each start.
    likelihoods : tuple of float
        Predicted log-likelihood of these drivers at each start, after their parameters have responded [nats].
    at : dict of int to DriverDensity
        Samples of each of these drivers at the start with the largest likelihood.
    """

    candidate: Candidate
    some: range
    changes: tuple[dict[int, Column], ...]
    likelihoods: tuple[float, ...]
    at: dict[int, DriverDensity]

    @property
    def best(self) -> int:
        """Number of the start with the largest likelihood."""
        return int(np.argmax(self.likelihoods))

    @property
    def worst(self) -> dict[int, float | Array]:
        """The start with the smallest likelihood."""
        return self.candidate.starts[int(np.argmin(self.likelihoods))]

    def loss(self, base: JointFit) -> float:
        """Return the fall of the log-likelihood of all drivers at ``worst`` [nats].

        An effect of this strength would have gained as much if it existed.
        """
        here = base.samples.only(self.some).total
        return (here - min(self.likelihoods)) * len(base.slopes) / len(self.some)


def glance(data: Recorded, base: JointFit, candidate: Candidate, work: Executor) -> Glance:
    """Glance at the starts of a candidate.

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
    Glance
        What the starts show.
    """
    # a push moves one driver alone
    some = range(0, data.drivers, 1 if candidate.happens_once else max(1, data.drivers // _DRIVERS))
    likelihoods, changes = [], []
    best: PointwiseDensity | None = None
    for start in candidate.starts:
        model = added(base.model, candidate, start)
        # a parameter that only becomes free changes nothing yet
        is_same = not start and set(base.model.shared) <= set(model.shared)
        at = base.samples.only(some) if is_same else evaluate(data, model, work, some)
        changes.append({i: column(base.samples.of(i), at.of(i), 1.0, model.rows[i]) for i in some})
        likelihoods.append(predicted(base, model, at))
        if best is None or likelihoods[-1] >= max(likelihoods):
            best = at
    assert best is not None
    # copies, because the arrays have places for all drivers
    samples = {i: DriverDensity(*(values.copy() for values in best.of(i))) for i in some}
    return Glance(candidate, some, tuple(changes), tuple(likelihoods), samples)


def promised(data: Recorded, base: JointFit, seen: Glance) -> tuple[Array, Array]:
    """Predict the gain of a candidate and the multiple of its strengths that gains it, from a glance.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without the candidate, or a later model.
    seen : Glance
        A glance at the candidate, whose values all drivers share.

    Returns
    -------
    gains : ndarray, shape (S,)
        Predicted gain of all drivers [nats] from each start.
    scales : ndarray, shape (S,)
        Multiple of the start's strengths.
    """
    ray = (seen.candidate.strengths or seen.candidate.places)[0]
    model = replace(base.model, shared=(*base.model.shared, ray))
    here, nothing = base.samples.only(seen.some), (no_density(data.samples),) * 3
    # the prior alone moves the drivers whose samples are left out
    anyway = solve(joined(data, base, base.model, here, {}), base.model, range(FOLDS), 1e-3).predicted_gain
    gains, scales = [], []
    for change in seen.changes:
        new = {ray: [change.get(i, nothing) for i in range(data.drivers)]}
        step = solve(joined(data, base, model, here, new), model, range(FOLDS), 1e-3)
        gains.append((step.predicted_gain - anyway) * data.drivers / len(seen.some))
        scales.append(float(step.shared[-1]))
    return np.array(gains), np.array(scales)


def beyond_chance(data: Recorded, base: JointFit, seen: Glance) -> float:
    """Predict the gain of a candidate from a glance, less what the choice of its place brings by chance [nats].

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without the candidate, or a later model.
    seen : Glance
        A glance at the candidate.

    Returns
    -------
    float
        Predicted gain of all drivers [nats]. It has no limit for individual values, of which a start says little, and
        where the starts change nothing yet.
    """
    if seen.candidate.individual or not any(seen.candidate.starts):
        return float("inf")
    right_there = (max(seen.likelihoods) - base.samples.only(seen.some).total) * data.drivers / len(seen.some)
    return max(float(promised(data, base, seen)[0].max()), right_there) - seen.candidate.elsewhere


def promises(data: Recorded, base: JointFit, seen: Glance) -> bool:
    """Return whether a glance promises enough for a closer look."""
    return beyond_chance(data, base, seen) > _PROMISE


def worth_screening(data: Recorded, base: JointFit, glances: Mapping[str, Glance]) -> list[Candidate]:
    """Return the candidates whose glance promises something; the most promising one if none does."""
    left = {name: beyond_chance(data, base, seen) for name, seen in glances.items()}
    best = max(left, key=lambda name: left[name])
    return [glances[name].candidate for name, gain in left.items() if gain > _PROMISE or name == best]
