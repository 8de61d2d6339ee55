"""Fits of other car-following laws, in two ways.

A law is fitted in the causal filter, as the driver model is. It can also be fitted by least squares on the gap of one
simulated car behind its recorded leader (Treiber and Kesting, Traffic Flow Dynamics (2013), chapter 17).
"""

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import qmc

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.driver.utility import FAR, advance
from sugiyama_ros.effects.control import law_acceleration
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.joint import JointFit, fit_base, start_model
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import filtered_states
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law
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


# Number of starts to compare. Each parameter lies between its default divided and multiplied by the factor.
_LOOKED_AT, _FACTOR = 64, 4.0
# The sum of squares has many minima. The search takes a few steps from the best starts and follows the best of them.
_FEW, _TRIED, _FOLLOWED = 10, 8, 2
# Step of the difference quotients relative to the default: about the square root of the rounding error of a run.
_STEP = 1e-7
# A search ends when the sum of squares or the parameters change by less than this share, or after so many runs.
_ENOUGH, _MOST = 1e-6, 60


@dataclass(frozen=True, eq=False)
class Following:
    """Smoothed motion of one driver behind a leader, (T,) [m] and [m/s]; positions of centres do not wrap.

    half_lengths_m: half of the sum of both vehicles' lengths [m]; source: name of the driver in error messages. Raises
    InputError.
    """

    position_m: Array
    speed: Array
    leader_position_m: Array
    leader_speed: Array
    half_lengths_m: float
    period_s: float
    source: str = "following"

    def __post_init__(self) -> None:
        shapes = {a.shape for a in (self.position_m, self.speed, self.leader_position_m, self.leader_speed)}
        if len(shapes) > 1 or self.position_m.ndim != 1:
            raise InputError(f"{self.source}: positions and speeds differ in length; give T samples of each")

    @cached_property
    def states(self) -> Array:
        """Positions and speeds of the driver, then of the leader, (T, 4)."""
        return np.column_stack((self.position_m, self.speed, self.leader_position_m, self.leader_speed))


@dataclass(frozen=True, eq=False)
class GapFit:
    """A law fitted to the gaps of one driver: parameters in its order, and root mean square error of the gaps [m]."""

    parameters: Array
    rmse_m: float


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


def fit_gaps(law: Law, following: Following, chosen: Mask, start: Array | None = None) -> GapFit:
    """Fit a law by least squares of ``gap_errors``, from ``start`` or from many starts. Raises InputError."""
    default, lower, upper = (np.array([getattr(p, of) for p in law.parameters]) for of in ("default", "lower", "upper"))
    scored = np.isfinite(gap_errors(law, default, following, chosen))
    if scored.sum() <= len(default):
        raise InputError(
            f"{following.source}: {scored.sum()} samples cannot determine {len(default)} parameters of {law.name};"
            " give more"
        )

    def errors(rows: Array) -> Array:
        return gap_errors(law, rows, following, chosen)[..., scored]

    def slopes(parameters: Array) -> Array:
        step = _STEP * default
        at = errors(np.vstack((parameters, parameters + np.diag(step))))
        return np.asarray(((at[1:] - at[0]) / step[:, None]).T)

    def search(start: Array, most: int) -> OptimizeResult:
        return least_squares(
            errors, start, slopes, bounds=(lower, upper), x_scale=default, ftol=_ENOUGH, xtol=_ENOUGH, max_nfev=most
        )

    if start is not None:
        found = search(np.clip(start, lower, upper), _MOST)
        return GapFit(found.x, float(np.sqrt(np.mean(np.square(found.fun)))))
    places = qmc.Halton(len(default), scramble=False).random(_LOOKED_AT)
    starts = np.clip(default * _FACTOR ** (2.0 * places - 1.0), lower, upper)
    starts = starts[np.argsort(np.square(errors(starts)).sum(axis=1))]
    tried = sorted((search(start, _FEW) for start in starts[:_TRIED]), key=lambda found: float(found.cost))
    best = min((search(found.x, _MOST) for found in tried[:_FOLLOWED]), key=lambda found: float(found.cost))
    return GapFit(best.x, float(np.sqrt(np.mean(np.square(best.fun)))))
