"""How far values by chance spread, known from a few simulated recordings."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from sugiyama_ros.arrays import Array

#: Weight of the common std in the spread of one value, as a number of simulated recordings.
COMMON = 4


def spread_of_next(by_chance: Array, common: float) -> tuple[float, int]:
    """Return how far the next value by chance lies from the mean of the known ones.

    Parameters
    ----------
    by_chance : ndarray, shape (R,)
        Values in R simulated recordings.
    common : float
        Std that all such values share.

    Returns
    -------
    spread : float
        Scale of Student's t distribution.
    freedom : int
        Its degrees of freedom.
    """
    runs = len(by_chance)
    freedom = runs - 1 + COMMON
    squares = float(np.square(by_chance - by_chance.mean()).sum())
    return math.sqrt((squares + COMMON * common**2) / freedom * (1.0 + 1.0 / runs)), freedom


def widening(runs: int) -> float:
    """Return how much wider a std must be, if it is known from so many values, for 95 % intervals of 1.96 stds to hold.

    Parameters
    ----------
    runs : int
        Number of values, whose mean is known.

    Returns
    -------
    float
        Student's t over the normal distribution; 1 without values.
    """
    return float(student.ppf(0.975, runs) / norm.ppf(0.975)) if runs else 1.0


def of_best(p_alone: float, tests: float) -> float:
    """Return the probability that the smallest of independent p-values is as small (Šidák's correction).

    Parameters
    ----------
    p_alone : float
        The smallest p-value.
    tests : float
        Number of p-values.

    Returns
    -------
    float
        The probability; uniform by chance, and at most ``tests * p_alone``, Bonferroni's correction.
    """
    return -math.expm1(tests * math.log1p(-p_alone)) if p_alone < 1.0 else 1.0


def p_value_of(value: float, by_chance: Sequence[float], common: float) -> float:
    """Return the probability of a value as large by chance; parameters as for ``spread_of_next``."""
    known = np.array(by_chance)
    spread, freedom = spread_of_next(known, common)
    return float(student.sf((value - float(known.mean())) / max(spread, 1e-9), freedom))
