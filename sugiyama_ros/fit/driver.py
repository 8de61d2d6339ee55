"""Maximum-likelihood calibration of many drivers, each for himself (section 5 of the paper).

Fisher scoring: the expected information of innovations y with variance S is sum(dy dy' / S + dS dS' / 2 S^2), so the
utility's parameters are a least-squares problem (S does not depend on them) and the noises come with it. The search
runs in logarithms, with damping after Levenberg and Marquardt, between bounds. Nothing of one driver depends on
another, so any executor will do: threads, processes, or the workers of a Dask cluster.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import basinhopping

from sugiyama_ros.driver.parameters import (
    COUNT,
    KAPPA_V,
    NAMES,
    PARAMETERS,
    SIGMA_A,
    V_STAR,
    defaults,
    index,
    population,
)
from sugiyama_ros.filters import causal, paper
from sugiyama_ros.filters.chain import CHAIN, Chain
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.paper import Scored
from sugiyama_ros.fit.intervals import end_of_profile, quadratic
from sugiyama_ros.road import Array, Ints
from sugiyama_ros.trajectories.trajectories import Trajectories

Formulation = Literal["paper", "causal"]
#: The parameters that the paper estimates; section 4.1.
ESTIMATED = ("sigma_nu", "sigma_a", "v_star", "kappa_v")
# A desired speed [m/s] above this is not searched for, unless the data show at least half of it: below about half the
# desired speed the reward phi1 turns convex, and data of slow driving do not hold v* (Sugiyama's vehicle 21).
_FASTEST = 30.0
# Acceleration noise [m/s^2] to start from: larger than what is found, so that the search comes from the smooth side.
# The paper's likelihood has further maxima in kappa_v, within 0.4 of the one that is found from here.
_START_SIGMA_A = 1.0
# No parameter is searched for below this, in its own unit.
_SMALLEST = 1e-3
# Longest step in a logarithm; steps at most; a step that promises less log-likelihood ends the search.
_LONGEST, _STEPS, _ENOUGH = 0.7, 60, 1e-4
# The same for the causal likelihood, which is rough at a small scale.
_ENOUGH_CAUSAL = 0.02
# Difference quotients of the causal filter: part of a parameter's std, bounds of the step in a logarithm, first one.
_PART_OF_STD, _SHORTEST_STEP, _LONGEST_STEP, _FIRST_STEP = 0.5, 5e-3, 0.05, 0.03
# Std of a logarithm from which on a parameter does not count as identified.
_VAGUE = 0.5
#: The paper's regularisation, Eq. Regularized_SSM_Likelihood: centre and weight of v* [m/s] and kappa_v [s].
REGULARISATION = ((V_STAR, 11.0, 50.0), (KAPPA_V, 0.5, 500.0))
# Jobs that are handed to an executor at a time, so that memory stays bounded however many drivers there are.
_BATCH = 512
#: Score at parameters (P,), given the information (P, P) at some near by, if there is any yet.
Score = Callable[[Array, Array | None], Scored]


@dataclass(frozen=True, eq=False)
class Fit:
    """Maximum-likelihood estimate of one driver.

    parameters: (P,) with the estimated ones replaced; log_likelihood: there, no 2 pi term nor regularisation; std:
    (P,), from the expected information, 0 for what was given and infinite for what lies on a bound; at_bound: names of
    the estimated ones that do, so which the data do not hold; interval: (P, 2), ends of the 95 % intervals, 0 or
    infinite where the data set none.
    """

    vehicle: int
    parameters: Array
    log_likelihood: float
    std: Array
    at_bound: tuple[str, ...]
    interval: Array

    def identified(self, name: str) -> bool:
        """Whether the data hold a parameter: it lies on no bound, and is known to half of its value."""
        k = index(name)
        return name not in self.at_bound and bool(self.std[k] < _VAGUE * abs(self.parameters[k]))


def fit_driver(
    score: Score,
    vehicle: int,
    start: Array,
    places: Ints,
    upper: Array,
    enough: float = _ENOUGH,
    careful: Score | None = None,
) -> Fit:
    """Maximise a likelihood over the entries ``places``, from ``start`` (P,), between lower bounds and ``upper``.

    careful: a better score, from which the errors are taken at the maximum.
    """
    sign, smallest, largest = search_bounds(start, places, upper)

    def at(x: Array, information: Array | None) -> tuple[Scored, Array, Array]:
        parameters = _replaced(start, places, sign * np.exp(x))
        scored = score(parameters, information)
        scale = parameters[places]
        return (
            scored,
            scored.gradient[places] * scale,
            scored.information[np.ix_(places, places)] * np.outer(scale, scale),
        )

    x = np.clip(np.log(np.abs(start[places])), smallest, largest)
    here, gradient, information = at(x, None)
    damping = 1e-3
    for _ in range(_STEPS):
        free = ~(((x <= smallest) & (gradient < 0.0)) | ((x >= largest) & (gradient > 0.0)))
        if not free.any():
            break
        h = information[np.ix_(free, free)]
        ridge = np.diag(damping * np.diag(h) + 1e-9)
        change = np.zeros_like(x)
        change[free] = np.linalg.solve(h + ridge, gradient[free])
        if 0.5 * float(gradient @ change) < enough or damping > 1e8:
            break
        moved = np.clip(x + np.clip(change, -_LONGEST, _LONGEST), smallest, largest)
        there, gradient_there, information_there = at(moved, here.information)
        if there.log_likelihood > here.log_likelihood:
            x, here, gradient, information = moved, there, gradient_there, information_there
            damping = max(damping / 10.0, 1e-9)
        else:
            damping = max(damping * 10.0, 1e-2)
    parameters = _replaced(start, places, sign * np.exp(x))
    bound = (x <= smallest) | (x >= largest)
    inside = places[~bound]
    std: Array = np.zeros(len(start))
    std[places] = np.inf
    if len(inside):
        std[inside] = _stds(here if careful is None else careful(parameters, here.information), inside)
    at_bound = tuple(NAMES[k] for k, b in zip(places, bound, strict=True) if b)
    return Fit(vehicle, parameters, here.log_likelihood, std, at_bound, quadratic(parameters, std))


def search_bounds(start: Array, places: Ints, upper: Array) -> tuple[Array, Array, Array]:
    """Signs, and smallest and largest logarithms of the sizes, of the parameters at ``places``."""
    sign = np.sign(start[places])
    low, high = (np.array([getattr(PARAMETERS[k], side) for k in places]) for side in ("lower", "upper"))
    high = np.minimum(high, upper[places])
    smallest = np.log(np.maximum(np.where(sign > 0.0, low, -high), _SMALLEST))
    largest = np.log(np.maximum(np.where(sign > 0.0, high, -low), _SMALLEST))
    return sign, smallest, largest


def _replaced(parameters: Array, places: Ints, values: Array) -> Array:
    """A copy of parameters (P,) with other values at ``places``."""
    copy = parameters.copy()
    copy[places] = values
    return copy


def _stds(scored: Scored, places: Ints) -> Array:
    """Standard deviations of the parameters at ``places`` at a maximum.

    From the expected information, or where the samples' gradients scatter by more than that, from the sandwich of both
    (Huber 1967), which holds for a likelihood that is an approximation, too.
    """
    block = np.ix_(places, places)
    covariance = np.linalg.pinv(scored.information[block], hermitian=True)
    variance = np.diag(covariance)
    if scored.scatter is not None:
        variance = np.maximum(variance, np.diag(covariance @ scored.scatter[block] @ covariance))
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def causal_score(
    chain: Chain,
    ahead: Array | None,
    places: Ints,
    parameters: Array,
    information: Array | None,
    central: bool = False,
) -> Scored:
    """Score of the causal formulation by difference quotients of innovations and variances, in the logarithms.

    central: to both sides, for twice the work: one jump of the rough likelihood then does less harm.
    """
    y, variance, density = causal.predict_samples(chain, parameters, ahead)
    steps = np.full(len(places), _FIRST_STEP)
    if information is not None:
        held = np.diag(information)[places] * parameters[places] ** 2
        steps = np.clip(_PART_OF_STD / np.sqrt(np.maximum(held, 1e-12)), _SHORTEST_STEP, _LONGEST_STEP)
    scored = np.isfinite(density)
    y, variance = y[scored], variance[scored]
    dy, dvar = np.empty((len(places), len(y))), np.empty((len(places), len(y)))
    for j, (k, step) in enumerate(zip(places, steps, strict=True)):
        moved = parameters.copy()
        moved[k] *= np.exp(step)
        y_up, variance_up, _ = causal.predict_samples(chain, moved, ahead)
        y_down, variance_down, span = y, variance, step
        if central:
            moved[k] = parameters[k] * np.exp(-step)
            y_down, variance_down = (one[scored] for one in causal.predict_samples(chain, moved, ahead)[:2])
            span = 2.0 * step
        dy[j], dvar[j] = (y_up[scored] - y_down) / span, (variance_up[scored] - variance_down) / span
    slopes = -(dy * (y / variance) + 0.5 * dvar * (1.0 - y * y / variance) / variance)
    curvature = (dy / variance) @ dy.T + 0.5 * (dvar / variance**2) @ dvar.T
    gradient, full, scatter = np.zeros(COUNT), np.zeros((COUNT, COUNT)), np.zeros((COUNT, COUNT))
    scale = parameters[places]
    block = np.ix_(places, places)
    gradient[places] = slopes.sum(axis=1) / scale
    full[block] = curvature / np.outer(scale, scale)
    scatter[block] = slopes @ slopes.T / np.outer(scale, scale)
    return Scored(float(density[scored].sum()), gradient, full, scatter)


def regularised(scored: Scored, parameters: Array) -> Scored:
    """Eq. Regularized_SSM_Likelihood."""
    value, gradient, information = scored.log_likelihood, scored.gradient.copy(), scored.information.copy()
    for k, centre, weight in REGULARISATION:
        off = parameters[k] - centre
        value -= weight * off * off
        gradient[k] -= 2.0 * weight * off
        information[k, k] += 2.0 * weight
    return Scored(value, gradient, information)


@dataclass(frozen=True, eq=False)
class Job:
    """One driver's data and the search for his parameters; of the paper's formulation ``perceived``, else ``chain``."""

    vehicle: int
    start: Array
    places: Ints
    upper: Array
    is_regularised: bool = False
    profiled: bool = False
    hops: int = 0
    seed: int = 0
    with_errors: bool = True
    perceived: paper.Perceived | None = None
    chain: Chain | None = None
    ahead: Array | None = None

    def score(self, parameters: Array, information: Array | None, central: bool = False) -> Scored:
        if self.perceived is not None:
            return paper.score(self.perceived, parameters, self.places)
        assert self.chain is not None
        return causal_score(self.chain, self.ahead, self.places, parameters, information, central)

    def objective(self, parameters: Array, information: Array | None) -> Scored:
        scored = self.score(parameters, information)
        return regularised(scored, parameters) if self.is_regularised else scored

    def careful(self, parameters: Array, _: Array | None) -> Scored:
        # what the search knows of the information may come from a jump, which would make the next steps short, too
        rough = self.score(parameters, None, central=True)
        return self.score(parameters, rough.information, central=True)


def carry_out(job: Job) -> Fit:
    """Search, and what else is asked for."""
    if job.hops:
        job = replace(job, start=_hop(job))
    search = (job.objective, job.vehicle, job.start, job.places, job.upper)
    careful = job.careful if job.with_errors else None
    found = fit_driver(*search) if job.perceived is not None else fit_driver(*search, _ENOUGH_CAUSAL, careful)
    if job.profiled:
        found = replace(found, interval=_profile(job, found))
    if job.is_regularised:
        found = replace(found, log_likelihood=job.score(found.parameters, None).log_likelihood)
    return found


def _hop(job: Job) -> Array:
    """Parameters (P,) of the best of many local searches (Wales and Doye, J. Phys. Chem. A 101 (1997) 5111)."""
    sign, smallest, largest = search_bounds(job.start, job.places, job.upper)

    def at(x: Array) -> tuple[float, Array]:
        parameters = _replaced(job.start, job.places, sign * np.exp(x))
        scored = job.objective(parameters, None)
        return -scored.log_likelihood, -scored.gradient[job.places] * parameters[job.places]

    found = basinhopping(
        at,
        np.clip(np.log(np.abs(job.start[job.places])), smallest, largest),
        niter=job.hops,
        minimizer_kwargs={"method": "L-BFGS-B", "jac": True, "bounds": list(zip(smallest, largest, strict=True))},
        rng=np.random.default_rng([job.seed, job.vehicle]),
    )
    return _replaced(job.start, job.places, sign * np.exp(found.x))


def _profile(job: Job, found: Fit) -> Array:
    """Ends (P, 2) of the intervals of those parameters that were searched for, from the profile of their likelihood."""
    interval = found.interval.copy()
    _, smallest, largest = search_bounds(found.parameters, job.places, job.upper)
    for k, low, high in zip(job.places.tolist(), smallest.tolist(), largest.tolist(), strict=True):
        size = abs(float(found.parameters[k]))
        for side, sign, furthest in ((0, -1.0, np.log(size) - low), (1, 1.0, high - np.log(size))):
            distance = end_of_profile(_fall(job, found, k, sign), float(found.std[k]) / size, max(0.0, float(furthest)))
            interval[k, side] = found.parameters[k] * np.exp(sign * distance)
    return np.sort(interval, axis=-1)


def _fall(job: Job, found: Fit, place: int, sign: float) -> Callable[[float], float]:
    """Square root of twice the profile's fall, at a distance from what was found in the logarithm of a parameter."""
    held, last = replace(job, places=job.places[job.places != place]), found.parameters.copy()

    def fall(distance: float) -> float:
        last[place] = found.parameters[place] * np.exp(sign * distance)
        there = fit_driver(held.objective, held.vehicle, last, held.places, held.upper, _ENOUGH_CAUSAL)
        last[:] = there.parameters
        return float(np.sqrt(2.0 * max(0.0, found.log_likelihood - there.log_likelihood)))

    return fall


