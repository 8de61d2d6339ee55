"""What type of driver somebody is, among classes that are known: told from what has been learnt of him so far."""

from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.filters.learnt import Learnt


@dataclass(frozen=True, eq=False)
class DriverTypes:
    """Classes of drivers (``estimation.classes``): share (K,) of all drivers, and parameters (K, P)."""

    share: Array
    rows: Array

    def probabilities(self, learnt: Learnt, prior: Learnt) -> Array:
        """That a driver is of each class, (K,), from what is learnt of him since nothing but the prior was known.

        Both are normal distributions of logarithms, so their ratio is what the samples say of a class's parameters.
        """
        logs = np.log(self.rows[:, [index(name) for name in learnt.names]])
        return np.asarray(softmax(np.log(self.share) + _log_density(logs, learnt) - _log_density(logs, prior)))


def _log_density(logs: Array, learnt: Learnt) -> Array:
    """Log-density at points (K, A), but for what is the same for all."""
    off = logs - learnt.mean
    return np.asarray(-0.5 * np.sum(off * np.linalg.solve(learnt.covariance, off.T).T, axis=1))
