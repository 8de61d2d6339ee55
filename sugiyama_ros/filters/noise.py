"""A driver's noises learnt online: measurement noise sigma_nu and acceleration noise sigma_a.

A filter cannot hold them in its state, because they move no mean. They follow the likelihood instead: by recursive
prediction error (Ljung and Soderstrom, Theory and Practice of Recursive Identification, 1983, section 3.8), with the
exact sensitivities of the filter's mean and covariance, so that in the long run they end where the batch fit does.
The samples of a driver tell whether the acceleration noise changes: two interacting models (Blom and Bar-Shalom,
IEEE Trans. Automatic Control 33 (1988) 780), with a constant one and with one that is forgotten, are weighed by what
they predict. The measurement noise is the camera's and does not change.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_NU
from sugiyama_ros.filters.state import STATE
from sugiyama_ros.jit import kernel

#: The noises that are learnt, as places in a driver's row.
NOISES = [SIGMA_NU, SIGMA_A]


@dataclass(frozen=True)
class Learning:
    """How noises are learnt.

    prior_std: of their logarithms; relaxations_s: of each interacting model, the times [s] in which they return to the
    prior; dwell_s: mean time [s] that a driver stays with one of the models; outliers: share of the measured positions
    that are far off and the factor of their noise, as in the effect ``outlier_noise``, for the density of a sample.
    """

    prior_std: tuple[float, float] = (0.3, 0.7)
    relaxations_s: tuple[tuple[float, float], ...] = ((math.inf, math.inf), (math.inf, 300.0))
    dwell_s: float = 1000.0
    outliers: tuple[float, float] = (0.03, 2.6)


# Squared normalised innovation beyond which a sample teaches no more: a gross error is not the noise.
_LARGEST = 16.0
# Step of a logarithm at most, at one sample.
_STEP = 0.1
_NU, _A = 0, 1
# Place of the driver's own acceleration noise in the state.
_OWN_NOISE = 2


# The kernels below are loops over numbers. They do what a line of matrix products each would do, but such lines take
# several seconds to compile, on the first run of every user.


@kernel(vectorised=True)
def _transform(matrix: Array, vector: Array, square: Array) -> None:
    """Replace a vector (N,) by M v and a square matrix (N, N) by M S M'."""
    size = len(vector)
    moved, half = np.zeros(size), np.zeros((size, size))
    transposed = np.empty((size, size))
    for i in range(size):
        for k in range(size):
            by = matrix[i, k]
            transposed[k, i] = by
            if by != 0.0:  # most entries of F and of 1 - K H are 0
                moved[i] += by * vector[k]
                for j in range(size):
                    half[i, j] += by * square[k, j]
    for i in range(size):
        vector[i] = moved[i]
        for j in range(size):
            square[i, j] = 0.0
        for k in range(size):
            by = half[i, k]
            for j in range(size):
                square[i, j] += by * transposed[k, j]


@kernel
def _predict(jacobian: Array, noise: Array, d_mean: Array, d_covariance: Array) -> None:
    """Sensitivities after F x and F P F' + Q; d Q / d log sigma_a is twice the variance of the shock."""
    for k in range(2):
        _transform(jacobian, d_mean[k], d_covariance[k])
    d_covariance[_A, _OWN_NOISE, _OWN_NOISE] += 2.0 * noise[_OWN_NOISE, _OWN_NOISE]


@kernel(vectorised=True)
def _update(
    measures: Array, gain: Array, weight: Array, y: Array, own_noise_var: float, d_mean: Array, d_covariance: Array
) -> None:
    """Sensitivities after a Kalman update with H, K, S^-1 and y.

    own_noise_var: of the first entry of y if it is the driver's own, else 0. The gain is the best one, so its own
    change moves the covariance in second order only.
    """
    measured, size = measures.shape
    # H' S^-1 y and 1 - K H
    pulled, rest = np.zeros(size), np.zeros((size, size))
    first = 0.0
    for m in range(measured):
        weighted = 0.0
        for n in range(measured):
            weighted += weight[m, n] * y[n]
        if m == 0:
            first = weighted
        for i in range(size):
            pulled[i] += measures[m, i] * weighted
            for j in range(size):
                rest[i, j] -= gain[i, m] * measures[m, j]
    for i in range(size):
        rest[i, i] += 1.0
    for k in range(2):
        for i in range(size):
            for j in range(size):
                d_mean[k, i] += d_covariance[k, i, j] * pulled[j]
        _transform(rest, d_mean[k], d_covariance[k])
    for i in range(size):
        d_mean[_NU, i] -= gain[i, 0] * (2.0 * own_noise_var * first)
        for j in range(size):
            d_covariance[_NU, i, j] += 2.0 * own_noise_var * gain[i, 0] * gain[j, 0]


