"""Maximum-likelihood calibration of one driver (section 5 of the paper)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import KAPPA_V, NAMES, V_STAR, index
from sugiyama_ros.filters import paper
from sugiyama_ros.filters.paper import Scored
from sugiyama_ros.fit.bounds import LogSpace, log_space
from sugiyama_ros.fit.driver_score import DriverChains, causal_score, predicted, regularised
from sugiyama_ros.fit.intervals import end_of_profile, quadratic
from sugiyama_ros.fit.scoring import Point, search
from sugiyama_ros.fit.standard_errors import stds

Formulation = Literal["paper", "causal"]
#: Acceleration noise [m/s^2] at the start. It is larger than usual estimates, because the likelihood is smoother there.
START_SIGMA_A = 1.0
# The paper's likelihood has several maxima: a small risk premium with a desired speed far above the data may explain a
# driver as well. Factors of v_star and kappa_v at the starts: of 154 drivers, measured and simulated, 25 have a maximum
# that is 0.1 to 301 nats higher than the one of the first start. These four starts find all that a grid of 25 finds.
_STARTS = ((1.0, 1.0), (0.7, 6.0), (2.2, 0.15), (0.7, 0.15))
# A search ends when a step has a predicted gain below this [nats]; the causal likelihood is rough at small scales.
_ENOUGH, ENOUGH_CAUSAL = 1e-4, 0.02
# A parameter does not count as identified if the std of its logarithm is larger than this.
_VAGUE = 0.5
#: Returns the score at parameters (P,), given the information (P, P) at nearby parameters, or None.
Score = Callable[[Array, Array | None], Scored]
#: The same as ``Score``, or None if the log-likelihood is not larger than a number, so that nobody needs the score.
BetterScore = Callable[[Array, Array | None, float], Scored | None]


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


#: The search without further options.
PLAIN = SearchOptions()


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
        return name not in self.at_bound and bool(self.std[k] < _VAGUE * abs(self.parameters[k]))


def fit_driver(
    score: BetterScore, vehicle: int, space: LogSpace, enough: float = _ENOUGH, careful: Score | None = None
) -> Fit:
    """Maximise the likelihood of one driver.

    enough: the search ends when the predicted gain of a step is less than this [nats].
    """

    def at(x: Array, near: Point | None) -> Point | None:
        parameters = space.parameters(x)
        known = (None, -np.inf) if near is None else (near.scored.information, near.value)
        scored = score(parameters, *known)
        if scored is None:
            return None
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
        std[inside] = stds(scored, parameters, inside)
    return Fit(
        vehicle=vehicle,
        parameters=parameters,
        log_likelihood=found.value,
        std=std,
        at_bound=tuple(NAMES[k] for k, b in zip(space.places, bound, strict=True) if b),
        interval=quadratic(parameters, std),
    )


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
    options: SearchOptions = PLAIN
    perceived: paper.Perceived | None = None
    followed: DriverChains | None = None

    @property
    def space(self) -> LogSpace:
        """Coordinates of the search."""
        return log_space(self.start, self.places, self.lower, self.upper)

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

    def careful(self, parameters: Array, _: Array | None) -> Scored:
        """Return the score from central differences, whose steps follow from a newly computed information."""
        # the information of the search may come from a jump of the likelihood, which would make these steps too short
        rough = self.score(parameters, None, central=True)
        return self.score(parameters, rough.information, central=True)


def carry_out(job: Job) -> Fit:
    """Search for one driver's parameters, with the options of the job."""
    options = job.options
    careful = job.careful if options.with_errors else None
    if job.perceived is not None:
        # the first of equal maxima counts
        found = max((fit_driver(one.better, one.vehicle, one.space) for one in _started(job)), key=_height)
    else:
        found = fit_driver(job.better, job.vehicle, job.space, ENOUGH_CAUSAL, careful)
    if options.profiled:
        found = replace(found, interval=_profile(job, found))
    if options.is_regularised:
        found = replace(found, log_likelihood=job.score(found.parameters, None).log_likelihood)
    return found


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
    space = log_space(found.parameters, job.places, job.lower, job.upper)
    for k, low, high in zip(job.places.tolist(), space.smallest.tolist(), space.largest.tolist(), strict=True):
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
        space = log_space(last, held.places, held.lower, held.upper)
        there = fit_driver(held.better, held.vehicle, space, ENOUGH_CAUSAL)
        last[:] = there.parameters
        return float(np.sqrt(2.0 * max(0.0, found.log_likelihood - there.log_likelihood)))

    return fall
