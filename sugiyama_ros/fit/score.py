"""What a model says of every sample: innovations, their variances, log-likelihoods and filtered states."""

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters import causal
from sugiyama_ros.filters.chain import Chain
from sugiyama_ros.fit.model import Model, leaders
from sugiyama_ros.fit.recording import Recorded


class DriverDensity(NamedTuple):
    """Innovation [m], its variance [m^2] and log-likelihood of every sample of one driver, (T,) each."""

    innovation_m: Array
    innovation_var: Array
    log_likelihood: Array


@dataclass(frozen=True, eq=False)
class PointwiseDensity:
    """Innovation [m], its variance [m^2] and log-likelihood of all samples, (N, T) each; NaN if not scored."""

    innovation_m: Array
    innovation_var: Array
    log_likelihood: Array

    @property
    def total(self) -> float:
        """Log-likelihood of all samples together."""
        return float(np.nansum(self.log_likelihood))

    def copy(self) -> "PointwiseDensity":
        """A copy that shares no arrays."""
        return PointwiseDensity(self.innovation_m.copy(), self.innovation_var.copy(), self.log_likelihood.copy())

    def only(self, who: Sequence[int]) -> "PointwiseDensity":
        """The samples of some drivers, and NaN for the others."""
        some = unknown(*self.log_likelihood.shape)
        for i in who:
            some.put(i, self.of(i))
        return some

    def of(self, driver: int) -> DriverDensity:
        """The samples of one driver."""
        return DriverDensity(self.innovation_m[driver], self.innovation_var[driver], self.log_likelihood[driver])

    def put(self, driver: int, samples: DriverDensity) -> None:
        """Replace the samples of one driver."""
        self.innovation_m[driver], self.innovation_var[driver], self.log_likelihood[driver] = samples


def unknown(drivers: int, samples: int) -> PointwiseDensity:
    """Samples of which nothing is known yet: NaN everywhere."""
    return PointwiseDensity(*(np.full((drivers, samples), np.nan) for _ in range(3)))


def predict_driver(chain: Chain, row: Array, ahead: Array) -> DriverDensity:
    """What the filter says of one driver's samples.

    Parameters
    ----------
    chain
        The driver and the vehicles ahead.
    row
        (WIDTH,) parameters of the driver.
    ahead
        (M - 1, WIDTH) parameters of the drivers ahead.
    """
    return DriverDensity(*causal.predict_samples(chain, row, ahead))


def evaluate(data: Recorded, model: Model, work: Executor, who: Sequence[int] | None = None) -> PointwiseDensity:
    """What the model says of every sample.

    Parameters
    ----------
    data, model
        The recording and the model.
    work
        Executor that runs the filters.
    who
        Numbers of the drivers whose samples are wanted; the others get NaN. All drivers if left out.
    """
    chosen = range(data.drivers) if who is None else who
    samples = unknown(data.drivers, len(data.fold))
    for i, at in zip(chosen, predict_drivers(data, model, chosen, work), strict=True):
        samples.put(i, at)
    return samples


def predict_drivers(data: Recorded, model: Model, who: Iterable[int], work: Executor) -> list[DriverDensity]:
    """What the model says of the samples of drivers ``who``, in that order."""
    jobs = [(data.chains[i], model.rows[i], leaders(data, model, i)) for i in who]
    return list(work.map(_predict_driver, jobs))


def _predict_driver(job: tuple[Chain, Array, Array]) -> DriverDensity:
    return predict_driver(*job)


def filtered_states(data: Recorded, model: Model, work: Executor) -> Array:
    """Filtered position [m], speed [m/s], noise and held acceleration [m/s^2] of all drivers, (T, N, 4), or NaN."""
    return follow(data, model, work)[1]


def follow(data: Recorded, model: Model, work: Executor) -> tuple[PointwiseDensity, Array]:
    """What the model says of every sample, and the filtered states as ``filtered_states`` gives them."""
    jobs = [(data.chains[i], model.rows[i], leaders(data, model, i)) for i in range(data.drivers)]
    outputs = list(work.map(_follow_driver, jobs))
    y, variance, density = (np.array([o[k] for o in outputs]) for k in range(3))
    states = np.stack([o[3] for o in outputs], axis=1)
    states[~np.isfinite(variance.T)] = np.nan
    return PointwiseDensity(y, variance, density), states


def _follow_driver(job: tuple[Chain, Array, Array]) -> tuple[Array, Array, Array, Array]:
    chain, row, ahead = job
    return causal.predict_states(chain, row, ahead)
