"""Maximum-likelihood calibration of one driver (section 5 of the paper)."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import COUNT, KAPPA_V, NAMES, SIGMA_A, V_STAR, index
from sugiyama_ros.filters import paper
from sugiyama_ros.filters.chain import CHAIN, Chain
from sugiyama_ros.filters.paper import Scored
from sugiyama_ros.fit.scoring import (
    Point,
    coordinate,
    derivatives,
    fastest,
    limits,
    lower_bounds,
    search,
    upper_bounds,
    value,
)
from sugiyama_ros.fit.smooth_positions import ESTIMATED, evenness, measured, with_short_periods
from sugiyama_ros.fit.standard_errors import end_of_profile, is_determined, quadratic, stds
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.workers import ordered_map

# Steps of the difference quotients of the causal filter: as part of a parameter's std; shortest, longest and first step
# of a logarithm.
_PART_OF_STD, _SHORTEST_STEP, _LONGEST_STEP, _FIRST_STEP = 0.5, 5e-3, 0.05, 0.03
#: The paper's regularisation, Eq. Regularized_SSM_Likelihood: centre and weight of v* [m/s] and kappa_v [s].
REGULARISATION = ((V_STAR, 11.0, 50.0), (KAPPA_V, 0.5, 500.0))


class DriverChains(NamedTuple):
    """One driver in the filter: one chain or several, of different times.

    chains: data of the driver and of the vehicles ahead; ahead: (M - 1, P), for each chain the parameters of the
    drivers ahead; scored: (T,), samples of each chain that count, besides those that the filter leaves out; empty if
    all others count.
    """

    chains: tuple[Chain, ...]
    ahead: tuple[Array, ...]
    scored: tuple[Mask, ...] = ()


def causal_score(
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
        steps = np.clip(_PART_OF_STD / np.sqrt(np.maximum(held, 1e-12)), _SHORTEST_STEP, _LONGEST_STEP)
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
    for k, centre, weight in REGULARISATION:
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
# A search ends when a step has a predicted gain below this [nats]; the causal likelihood is rough at small scales.
_ENOUGH, _ENOUGH_CAUSAL = 1e-4, 0.02


@dataclass(frozen=True)
class SearchOptions:
    """Options of a calibration of drivers.

    is_regularised: whether to add the paper's regularisation; profiled: whether intervals come from the profile
    likelihood; with_errors: whether to compute the standard errors of the causal formulation, which takes as long as a
    search; from_several: whether the paper's formulation searches from several starts.
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
    parameters on a bound, which the data do not determine; interval: (P, 2), ends of the 95 % intervals; 0 or infinite
    where the data set no end.
    """

    vehicle: int
    parameters: Array
    log_likelihood: float
    std: Array
    at_bound: tuple[str, ...]
    interval: Array

    def identified(self, name: str) -> bool:
        """Whether the data determine a parameter: it is not on a bound, and its std is less than half of its value."""
        k = index(name)
        return name not in self.at_bound and bool(is_determined(self.std[k], self.parameters[k]))


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
        """Return the score of the formulation without regularisation; arguments as for ``causal_score``."""
        if self.perceived is not None:
            return paper.score(self.perceived, parameters, self.places)
        assert self.followed is not None
        return causal_score(self.followed, self.places, parameters, information, central, here)

    def objective(self, parameters: Array, information: Array | None, here: Array | None = None) -> Scored:
        """Return the score that the search maximises; arguments as for ``causal_score``."""
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
    if job.perceived is not None:
        # the first of equal maxima counts
        found = max((_fit(one, _ENOUGH) for one in _started(job)), key=_height)
    else:
        found = _fit(job, _ENOUGH_CAUSAL, is_careful=options.with_errors)
    if options.profiled:
        found = replace(found, interval=_profile(job, found))
    if options.is_regularised:
        found = replace(found, log_likelihood=job.score(found.parameters, None).log_likelihood)
    return found


def _fit(job: Job, enough: float, is_careful: bool = False) -> Fit:
    """Maximise the likelihood, until the predicted gain of a step is less than ``enough`` [nats]."""

    def at(x: Array, near: Point | None) -> Point | None:
        parameters = job.parameters(x)
        known = (None, -np.inf) if near is None else (near.scored.information, near.value)
        scored = job.better(parameters, *known)
        if scored is None:
            return None
        return Point(x, scored.log_likelihood, *derivatives(scored, parameters, job.places), scored)

    found, places = search(at, job.x, job.ends, enough), job.places
    parameters = job.parameters(found.x)
    bound = (found.x <= job.ends[0]) | (found.x >= job.ends[1])
    std: Array = np.zeros(len(parameters))
    std[places] = np.inf
    if not bound.all():
        scored = job.careful(parameters) if is_careful else found.scored
        std[places[~bound]] = stds(scored, parameters, places[~bound])
    return Fit(
        vehicle=job.vehicle,
        parameters=parameters,
        log_likelihood=found.value,
        std=std,
        at_bound=tuple(NAMES[k] for k in places[bound]),
        interval=quadratic(parameters, std),
    )


def _started(job: Job) -> Iterator[Job]:
    """The search from each of its starts."""
    both = np.isin((V_STAR, KAPPA_V), job.places).all()
    for v_star, kappa_v in _STARTS if job.options.from_several and both else _STARTS[:1]:
        start = job.start.copy()
        start[V_STAR] *= v_star
        start[KAPPA_V] *= kappa_v
        yield replace(job, start=start)


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
        there = _fit(replace(held, start=last), _ENOUGH_CAUSAL)
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
