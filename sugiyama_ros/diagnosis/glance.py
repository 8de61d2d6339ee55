"""A glance at a candidate: what its starts alone promise, before it is screened."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import TypeVar

from sugiyama_ros.diagnosis.candidates import Candidate, added
from sugiyama_ros.diagnosis.few import FitOfFew
from sugiyama_ros.diagnosis.screen import Screened, differences, joined
from sugiyama_ros.fit.joint import JointFit, solve
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import evaluate
from sugiyama_ros.progress import OnStage
from sugiyama_ros.workers import at_once

# A candidate is screened if a glance at it predicts more than this gain [nats].
_PROMISE = 10.0

# Gain [nats] that a parameter of one driver brings by chance, on average.
_BY_CHANCE = 0.5

# Drivers on whom a glance falls, or up to twice as many.
_DRIVERS = 4

_Look = TypeVar("_Look", Screened, FitOfFew)


def glance(data: Recorded, base: JointFit, candidate: Candidate, work: Executor) -> float:
    """Predict the gain of a candidate from its starts alone.

    The changes of some drivers' samples at a start serve as derivatives by the strength.

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
    float
        Predicted gain [nats] over all drivers.
    """
    # a push moves one driver alone
    some = range(0, data.drivers, 1 if candidate.happens_once else max(1, data.drivers // _DRIVERS))
    here, best = base.samples.only(some), 0.0
    place = candidate.places[0]
    if candidate.individual:
        model = added(base.model, replace(candidate, places=(place,)), {})
    else:
        model = replace(base.model, shared=(*base.model.shared, place))
    for start in candidate.starts:
        there = added(base.model, candidate, start)
        new = {place: differences(here, evaluate(data, there, work, some), 1.0, there.rows)}
        best = max(best, solve(joined(data, base, model, here, new), model, range(FOLDS), 1e-3).predicted_gain)
    return best * data.drivers / len(some)


def worth_screening(
    data: Recorded, base: JointFit, possible: Sequence[Candidate], work: Executor, on_progress: OnStage
) -> list[Candidate]:
    """Return the candidates, but of those that get a glance first only those whose glance promises something."""

    def promises(candidate: Candidate) -> bool:
        has_own = candidate.individual and not candidate.happens_once
        own = _BY_CHANCE * data.drivers * len(candidate.places) if has_own else 0.0
        return glance(data, base, candidate, work) > _PROMISE + candidate.elsewhere + own

    glanced = [c for c in possible if c.glanced]
    promised = at_once(promises, glanced, "first glances", on_progress)
    left = {c.name for c, yes in zip(glanced, promised, strict=True) if not yes}
    return [c for c in possible if c.name not in left]


def best_forms(looks: Sequence[_Look]) -> list[_Look]:
    """Return the looks at, or the fits of, the form of each mechanism that gains most."""
    best: dict[str, _Look] = {}
    for look in looks:
        mechanism = look.candidate.mechanism
        if mechanism not in best or look.gain > best[mechanism].gain:
            best[mechanism] = look
    return list(best.values())