def upper_bounds(trajectories: Trajectories) -> Array:
    """Upper bounds (P,) of the search; that of v* follows the speeds in the data."""
    upper = np.array([p.upper for p in PARAMETERS])
    speed = paper.smoothed_speed(trajectories.road.unwrap(trajectories.position_m), 2, trajectories.period_s)
    upper[V_STAR] = min(upper[V_STAR], max(_FASTEST, 2.0 * float(np.nanquantile(speed, 0.99))))
    return upper


def calibrate(
    trajectories: Trajectories,
    formulation: Formulation = "causal",
    estimated: Sequence[str] = ESTIMATED,
    *,
    is_regularised: bool = False,
    profiled: bool = False,
    hops: int = 0,
    seed: int = 0,
    with_errors: bool = True,
    starts: Mapping[int, Array] | None = None,
    skip: Collection[int] = (),
    work: Executor | None = None,
) -> Iterator[Fit]:
    """Fit every driver for himself, and yield the fits in the order of the vehicles.

    starts: parameters (P,) by vehicle, from which the search begins, and which the drivers ahead are taken to have;
    without them it begins at the paper's mean with a larger acceleration noise. profiled: whether intervals come from
    the profile likelihood; hops: of scipy's basinhopping, with a seed, before the search; with_errors: whether the
    causal formulation's errors matter, which cost as much as a search; skip: vehicles to leave out;
    work: what carries the searches out, in turn if nothing does. Raises InputError for an unknown parameter, or data
    that the formulation cannot take.
    """
    places, upper, known = np.array([index(name) for name in estimated]), upper_bounds(trajectories), starts or {}

    def job(driver: int) -> Job:
        one = job_of(trajectories, driver, formulation, places, upper, known)
        return replace(
            one, is_regularised=is_regularised, profiled=profiled, hops=hops, seed=seed, with_errors=with_errors
        )

    skipped = set(skip)
    left = [i for i, v in enumerate(trajectories.vehicle.tolist()) if v not in skipped]
    for first in range(0, len(left), _BATCH):
        jobs = map(job, left[first : first + _BATCH])
        yield from map(carry_out, jobs) if work is None else work.map(carry_out, list(jobs))


def job_of(
    trajectories: Trajectories,
    driver: int,
    formulation: Formulation,
    places: Ints,
    upper: Array,
    known: Mapping[int, Array],
) -> Job:
    """The plain search for the parameters at ``places`` of one driver; known: starts by vehicle."""
    begin = defaults()
    begin[SIGMA_A] = _START_SIGMA_A
    vehicle = int(trajectories.vehicle[driver])
    one = Job(vehicle, known.get(vehicle, begin), places, upper)
    if formulation == "paper":
        return replace(one, perceived=paper.perceive(trajectories, driver))
    chain = chain_behind(trajectories, driver)
    ahead = [known.get(_most(chain.identity[:, m]), population()) for m in range(1, CHAIN)]
    return replace(one, chain=chain, ahead=np.array(ahead))


def _most(identity: Ints) -> int:
    """Who is there in most samples, or -1."""
    values, counts = np.unique(identity[identity >= 0], return_counts=True)
    return int(values[np.argmax(counts)]) if len(values) else -1
