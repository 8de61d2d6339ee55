"""The gain of one model over another, with its standard error."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.score import PointwiseDensity


@dataclass(frozen=True)
class Gain:
    """Log-likelihood of one model minus the log-likelihood of another model.

    nats: sum over all samples [nats]; se: standard error of the sum [nats].
    """

    nats: float
    se: float


def gain(data: Recorded, better: PointwiseDensity, than: PointwiseDensity) -> Gain:
    """Return the gain of one model over another, paired sample by sample."""
    difference = better.log_likelihood - than.log_likelihood
    known = np.isfinite(difference)
    # who follows nobody is not predicted, and tells nothing of how drivers differ
    by_driver = np.nansum(difference[known.any(axis=1)], axis=1)
    # nor do blocks in which nothing is predicted
    where, block = np.unique(data.block[known], return_inverse=True)
    by_block = np.bincount(block, weights=difference[known], minlength=len(where))
    se = max(sum_error(by_driver), sum_error(by_block))
    return Gain(float(by_driver.sum()), se)


def sum_error(parts: ArrayLike) -> float:
    """Return the standard error of the sum of exchangeable parts (N,), by the jackknife."""
    x = np.asarray(parts)
    return math.sqrt(len(x) * float(np.var(x, ddof=1))) if len(x) > 1 else 0.0
