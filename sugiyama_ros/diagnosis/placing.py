"""Where, when and how strongly something acts: the likelihood has several maxima, and a search ends in one of them."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.response import predicted
from sugiyama_ros.diagnosis.screen import FULL
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import JointFit, at_model, maximise, renewed, rise, warm_start
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import evaluate

# Number of places or times on each side, up to the distance between two starts of the search.
_TRIES = 12
# Factors of the other parameters.
_FACTORS = (0.8, 0.9, 0.95, 1.05, 1.1, 1.25)
# A value elsewhere is followed if it promises at least this gain [nats], as far as so many drivers tell, or up to twice
# as many.
_WORTH, _DRIVERS = 1.0, 22
# Fall of the log-likelihood [nats] at the ends of a 95 % interval (Wilks), and these ends in standard errors.
_FALL, _REACH = 1.92, 1.96


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
        values = _elsewhere(candidate, place, here) if ROW.declared[place].axis else [f * here for f in _FACTORS]
        fitted = _best_of(data, fitted, place, values, work)
    return fitted


def profiled(
    data: Recorded, fitted: JointFit, effects: Sequence[Candidate], stds: Mapping[str, float], work: Executor
) -> dict[str, float]:
    """Widen the standard errors of places and times to where the log-likelihood hardly falls.

    While all cars stand, the time at which they begin to want another speed does not matter. The curvature of the
    log-likelihood at its maximum does not know how far this reaches.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The fitted model with the effects.
    effects : sequence of Candidate
        Effects that all drivers have.
    stds : mapping of str to float
        Standard errors of shared parameters by name.
    work : Executor
        Runs the filters.

    Returns
    -------
    dict of str to float
        The errors, so wide that 95 % intervals reach to where the log-likelihood is 1.92 nats lower (Wilks).
    """
    found, least = dict(stds), predicted(fitted, fitted.model, fitted.samples) - _FALL
    for effect in effects:
        for place in effect.places:
            name, here = ROW.entries[place], fitted.model.rows[:, place]
            if not ROW.declared[place].axis or name not in found:
                continue
            for value in _elsewhere(effect, place, here):
                if _promised(data, fitted, place, value, work)[0] >= least:
                    found[name] = max(found[name], abs(float(value[0] - here[0])) / _REACH)
    return found


def _elsewhere(candidate: Candidate, place: int, here: Array) -> list[Array]:
    """Places or times (N,) around ``here``, up to the distance between two starts; none with a single start."""
    starts = np.unique([start[place] for start in candidate.starts])
    if len(starts) < 2:
        return []
    shares = np.delete(np.arange(-_TRIES, _TRIES + 1), _TRIES) / _TRIES
    return [here + share * float(np.diff(starts).min()) for share in shares]


def _promised(
    data: Recorded, fitted: JointFit, place: int, value: Array, work: Executor, who: Sequence[int] | None = None
) -> tuple[float, Array]:
    """Predicted log-likelihood of some drivers with another value (N,) of one parameter, and the rows with it."""
    declared, rows = ROW.declared[place], fitted.model.rows.copy()
    rows[:, place] = value if declared.axis else np.clip(value, declared.lower, declared.upper)
    model = replace(fitted.model, rows=rows)
    return predicted(fitted, model, evaluate(data, model, work, who)), rows


def _best_of(data: Recorded, fitted: JointFit, place: int, values: Sequence[Array], work: Executor) -> JointFit:
    """The best fit from one of the ``values`` (N,) of one parameter, or the fit itself if none promises more."""
    who = data.spread(_DRIVERS)
    here = predicted(fitted, fitted.model, fitted.samples.only(who))
    tried = [_promised(data, fitted, place, value, work, who) for value in values]
    best, rows = max(tried, key=lambda one: one[0], default=(-np.inf, fitted.model.rows))
    if (best - here) * data.drivers / len(who) < _WORTH:
        return fitted
    everybody = np.ones(data.drivers, np.bool_)
    there = at_model(data, fitted, replace(fitted.model, rows=rows), work, everybody)
    # derivatives of another place may have promised too much, most of all where noises differ
    there = renewed(data, there, work, everybody)
    if predicted(there, there.model, there.samples) < predicted(fitted, fitted.model, fitted.samples):
        return fitted
    again = maximise(data, there, work, renewals=FULL.renewals - 1)
    return again if rise(fitted, again) > 0.0 else fitted
