"""Maximum-likelihood calibration of one driver (section 5 of the paper)."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import COUNT, KAPPA_V, NAMES, SIGMA_A, V_STAR, index
from sugiyama_ros.filters import paper
from sugiyama_ros.filters.chain import CHAIN, Chain
from sugiyama_ros.filters.paper import Scored
from sugiyama_ros.fit.coordinates import (
    ENOUGH_CAUSAL,
    LONGEST,
    LONGEST_STEP,
    PART_OF_STD,
    Damping,
    coordinate,
    damped_step,
    fastest,
    has_both_ends,
    limits,
    lower_bounds,
    upper_bounds,
    value,
    with_open_ends,
)
from sugiyama_ros.fit.smooth_positions import ESTIMATED, evenness, measured, with_short_periods
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.workers import ordered_map

# Steps of the difference quotients of the causal filter, in a logarithm: shortest and first one.
_SHORTEST_STEP, _FIRST_STEP = 5e-3, 0.03
# The paper's regularisation, Eq. Regularized_SSM_Likelihood: centre and weight of v* [m/s] and kappa_v [s].
_REGULARISATION = ((V_STAR, 11.0, 50.0), (KAPPA_V, 0.5, 500.0))


class DriverChains(NamedTuple):
    """One driver in the filter: one chain or several, of different times.

    chains: data of the driver and of the vehicles ahead; ahead: (M - 1, P), for each chain the parameters of the
    drivers ahead; scored: (T,), samples of each chain that count, besides those that the filter leaves out; empty if
    all others count.
    """

    chains: tuple[Chain, ...]
    ahead: tuple[Array, ...]
    scored: tuple[Mask, ...] = ()


def _causal_score(
    followed: DriverChains,
    places: Ints,
    parameters: Array,
    information: Array | None,
    central: bool = False,
    here: Array | None = None,
) -> Scored:
    """Return the score from difference quotients of innovations and variances, by the logarithms of the parameters.

    information: (P, P), information at nearby parameters, which sets the steps; none if it is not known; here: (3,
    samples), what ``predicted`` returns for these parameters, if it is known.
    """
    steps = np.full(len(places), _FIRST_STEP)
    if information is not None:
        held = np.diag(information)[places] * parameters[places] ** 2
        steps = np.clip(PART_OF_STD / np.sqrt(np.maximum(held, 1e-12)), _SHORTEST_STEP, LONGEST_STEP)
    signs = (1.0, -1.0) if central else (1.0,)
    moved = np.tile(parameters, (len(signs), len(places), 1))
    for sign, rows in zip(signs, moved, strict=True):
        rows[np.arange(len(places)), places] *= np.exp(sign * steps)
    here = predicted(followed, [parameters])[0] if here is None else here
    there = predicted(followed, [*moved.reshape(-1, len(parameters))])
    density = here[2]
    scored = np.isfinite(density)
    y, variance = here[:2, scored]
    up = there[: len(places), :2, scored]
    down = there[len(places) :, :2, scored] if central else here[:2, scored]
    dy, dvar = np.moveaxis((up - down) / (len(signs) * steps[:, None, None]), 1, 0)
    slopes = -(dy * (y / variance) + 0.5 * dvar * (1.0 - y * y / variance) / variance)
    curvature = (dy / variance) @ dy.T + 0.5 * (dvar / variance**2) @ dvar.T
    gradient, full, scatter = np.zeros(COUNT), np.zeros((COUNT, COUNT)), np.zeros((COUNT, COUNT))
    scale = parameters[places]
    block = np.ix_(places, places)
    gradient[places] = slopes.sum(axis=1) / scale
    full[block] = curvature / np.outer(scale, scale)
    scatter[block] = slopes @ slopes.T / np.outer(scale, scale)
    return Scored(float(density[scored].sum()), gradient, full, scatter)


def predicted(followed: DriverChains, rows: Sequence[Array]) -> Array:
    """Return innovations, their variances and log-likelihoods (R, 3, samples of all chains) at R rows of parameters."""
    # Imported here: the paper's formulation does not need the causal filter, which takes long to load.
    from sugiyama_ros.filters import causal

    if not rows:  # one parameter alone has a profile, too
        return np.empty((0, 3, sum(len(chain.position_m) for chain in followed.chains)))
    each_chain = list(zip(followed.chains, followed.ahead, strict=True))
    jobs = [causal.ChainJob(chain, row, ahead) for row in rows for chain, ahead in each_chain]
    each, count = causal.predict_samples(jobs), len(followed.chains)
    found = [np.concatenate([np.array(one) for one in each[k : k + count]], axis=1) for k in range(0, len(jobs), count)]
    samples = np.array(found)
    if followed.scored:
        samples[:, 2, ~np.concatenate(followed.scored)] = np.nan
    return samples


def regularised(scored: Scored, parameters: Array) -> Scored:
    """Add the paper's regularisation, Eq. Regularized_SSM_Likelihood, to the score at parameters (P,)."""
    value, gradient, information = scored.log_likelihood, scored.gradient.copy(), scored.information.copy()
    for k, centre, weight in _REGULARISATION:
        off = parameters[k] - centre
        value -= weight * off * off
        gradient[k] -= 2.0 * weight * off
        information[k, k] += 2.0 * weight
    return Scored(value, gradient, information)


