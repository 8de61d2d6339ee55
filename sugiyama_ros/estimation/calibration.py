"""Maximum-likelihood calibration of many drivers, each for himself (section 5 of the paper)."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from typing import Literal

import numpy as np
from scipy.optimize import minimize

from sugiyama_ros.driver.parameters import PARAMETERS, SIGMA_A, V_STAR, defaults, index
from sugiyama_ros.estimation import causal, paper
from sugiyama_ros.road import Array, Ints
from sugiyama_ros.trajectories import Trajectories

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
# Step of the difference quotients, in logarithms: the likelihood is smooth to about 1e-9.
_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class Fit:
    """Maximum-likelihood estimate of one driver.

    parameters: (P,) with the estimated ones replaced; log_likelihood: there, no 2 pi term; at_bound: names of the
    estimated ones that lie on a bound, that is which the data do not hold.
    """

    vehicle: int
    parameters: Array
    log_likelihood: float
    at_bound: tuple[str, ...]


def fit_driver(
    objective: Callable[[Array], tuple[float, Array]], vehicle: int, start: Array, places: Ints, upper: Array
) -> Fit:
    """Maximise ``objective``, parameters (P,) -> (log-likelihood, gradient (P,)), over the entries ``places``.

    The search (L-BFGS-B) runs in the logarithms, from ``start`` (P,), between the declared lower bounds and ``upper``
    (P,).
    """
    bounds = [(np.log(max(PARAMETERS[k].lower, _SMALLEST)), np.log(upper[k])) for k in places]

    def negative(logarithms: Array) -> tuple[float, Array]:
        parameters = start.copy()
        parameters[places] = np.exp(logarithms)
        value, gradient = objective(parameters)
        return -value, -gradient[places] * parameters[places]

    found = minimize(negative, np.log(start[places]), jac=True, method="L-BFGS-B", bounds=bounds)
    parameters = start.copy()
    parameters[places] = np.exp(found.x)
    at_bound = tuple(
        PARAMETERS[k].name for k, x, (low, high) in zip(places, found.x, bounds, strict=True) if x in (low, high)
    )
    return Fit(vehicle, parameters, float(-found.fun), at_bound)


def _causal_objective(chain: causal.Chain, places: Ints, parameters: Array) -> tuple[float, Array]:
    """The causal log-likelihood and its gradient at ``places``, by central differences in the logarithms."""
    gradient = np.zeros(len(parameters))
    for k in places:
        low, high = parameters.copy(), parameters.copy()
        low[k] *= np.exp(-_STEP)
        high[k] *= np.exp(_STEP)
        rise = causal.log_likelihood(chain, high) - causal.log_likelihood(chain, low)
        gradient[k] = rise / (2.0 * _STEP * parameters[k])
    return causal.log_likelihood(chain, parameters), gradient


def _fit_one(trajectories: Trajectories, formulation: Formulation, start: Array, places: Ints, driver: int) -> Fit:
    objective: Callable[[Array], tuple[float, Array]]
    if formulation == "paper":
        objective = partial(paper.log_likelihood, paper.perceive(trajectories, driver))
    else:
        objective = partial(_causal_objective, causal.chain_behind(trajectories, driver), places)
    return fit_driver(objective, int(trajectories.vehicle[driver]), start, places, upper_bounds(trajectories))


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
    start: Array | None = None,
    workers: int = 1,
) -> Iterator[Fit]:
    """Fit every driver, over ``workers`` processes, and yield the fits in the order of the vehicles.

    start: (P,), else the paper's mean with a larger acceleration noise. Raises InputError for an unknown parameter, or
    data that the formulation cannot take.
    """
    places = np.array([index(name) for name in estimated])
    if start is None:
        start = defaults()
        start[SIGMA_A] = _START_SIGMA_A
    one = partial(_fit_one, trajectories, formulation, start, places)
    drivers = range(len(trajectories.vehicle))
    if workers == 1:
        yield from map(one, drivers)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(one, drivers)
