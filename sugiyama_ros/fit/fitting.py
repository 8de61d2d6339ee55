"""Maximum likelihood for many drivers at once: some parameters each driver's own, others the same for all.

The causal likelihood is a sum over samples of log-densities of innovations y with variance S, so that its expected
information is that of two least-squares problems, sum(dy dy' / S + dS dS' / 2 S^2), and Gauss and Newton find its
maximum in a few steps (with damping after Levenberg and Marquardt). What belongs to one driver is independent of what
belongs to another but for the shared parameters, so the system to solve is an arrow.

Parameters are searched in logarithms where they have a sign. Drivers are taken to be draws of one population: each
one's own parameters are held to the median driver's by a normal prior whose std is that over the drivers, each fitted
for himself (empirical Bayes), so that a parameter which the data of one driver do not hold stays near the others'.
"""

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from sugiyama_ros.driver.parameters import COUNT, NAMES, OMEGA_2, RHO, population
from sugiyama_ros.effects.registry import DECLARED, place, whole
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters import causal
from sugiyama_ros.fit.driver import calibrate, upper_bounds
from sugiyama_ros.road import Array, Ints
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Length [s] of the blocks that are held out in turn, and number of folds among which they are dealt out.
BLOCK_S, FOLDS = 25.0, 5
#: Std over the drivers, in a parameter's coordinate (a logarithm for most), before it is known; and least and largest.
PRIOR_STD, LEAST_STD, LARGEST_STD = 1.0, 0.05, 1.0
# Step of the difference quotients in a logarithm, and as part of the longest step of the search in a linear coordinate;
# once the information is known, as part of a parameter's std, and the longest in a logarithm. The likelihood is smooth
# at these scales only: close to contact the filter amplifies any smaller change without end.
_STEP, _PART_OF_STD, _LONGEST_STEP = 0.01, 0.5, 0.05
# Longest step of the search in a logarithm.
_LONGEST = 0.7
# A search has ended when a step promises less log-likelihood [nats] than this; from step to step of the difference
# quotients the likelihood of a recording is rough by about 1.
_ENOUGH = 0.5
# The same of a search that others follow.
_NEARLY = 20.0
# Prior stds from the median driver beyond which a driver is looked at again.
_FAR_AWAY = 3.5
# Steps of a search at most, and times at most that it takes the derivatives anew.
_STEPS, _RENEWALS = 12, 5
# Steps from the fit to all folds to that without one.
_STEPS_WITHOUT = 4
# What held-out samples may differ from fitted ones where the filter is not run anew: innovations by this many of their
# standard deviations, variances by this factor. Derivatives do not know where a change ends.
_MOST_OFF, _MOST_WIDER = 1.0, 2.0
OUTLIERS = place("outlier_noise", "share")
_TIMES = (place("preference_switch", "time"), place("external_push", "time"))
_CENTRES = (place("road_grade", "centre"), place("slow_patch", "centre"))

# Coordinates: +1 log p, -1 log -p, 0 p itself.
_SIGN = np.array([1.0 if p.lower >= 0.0 else 0.0 for p in DECLARED])
_SIGN[OMEGA_2] = -1.0


@dataclass(frozen=True, eq=False)
class Recorded:
    """Trajectories made ready for the filter: the chain of every driver, whom he follows, and blocks of time.

    chains: N; ahead: (N, M - 1) columns of the vehicles ahead, those of most samples, or -1; block: (T,) number of the
    block of time; fold: (T,) in which it is held out; upper: (WIDTH,) bounds of the search.
    """

    trajectories: Trajectories
    chains: tuple[causal.Chain, ...]
    ahead: Ints
    block: Ints
    fold: Ints
    segment: Ints
    upper: Array

    @property
    def drivers(self) -> int:
        """Number of drivers."""
        return len(self.chains)


