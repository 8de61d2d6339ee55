"""What other car-following models make of the same data: IDM and FVDM, calibrated in both ways that are in use.

In the causal filter, as the driver model is; and by least squares on the gap of one car simulated behind his leader as
he was recorded (Treiber and Kesting, Traffic Flow Dynamics, chapter 17).
"""

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_NU
from sugiyama_ros.effects.registry import DECLARED, LAW, LAW_PLACES
from sugiyama_ros.fit.joint import Fit
from sugiyama_ros.fit.least_squares import Following, fit_gaps
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.population import fit_base, start_model
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import filtered_states
from sugiyama_ros.laws.registry import LAWS, number_of

# Samples below which the gaps of a driver are not fitted.
_FEWEST = 50


def in_filter(data: Recorded, law: str, work: Executor) -> Fit:
    """A rival with his parameters and noises fitted for every driver in the causal filter."""
    places = LAW_PLACES[law]
    model = start_model(data.drivers, (SIGMA_NU, SIGMA_A, *range(places.start, places.stop)))
    for rows in (model.rows, model.ahead):
        rows[:, LAW] = number_of(law)
        rows[:, places] = [DECLARED[k].default for k in range(places.start, places.stop)]
    return fit_base(data, model.individual, work, model)


def by_gaps(data: Recorded, law: str, fitted: Fit, work: Executor) -> tuple[Model, ...]:
    """For every fold, the rival with parameters by least squares on the gaps outside it; the rest as in ``fitted``."""
    states = filtered_states(data, fitted.model, work)
    places = LAW_PLACES[law]
    jobs = [(data, law, states, i, fitted.model.rows[i, places]) for i in range(data.drivers)]
    found = np.stack(list(work.map(_fit_driver, jobs)))
    models = []
    for f in range(FOLDS):
        rows = fitted.model.rows.copy()
        rows[:, places] = found[:, f]
        models.append(replace(fitted.model, rows=rows, ahead=rows))
    return tuple(models)


def _fit_driver(job: tuple[Recorded, str, Array, int, Array]) -> Array:
    """Parameters (F, K) of one driver, without each fold in turn; as they were where too little is left."""
    data, law, states, i, start = job
    t = data.trajectories
    leader, samples = t.leader[:, i], np.arange(len(data.fold))
    way = states[samples, leader, 0] - states[:, i, 0]
    if t.road.is_ring:
        way = np.mod(way, t.road.circumference_m)
    following = Following(
        states[:, i, 0],
        states[:, i, 1],
        np.where(leader >= 0, states[:, i, 0] + way, np.nan),
        states[samples, leader, 1],
        0.5 * float(t.length_m[i] + np.median(t.length_m[leader])),
        t.period_s,
        f"{t.source}: vehicle {t.vehicle[i]}",
    )
    # a run starts anew with every block, where one sample is left out
    inside = np.diff(data.block, prepend=-1) == 0
    known = np.isfinite(following.states).all(axis=1) & inside
    if known.sum() <= _FEWEST:
        return np.tile(start, (FOLDS, 1))
    everywhere = fit_gaps(LAWS[law], following, known).parameters
    masks = [known & (data.fold != f) for f in range(FOLDS)]
    return np.array(
        [fit_gaps(LAWS[law], following, m, everywhere).parameters if m.sum() > _FEWEST else start for m in masks]
    )


def has_parameters(name: str) -> bool:
    """Whether a law has anything to calibrate but noises."""
    return bool(LAWS[name].parameters)
