"""Fits of other car-following laws, in two ways.

A law is fitted in the causal filter, as the driver model is. It can also be fitted by least squares on the gap of one
simulated car behind its recorded leader (Treiber and Kesting, Traffic Flow Dynamics (2013), chapter 17).
"""

from concurrent.futures import Executor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import qmc

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.driver.utility import FAR, advance
from sugiyama_ros.effects.control import law_acceleration
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import JointFit, fit_base, start_model
from sugiyama_ros.fit.model import Model, filtered_states
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law
from sugiyama_ros.laws.registry import LAWS, PAPERS, number_of

# The gaps of a driver are fitted only if there are more samples than this; maximum number of runs of a search.
_FEWEST, _MOST = 50, 60


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
        np.column_stack((states[:, i, :2], np.where(led, ahead, np.nan), states[samples, leader, 1])),
        0.5 * float(around.length_m[:, i].max() + usual),
        around.period_s,
    )
    # the simulated car restarts with every block, because the first sample of a block is left out
    inside = (np.diff(data.block[i], prepend=-1) == 0) & (np.diff(data.segment[i], prepend=0) == 0)
    known = np.isfinite(following.states).all(axis=1) & inside
    one = LAWS[law]
    if known.sum() <= _FEWEST:
        return np.tile(start, (FOLDS, 1))
    everywhere = fit_gaps(one, following, known)
    masks = [known & (data.fold[i] != f) for f in range(FOLDS)]
    return np.array([fit_gaps(one, following, m, everywhere) if m.sum() > _FEWEST else start for m in masks])


class Following(NamedTuple):
    """Smoothed motion of one driver behind a leader.

    states: (T, 4), positions of centres [m], which do not wrap, and speeds [m/s] of the driver, then of the leader;
    half_lengths_m: half of the sum of both vehicles' lengths [m]; period_s: time from one sample to the next [s].
    """

    states: Array
    half_lengths_m: float
    period_s: float


@kernel
def _run(rows: Array, states: Array, half_lengths: float, period: float, driven: Mask, out: Array) -> None:
    """Fill ``out`` (K, T) with the errors of the gaps [m] for rows (K, WIDTH); entries without an error stay as they
    are.
    """
    for k in range(len(rows)):
        x, v = 0.0, 0.0
        for t in range(len(states)):
            if not driven[t]:
                continue
            position, speed, leader_position, leader_speed = states[t]
            if t > 0 and driven[t - 1]:
                out[k, t] = position - x
            else:
                x, v = position, max(speed, 0.0)
            gap = leader_position - x - half_lengths
            a = law_acceleration(gap, v, leader_speed, rows[k])
            x, v = advance(x, v, a, period)
            v = max(v, 0.0)


def gap_errors(law: Law, parameters: Array, following: Following, chosen: Mask) -> Array:
    """Return the errors of the gaps in a simulation of one car, simulated minus measured.

    The car starts as measured at the first sample of each unbroken run of ``chosen`` samples (T,), where the error is
    NaN. The integration is Euler's rule as in the simulation; speeds stay at or above 0. Returns (..., T) [m].
    """
    values = parameters.reshape(-1, parameters.shape[-1])
    rows = np.zeros((len(values), ROW.width))
    rows[:, ROW.law], rows[:, ROW.law_places[law.name]] = number_of(law.name), values
    states = following.states
    driven = chosen & np.isfinite(states).all(axis=1)
    errors = np.full((len(rows), len(states)), np.nan)
    _run(rows, states, following.half_lengths_m, following.period_s, driven, errors)
    return errors.reshape(*parameters.shape[:-1], len(states))


def fit_gaps(law: Law, following: Following, chosen: Mask, start: Array | None = None) -> Array:
    """Fit a law by least squares of ``gap_errors``, from ``start`` or from many starts; returns its parameters (K,)."""
    default, lower, upper = (np.array([getattr(p, of) for p in law.parameters]) for of in ("default", "lower", "upper"))
    scored = np.isfinite(gap_errors(law, default, following, chosen))
    # about the square root of the rounding error of a run
    step = 1e-7 * default

    def errors(rows: Array) -> Array:
        return gap_errors(law, rows, following, chosen)[..., scored]

    def slopes(parameters: Array) -> Array:
        at = errors(np.vstack((parameters, parameters + np.diag(step))))
        return np.asarray(((at[1:] - at[0]) / step[:, None]).T)

    def search(start: Array, most: int) -> OptimizeResult:
        return least_squares(
            errors, start, slopes, bounds=(lower, upper), x_scale=default, ftol=1e-6, xtol=1e-6, max_nfev=most
        )

    if start is not None:
        return np.asarray(search(np.clip(start, lower, upper), _MOST).x)
    # the sum of squares has many minima: of many starts, each within a factor of 4 of the default, the search takes a
    # few steps from the best ones, and follows the two best of them
    starts = np.clip(default * 4.0 ** (2.0 * qmc.Halton(len(default), scramble=False).random(64) - 1.0), lower, upper)
    starts = starts[np.argsort(np.square(errors(starts)).sum(axis=1))]
    tried = sorted((search(start, 10) for start in starts[:8]), key=lambda found: float(found.cost))
    return np.asarray(min((search(found.x, _MOST) for found in tried[:2]), key=lambda found: float(found.cost)).x)
