"""Maximum-likelihood calibration of many drivers, each alone (section 5 of the paper).

Nothing of one driver depends on another, so any executor will do: threads, processes, or the workers of a Dask cluster.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import basinhopping

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import NAMES, SIGMA_A, defaults, index, population
from sugiyama_ros.filters import paper
from sugiyama_ros.filters.chain import CHAIN, Chain
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.paper import Scored
from sugiyama_ros.fit.bounds import LogSpace, log_space, upper_bounds
from sugiyama_ros.fit.driver_score import causal_score, regularised
from sugiyama_ros.fit.intervals import end_of_profile, quadratic
from sugiyama_ros.fit.scoring import Point, search
from sugiyama_ros.trajectories.trajectories import Trajectories

Formulation = Literal["paper", "causal"]
#: The parameters that the paper estimates; section 4.1.
ESTIMATED = ("sigma_nu", "sigma_a", "v_star", "kappa_v")
# Acceleration noise [m/s^2] to start from: larger than what is found, so that the search comes from the smooth side.
# The paper's likelihood has further maxima in kappa_v, within 0.4 of the maximum that is found from here.
_START_SIGMA_A = 1.0
# A search ends when a step is predicted to gain less than this; the causal likelihood is rough at a small scale.
_ENOUGH, _ENOUGH_CAUSAL = 1e-4, 0.02
# Std of a logarithm from which on a parameter does not count as identified.
_VAGUE = 0.5
# Jobs that are handed to an executor at a time, so that memory stays bounded however many drivers there are.
_BATCH = 512
#: Score at parameters (P,), given the information (P, P) at parameters near by, if there is any yet.
Score = Callable[[Array, Array | None], Scored]


@dataclass(frozen=True)
class SearchOptions:
    """What a calibration of drivers does besides the plain search.

    is_regularised: whether the paper's regularisation is added; profiled: whether intervals come from the profile
    likelihood; hops: of scipy's basinhopping before the search, with ``seed``; with_errors: whether the errors of the
    causal formulation are needed, which take as long as a search.
    """

    is_regularised: bool = False
    profiled: bool = False
    hops: int = 0
    seed: int = 0
    with_errors: bool = True


#: The search and nothing else.
PLAIN = SearchOptions()


@dataclass(frozen=True, eq=False)
class Fit:
    """Maximum-likelihood estimate of one driver.

    vehicle: number; parameters: (P,); log_likelihood: at the maximum, without the 2 pi term and the regularisation;
    std: (P,) from the expected information, 0 for what was given and infinite for what lies on a bound; at_bound: names
    of the parameters that lie on a bound, which the data do not hold; interval: (P, 2) ends of the 95 % intervals, 0 or
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
    score: Score, vehicle: int, space: LogSpace, enough: float = _ENOUGH, careful: Score | None = None
) -> Fit:
    """Maximise one driver's likelihood.

    Parameters
    ----------
    score
        The likelihood with its gradient and information.
    vehicle
        Number of the driver's vehicle.
    space
        Parameters that are searched for, their start and their bounds.
    enough
        The search ends when a step is predicted to gain less than this.
    careful
        A better score, from which the errors are taken at the maximum.
    """

    def at(x: Array, near: Point | None) -> Point:
        parameters = space.parameters(x)
        scored = score(parameters, None if near is None else near.scored.information)
        gradient, information = space.derivatives(parameters, scored.gradient, scored.information)
        return Point(x, scored.log_likelihood, gradient, information, scored)

    found = search(at, space, enough)
    parameters = space.parameters(found.x)
    bound = (found.x <= space.smallest) | (found.x >= space.largest)
    inside = space.places[~bound]
    std: Array = np.zeros(len(parameters))
    std[space.places] = np.inf
    if len(inside):
        scored = found.scored if careful is None else careful(parameters, found.scored.information)
        std[inside] = _stds(scored, inside)
    return Fit(
        vehicle=vehicle,
        parameters=parameters,
        log_likelihood=found.value,
        std=std,
        at_bound=tuple(NAMES[k] for k, b in zip(space.places, bound, strict=True) if b),
        interval=quadratic(parameters, std),
    )


def _stds(scored: Scored, places: Ints) -> Array:
    """Standard deviations of the parameters at ``places`` at a maximum.

    They come from the expected information, or from the sandwich estimate (Huber 1967) where the samples' gradients
    scatter by more than the information says. The sandwich also holds for a likelihood that is an approximation.
    """
    block = np.ix_(places, places)
    covariance = np.linalg.pinv(scored.information[block], hermitian=True)
    variance = np.diag(covariance)
    if scored.scatter is not None:
        variance = np.maximum(variance, np.diag(covariance @ scored.scatter[block] @ covariance))
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True, eq=False)
class Job:
    """One driver's data and the search for their parameters.

    vehicle: number; start, upper: (P,); places: (K,) of the parameters that are searched for; options: what else is
    done; perceived: data of the paper's formulation, or chain and ahead: data of the causal formulation.
    """

    vehicle: int
    start: Array
    places: Ints
    upper: Array
    options: SearchOptions = PLAIN
    perceived: paper.Perceived | None = None
    chain: Chain | None = None
    ahead: Array | None = None

    @property
    def space(self) -> LogSpace:
        """Logarithms in which the search goes."""
        return log_space(self.start, self.places, self.upper)

    def score(self, parameters: Array, information: Array | None, central: bool = False) -> Scored:
        """Score of the formulation, without regularisation; arguments as for ``causal_score``."""
        if self.perceived is not None:
            return paper.score(self.perceived, parameters, self.places)
        assert self.chain is not None
        return causal_score(self.chain, self.ahead, self.places, parameters, information, central)

    def objective(self, parameters: Array, information: Array | None) -> Scored:
        """Score of what is maximised."""
        scored = self.score(parameters, information)
        return regularised(scored, parameters) if self.options.is_regularised else scored

    def careful(self, parameters: Array, _: Array | None) -> Scored:
        """Score from central differences, with steps from an information that was computed here."""
        # what the search knows of the information may come from a jump, which would make the next steps short, too
        rough = self.score(parameters, None, central=True)
        return self.score(parameters, rough.information, central=True)


