"""95 % intervals of a parameter: of a likelihood that is quadratic in its logarithm, or of the profile likelihood."""

import math
from collections.abc import Callable

import numpy as np

from sugiyama_ros.arrays import Array

#: Standard deviations of a normal distribution within which 95 % lie.
SIGMAS = 1.96
# Values that are tried for one end, and how well the fall must be met, in standard deviations.
_TRIES, _CLOSE = 20, 0.05
# How many times further than the last one the next value may be, and must be; the first one at most, in logarithms.
_FURTHER, _FURTHER_AT_LEAST, _FIRST = 2.5, 1.3, 0.5


def quadratic(parameters: Array, std: Array) -> Array:
    """Ends (..., 2) of intervals of positive or negative parameters (...) with stds (...), quadratic in the logarithms.

    An infinite std leaves 0 and infinity, a std of 0 the parameter itself.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        far = np.exp(SIGMAS * std / np.abs(parameters))
        ends = np.stack([parameters / far, parameters * far], axis=-1)
    return np.sort(np.where(std[..., None] > 0.0, ends, parameters[..., None]), axis=-1)


def end_of_profile(fall: Callable[[float], float], guess: float, furthest: float) -> float:
    """Distance from the maximum at which the profile likelihood has fallen by 1.96^2 / 2; infinite beyond ``furthest``.

    fall: square root of twice the fall at a distance; guess: a standard deviation. By Wilks (Ann. Math. Stat. 9 (1938)
    60), the values within are a 95 % interval, whatever the scale on which the distance is measured.
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