@kernel
def _mix(weight: Array, stay: float, mean: Array, covariance: Array) -> None:
    """Mix the models before a period: a driver who follows a model now may have followed another one before."""
    models = len(weight)
    if models == 1:
        return
    was, spread, before = mean.copy(), covariance.copy(), weight.copy()
    came_from = np.empty(models)
    for j in range(models):
        weight[j] = 0.0
        for i in range(models):
            came_from[i] = before[i] * (stay if i == j else (1.0 - stay) / (models - 1))
            weight[j] += came_from[i]
        for i in range(models):
            came_from[i] /= weight[j]
        _moments(came_from, was, spread, mean[j], covariance[j])


@kernel
def _moments(weight: Array, means: Array, covariances: Array, mean: Array, covariance: Array) -> None:
    """Fill in the mean (2,) and the covariance (2, 2) of a mixture."""
    for i in range(2):
        mean[i] = 0.0
        for k in range(len(weight)):
            mean[i] += weight[k] * means[k, i]
    for i in range(2):
        for j in range(2):
            covariance[i, j] = 0.0
            for k in range(len(weight)):
                off = (means[k, i] - mean[i]) * (means[k, j] - mean[j])
                covariance[i, j] += weight[k] * (covariances[k, i, j] + off)


class _Sample(NamedTuple):
    """A sample as the noises learn from it: innovation y [m], its variance [m^2], its slopes and shifts.

    The slopes are the derivatives of the variance by the logarithms of sigma_nu and sigma_a; the shifts are those of y.
    """

    y: float
    variance: float
    slope_nu: float
    slope_a: float
    shift_nu: float
    shift_a: float


@kernel(vectorised=True)
def _learn_one(sample: _Sample, centre: Array, mean: Array, covariance: Array) -> float:
    """Update one model with a sample and return the log-density of the sample, without the 2 pi term."""
    y, variance, slope_nu, slope_a, shift_nu, shift_a = sample
    off_nu, off_a = mean[0] - centre[0], mean[1] - centre[1]
    own_y = y + (shift_nu * off_nu + shift_a * off_a)
    own_var = variance * math.exp((slope_nu * off_nu + slope_a * off_a) / variance)
    scale = min(own_y * own_y / own_var, _LARGEST)
    bounded = math.copysign(math.sqrt(scale * own_var), own_y)
    per_slope, per_shift = -0.5 / variance * (1.0 - scale), bounded / own_var
    score_nu, score_a = per_slope * slope_nu - per_shift * shift_nu, per_slope * slope_a - per_shift * shift_a
    # the inverse of the covariance, plus the expected information
    nu_nu, nu_a, a_a = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    determinant = nu_nu * a_a - nu_a * nu_a
    of_slope, of_shift = 0.5 / variance**2, 1.0 / own_var
    known_nu = a_a / determinant + (of_slope * slope_nu * slope_nu + of_shift * shift_nu * shift_nu)
    known_both = -nu_a / determinant + (of_slope * slope_nu * slope_a + of_shift * shift_nu * shift_a)
    known_a = nu_nu / determinant + (of_slope * slope_a * slope_a + of_shift * shift_a * shift_a)
    determinant = known_nu * known_a - known_both * known_both
    nu_nu, nu_a, a_a = known_a / determinant, -known_both / determinant, known_nu / determinant
    covariance[0, 0], covariance[0, 1], covariance[1, 0], covariance[1, 1] = nu_nu, nu_a, nu_a, a_a
    mean[0] += min(max(nu_nu * score_nu + nu_a * score_a, -_STEP), _STEP)
    mean[1] += min(max(nu_a * score_nu + a_a * score_a, -_STEP), _STEP)
    density: float = -0.5 * (math.log(own_var) + scale)
    return density


@kernel
def _learn(sample: _Sample, centre: Array, weight: Array, mean: Array, covariance: Array) -> None:
    """Update each model with a sample, by the score and the expected information of the logarithms."""
    models, best, total = len(weight), -math.inf, 0.0
    density = np.empty(models)
    for j in range(models):
        density[j] = _learn_one(sample, centre, mean[j], covariance[j])
        best = max(best, density[j])
    for j in range(models):
        weight[j] *= math.exp(density[j] - best)
        total += weight[j]
    for j in range(models):
        weight[j] /= total


