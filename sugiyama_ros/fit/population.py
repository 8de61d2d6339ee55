"""Drivers as draws of one population: the base model, the spread of the drivers as a prior, and second chances.

Each driver's own parameters are held to the median driver's by a normal prior whose std is the spread over the drivers,
each fitted alone (empirical Bayes), so a parameter that one driver's data do not hold stays near the others'.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.driver.parameters import NAMES, population
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.driver import calibrate
from sugiyama_ros.fit.joint import JointFit, at_model, maximise, mixed, objectives, renewed, start_fit, warm_start
from sugiyama_ros.fit.model import Model, coordinate
from sugiyama_ros.fit.recording import FOLDS, Recorded

#: Std over the drivers, in a parameter's coordinate (a logarithm for most), before it is known; and least and largest.
PRIOR_STD, LEAST_STD, LARGEST_STD = 1.0, 0.05, 1.0
# Log-likelihood [nats] below which the first search ends, because others follow.
_NEARLY = 20.0
# Prior stds from the median driver beyond which a driver is fitted again.
_FAR_AWAY = 3.5


def start_model(drivers: int, individual: Sequence[int]) -> Model:
    """The model without effects in which every driver is the population's mean."""
    rows = np.tile(ROW.with_effects(population()), (drivers, 1))
    return Model(rows, tuple(individual), (), (PRIOR_STD,) * len(individual), rows.copy())


def fit_base(data: Recorded, individual: Sequence[int], work: Executor, start: Model | None = None) -> JointFit:
    """Fit every driver alone, then all drivers as draws of one population, with the drivers ahead as they were found.

    Parameters
    ----------
    data
        The recording.
    individual
        Places of the parameters that are fitted for each driver.
    work
        Executor that runs the filters.
    start
        Where the search starts. If left out, it starts where the paper's likelihood, which is cheap, has its maximum.
    """
    first = start or start_model(data.drivers, individual)
    near = _by_paper(data, first, work) if start is None else None
    start_at = start_fit(data, near or first, work)
    found = maximise(data, start_at, work, iterations=10 if near is None else 3, enough=_NEARLY)
    return _second_chance(data, warm_start(data, found, as_population(found.model), work), work)


def _second_chance(data: Recorded, found: JointFit, work: Executor) -> JointFit:
    """Search again from the median driver for drivers who are unlike all others, and keep the better of both.

    The likelihood of a driver has several maxima, and a search may have ended in a poor one far away.
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
    """The model with drivers as the paper's formulation finds them; None if it cannot take the recording.

    A parameter that a driver's data do not hold is set to the median over the drivers whose data do, if there are any.
    """
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
    """The model with the drivers' spread as the prior, and the drivers ahead as they were found."""
    own = coordinate(model.rows[:, list(model.individual)], model.individual)
    spread = 1.4826 * np.median(np.abs(own - np.median(own, axis=0)), axis=0)
    # a few drivers say little about the spread
    known = len(own) / (len(own) + 3.0)
    std = np.clip(known * spread + (1.0 - known) * 0.3, LEAST_STD, LARGEST_STD)
    return replace(model, prior_std=tuple(std.tolist()), ahead=model.rows)
