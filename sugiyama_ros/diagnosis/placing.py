"""Where, when and how strongly something acts: the likelihood has several maxima, and a search ends in one of them."""

from collections.abc import Sequence
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

# Number of places or times on each side, up to the distance between two starts of the search.
_TRIES = 12
# Factors of the other parameters.
_FACTORS = (0.8, 0.9, 0.95, 1.05, 1.1, 1.25)
# A value elsewhere is followed if it promises at least this gain [nats].
_WORTH = 1.0


def converged(data: Recorded, near: JointFit, candidate: Candidate, work: Executor) -> JointFit:
    """Fit a model with a candidate to the end, with its own parameters for the drivers ahead, from a nearby fit.

    Arguments as for ``best_placed``, which follows.
    """
    model = replace(near.model, ahead=near.model.rows)
    return best_placed(data, warm_start(data, near, model, work, renewals=FULL.renewals), candidate, work)


def best_placed(data: Recorded, fitted: JointFit, candidate: Candidate, work: Executor) -> JointFit:
    """Search again from the best place, time and strength around those of a fit, and keep the better of both fits.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The fitted model with a candidate.
    candidate : Candidate
        The candidate; only what drivers share is searched for.
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
        here = fitted.model.rows[:, place]
        if ROW.declared[place].axis:
            starts = np.unique([start[place] for start in candidate.starts])
            spacing = float(np.diff(starts).min(initial=np.inf))
            shares = np.delete(np.arange(-_TRIES, _TRIES + 1), _TRIES) / _TRIES
            values = [here + share * spacing for share in shares] if len(starts) > 1 else []
        else:
            values = [factor * here for factor in _FACTORS]
        fitted = _best_of(data, fitted, place, values, work)
    return fitted


def _best_of(data: Recorded, fitted: JointFit, place: int, values: Sequence[Array], work: Executor) -> JointFit:
    """The best fit from one of the ``values`` (N,) of one parameter, or the fit itself if none promises more."""
    declared = ROW.declared[place]

    def promised(value: Array) -> tuple[float, Array]:
        rows = fitted.model.rows.copy()
        rows[:, place] = value if declared.axis else np.clip(value, declared.lower, declared.upper)
        model = replace(fitted.model, rows=rows)
        return predicted(fitted, model, evaluate(data, model, work)), rows

    tried = [promised(value) for value in values]
    best, rows = max(tried, key=lambda one: one[0], default=(-np.inf, fitted.model.rows))
    if best < predicted(fitted, fitted.model, fitted.samples) + _WORTH:
        return fitted
    again = warm_start(data, fitted, replace(fitted.model, rows=rows), work, renewals=FULL.renewals)
    return again if rise(fitted, again) > 0.0 else fitted
