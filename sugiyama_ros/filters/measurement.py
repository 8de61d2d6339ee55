"""The measurement of a vehicle's position: its offset, its noise, and how much an innovation counts."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import SIGMA_NU
from sugiyama_ros.effects.sensing import displacement, is_contaminated, noise_std_factor, weigh
from sugiyama_ros.jit import kernel


@kernel(allocates=False)
def measurement(position: float, parameters: Array, circumference_m: float) -> tuple[float, float]:
    """Return what a measured position is expected to have beyond the true position, and its slope.

    position: true position [m]; circumference_m: length of the ring [m], 0 for an open road. Returns offset: measured
    position less the true one, without noise [m]; slope: derivative of the measured position by the true one: the entry
    of H.
    """
    offset, slope = displacement(position, circumference_m, parameters)
    return offset, 1.0 + slope


@kernel(allocates=False)
def noise_var_at(position: float, parameters: Array, circumference_m: float) -> float:
    """Return the variance of the measurement noise [m^2] at a position [m]; arguments as for ``measurement``."""
    variance: float = parameters[SIGMA_NU] ** 2
    return variance * noise_std_factor(position, circumference_m, parameters) ** 2


@kernel(allocates=False)
def weights(y: float, variance: float, parameters: Array) -> tuple[float, float]:
    """Return how much an innovation counts.

    Without outliers both weights are 1 / S. With outliers the update is a mixture of two updates; the weights make its
    mean and its covariance.

    y: innovation [m]; variance: its variance S [m^2]. Returns step: factor of P H' y in what is added to the mean
    [1/m^2]; shrink: factor of P H' H P in what is taken off P [1/m^2].
    """
    if not is_contaminated(parameters):
        return 1.0 / variance, 1.0 / variance
    bad, wide, _ = weigh(y, variance, parameters[SIGMA_NU] ** 2, parameters)
    gain = (1.0 - bad) / variance + bad / wide
    between = (1.0 - bad) / variance**2 + bad / wide**2 - gain * gain
    return gain, gain - y * y * between


@kernel(allocates=False)
def log_density(y: float, variance: float, parameters: Array) -> float:
    """Return the log-likelihood of an innovation, without the term of 2 pi; arguments as for ``weights``."""
    if not is_contaminated(parameters):
        return -0.5 * (math.log(variance) + y * y / variance)
    density: float = weigh(y, variance, parameters[SIGMA_NU] ** 2, parameters)[2]
    return density


@kernel
def weigh_samples(y: Array, variance: Array, parameters: Array, weight: Array, density: Array) -> None:
    """Fill in how much each of T innovations counts, and its log-likelihood.

    y, variance: innovations [m] and their variances [m^2], (T,) each.
    """
    for t in range(len(y)):
        weight[t] = weights(y[t], variance[t], parameters)[0] * variance[t]
        density[t] = log_density(y[t], variance[t], parameters)