def prepare(trajectories: Trajectories, segment: Ints | None = None) -> Recorded:
    """Make trajectories ready; at a change of ``segment`` (T,) the recording is broken, and every filter starts anew.

    Raises InputError where there are too few samples to hold any out.
    """
    samples, drivers = trajectories.position_m.shape
    duration = trajectories.period_s * samples
    if duration < 8.0:
        raise InputError(f"{trajectories.source}: lasts {duration:.1f} s; give at least 8 s to fit and to hold out")
    block_s = min(BLOCK_S, duration / (2 * FOLDS))
    block = np.minimum(
        (np.arange(samples) * trajectories.period_s / block_s).astype(np.int64), round(duration / block_s) - 1
    )
    chains = tuple(causal.chain_behind(trajectories, i, segment=segment) for i in range(drivers))
    column = {int(v): k for k, v in enumerate(trajectories.vehicle)}
    ahead = np.full((drivers, causal.CHAIN - 1), -1)
    for i in range(drivers):
        for m in range(1, causal.CHAIN):
            known = trajectories.vehicle[_columns(trajectories, i, m)[_columns(trajectories, i, m) >= 0]]
            if len(known):
                values, counts = np.unique(known, return_counts=True)
                ahead[i, m - 1] = column[int(values[np.argmax(counts)])]
    upper = np.array([p.upper for p in DECLARED])
    upper[:COUNT] = upper_bounds(trajectories)
    upper[RHO] = 0.99
    unbroken = np.zeros(samples, np.int64) if segment is None else segment
    return Recorded(trajectories, chains, ahead, block, block % FOLDS, unbroken, upper)


def _columns(trajectories: Trajectories, driver: int, m: int) -> Ints:
    column = np.where(trajectories.present[:, driver], driver, -1)
    samples = np.arange(len(column))
    for _ in range(m):
        column = np.where(column >= 0, trajectories.leader[samples, column], -1)
    return column


@dataclass(frozen=True, eq=False)
class Samples:
    """Innovation y [m], its variance S [m^2] and log-likelihood of all samples, (N, T); NaN if not scored."""

    innovation_m: Array
    innovation_var: Array
    log_likelihood: Array

    @property
    def total(self) -> float:
        """Log-likelihood of all."""
        return float(np.nansum(self.log_likelihood))

    def copy(self) -> "Samples":
        """Arrays of their own."""
        return Samples(self.innovation_m.copy(), self.innovation_var.copy(), self.log_likelihood.copy())

    def only(self, who: Sequence[int]) -> "Samples":
        """Those of some drivers, NaN of the others."""
        some = unknown(*self.log_likelihood.shape)
        for i in who:
            some.put(i, self.of(i))
        return some

    def of(self, driver: int) -> tuple[Array, Array, Array]:
        """Those of one driver, (T,) each."""
        return self.innovation_m[driver], self.innovation_var[driver], self.log_likelihood[driver]

    def put(self, driver: int, samples: tuple[Array, Array, Array]) -> None:
        """Put in other samples of one driver, (T,) each."""
        self.innovation_m[driver], self.innovation_var[driver], self.log_likelihood[driver] = samples


def unknown(drivers: int, samples: int) -> Samples:
    """Samples of which nothing is known yet."""
    return Samples(*(np.full((drivers, samples), np.nan) for _ in range(3)))


@dataclass(frozen=True, eq=False)
class Model:
    """A model of all drivers: their rows (N, WIDTH), the entries fitted, and whom it takes to be ahead.

    individual, shared: places in the rows that are fitted, each driver's own and the same for all; prior_std: of the
    own ones over the drivers, in their coordinates; ahead: (N, WIDTH) rows that drivers have as leaders of others
    (shared entries follow ``rows``).
    """

    rows: Array
    individual: tuple[int, ...]
    shared: tuple[int, ...]
    prior_std: tuple[float, ...]
    ahead: Array

    @property
    def away(self) -> Array:
        """Own coordinates minus the median driver's, over the prior's std, (N, I)."""
        own = coordinate(self.rows[:, list(self.individual)], self.individual)
        return np.asarray((own - np.median(own, axis=0)) / np.array(self.prior_std))


def own_of(chain: causal.Chain, row: Array, ahead: Array) -> tuple[Array, Array, Array]:
    """Innovation, variance and log-likelihood of one driver's samples."""
    y, variance, density = causal.predict_samples(chain, row, ahead)
    return y, variance, density


