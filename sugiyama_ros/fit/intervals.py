"""95 % intervals of a parameter, from a quadratic log-likelihood or from the profile likelihood."""

import math
from collections.abc import Callable

import numpy as np

from sugiyama_ros.arrays import Array

#: A normal variable lies within this many standard deviations of its mean with a probability of 95 %.
SIGMAS = 1.96
# Maximum number of trial values for one end, and tolerance of the fall, in standard deviations.
_TRIES, _CLOSE = 20, 0.05
# Largest and smallest ratio of the next distance to the last distance; largest guess of a logarithm's std.
_FURTHER, _FURTHER_AT_LEAST, _FIRST = 2.5, 1.3, 0.5


def quadratic(parameters: Array, std: Array) -> Array:
    """Return 95 % intervals from a log-likelihood that is quadratic in the logarithms of the parameters.

    parameters: (...), parameters, positive or negative; std: (...), standard deviations of the parameters. Returns
    (..., 2), ends of the intervals; for an infinite std they are 0 and infinity; for a std of 0, both are the
    parameter.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        far = np.exp(SIGMAS * std / np.abs(parameters))
        ends = np.stack([parameters / far, parameters * far], axis=-1)
    return np.sort(np.where(std[..., None] > 0.0, ends, parameters[..., None]), axis=-1)


def end_of_profile(fall: Callable[[float], float], guess: float, furthest: float) -> float:
    """Return the distance from the maximum at which the profile log-likelihood has fallen by 1.96^2 / 2.

    The values within this distance are a 95 % interval, on any scale of the distance.

    References
    ----------
    S. S. Wilks, Ann. Math. Stat. 9 (1938) 60.
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
