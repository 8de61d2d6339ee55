"""A glance at a candidate: what its starts alone promise, before it is screened."""

from concurrent.futures import Executor
from dataclasses import replace

from sugiyama_ros.diagnosis.candidates import Candidate, added
from sugiyama_ros.diagnosis.screen import differences, joined
from sugiyama_ros.fit.joint import JointFit, solve
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import evaluate

# Drivers on whom a glance falls, or up to twice as many.
_DRIVERS = 4


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
    model = replace(base.model, shared=(*base.model.shared, place))
    for start in candidate.starts:
        there = added(base.model, candidate, start)
        new = {place: differences(here, evaluate(data, there, work, some), 1.0, there.rows)}
        best = max(best, solve(joined(data, base, model, here, new), model, range(FOLDS), 1e-3).predicted_gain)
    return best * data.drivers / len(some)
