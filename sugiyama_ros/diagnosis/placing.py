"""Where and when something acts: the likelihood has several maxima along a place or a time; a search ends in one."""

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.response import predicted
from sugiyama_ros.diagnosis.screen import FULL
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import JointFit, rise, warm_start
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import evaluate

# Number of values on each side, up to the distance between two starts of the search.
_TRIES = 12
# A value elsewhere is followed if it promises at least this gain [nats].
_WORTH = 1.0


def best_placed(data: Recorded, fitted: JointFit, candidate: Candidate, work: Executor) -> JointFit:
    """Search again from the best place and time around those of a fit, and keep the better of both fits.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The fitted model with a candidate.
    candidate : Candidate
        The candidate; only a place or a time that drivers share is searched for.
    work : Executor
        Runs the filters.

    Returns
    -------
    JointFit
        The better fit.
    """
    if candidate.individual:
        return fitted
    for place in candidate.places:
        if not ROW.declared[place].axis:
            continue
        starts = np.unique([start[place] for start in candidate.starts])
        if len(starts) > 1:
            fitted = _best_along(data, fitted, place, float(np.diff(starts).min()), work)
    return fitted


def _best_along(data: Recorded, fitted: JointFit, place: int, spacing: float, work: Executor) -> JointFit:
    """The best fit with one parameter within the distance between two starts."""
    here = fitted.model.rows[:, place]
    shares = np.delete(np.arange(-_TRIES, _TRIES + 1), _TRIES) / _TRIES

    def promised(share: float) -> tuple[float, Array]:
        rows = fitted.model.rows.copy()
        rows[:, place] = here + share * spacing
        model = replace(fitted.model, rows=rows)
        return predicted(fitted, model, evaluate(data, model, work)), rows

    tried = [promised(float(share)) for share in shares]
    best, rows = max(tried, key=lambda one: one[0])
    if best < predicted(fitted, fitted.model, fitted.samples) + _WORTH:
        return fitted
    again = warm_start(data, fitted, replace(fitted.model, rows=rows), work, renewals=FULL.renewals)
    return again if rise(fitted, again) > 0.0 else fitted
