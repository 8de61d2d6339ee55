"""Standard errors at a maximum of the likelihood; infinite for what the data say nothing about."""

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.filters.paper import Scored

# Information about the logarithm of a parameter below which the data say nothing about it: a std of a factor of e^1000.
_NOTHING = 1e-6


def stds(scored: Scored, parameters: Array, places: Ints) -> Array:
    """Standard deviations of parameters at a maximum.

    They come from the expected information, or from the sandwich estimate if it is larger: if the gradients of the
    samples scatter more than the information says. The sandwich also holds for an approximate likelihood.

    parameters: (P,), parameters at the maximum; places: (K,), which of them were searched for. Returns (K,), standard
    deviations; infinite where the data say nothing.

    References
    ----------
    Huber, Proc. Fifth Berkeley Symp. Math. Stat. Prob. 1 (1967) 221.
    """
    block = np.ix_(places, places)
    information = scored.information[block]
    covariance = np.linalg.pinv(information, hermitian=True)
    variance = np.diag(covariance)
    if scored.scatter is not None:
        variance = np.maximum(variance, np.diag(covariance @ scored.scatter[block] @ covariance))
    found = np.sqrt(np.maximum(variance, 0.0))
    return np.where(untouched(information, parameters[places]), np.inf, found)


def untouched(information: Array, values: Array) -> Array:
    """Which parameters the data say nothing about, alone or in some combination.

    information: (K, K), expected information about the parameters; values: (K,), their values, which give the scale:
    the information about logarithms has no unit. Returns (K,), true for a parameter that takes part in a combination
    about which there is no information.
    """
    known, direction = np.linalg.eigh(information * np.outer(values, values))
    return np.asarray((np.square(direction[:, known < _NOTHING]) > _NOTHING).any(axis=1))