def carry_out(job: Job) -> Fit:
    """Search for one driver's parameters, with everything that the options ask for."""
    options = job.options
    if options.hops:
        job = replace(job, start=_hop(job))
    careful = job.careful if options.with_errors else None
    search = (job.objective, job.vehicle, job.space)
    found = fit_driver(*search) if job.perceived is not None else fit_driver(*search, _ENOUGH_CAUSAL, careful)
    if options.profiled:
        found = replace(found, interval=_profile(job, found))
    if options.is_regularised:
        found = replace(found, log_likelihood=job.score(found.parameters, None).log_likelihood)
    return found


def _hop(job: Job) -> Array:
    """Parameters (P,) of the best of many local searches (Wales and Doye, J. Phys. Chem. A 101 (1997) 5111)."""
    space = job.space

    def at(x: Array) -> tuple[float, Array]:
        parameters = space.parameters(x)
        scored = job.objective(parameters, None)
        return -scored.log_likelihood, -scored.gradient[job.places] * parameters[job.places]

    bounds = list(zip(space.smallest, space.largest, strict=True))
    found = basinhopping(
        at,
        space.x,
        niter=job.options.hops,
        minimizer_kwargs={"method": "L-BFGS-B", "jac": True, "bounds": bounds},
        rng=np.random.default_rng([job.options.seed, job.vehicle]),
    )
    return space.parameters(found.x)


def _profile(job: Job, found: Fit) -> Array:
    """Ends (P, 2) of the intervals of the parameters that were searched for, from the profile of their likelihood."""
    interval = found.interval.copy()
    space = log_space(found.parameters, job.places, job.upper)
    for k, low, high in zip(job.places.tolist(), space.smallest.tolist(), space.largest.tolist(), strict=True):
        size = abs(float(found.parameters[k]))
        for side, sign, furthest in ((0, -1.0, np.log(size) - low), (1, 1.0, high - np.log(size))):
            distance = end_of_profile(_fall(job, found, k, sign), float(found.std[k]) / size, max(0.0, float(furthest)))
            interval[k, side] = found.parameters[k] * np.exp(sign * distance)
    return np.sort(interval, axis=-1)


def _fall(job: Job, found: Fit, place: int, sign: float) -> Callable[[float], float]:
    """Square root of twice the profile's fall, at a distance from the maximum in the logarithm of a parameter."""
    held, last = replace(job, places=job.places[job.places != place]), found.parameters.copy()

    def fall(distance: float) -> float:
        last[place] = found.parameters[place] * np.exp(sign * distance)
        space = log_space(last, held.places, held.upper)
        there = fit_driver(held.objective, held.vehicle, space, _ENOUGH_CAUSAL)
        last[:] = there.parameters
        return float(np.sqrt(2.0 * max(0.0, found.log_likelihood - there.log_likelihood)))

    return fall


def calibrate(
    trajectories: Trajectories,
    formulation: Formulation = "causal",
    estimated: Sequence[str] = ESTIMATED,
    options: SearchOptions = PLAIN,
    *,
    starts: Mapping[int, Array] | None = None,
    skip: Collection[int] = (),
    work: Executor | None = None,
) -> Iterator[Fit]:
    """Fit every driver alone.

    Parameters
    ----------
    trajectories
        The recording.
    formulation
        Likelihood: "paper" or "causal".
    estimated
        Names of the parameters that are searched for.
    options
        What is done besides the plain search.
    starts
        Parameters (P,) by vehicle: where the search starts, and what the drivers ahead are taken to have. If left out,
        it starts at the paper's mean with a larger acceleration noise.
    skip
        Vehicles that are left out.
    work
        Executor that carries out the searches; if left out, they are carried out in turn.

    Yields
    ------
    The fits in the order of the vehicles.

    Raises
    ------
    InputError
        For an unknown parameter, or data that the formulation cannot take.
    """
    places, upper, known = np.array([index(name) for name in estimated]), upper_bounds(trajectories), starts or {}

    def job(driver: int) -> Job:
        return replace(job_of(trajectories, driver, formulation, places, upper, known), options=options)

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
    """The plain search for the parameters of one driver.

    Parameters
    ----------
    trajectories
        The recording.
    driver
        Column of the driver.
    formulation
        Likelihood: "paper" or "causal".
    places
        (K,) places of the parameters that are searched for.
    upper
        (P,) upper bounds.
    known
        Parameters (P,) by vehicle, as ``starts`` of ``calibrate``.
    """
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
    """Number of the vehicle that is there in most samples, or -1."""
    values, counts = np.unique(identity[identity >= 0], return_counts=True)
    return int(values[np.argmax(counts)]) if len(values) else -1