Formulation = Literal["paper", "causal"]
#: Acceleration noise [m/s^2] at the start. It is larger than usual estimates, because the likelihood is smoother there.
START_SIGMA_A = 1.0
# The paper's likelihood has several maxima: a small risk premium with a desired speed far above the data may explain a
# driver as well. Factors of v_star and kappa_v at the starts: of 154 drivers, measured and simulated, 25 have a maximum
# that is 0.1 to 301 nats higher than the one of the first start. These four starts find all that a grid of 25 finds.
_STARTS = ((1.0, 1.0), (0.7, 6.0), (2.2, 0.15), (0.7, 0.15))
# A search with the paper's formulation ends when a step has a predicted gain below this [nats].
_ENOUGH = 1e-4


# Maximum number of steps of a search.
_STEPS = 60
# Damping of the search for the parameters of a single driver.
_ALONE = Damping(least=1e-9, least_after_failure=1e-2, most=1e8)


@dataclass(frozen=True)
class SearchOptions:
    """Options of a calibration of drivers.

    is_regularised: whether to add the paper's regularisation; profiled: whether intervals come from the profile
    likelihood; with_errors: whether to compute the standard errors of the causal formulation, which takes as long as a
    search; from_several: whether the search begins at several starts, and the highest maximum counts.
    """

    is_regularised: bool = False
    profiled: bool = False
    with_errors: bool = True
    from_several: bool = False


@dataclass(frozen=True, eq=False)
class Fit:
    """Maximum-likelihood estimate of one driver.

    vehicle: number of the vehicle; parameters: (P,), estimated parameters; log_likelihood: log-likelihood at the
    maximum [nats], without the 2 pi term and the regularisation; std: (P,), standard deviations; 0 for a parameter that
    was given, infinite for a parameter on a bound or one that the data say nothing about; at_bound: names of the
    parameters on a bound, which the data do not determine; interval: (P, 2), ends of the 95 % intervals, as of
    ``with_open_ends``.
    """

    vehicle: int
    parameters: Array
    log_likelihood: float
    std: Array
    at_bound: tuple[str, ...]
    interval: Array

    def identified(self, name: str) -> bool:
        """Whether the data determine a parameter: it is not on a bound, and ``is_determined``."""
        k = index(name)
        return name not in self.at_bound and bool(is_determined(self.std[k], self.parameters[k], self.interval[k]))