def leaders(data: Recorded, model: Model, driver: int) -> Array:
    """Rows (M - 1, WIDTH) of the vehicles ahead of a driver."""
    ahead = data.ahead[driver]
    rows: Array = model.ahead[ahead]
    if ahead.min() < 0:
        rows[ahead < 0] = np.median(model.ahead, axis=0)
    rows[:, model.shared] = model.rows[driver, model.shared]
    return rows


def evaluate(data: Recorded, model: Model, work: Executor, who: Sequence[int] | None = None) -> Samples:
    """What the model says of every sample; of those of drivers ``who`` alone, NaN of the others', if they are given."""
    chosen = range(data.drivers) if who is None else who
    samples = unknown(data.drivers, len(data.fold))
    for i, at in zip(chosen, _evaluate(data, model, chosen, work), strict=True):
        samples.put(i, at)
    return samples


def _evaluate(data: Recorded, model: Model, who: Iterable[int], work: Executor) -> list[tuple[Array, Array, Array]]:
    jobs = [(data.chains[i], model.rows[i], leaders(data, model, i)) for i in who]
    return list(work.map(_star_own, jobs))


def _star_own(job: tuple[causal.Chain, Array, Array]) -> tuple[Array, Array, Array]:
    return own_of(*job)


def filtered_states(data: Recorded, model: Model, work: Executor) -> Array:
    """Filtered position, speed, noise and held acceleration of every driver, (T, N, 4); NaN where unknown."""
    return follow(data, model, work)[1]


def follow(data: Recorded, model: Model, work: Executor) -> tuple[Samples, Array]:
    """What the model says of every sample, and the filtered states as in ``filtered_states``."""
    jobs = [(data.chains[i], model.rows[i], leaders(data, model, i)) for i in range(data.drivers)]
    outputs = list(work.map(_follow_driver, jobs))
    y, variance, density = (np.array([o[k] for o in outputs]) for k in range(3))
    states = np.stack([o[3] for o in outputs], axis=1)
    states[~np.isfinite(variance.T)] = np.nan
    return Samples(y, variance, density), states


def _follow_driver(job: tuple[causal.Chain, Array, Array]) -> tuple[Array, Array, Array, Array]:
    chain, row, ahead = job
    return causal.predict_states(chain, row, ahead)


# --- coordinates -----------------------------------------------------------------------------------------------------


def coordinate(values: Array, places: Sequence[int]) -> Array:
    """Coordinates of parameters (..., K) at ``places``: logarithms where they have a sign."""
    sign = _SIGN[list(places)]
    logarithm = np.log(np.maximum(np.where(sign == 0.0, 1.0, sign * values), 1e-12))
    return np.where(sign == 0.0, values, logarithm)


def value(coordinates: Array, places: Sequence[int]) -> Array:
    """Parameters from their coordinates."""
    sign = _SIGN[list(places)]
    return np.where(sign == 0.0, coordinates, sign * np.exp(np.where(sign == 0.0, 0.0, coordinates)))


def difference_steps(data: Recorded, places: Sequence[int]) -> Array:
    """Steps of difference quotients where nothing is known of the information yet."""
    linear = _SIGN[list(places)] == 0.0
    return np.where(linear, _STEP * _reach(data, places), _STEP)


def _within(values: Array, places: Sequence[int], upper: Array) -> Array:
    lower = np.array([max(DECLARED[k].lower, 1e-3) if _SIGN[k] > 0.0 else DECLARED[k].lower for k in places])
    highest = np.array([min(upper[k], -1e-3) if _SIGN[k] < 0.0 else upper[k] for k in places])
    return np.clip(values, lower, highest)


# --- derivatives -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Slopes:
    """One driver's score and information in each fold, own parameters first, then the shared ones.

    score: (F, K); information: (F, K, K); log_likelihood: (F,); innovation, variance: (K, T), the derivatives of every
    sample's innovation and of its variance; density: (K, T), what that of its log-likelihood has beyond theirs, which
    is nothing but with outliers.
    """

    score: Array
    information: Array
    log_likelihood: Array
    innovation: Array
    variance: Array
    density: Array


