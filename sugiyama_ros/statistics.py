"""What chance does: the level of significance, tails of gains, standard errors of sums, and false discoveries."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t as student

from sugiyama_ros.arrays import Array

#: Level of significance, and false-discovery rate: nothing is added that chance shows more often.
ALPHA = 0.05
# Part of the gains that shows how the tail falls.
_TAIL = 0.1


class Tail(NamedTuple):
    """The null distribution of a gain: its draws in order, and the exponential tail beyond the largest tenth of them.

    Gains of likelihoods have exponential tails, and none falls faster than e^-gain (Wilks).
    """

    ordered: Array
    start: float
    excess: float

    @staticmethod
    def of(null: Array) -> "Tail":
        """The distribution of draws (B,)."""
        ordered = np.sort(null)
        start = float(np.quantile(ordered, 1.0 - _TAIL))
        return Tail(ordered, start, max(float(np.mean(ordered[ordered >= start] - start)), 1.0))

    def improbable(self, gains: float | Array) -> Array:
        """Return -ln p of gains."""
        count = len(self.ordered)
        rank = (1 + count - np.searchsorted(self.ordered, gains, side="left")) / (1 + count)
        beyond = (gains - self.start) / self.excess - math.log(_TAIL)
        return np.where(gains > self.start, beyond, np.minimum(-np.log(np.minimum(rank, 1.0)), -math.log(_TAIL)))

    def gain_at(self, level: float) -> float:
        """Return the gain of which -ln p is a level beyond the tail's start."""
        return self.start + self.excess * max(level + math.log(_TAIL), 0.0)


def sum_error(parts: ArrayLike) -> float:
    """Return the standard error of the sum of exchangeable parts (N,), by the jackknife."""
    x = np.asarray(parts)
    return math.sqrt(len(x) * float(np.var(x, ddof=1))) if len(x) > 1 else 0.0


def failing(p_values: Sequence[float]) -> float:
    """Return the largest p-value that fails, by Benjamini and Hochberg's step-up procedure; -1 if none does."""
    passed = [p for k, p in enumerate(sorted(p_values), 1) if p <= ALPHA * k / len(p_values)]
    return max(passed, default=-1.0)


def student_log_density(off: Array, var: Array, free: float) -> Array:
    """Return the logarithm of the density of Student's t distribution with a variance, without the term of 2 pi."""
    density = student.logpdf(off, free, scale=np.sqrt((1.0 - 2.0 / free) * var))
    return np.asarray(density + 0.5 * math.log(2.0 * math.pi))