@dataclass(frozen=True, eq=False)
class Job:
    """Data of one driver, and the search for the driver's parameters.

    vehicle: number; start, lower, upper: start, smallest sizes and upper bounds (P,); places: places (K,) of the
    parameters in the search; options: options of the calibration; perceived: data of the paper's formulation;
    followed: data of the causal formulation.
    """

    vehicle: int
    start: Array
    places: Ints
    lower: Array
    upper: Array
    options: SearchOptions = SearchOptions()
    perceived: paper.Perceived | None = None
    followed: DriverChains | None = None

    @property
    def x(self) -> Array:
        """Coordinates (K,) of the start, within the bounds."""
        return np.clip(coordinate(self.start[self.places], self.places), *self.ends)

    @property
    def ends(self) -> Array:
        """Smallest and largest coordinates (2, K)."""
        return np.sort(coordinate(limits(self.places, self.lower, self.upper), self.places), axis=0)

    def parameters(self, x: Array) -> Array:
        """Return all parameters (P,) at the coordinates x (K,)."""
        moved = self.start.copy()
        moved[self.places] = value(x, self.places)
        return moved

    def score(
        self, parameters: Array, information: Array | None, central: bool = False, here: Array | None = None
    ) -> Scored:
        """Return the score of the formulation without regularisation; arguments as for ``_causal_score``."""
        if self.perceived is not None:
            return paper.score(self.perceived, parameters, self.places)
        assert self.followed is not None
        return _causal_score(self.followed, self.places, parameters, information, central, here)

    def objective(self, parameters: Array, information: Array | None, here: Array | None = None) -> Scored:
        """Return the score that the search maximises; arguments as for ``_causal_score``."""
        scored = self.score(parameters, information, here=here)
        return regularised(scored, parameters) if self.options.is_regularised else scored

    def better(self, parameters: Array, information: Array | None, above: float) -> Scored | None:
        """Return ``objective``, or None if its value is not above ``above``."""
        if self.followed is None:
            return self.objective(parameters, information)
        # the slopes take several passes of the filter, the log-likelihood takes one, and the regularisation lowers it
        here = predicted(self.followed, [parameters])[0]
        return self.objective(parameters, information, here) if np.nansum(here[2]) > above else None

    def careful(self, parameters: Array) -> Scored:
        """Return the score from central differences, whose steps follow from a newly computed information."""
        # the information of the search may come from a jump of the likelihood, which would make these steps too short
        rough = self.score(parameters, None, central=True)
        return self.score(parameters, rough.information, central=True)


def carry_out(job: Job) -> Fit:
    """Search for one driver's parameters, with the options of the job."""
    options = job.options
    enough = ENOUGH_CAUSAL if job.perceived is None else _ENOUGH
    is_careful = job.perceived is None and options.with_errors
    # the first of equal maxima counts
    found = max((_fit(one, enough, is_careful) for one in _started(job)), key=_height)
    if options.profiled:
        found = replace(found, interval=_profile(job, found))
    if options.is_regularised:
        found = replace(found, log_likelihood=job.score(found.parameters, None).log_likelihood)
    return found


def _derivatives(scored: Scored, parameters: Array, places: Ints) -> tuple[Array, Array]:
    """Gradient (K,) and information (K, K) of a score at parameters (P,), by the coordinates at ``places``."""
    scale, block = parameters[places], scored.information[np.ix_(places, places)]
    return scored.gradient[places] * scale, block * np.outer(scale, scale)


class _Point(NamedTuple):
    """A point of a search: coordinates (K,), the function's value, its derivatives, and what the caller keeps."""

    x: Array
    value: float
    gradient: Array
    information: Array
    scored: Any


def _search(at: Callable[[Array, _Point | None], _Point | None], start: Array, ends: Array, enough: float) -> _Point:
    """Maximise a function of coordinates (K,) between their ``ends`` (2, K)."""
    (smallest, largest), here, damping = ends, at(start, None), _ALONE.start
    if here is None:
        raise ValueError("the search needs a point to begin with")
    for _ in range(_STEPS):
        x, gradient = here.x, here.gradient
        free = ~(((x <= smallest) & (gradient < 0.0)) | ((x >= largest) & (gradient > 0.0)))
        if not free.any():
            break
        change = np.zeros_like(x)
        change[free] = damped_step(here.information[np.ix_(free, free)], gradient[free], damping, 1e-9)
        if 0.5 * float(gradient @ change) < enough or damping > _ALONE.most:
            break
        there = at(np.clip(x + np.clip(change, -LONGEST, LONGEST), smallest, largest), here)
        is_better = there is not None and there.value > here.value
        here = there if there is not None and is_better else here
        damping = float(_ALONE.updated(damping, is_better, not is_better))
    return here


def _fit(job: Job, enough: float, is_careful: bool = False) -> Fit:
    """Maximise the likelihood, until the predicted gain of a step is less than ``enough`` [nats]."""

    def at(x: Array, near: _Point | None) -> _Point | None:
        parameters = job.parameters(x)
        known = (None, -np.inf) if near is None else (near.scored.information, near.value)
        scored = job.better(parameters, *known)
        if scored is None:
            return None
        return _Point(x, scored.log_likelihood, *_derivatives(scored, parameters, job.places), scored)

    found, places = _search(at, job.x, job.ends, enough), job.places
    parameters = job.parameters(found.x)
    bound = (found.x <= job.ends[0]) | (found.x >= job.ends[1])
    std: Array = np.zeros(len(parameters))
    std[places] = np.inf
    if not bound.all():
        scored = job.careful(parameters) if is_careful else found.scored
        std[places[~bound]] = stds(scored, parameters, places[~bound])
    interval = quadratic(parameters, std)
    interval[places] = with_open_ends(interval[places], places, limits(places, job.lower, job.upper))
    return Fit(
        vehicle=job.vehicle,
        parameters=parameters,
        log_likelihood=found.value,
        std=std,
        at_bound=tuple(NAMES[k] for k in places[bound]),
        interval=interval,
    )


