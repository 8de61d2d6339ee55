"""Fits from nothing to recordings that the final model simulates: what is wrong with a fit shows there.

The filter approximates what drivers see, and its likelihood is rough, with several maxima. So the fit of an effect may
be biased, and its error larger than the width of the likelihood says.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.diagnosis.addition import Addition
from sugiyama_ros.diagnosis.bootstrap import resample, seeds
from sugiyama_ros.diagnosis.candidates import Candidate, candidates
from sugiyama_ros.diagnosis.placing import converged
from sugiyama_ros.diagnosis.screen import with_candidate
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import filtered_states
from sugiyama_ros.progress import OnStage
from sugiyama_ros.workers import at_once


def fit_from_nothing(data: Recorded, effects: Sequence[Candidate], work: Executor) -> JointFit:
    """Fit the base model, and then add effects one after the other, as a diagnosis does.

    Parameters
    ----------
    data : Recorded
        The recording.
    effects : sequence of Candidate
        What to add, for all drivers.
    work : Executor
        Runs the filters.

    Returns
    -------
    JointFit
        The model with the effects.
    """
    fitted = fit_base(data, data.even.individual(V_STAR, KAPPA_V), work)
    for effect in effects:
        fitted = converged(data, with_candidate(data, fitted, effect, work), effect, work)
    return fitted


def refits(
    data: Recorded,
    fitted: JointFit,
    effects: Sequence[Candidate],
    seed: int,
    runs: int,
    work: Executor,
    on_progress: OnStage = lambda what, done, total: None,
) -> list[JointFit]:
    """Simulate recordings from a fit, and fit the same model to them from nothing.

    Parameters
    ----------
    data : Recorded
        The recording.
    fitted : JointFit
        The model with the effects.
    effects : sequence of Candidate
        The effects, as for ``fit_from_nothing``.
    seed : int
        Seed of the simulations.
    runs : int
        Number of simulated recordings.
    work : Executor
        Runs the filters.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.

    Returns
    -------
    list of JointFit
        The fits; none without effects.
    """
    if not effects or not runs:
        return []
    states = filtered_states(data, fitted.model, work)

    def one(rng: np.random.Generator) -> JointFit:
        simulated = resample(data, fitted.model, states, rng).roughly
        return fit_from_nothing(replace(simulated, even=data.even), effects, work)

    return at_once(one, seeds(seed, runs), "fitting simulated recordings", on_progress)


def added_to_all(data: Recorded, additions: Sequence[Addition]) -> list[Candidate]:
    """Return the candidates that additions stand for; none if a fit from nothing cannot find all of them.

    It cannot find what only some drivers have, what happens once, or a force without a name.
    """
    possible = {c.name: c for c in candidates(data)}
    if any(one.drivers or one.form not in possible for one in additions):
        return []
    return [possible[one.form] for one in additions]