def sums(
    samples: tuple[Array, Array, Array], derivatives: tuple[Array, Array, Array], row: Array, fold: Ints
) -> Slopes:
    """Score and information from a driver's samples, (T,) each, and their derivatives, (K, T) each, as in ``Slopes``.

    With outliers an innovation counts as much as the slope of its density says, and the information is that of the
    densities' products.
    """
    (y, variance, density), (dy, dvar, direct) = samples, derivatives
    score, information, total = np.zeros((FOLDS, len(dy))), np.zeros((FOLDS, len(dy), len(dy))), np.zeros(FOLDS)
    _add_up(y, variance, density, dy, dvar, direct, row, fold, score, information, total)
    return Slopes(score, information, total, dy, dvar, direct)


@njit(nogil=True, cache=True)
def _add_up(
    y: Array,
    variance: Array,
    density: Array,
    dy: Array,
    dvar: Array,
    direct: Array,
    row: Array,
    fold: Ints,
    score: Array,
    information: Array,
    total: Array,
) -> None:
    """Score (F, K), information (F, K, K) and log-likelihood (F,) of every fold, from scored samples."""
    robust, places = row[OUTLIERS] > 0.0, len(dy)
    slope = density_slope(y, variance, dy, dvar, row) + direct
    for t in range(len(fold)):
        if math.isnan(density[t]):
            continue
        f, s = fold[t], variance[t]
        total[f] += density[t]
        for i in range(places):
            score[f, i] += slope[i, t]
            for j in range(i + 1):
                if robust:
                    h = slope[i, t] * slope[j, t]
                else:
                    h = (dy[i, t] * dy[j, t] + 0.5 * dvar[i, t] * dvar[j, t] / s) / s
                information[f, i, j] += h
                if j < i:
                    information[f, j, i] += h


@njit(nogil=True, cache=True)
def density_slope(y: Array, variance: Array, dy: Array, dvar: Array, row: Array) -> Array:
    """Derivatives (K, T) of log-likelihoods through those of innovations and their variances."""
    slope = np.empty_like(dy)
    weight, density = np.ones_like(y), np.empty_like(y)
    if row[OUTLIERS] > 0.0:
        causal.weigh_samples(y, variance, row, weight, density)
    for t in range(len(y)):
        by_y = weight[t] * y[t] / variance[t]
        by_variance = 0.5 * weight[t] * (1.0 - by_y * y[t]) / variance[t]
        for k in range(len(dy)):
            slope[k, t] = -(dy[k, t] * by_y + dvar[k, t] * by_variance)
    return slope


def _slopes_of(
    chain: causal.Chain,
    row: Array,
    ahead: Array,
    at: tuple[Array, Array, Array],
    individual: tuple[int, ...],
    shared: tuple[int, ...],
    fold: Ints,
    steps: Array,
) -> Slopes:
    """Score and information of one driver, whose samples are ``at``, by difference quotients."""
    places = [*individual, *shared]
    coordinates = coordinate(row[places], places)
    dy, dvar, direct = (np.empty((len(places), len(fold))) for _ in range(3))
    for k, step in enumerate(steps):
        moved = coordinates.copy()
        moved[k] += step
        changed, changed_ahead = row.copy(), ahead
        changed[places] = value(moved, places)
        if k >= len(individual):
            changed_ahead = ahead.copy()
            changed_ahead[:, places[k]] = changed[places[k]]
        y, variance, density = own_of(chain, changed, changed_ahead)
        dy[k], dvar[k], direct[k] = (y - at[0]) / step, (variance - at[1]) / step, (density - at[2]) / step
    direct -= density_slope(at[0], at[1], dy, dvar, row) if row[OUTLIERS] > 0.0 else direct
    return sums(at, (dy, dvar, direct), row, fold)


def _star_slopes(
    job: tuple[causal.Chain, Array, Array, tuple[Array, Array, Array], tuple[int, ...], tuple[int, ...], Ints, Array],
) -> Slopes:
    return _slopes_of(*job)


def slopes(
    data: Recorded, model: Model, work: Executor, known: Sequence[Slopes] | None = None
) -> tuple[list[Slopes], Samples]:
    """Scores and informations of all drivers, and the samples, at a model; ``known``: slopes at one near by."""
    if known is None:
        steps = np.tile(difference_steps(data, [*model.individual, *model.shared]), (data.drivers, 1))
    else:
        steps = _informed_steps(data, model, known)
    samples = evaluate(data, model, work)
    return _slopes(data, model, samples, steps, range(data.drivers), work), samples


