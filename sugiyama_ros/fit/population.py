"""Drivers as draws from one population: the base model, the prior from the spread of the drivers, and second searches.

A normal prior pulls the individual parameters of each driver towards the median driver. Its std is the spread over the
drivers, each fitted alone (empirical Bayes). A parameter that the data of one driver do not determine therefore stays
near the values of the other drivers.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.each_driver import calibrate
from sugiyama_ros.fit.joint import JointFit, at_model, maximise, mixed, objectives, renewed, start_fit, warm_start
from sugiyama_ros.fit.model import Model, coordinate
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.sampling import measured_every

#: Prior std of a parameter's coordinate (a logarithm for most): before the spread is known; smallest; largest.
PRIOR_STD, LEAST_STD, LARGEST_STD = 1.0, 0.05, 1.0
# The first search ends when the predicted gain of a step is less than this [nats], because other searches follow.
_NEARLY = 20.0
# A driver further than this from the median driver, in prior stds, is fitted again.
_FAR_AWAY = 3.5
# A fit has settled if the log-likelihood rises by less than this for each driver, or for all of them [nats], when the
# drivers ahead get the parameters that were found for them. Maximum number of fits until it has.
_AGREES, _AGREE, _PASSES = 0.1, 2.0, 5


def start_model(data: Recorded, individual: Sequence[int]) -> Model:
    """Return the model without effects in which every driver is the mean of the population."""
    typical = data.even.typical(data.speed)
    rows = np.tile(ROW.with_effects(typical), (data.drivers, 1))
    return Model(rows, tuple(individual), (), (PRIOR_STD,) * len(individual), rows.copy())


def fit_nearly(data: Recorded, individual: Sequence[int], work: Executor, start: Model | None = None) -> JointFit:
    """Fit every driver alone, but not to the end, because other searches follow, or because the fit is far behind."""
    first = start or start_model(data, individual)
    near = _by_paper(data, first, work) if start is None else None
    start_at = start_fit(data, near or first, work)
    return maximise(data, start_at, work, iterations=10 if near is None else 3, enough=_NEARLY)


def fit_base(data: Recorded, individual: Sequence[int], work: Executor, start: Model | None = None) -> JointFit:
    """Fit every driver alone, then all drivers as draws from one population.

    The second fit uses the first fit's parameters for the drivers ahead. It is repeated, with its own parameters for
    them, as long as the likelihood rises by it.
    """
    near = fit_nearly(data, individual, work, start)
    return _settled(data, _as_one_population(data, near, work), work)


def _as_one_population(data: Recorded, near: JointFit, work: Executor) -> JointFit:
    """Fit all drivers as draws from one population, with the parameters of a nearby fit for the drivers ahead."""
    return _second_chance(data, warm_start(data, near, as_population(near.model), work), work)


def _settled(data: Recorded, found: JointFit, work: Executor) -> JointFit:
    """Fit again with the parameters found for the drivers ahead, too, while the log-likelihood rises by it.

    Where it falls, the drivers ahead are better predicted by the parameters of the fit before, which is kept.
    """
    enough = max(_AGREES * data.drivers, _AGREE)
    there = at_model(data, found, as_population(found.model), work, np.ones(data.drivers, np.bool_))
    if abs(there.log_likelihood - found.log_likelihood) < enough:
        return found
    for _ in range(_PASSES):
        again = _as_one_population(data, found, work)
        rise = again.log_likelihood - found.log_likelihood
        if rise > 0.0:
            found = again
        if rise < enough:
            break
    return found


def _second_chance(data: Recorded, found: JointFit, work: Executor) -> JointFit:
    """Search again from the median driver for drivers who are unlike all others, and keep the better of both fits.

    The likelihood of a driver has several maxima, and the first search may have ended in a poor, distant maximum.
    """
    far = np.abs(found.model.away).max(axis=1) > _FAR_AWAY
    if not far.any():
        return found
    own = list(found.model.individual)
    rows = found.model.rows.copy()
    rows[np.ix_(far, own)] = np.median(rows[:, own], axis=0)
    elsewhere = at_model(data, found, replace(found.model, rows=rows), work, far)
    again = maximise(data, renewed(data, elsewhere, work, far), work)
    everywhere = range(FOLDS)
    better = objectives(again.slopes, again.model, everywhere) > objectives(found.slopes, found.model, everywhere)
    return maximise(data, mixed(found, again, better), work, iterations=4)


def _by_paper(data: Recorded, model: Model, work: Executor) -> Model | None:
    """The model fitted with the paper's formulation; None if the formulation cannot use the recording.

    In the paper, drivers decide once for each sample. So the formulation says little of samples that are far apart, and
    nothing of noises that it does not have.

    A parameter that the data of a driver do not determine becomes the median over the drivers whose data determine it,
    if there are any.
    """
    if data.trajectories is None or measured_every(data.trajectories) > 1 or data.even.has_other_noises:
        return None
    names = [NAMES[k] for k in model.individual]
    try:
        fits = list(calibrate(data.trajectories, "paper", names, work=work))
    except InputError:
        return None
    rows = model.rows.copy()
    for k, name in zip(model.individual, names, strict=True):
        known = [one.parameters[k] for one in fits if one.identified(name)]
        if known:
            rows[:, k] = [one.parameters[k] if one.identified(name) else np.median(known) for one in fits]
    return as_population(replace(model, rows=rows))


def as_population(model: Model) -> Model:
    """Return the model with the spread of its drivers as the prior, and with its own rows for the drivers ahead."""
    own = coordinate(model.rows[:, list(model.individual)], model.individual)
    spread = 1.4826 * np.median(np.abs(own - np.median(own, axis=0)), axis=0)
    # a small number of drivers determines the spread poorly
    known = len(own) / (len(own) + 3.0)
    std = np.clip(known * spread + (1.0 - known) * 0.3, LEAST_STD, LARGEST_STD)
    return replace(model, prior_std=tuple(std.tolist()), ahead=model.rows)
