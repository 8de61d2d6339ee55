"""Which of several known classes a driver belongs to, from what has been learnt about the driver so far."""

from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.filters.online import Learnt


@dataclass(frozen=True, eq=False)
class DriverTypes:
    """Classes of drivers (``fit.classes``): share (K,) of all drivers, and parameters (K, P)."""

    share: Array
    rows: Array

    def probabilities(self, learnt: Learnt, prior: Learnt) -> Array:
        """Probabilities (K,) that a driver belongs to each class.

        Both arguments are normal distributions of logarithms, so their ratio is what the samples say about the
        parameters of a class.

        Parameters
        ----------
        learnt
            What is known about the driver's parameters now.
        prior
            What was known before the first sample.
        """
        logs = np.log(self.rows[:, [index(name) for name in learnt.names]])
        return np.asarray(softmax(np.log(self.share) + _log_density(logs, learnt) - _log_density(logs, prior)))


def _log_density(logs: Array, learnt: Learnt) -> Array:
    """Log-density at points (K, A), up to a constant."""
    off = logs - learnt.mean
    return np.asarray(-0.5 * np.sum(off * np.linalg.solve(learnt.covariance, off.T).T, axis=1))