def _slopes(
    data: Recorded, model: Model, samples: Samples, steps: Array, who: Iterable[int], work: Executor
) -> list[Slopes]:
    """Slopes of drivers, whose samples are known, by difference quotients with steps (N, K)."""
    about = model.individual, model.shared, data.fold
    jobs = [(data.chains[i], model.rows[i], leaders(data, model, i), samples.of(i), *about, steps[i]) for i in who]
    return list(work.map(_star_slopes, jobs))


def _informed_steps(data: Recorded, model: Model, all_slopes: Sequence[Slopes]) -> Array:
    """Steps of difference quotients, (N, K), from the information; a shared parameter's is that of all drivers."""
    places, own = [*model.individual, *model.shared], len(model.individual)
    information = np.array([np.diag(s.information.sum(axis=0)) for s in all_slopes])
    information[:, :own] += 1.0 / np.square(np.array(model.prior_std))
    information[:, own:] = information[:, own:].sum(axis=0)
    longest = difference_steps(data, places) * (_LONGEST_STEP / _STEP)
    steps = _PART_OF_STD / np.sqrt(np.maximum(information, 1e-12))
    return np.asarray(np.clip(steps, 0.02 * longest, longest))


# --- the search ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Step:
    """A step of the search: of each driver's own coordinates (N, I), of the shared ones (S,), and what both promise.

    promises: (N,) of the own ones, in log posterior [nats]; promise: of all.
    """

    individual: Array
    shared: Array
    promises: Array
    promise: float


def solve(
    all_slopes: Sequence[Slopes],
    model: Model,
    folds: Sequence[int],
    damping: float | Array,
    curvature: Sequence[int] | None = None,
) -> Step:
    """Newton step of ``model`` on the samples of ``folds``, with the prior in proportion.

    damping: the drivers'; curvature: the folds that the information is taken from, if others.
    """
    curved, own = list(folds if curvature is None else curvature), len(model.individual)
    damped: Array = np.broadcast_to(damping, len(all_slopes))
    std, share = np.array(model.prior_std), len(folds) / FOLDS
    g: Array = np.array([s.score for s in all_slopes])[:, list(folds)].sum(axis=1)
    h: Array = np.array([s.information for s in all_slopes])[:, curved].sum(axis=1)
    g_own, h_own, cross = g[:, :own] - share * model.away / std, h[:, :own, :own], h[:, :own, own:]
    h_own = h_own + len(curved) / FOLDS * np.diag(1.0 / std**2)
    inverse = np.linalg.inv(h_own + damped[:, None, None] * (h_own * np.eye(own)))
    # what the own parameters give way by, for each shared one
    gives_way = inverse @ cross
    reduced = (h[:, own:, own:] - cross.transpose(0, 2, 1) @ gives_way).sum(axis=0)
    rest = g[:, own:].sum(axis=0) - np.einsum("nis,ni->s", gives_way, g_own)
    ridge = (damped.max() + 1e-9) * np.diag(np.abs(np.diag(reduced))) + 1e-6 * np.eye(len(rest))
    of_shared: Array = np.linalg.solve(reduced + ridge, rest).astype(np.float64)
    of_own: Array = np.einsum("nij,nj->ni", inverse, g_own - cross @ of_shared)
    promises: Array = 0.5 * np.einsum("ni,nij,nj->n", g_own, inverse, g_own)
    return Step(of_own, of_shared, promises, 0.5 * float(rest @ of_shared) + float(promises.sum()))


def moved(data: Recorded, model: Model, step: Step, share: float = 1.0) -> Model:
    """The model a step (or part of it) further, within bounds."""
    rows = model.rows.copy()
    own, shared = list(model.individual), list(model.shared)
    for places, change in ((own, step.individual), (shared, np.tile(step.shared, (len(rows), 1)))):
        if not places:
            continue
        now = coordinate(rows[:, places], places)
        longest = np.where(_SIGN[places] == 0.0, _reach(data, places), _LONGEST)
        rows[:, places] = _within(value(now + np.clip(share * change, -longest, longest), places), places, data.upper)
    return replace(model, rows=rows)