def _started(job: Job) -> Iterator[Job]:
    """The search from each of its starts."""
    several = job.options.from_several
    if job.followed is not None:
        yield job
        own = _own_speed(job.followed) if several and V_STAR in job.places else math.nan
        if not math.isnan(own):
            yield _from(job, own, float(job.start[KAPPA_V]))
        return
    both = np.isin((V_STAR, KAPPA_V), job.places).all()
    for v_star, kappa_v in _STARTS if several and both else _STARTS[:1]:
        yield _from(job, v_star * float(job.start[V_STAR]), kappa_v * float(job.start[KAPPA_V]))


def _from(job: Job, v_star: float, kappa_v: float) -> Job:
    start = job.start.copy()
    start[V_STAR], start[KAPPA_V] = v_star, kappa_v
    return replace(job, start=start)


def _own_speed(followed: DriverChains) -> float:
    """High speed [m/s] of a driver; NaN if it is not known."""
    counts = followed.scored or tuple(np.ones(len(chain.position_m), np.bool_) for chain in followed.chains)
    speeds = [chain.high_speed(one) for chain, one in zip(followed.chains, counts, strict=True)]
    return max((speed for speed in speeds if not math.isnan(speed)), default=math.nan)


def _height(fit: Fit) -> float:
    """Log-likelihood, to a hundredth of a nat: less does not tell two maxima apart."""
    return round(fit.log_likelihood, 2)


def _profile(job: Job, found: Fit) -> Array:
    """Ends (P, 2) of the intervals; the parameters of the search get intervals from the profile likelihood."""
    interval = found.interval.copy()
    for k, low, high in zip(job.places.tolist(), *job.ends.tolist(), strict=True):
        size = abs(float(found.parameters[k]))
        for side, sign, furthest in ((0, -1.0, np.log(size) - low), (1, 1.0, high - np.log(size))):
            distance = end_of_profile(_fall(job, found, k, sign), float(found.std[k]) / size, max(0.0, float(furthest)))
            interval[k, side] = found.parameters[k] * np.exp(sign * distance)
    return np.sort(interval, axis=-1)


def _fall(job: Job, found: Fit, place: int, sign: float) -> Callable[[float], float]:
    """Square root of twice the fall of the profile, at a distance from the maximum in the logarithm of a parameter."""
    held, last = replace(job, places=job.places[job.places != place]), found.parameters.copy()

    def fall(distance: float) -> float:
        last[place] = found.parameters[place] * np.exp(sign * distance)
        there = _fit(replace(held, start=last), ENOUGH_CAUSAL)
        last[:] = there.parameters
        return float(np.sqrt(2.0 * max(0.0, found.log_likelihood - there.log_likelihood)))

    return fall


def calibrate(
    trajectories: DenseTracks,
    formulation: Formulation = "causal",
    estimated: Sequence[str] = ESTIMATED,
    options: SearchOptions = SearchOptions(),
    *,
    known: Mapping[int, Array] = MappingProxyType({}),
    work: Executor | None = None,
) -> Iterator[Fit]:
    """Fit every driver alone; arguments as for ``jobs``. Raises InputError."""
    yield from ordered_map(carry_out, jobs(trajectories, formulation, estimated, options, known), work)


