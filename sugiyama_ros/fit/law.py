"""Fits of other car-following laws, in two ways.

A law is fitted in the causal filter, as the driver model is. It can also be fitted by least squares on the gap of one
simulated car behind its recorded leader (Treiber and Kesting, Traffic Flow Dynamics (2013), chapter 17).
"""

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.driver.utility import FAR
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.least_squares import Following, fit_gaps
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.population import fit_base, start_model
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import filtered_states
from sugiyama_ros.laws.registry import LAWS, PAPERS, number_of

# The gaps of a driver are fitted only if there are more samples than this.
_FEWEST = 50


def in_filter(data: Recorded, law: str, work: Executor) -> JointFit:
    """Fit the parameters and the noises of a law for every driver in the causal filter."""
    model = start_of_drivers(data, law)
    return fit_base(data, model.individual, work, None if law == PAPERS else model)


def start_of_drivers(data: Recorded, law: str) -> Model:
    """Return the model in which every driver drives by a law, with the parameters with which the search begins."""
    if law == PAPERS:
        return start_model(data, data.even.individual(V_STAR, KAPPA_V))
    places = ROW.law_places[law]
    model = start_model(data, data.even.individual(*range(places.start, places.stop)))
    for rows in (model.rows, model.ahead):
        rows[:, ROW.law] = number_of(law)
        rows[:, places] = start_of(law, data.speed)
    return model


def start_of(law: str, speed: float) -> Array:
    """Return the parameters (K,) with which a search begins; ``speed``: a high one in the data [m/s].

    Where the free speed of the declared defaults is below the speed in the data, all speeds among them are larger in
    proportion: a driver far above the desired speed hardly says how much too small it is.
    """
    one = LAWS[law]
    values = np.array([p.default for p in one.parameters])
    speeds = np.linspace(0.5, 80.0, 160)
    grows = [v for v in speeds.tolist() if one.function(FAR, v, v, values) > 0.0]
    if not grows or max(grows) >= speed:
        return values
    is_speed = np.array([p.unit == "m/s" for p in one.parameters])
    scaled = np.where(is_speed, values * speed / max(grows), values)
    return np.asarray(np.clip(scaled, [p.lower for p in one.parameters], [p.upper for p in one.parameters]))


def by_gaps(data: Recorded, law: str, fitted: JointFit, work: Executor) -> tuple[Model, ...]:
    """Fit a law by least squares to the gaps outside each fold; ``fitted``: the law in the filter."""
    states = filtered_states(data, fitted.model, work)
    places = ROW.law_places[law]
    jobs = [(data, law, states, i, fitted.model.rows[i, places]) for i in range(data.drivers)]
    found = np.stack(list(work.map(_fit_driver, jobs)))
    models = []
    for f in range(FOLDS):
        rows = fitted.model.rows.copy()
        rows[:, places] = found[:, f]
        models.append(replace(fitted.model, rows=rows, ahead=rows))
    return tuple(models)


def _fit_driver(job: tuple[Recorded, str, Array, int, Array]) -> Array:
    """Parameters (F, K) of one driver, fitted without each fold; the start where too few samples remain."""
    data, law, states, i, start = job
    around = data.vicinity
    leader, samples = around.leader[:, i], np.arange(data.samples)
    way = states[samples, leader, 0] - states[:, i, 0]
    if around.road.is_ring:
        way = np.mod(way, around.road.circumference_m)
    led = leader >= 0
    length = around.length_m[samples, leader]
    usual = np.median(length[led]) if led.any() else 0.0
    # a leader of another length stands where a leader of the usual length would leave the same gap
    ahead = states[:, i, 0] + way + 0.5 * (usual - length)
    following = Following(
        position_m=states[:, i, 0],
        speed=states[:, i, 1],
        leader_position_m=np.where(led, ahead, np.nan),
        leader_speed=states[samples, leader, 1],
        half_lengths_m=0.5 * float(around.length_m[:, i].max() + usual),
        period_s=around.period_s,
        source=f"{around.source}: vehicle {around.names[i].shown}",
    )
    # the simulated car restarts with every block, because the first sample of a block is left out
    inside = (np.diff(data.block[i], prepend=-1) == 0) & (np.diff(data.segment[i], prepend=0) == 0)
    known = np.isfinite(following.states).all(axis=1) & inside
    one = LAWS[law]
    if known.sum() <= _FEWEST:
        return np.tile(start, (FOLDS, 1))
    everywhere = fit_gaps(one, following, known).parameters
    masks = [known & (data.fold[i] != f) for f in range(FOLDS)]
    return np.array([fit_gaps(one, following, m, everywhere).parameters if m.sum() > _FEWEST else start for m in masks])
