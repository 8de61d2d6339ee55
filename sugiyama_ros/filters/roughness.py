"""How rough positions are: the size of their third differences, and what a model's noises make of them.

Third differences are large where noise is, and small where a vehicle moves by itself.
"""

import math

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import REFERENCE_PERIOD_S, SIGMA_A, SIGMA_NU, SIGMA_V, SIGMA_X, at_period

#: Variance of a third difference, in variances of white noise, of the position noise and of the speed noise (times the
#: squared period): sums of squares of the coefficients of the third, the second and the first difference.
WHITE, OF_POSITION, OF_SPEED = 20.0, 6.0, 2.0
#: Smallest std of third differences [m]: less is the rounding of the numbers.
LEAST = 1e-5
# A speed is far above the desired speed by this factor; the desired speed is then slightly above it.
_FAR_ABOVE, _SLIGHTLY_ABOVE = 1.5, 1.1
#: Scale of the normal distribution over the median of its absolute values.
PER_MEDIAN = 1.4826
#: Places of the standard deviations of noises among the parameters; rho, a correlation, is none.
SIGMAS = [SIGMA_NU, SIGMA_A, SIGMA_X, SIGMA_V]


def roughness(third: Array) -> float:
    """Return the std [m] of third differences, from their absolute values (n,); spikes do not move it."""
    return PER_MEDIAN * float(np.median(third))


def roughness_of_noises(row: Array, period_s: float) -> float:
    """Return the std [m] of third differences that position noise and speed noise alone make.

    row: (P,), the driver's parameters at the reference period; period_s: time between two samples [s].
    """
    there = at_period(row, period_s)
    return math.sqrt(OF_POSITION * float(there[SIGMA_X]) ** 2 + OF_SPEED * (period_s * float(there[SIGMA_V])) ** 2)


def with_smooth_noises(row: Array, white_m: float, rest_m: float, period_s: float) -> Array:
    """Return a row with noises that make third differences of a given size.

    row: (P,), the driver's parameters at the reference period; white_m: std [m] of the third differences that the
    measurement noise makes; rest_m: std [m] of the third differences that the position noise makes, and the speed noise
    at most: it does not grow; period_s: time between two samples [s].
    """
    start, scale = row.copy(), math.sqrt(period_s / REFERENCE_PERIOD_S)
    start[SIGMA_NU] = white_m / math.sqrt(WHITE)
    start[SIGMA_X] = rest_m / math.sqrt(OF_POSITION) / scale
    start[SIGMA_V] = min(rest_m / math.sqrt(OF_SPEED) / period_s / scale, row[SIGMA_V])
    return start


def in_proportion(row: Array, roughness_m: float, period_s: float) -> Array:
    """Return a row whose noises are smaller or larger in proportion, so that they make third differences of a size.

    row: (P,), the driver's parameters at the reference period; roughness_m: std [m] of the third differences; period_s:
    time between two samples [s].
    """
    start = row.copy()
    start[SIGMAS] *= roughness_m / math.hypot(math.sqrt(WHITE) * row[SIGMA_NU], roughness_of_noises(row, period_s))
    return start


def desired_speed_above(speed: float, desired: float) -> float:
    """Return a desired speed [m/s] to start from, for a driver who has driven at a speed [m/s].

    A driver far above a desired speed hardly says how much too small it is.
    """
    return _SLIGHTLY_ABOVE * speed if speed > _FAR_ABOVE * desired else desired