def jobs(
    trajectories: DenseTracks,
    formulation: Formulation,
    estimated: Sequence[str],
    options: SearchOptions = SearchOptions(),
    known: Mapping[int, Array] = MappingProxyType({}),
) -> Iterator[Job]:
    """Yield the search for each driver, from the population's mean with a larger acceleration noise.

    known: parameters (P,) by vehicle, for the start and for the drivers ahead.
    """
    seen = measured(trajectories)
    even, speed = evenness(seen), fastest(seen)
    typical = even.typical(speed)
    start, places = typical.copy(), np.array([index(name) for name in estimated])
    start[SIGMA_A] = START_SIGMA_A
    plain = Job(0, start, places, lower_bounds(even), upper_bounds(speed), options)
    if formulation == "causal":
        from sugiyama_ros.filters.extract import chain_behind  # here, because the paper's formulation starts without it

        trajectories = with_short_periods(trajectories)
    for driver, vehicle in enumerate(trajectories.vehicle.tolist()):
        if vehicle in trajectories.controlled:
            continue
        one = replace(plain, vehicle=vehicle, start=known.get(vehicle, start))
        if formulation == "paper":
            yield replace(one, perceived=paper.perceive(trajectories, driver))
            continue
        chain = chain_behind(trajectories, driver, with_rear=False)
        ahead = [known.get(most_seen(chain.identity[:, m]), typical) for m in range(1, CHAIN)]
        yield replace(one, followed=DriverChains((chain,), (np.array(ahead),)))


def most_seen(identity: Ints) -> int:
    """Return the number of the vehicle that is present in most samples, (T,), or -1."""
    values, counts = np.unique(identity[identity >= 0], return_counts=True)
    return int(values[np.argmax(counts)]) if len(values) else -1


# Information about the logarithm of a parameter below which the data say nothing about it: a std of a factor of e^1000.
_NOTHING = 1e-6


def stds(scored: Scored, parameters: Array, places: Ints) -> Array:
    """Standard deviations (K,) at a maximum of the parameters at ``places``; infinite where the data say nothing.

    They come from the expected information, or from the sandwich estimate (Huber, Proc. Fifth Berkeley Symp. Math.
    Stat. Prob. 1 (1967) 221) if it is larger: if the gradients of the samples scatter more than the information says.
    """
    block = np.ix_(places, places)
    information = scored.information[block]
    covariance = np.linalg.pinv(information, hermitian=True)
    variance = np.diag(covariance)
    if scored.scatter is not None:
        variance = np.maximum(variance, np.diag(covariance @ scored.scatter[block] @ covariance))
    found = np.sqrt(np.maximum(variance, 0.0))
    return np.where(untouched(information, parameters[places]), np.inf, found)


def is_determined(std: Array | float, value: Array | float, interval: Array) -> Mask:
    """Whether the data determine parameters (...).

    The standard deviation is less than half of the value, and the data set both ends of the interval (..., 2).
    """
    return np.asarray((np.asarray(std) < 0.5 * np.abs(value)) & has_both_ends(interval))


def untouched(information: Array, values: Array) -> Mask:
    """Which parameters (K,) take part in a combination about which the data say nothing.

    values: (K,), their values, which give the scale: the information about logarithms has no unit.
    """
    known, direction = np.linalg.eigh(information * np.outer(values, values))
    return np.asarray((np.square(direction[:, known < _NOTHING]) > _NOTHING).any(axis=1))


#: A normal variable lies within this many standard deviations of its mean with a probability of 95 %.
SIGMAS = 1.96


def quadratic(parameters: Array, std: Array) -> Array:
    """Return 95 % intervals (..., 2) from a log-likelihood that is quadratic in the logarithms of the parameters.

    For an infinite std the ends are 0 and infinity; for a std of 0, both are the parameter.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        far = np.exp(SIGMAS * std / np.abs(parameters))
        ends = np.stack([parameters / far, parameters * far], axis=-1)
    return np.sort(np.where(std[..., None] > 0.0, ends, parameters[..., None]), axis=-1)


def end_of_profile(fall: Callable[[float], float], guess: float, furthest: float) -> float:
    """Return the distance from the maximum at which the profile log-likelihood has fallen by 1.96^2 / 2.

    The values within this distance are a 95 % interval (Wilks, Ann. Math. Stat. 9 (1938) 60).
    """
    near, low = 0.0, 0.0
    far, high = math.inf, math.inf
    at = min(SIGMAS * min(guess, 0.5), furthest)
    for _ in range(20):
        here = fall(at)
        if here < SIGMAS:
            if at >= furthest:
                return math.inf
            near, low = at, here
        else:
            far, high = at, here
        if abs(here - SIGMAS) < 0.05:  # standard deviations
            return at
        if high < math.inf:
            at = near + (far - near) * (SIGMAS - low) / (high - low)
        else:
            at = min(at * min(max(SIGMAS / max(here, 1e-9), 1.3), 2.5), furthest)
    return at