def _reach(data: Recorded, places: Sequence[int]) -> Array:
    """Longest step of linear coordinates: part of the declared range, of the recording, or of the road."""
    t = data.trajectories
    road = t.road.circumference_m or float(np.nanmax(t.position_m) - np.nanmin(t.position_m))
    reach = np.array([0.2 * (DECLARED[k].upper - DECLARED[k].lower) for k in places])
    for j, k in enumerate(places):
        if k in _TIMES:
            reach[j] = 0.05 * t.duration_s
        elif k in _CENTRES:
            reach[j] = 0.1 * road
    return reach


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model, and the samples and slopes at its maximum."""

    model: Model
    samples: Samples
    slopes: tuple[Slopes, ...]

    @property
    def log_likelihood(self) -> float:
        """Of all samples, those fitted."""
        return self.samples.total


def begun(data: Recorded, model: Model, work: Executor) -> Fit:
    """Where a search from ``model`` on begins."""
    start, samples = slopes(data, model, work)
    return Fit(model, samples, tuple(start))


def fit(data: Recorded, model: Model, work: Executor, *, iterations: int = _STEPS) -> Fit:
    """Maximise the likelihood from ``model`` on; ``iterations``: steps tried at most."""
    return climb(data, begun(data, model, work), work, iterations=iterations)


def refit(data: Recorded, near: Fit, model: Model, work: Executor, *, renewals: int = _RENEWALS) -> Fit:
    """Maximise the likelihood from ``model`` on, with the derivatives of a fit near by until they are poor."""
    start = _at(data, near, model, work, np.ones(data.drivers, np.bool_))
    return climb(data, start, work, renewals=renewals, fresh=False)


def climb(
    data: Recorded,
    start: Fit,
    work: Executor,
    *,
    folds: Sequence[int] = tuple(range(FOLDS)),
    iterations: int = _STEPS,
    enough: float = _ENOUGH,
    renewals: int = _RENEWALS,
    fresh: bool = True,
) -> Fit:
    """Go on from a model with slopes, until a step promises less than ``enough`` [nats].

    The derivatives of the samples, by far the dearest part, are kept from step to step and taken anew, ``renewals``
    times at most, where they have become so poor that a step gains less than half of what it promises, and at the end;
    ``fresh``: whether they are those of the start. Without shared parameters every driver goes his own way, and rests
    as soon as he is there.
    """
    here, together = start, bool(start.model.shared)
    damping: Array = np.full(data.drivers, 1e-3)
    is_fresh = np.full(data.drivers, fresh)

    def next_step() -> tuple[Step, NDArray[np.bool_]]:
        step = solve(here.slopes, here.model, folds, damping)
        return step, together | (step.promises > enough / data.drivers)

    for _ in range(iterations):
        step, moves = next_step()
        if step.promise < enough or damping[moves].min(initial=np.inf) > 1e4:
            if is_fresh.all() or not renewals:
                break
            here, renewals = _anew(data, here, work, ~is_fresh), renewals - 1
            is_fresh[:] = True
            step, moves = next_step()
            if step.promise < enough:
                break
        there = _at(data, here, moved(data, here.model, step), work, moves)
        rise = objectives(there.slopes, there.model, folds) - objectives(here.slopes, here.model, folds)
        promises = step.promises
        if together:
            rise, promises = np.full_like(rise, rise.mean()), np.full_like(rise, step.promise / data.drivers)
        better = moves & (rise > 0.0)
        here = _mixed(here, there, better)
        gained = np.where(better, rise, 0.0)
        poor = moves & (gained <= 0.5 * promises)
        if gained.sum() < enough and is_fresh[moves].all() and better.any():
            break
        damping = np.where(better, np.maximum(damping / 10.0, 1e-6), damping)
        damping = np.where(moves & ~better & is_fresh, np.maximum(10.0 * damping, 0.1), damping)
        again = poor & (better | ~is_fresh) & (renewals > 0)
        if again.any():
            here, renewals = _anew(data, here, work, again), renewals - 1
        is_fresh = (is_fresh & ~better) | again
    return here


def _at(data: Recorded, here: Fit, model: Model, work: Executor, who: NDArray[np.bool_]) -> Fit:
    """The model near by that some drivers (N,) move to, with the derivatives as they were."""
    numbers = np.flatnonzero(who)
    rows, slopes_, samples = here.model.rows.copy(), list(here.slopes), here.samples.copy()
    rows[who] = model.rows[who]
    for i, at in zip(numbers, _evaluate(data, model, numbers, work), strict=True):
        s = slopes_[i]
        slopes_[i] = sums(at, (s.innovation, s.variance, s.density), rows[i], data.fold)
        samples.put(i, at)
    return Fit(replace(model, rows=rows), samples, tuple(slopes_))


def _anew(data: Recorded, here: Fit, work: Executor, who: NDArray[np.bool_]) -> Fit:
    """The same with the derivatives of some drivers (N,) taken anew."""
    numbers, slopes_ = np.flatnonzero(who), list(here.slopes)
    steps = _informed_steps(data, here.model, here.slopes)
    for i, s in zip(numbers, _slopes(data, here.model, here.samples, steps, numbers, work), strict=True):
        slopes_[i] = s
    return replace(here, slopes=tuple(slopes_))


def _mixed(here: Fit, there: Fit, better: NDArray[np.bool_]) -> Fit:
    """The one fit for some drivers (N,) and ``here`` for the rest."""
    rows, slopes_, samples = here.model.rows.copy(), list(here.slopes), here.samples.copy()
    rows[better] = there.model.rows[better]
    for i in np.flatnonzero(better):
        slopes_[i] = there.slopes[i]
        samples.put(i, there.samples.of(i))
    return Fit(replace(here.model, rows=rows), samples, tuple(slopes_))


def objectives(all_slopes: Sequence[Slopes], model: Model, folds: Sequence[int]) -> Array:
    """Log-likelihood of each driver's samples in ``folds`` and log prior, in proportion; (N,)."""
    likelihood = np.array([s.log_likelihood for s in all_slopes])[:, list(folds)].sum(axis=1)
    return np.asarray(likelihood - 0.5 * len(folds) / FOLDS * np.square(model.away).sum(axis=1))