class NoiseLearner:
    """Learns the logarithms of a driver's noises from the steps of a Kalman filter.

    Parameters
    ----------
    learning
        How the noises are learnt.
    prior_mean
        Prior mean of the logarithms at the period of the samples, (2,).
    period_s
        Time between two samples [s].
    size
        Number N of entries of the filter's state.

    Attributes
    ----------
    mean, covariance
        Of the logarithms as known now, (2,) and (2, 2).
    d_mean, d_covariance
        Derivatives of the filter's mean (2, N) and covariance (2, N, N) by the logarithms.
    weight
        Probability of each interacting model.
    outliers
        Share and factor of outliers, (2,).
    """

    def __init__(self, learning: Learning, prior_mean: Array, period_s: float, size: int) -> None:
        self._prior_mean, self._prior_var = prior_mean, np.diag(np.square(learning.prior_std))
        self._kept = np.exp(-period_s / np.array(learning.relaxations_s))
        self._stay = math.exp(-period_s / learning.dwell_s)
        self.d_mean, self.d_covariance = np.zeros((2, size)), np.zeros((2, size, size))
        self.outliers: Array = np.array(learning.outliers)
        models = len(self._kept)
        self.weight: Array = np.full(models, 1.0 / models)
        self.recall(prior_mean, self._prior_var)

    def recall(self, mean: Array, covariance: Array) -> None:
        """Go on from a mean (2,) of the logarithms and its covariance (2, 2)."""
        self._means = np.tile(mean, (len(self._kept), 1))
        self._covariances = np.tile(covariance, (len(self._kept), 1, 1))
        self.mean, self.covariance = mean.copy(), covariance.copy()

    @property
    def values(self) -> Array:
        """The noises (2,) themselves."""
        return np.exp(self.mean)

    def predict(self, jacobian: Array, noise: Array) -> None:
        """Go on by one period with the filter's F and Q, and forget a little."""
        _predict(jacobian, noise, self.d_mean, self.d_covariance)
        _mix(self.weight, self._stay, self._means, self._covariances)
        self._means = self._prior_mean + self._kept * (self._means - self._prior_mean)
        kept = self._kept[:, :, None] * self._kept[:, None, :]
        self._covariances = kept * self._covariances + (1.0 - kept) * self._prior_var
        self._sum_up()

    def learn(self, y: float, variance: float, noise_var: float, factor: float) -> None:
        """Take in the driver's own innovation [m] and its variance, before the filter is updated with it."""
        by_nu, by_a = self.d_covariance[:, 0, 0].tolist()
        shift_nu, shift_a = self.d_mean[:, 0].tolist()
        sample = _Sample(
            y=y,
            variance=variance,
            slope_nu=factor * factor * by_nu + 2.0 * noise_var,
            slope_a=factor * factor * by_a,
            shift_nu=-factor * shift_nu,
            shift_a=-factor * shift_a,
        )
        _learn(sample, self.mean, self.weight, self._means, self._covariances)
        self._sum_up()

    def _sum_up(self) -> None:
        """Mean and covariance over all models, as new arrays."""
        self.mean, self.covariance = np.empty(2), np.empty((2, 2))
        _moments(self.weight, self._means, self._covariances, self.mean, self.covariance)

    def update(self, kalman: Any, measures: Array, own_noise_var: float) -> None:
        """After the filter's update; own_noise_var: of the first measured position, 0 if it is not the driver's."""
        # one layout, so that one version of the function is compiled
        weight = np.ascontiguousarray(kalman.SI)
        _update(measures, kalman.K, weight, kalman.y, own_noise_var, self.d_mean, self.d_covariance)

    def start(self, covariance: Array) -> None:
        """Begin with the filter, which has just begun to follow the driver with this covariance."""
        self.d_mean[:], self.d_covariance[:] = 0.0, 0.0
        own = slice(0, _OWN_NOISE)
        self.d_covariance[_NU, own, own] = 2.0 * covariance[own, own]
        self.d_covariance[_A, _OWN_NOISE, _OWN_NOISE] = 2.0 * covariance[_OWN_NOISE, _OWN_NOISE]

    def forget(self, m: int) -> None:
        """Vehicle m of the chain is another one now."""
        gone = slice(STATE * m, STATE * (m + 1))
        self.d_mean[:, gone] = 0.0
        self.d_covariance[:, gone, :] = 0.0
        self.d_covariance[:, :, gone] = 0.0
