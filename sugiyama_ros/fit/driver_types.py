"""The type of a driver: probabilities of known classes, given what a filter has learnt of the driver so far."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, index

if TYPE_CHECKING:
    # The online filter is not needed to keep or write the classes, and takes long to load.
    from sugiyama_ros.filters.online import Learnt


@dataclass(frozen=True, eq=False)
class DriverTypes:
    """Classes of drivers, as ``fit.classes`` finds them.

    share: (K,), share of all drivers in each class; rows: (K, P), parameters of each class.
    """

    share: Array
    rows: Array

    def probabilities(self, learnt: "Learnt", prior: "Learnt") -> Array:
        """Return the probability of each class for one driver.

        Both arguments are normal distributions of logarithms. Their ratio is the likelihood that the samples give to
        the parameters of a class.

        Returns (K,), probabilities of the classes.
        """
        # Imported here: commands that only read or write classes start sooner without scipy.
        from scipy.special import softmax

        # the classes say nothing of parameters of effects
        of_driver = [k for k, name in enumerate(learnt.names) if name in NAMES]
        logs = np.log(self.rows[:, [index(learnt.names[k]) for k in of_driver]])
        gain = _log_density(logs, learnt, of_driver) - _log_density(logs, prior, of_driver)
        return np.asarray(softmax(np.log(self.share) + gain))


def _log_density(logs: Array, learnt: "Learnt", chosen: list[int]) -> Array:
    """Log-density (K,) of the chosen parameters at points (K, A), without the terms that are equal for all points."""
    off, covariance = logs - learnt.mean[chosen], learnt.covariance[np.ix_(chosen, chosen)]
    return np.asarray(-0.5 * np.sum(off * np.linalg.solve(covariance, off.T).T, axis=1))