def objective(all_slopes: Sequence[Slopes], model: Model, folds: Sequence[int]) -> float:
    """The same of all drivers."""
    return float(objectives(all_slopes, model, folds).sum())


def start_model(drivers: int, individual: Sequence[int]) -> Model:
    """Where the search of a model without effects begins: a driver of whom nothing is known."""
    rows = np.tile(whole(population()), (drivers, 1))
    return Model(rows, tuple(individual), (), (PRIOR_STD,) * len(individual), rows.copy())


def fit_base(data: Recorded, individual: Sequence[int], work: Executor, start: Model | None = None) -> Fit:
    """Fit every driver for himself, then as draws of one population, with the drivers ahead as they were found.

    Without a ``start`` the search begins where the paper's likelihood, which is cheap, has its maximum.
    """
    first = start or start_model(data.drivers, individual)
    near = _by_paper(data, first, work) if start is None else None
    start_at = begun(data, near or first, work)
    found = climb(data, start_at, work, iterations=10 if near is None else 3, enough=_NEARLY)
    return _second_chance(data, refit(data, found, as_population(found.model), work), work)


def _second_chance(data: Recorded, found: Fit, work: Executor) -> Fit:
    """Let drivers who are unlike all others start again as the median driver; they keep what is better.

    The likelihood of a driver has several maxima, and a search may have ended in a poor one far away.
    """
    far = np.abs(found.model.away).max(axis=1) > _FAR_AWAY
    if not far.any():
        return found
    own = list(found.model.individual)
    rows = found.model.rows.copy()
    rows[np.ix_(far, own)] = np.median(rows[:, own], axis=0)
    elsewhere = _at(data, found, replace(found.model, rows=rows), work, far)
    again = climb(data, _anew(data, elsewhere, work, far), work)
    everywhere = range(FOLDS)
    better = objectives(again.slopes, again.model, everywhere) > objectives(found.slopes, found.model, everywhere)
    return climb(data, _mixed(found, again, better), work, iterations=4)


