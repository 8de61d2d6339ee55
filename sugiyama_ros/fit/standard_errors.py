"""Standard errors at a maximum of the likelihood, and 95 % intervals of a parameter."""

import math
from collections.abc import Callable

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.filters.paper import Scored

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


def is_determined(std: Array | float, value: Array | float) -> Mask:
    """Whether the data determine parameters (...): the standard deviation is less than half of the value."""
    return np.asarray(np.asarray(std) < 0.5 * np.abs(value))


def untouched(information: Array, values: Array) -> Array:
    """Which parameters (K,) take part in a combination about which the data say nothing.

    values: (K,), their values, which give the scale: the information about logarithms has no unit.
    """
    known, direction = np.linalg.eigh(information * np.outer(values, values))
    return np.asarray((np.square(direction[:, known < _NOTHING]) > _NOTHING).any(axis=1))


#: A normal variable lies within this many standard deviations of its mean with a probability of 95 %.
SIGMAS = 1.96
# Maximum number of trial values for one end, and tolerance of the fall, in standard deviations.
_TRIES, _CLOSE = 20, 0.05
# Largest and smallest ratio of the next distance to the last distance; largest guess of a logarithm's std.
_FURTHER, _FURTHER_AT_LEAST, _FIRST = 2.5, 1.3, 0.5


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
    at = min(SIGMAS * min(guess, _FIRST), furthest)
    for _ in range(_TRIES):
        here = fall(at)
        if here < SIGMAS:
            if at >= furthest:
                return math.inf
            near, low = at, here
        else:
            far, high = at, here
        if abs(here - SIGMAS) < _CLOSE:
            return at
        if high < math.inf:
            at = near + (far - near) * (SIGMAS - low) / (high - low)
        else:
            at = min(at * min(max(SIGMAS / max(here, 1e-9), _FURTHER_AT_LEAST), _FURTHER), furthest)
    return at
