"""Many drivers as one: classes, a population, and how well each predicts drivers whom it was not fitted to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, SIGMA_NU, SIGMA_V, SIGMA_X, index

if TYPE_CHECKING:
    # The online filter is not needed to keep or write the classes, and takes long to load.
    from sugiyama_ros.filters.online import Learnt


#: Smallest standard deviation of the logarithm of a parameter over a population.
LEAST_STD = 0.05
#: Noises of what measures, and of how it smooths: they belong to a recording, not to a driver.
OF_RECORDING = (SIGMA_NU, SIGMA_X, SIGMA_V)


@dataclass(frozen=True, eq=False)
class Classes:
    """K classes of N drivers, the largest class first.

    names: of the classes, if they are known from the vehicles; rows: (K, width), row of each class, with the noises of
    the first recording; interval: (K, width, 2), ends of the 95 % intervals; share: (K,), share of the
    drivers in each class; probability: (N, K), probability that a driver belongs to a class; own_rows: (N, width), row
    of each driver in the likeliest class; log_likelihood: (N,), log-likelihood of each driver under the mixture [nats];
    goals: what drivers may intend; goal_probability: (N, G), probability of each goal; entries: where drivers come in;
    goal_share: (E, G), share of each goal among the drivers of an entry.
    """

    names: tuple[str, ...]
    rows: Array
    interval: Array
    share: Array
    probability: Array
    own_rows: Array
    log_likelihood: Array
    goals: tuple[str, ...]
    goal_probability: Array
    entries: tuple[str, ...]
    goal_share: Array

    def population(self, names: Sequence[str]) -> "Population":
        """Return the population with the mean and the spread of the classes; ``names``: of its parameters."""
        logs = np.log(np.abs(self.rows[:, [index(name) for name in names]]))
        mean = self.share @ logs
        spread = np.sqrt(self.share @ np.square(logs - mean))
        return Population({name: (float(np.exp(m)), float(s)) for name, m, s in zip(names, mean, spread, strict=True)})


@dataclass(frozen=True)
class Population:
    """Drivers as draws of one population: median and standard deviation of the logarithm of each parameter, by name."""

    parameters: Mapping[str, tuple[float, float]]

    def document(self) -> dict[str, dict[str, float]]:
        """Return what is known, for JSON documents and model files."""
        return {name: {"median": median, "log_std": std} for name, (median, std) in self.parameters.items()}


@dataclass(frozen=True, eq=False)
class Predictions:
    """What one model predicts of N drivers whom it was not fitted to: log-densities [nats], (N,) each.

    name: of the model; classes: their number, 0 for another model; whole: of all samples of a driver; NaN if the model
    cannot say; later: of the second half of a driver's samples, once the first half is known.
    """

    name: str
    classes: int
    whole: Array
    later: Array

    def document(self, reference: "Predictions") -> dict[str, Any]:
        """Return the mean gain over another model and its standard error [nats a driver], for JSON documents."""
        both = {"whole": (self.whole, reference.whole), "later": (self.later, reference.later)}
        found: dict[str, Any] = {"model": self.name}
        for key, (own, other) in both.items():
            found[key], found[f"{key}_std"] = gain(own, other)
        return found


def gain(better: Array, than: Array) -> tuple[float, float]:
    """Return the mean difference (N,) over drivers [nats], and its standard error."""
    off = better - than
    return float(off.mean()), float(off.std(ddof=1) / np.sqrt(len(off)))


@dataclass(frozen=True, eq=False)
class DriverTypes:
    """Classes of drivers, as ``fit.classes`` finds them.

    share: (K,), share of all drivers in each class; rows: (K, P), parameters of each class.
    """

    share: Array
    rows: Array

    def probabilities(self, learnt: "Learnt", prior: "Learnt") -> Array:
        """Return the probability (K,) of each class for one driver.

        Both arguments are normal distributions of logarithms. Their ratio is the likelihood that the samples give to
        the parameters of a class.
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