def _by_paper(data: Recorded, model: Model, work: Executor) -> Model | None:
    """The model with drivers as the paper's formulation finds them; None where that does not apply.

    What a driver's data do not hold is that of the median driver whose do, or where the search begins anyway.
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


def without_folds(data: Recorded, fitted: Fit, work: Executor, *, searched: bool) -> tuple[Model, ...]:
    """For every fold, the model fitted to the others.

    With ``searched`` by a search that does not see the fold, else nearly, as ``_without`` gives it.
    """
    models = []
    for f in range(FOLDS):
        model = _without(data, fitted, f)
        if searched:
            others = [k for k in range(FOLDS) if k != f]
            model = climb(data, begun(data, model, work), work, folds=others, iterations=_STEPS_WITHOUT).model
        models.append(model)
    return tuple(models)


def _without(data: Recorded, fitted: Fit, fold: int) -> Model:
    """The model fitted to all folds but one, by the infinitesimal jackknife (Giordano et al. 2019).

    One step with the information of all folds, in proportion: that of the others alone may be next to nothing for a
    parameter, and the step without end.
    """
    others = [k for k in range(FOLDS) if k != fold]
    step = solve(fitted.slopes, fitted.model, others, 1e-6, curvature=range(FOLDS))
    return moved(data, fitted.model, step, FOLDS / (FOLDS - 1))


def held_out(data: Recorded, models: Sequence[Model], work: Executor) -> Samples:
    """Samples of every fold as predicted by the model fitted without it, from ``without_folds``."""
    return of_folds(data, [evaluate(data, model, work) for model in models])


def of_folds(data: Recorded, by_model: Sequence[Samples]) -> Samples:
    """Samples put together, those of each fold from what the model of that number says of all."""
    known = unknown(data.drivers, len(data.fold))
    for f, samples in enumerate(by_model):
        mask = data.fold == f
        known.innovation_m[:, mask] = samples.innovation_m[:, mask]
        known.innovation_var[:, mask] = samples.innovation_var[:, mask]
        known.log_likelihood[:, mask] = samples.log_likelihood[:, mask]
    return known


def held_out_nearly(data: Recorded, fitted: Fit) -> Samples:
    """As ``held_out`` after ``without_folds``, but with the samples' derivatives instead of the filter, at once."""
    places = [*fitted.model.individual, *fitted.model.shared]
    at = coordinate(fitted.model.rows[:, places], places)
    without = np.array([_without(data, fitted, f).rows[:, places] for f in range(FOLDS)])
    changes = (coordinate(without, places) - at)[data.fold]
    near = fitted.samples.copy()
    for i, (s, row) in enumerate(zip(fitted.slopes, fitted.model.rows, strict=True)):
        y, variance, density = near.of(i)
        off_y, off_variance, off_density = (
            np.einsum("tk,kt->t", changes[:, i], d) for d in (s.innovation, s.variance, s.density)
        )
        most = _MOST_OFF * np.sqrt(variance)
        y += np.clip(off_y, -most, most)
        variance[:] = np.clip(variance + off_variance, variance / _MOST_WIDER, variance * _MOST_WIDER)
        scored = np.isfinite(density)
        causal.weigh_samples(y, variance, row, np.empty_like(y), density)
        density += np.where(scored, off_density, np.nan)
    return near


@dataclass(frozen=True)
class Gain:
    """Held-out log-likelihood of one model over another [nats], summed over all samples, and its standard error."""

    nats: float
    se: float
    drivers: tuple[float, ...]


def gain(data: Recorded, better: Samples, than: Samples) -> Gain:
    """Paired gain; its standard error is the larger one of the jackknives over blocks of time and over drivers."""
    difference = better.log_likelihood - than.log_likelihood
    by_driver = np.nansum(difference, axis=1)
    blocks = np.array([np.nansum(difference[:, data.block == b]) for b in np.unique(data.block)])
    return Gain(float(by_driver.sum()), max(sum_error(by_driver), sum_error(blocks)), tuple(by_driver.tolist()))


def sum_error(parts: ArrayLike) -> float:
    """Standard error of the sum of parts (N,) that are alike, by the jackknife."""
    x = np.asarray(parts)
    return math.sqrt(len(x) * float(np.var(x, ddof=1))) if len(x) > 1 else 0.0
