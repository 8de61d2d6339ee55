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
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_NU
from sugiyama_ros.filters.state import STATE

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


#: Squared normalised innovation beyond which a sample teaches no more: a gross error is not the noise.
LARGEST = 16.0
#: Step of a logarithm at most, at one sample.
STEP = 0.1
NU, A = 0, 1
#: Place of the driver's own acceleration noise in the state.
OWN_NOISE = 2


def _predict(jacobian: Array, noise: Array, d_mean: Array, d_covariance: Array) -> None:
    """Sensitivities after F x and F P F' + Q; d Q / d log sigma_a is twice the variance of the shock."""
    for k in range(2):
        d_mean[k] = jacobian @ d_mean[k]
        d_covariance[k] = jacobian @ d_covariance[k] @ jacobian.T
    d_covariance[A, OWN_NOISE, OWN_NOISE] += 2.0 * noise[OWN_NOISE, OWN_NOISE]


def _update(
    measures: Array, gain: Array, weight: Array, y: Array, own_noise_var: float, d_mean: Array, d_covariance: Array
) -> None:
    """Sensitivities after a Kalman update with H, K, S^-1 and y.

    own_noise_var: of the first entry of y if it is the driver's own, else 0. The gain is the best one, so its own
    change moves the covariance in second order only.
    """
    rest = np.eye(len(d_mean[0])) - gain @ measures
    weighted = weight @ y
    own = np.ascontiguousarray(gain[:, 0])
    for k in range(2):
        d_noise = 2.0 * own_noise_var if k == NU else 0.0
        moved = d_mean[k] + d_covariance[k] @ (measures.T @ weighted)
        d_mean[k] = rest @ moved - own * (d_noise * weighted[0])
        d_covariance[k] = rest @ d_covariance[k] @ rest.T + d_noise * np.outer(own, own)


def _mix(weight: Array, stay: float, mean: Array, covariance: Array) -> None:
    """Mix the models before a period: a driver who follows a model now may have followed another one before."""
    models = len(weight)
    if models == 1:
        return
    stays = np.full((models, models), (1.0 - stay) / (models - 1))
    np.fill_diagonal(stays, stay)
    came_from = stays * weight.reshape(-1, 1)
    weight[:] = came_from.sum(axis=0)
    was, spread = mean.copy(), covariance.copy()
    for j in range(models):
        mean[j], covariance[j] = _moments(came_from[:, j] / weight[j], was, spread)


def _moments(weight: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Mean (2,) and covariance (2, 2) of a mixture."""
    centre, around = np.zeros(2), np.zeros((2, 2))
    for k in range(len(weight)):
        centre += weight[k] * mean[k]
    for k in range(len(weight)):
        off = mean[k] - centre
        around += weight[k] * (covariance[k] + np.outer(off, off))
    return centre, around


class NoiseLearner:
    """Learns the logarithms of a driver's noises from the steps of a Kalman filter.

    learning: how the noises are learnt; prior_mean: prior mean of the logarithms at the period of the samples, (2,);
    period_s: time between two samples [s]; size: number N of entries of the filter's state; mean, covariance: of the
    logarithms as known now, (2,) and (2, 2); d_mean, d_covariance: derivatives of the filter's mean (2, N) and
    covariance (2, N, N) by the logarithms; weight: probability of each interacting model; outliers: share and factor of
    outliers, (2,).
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

    def predict(self, jacobian: Array, noise: Array, periods: float = 1.0) -> None:
        """Go on by some periods with the filter's F and Q, and forget a little."""
        _predict(jacobian, noise, self.d_mean, self.d_covariance)
        _mix(self.weight, self._stay**periods, self._means, self._covariances)
        each = self._kept**periods
        self._means = self._prior_mean + each * (self._means - self._prior_mean)
        kept = each[:, :, None] * each[:, None, :]
        self._covariances = kept * self._covariances + (1.0 - kept) * self._prior_var
        self.mean, self.covariance = _moments(self.weight, self._means, self._covariances)

    def learn(self, y: float, variance: float, noise_var: float, factor: float) -> None:
        """Take in the driver's own innovation [m] and its variance, before the filter is updated with it.

        Each model moves by the score and the expected information of the logarithms.
        """
        slopes, shifts = np.empty(2), np.empty(2)
        for k in range(2):
            slopes[k] = factor * factor * self.d_covariance[k, 0, 0] + (2.0 * noise_var if k == NU else 0.0)
            shifts[k] = -factor * self.d_mean[k, 0]
        density = np.empty(len(self.weight))
        for j in range(len(self.weight)):
            off = self._means[j] - self.mean
            own_y = y + shifts @ off
            own_var = variance * math.exp(slopes @ off / variance)
            scale = min(own_y * own_y / own_var, LARGEST)
            density[j] = -0.5 * (math.log(own_var) + scale)
            bounded = math.copysign(math.sqrt(scale * own_var), own_y)
            score = -0.5 * slopes / variance * (1.0 - scale) - bounded / own_var * shifts
            information = 0.5 * np.outer(slopes, slopes) / variance**2 + np.outer(shifts, shifts) / own_var
            self._covariances[j] = np.linalg.inv(np.linalg.inv(self._covariances[j]) + information)
            self._means[j] += np.clip(self._covariances[j] @ score, -STEP, STEP)
        self.weight *= np.exp(density - density.max())
        self.weight /= self.weight.sum()
        self.mean, self.covariance = _moments(self.weight, self._means, self._covariances)

    def update(self, kalman: Any, measures: Array, own_noise_var: float) -> None:
        """After the filter's update; own_noise_var: of the first measured position, 0 if it is not the driver's."""
        _update(measures, kalman.K, kalman.SI, kalman.y, own_noise_var, self.d_mean, self.d_covariance)

    def start(self, covariance: Array) -> None:
        """Begin with the filter, which has just begun to follow the driver with this covariance."""
        self.d_mean[:], self.d_covariance[:] = 0.0, 0.0
        own = slice(0, OWN_NOISE)
        self.d_covariance[NU, own, own] = 2.0 * covariance[own, own]
        self.d_covariance[A, OWN_NOISE, OWN_NOISE] = 2.0 * covariance[OWN_NOISE, OWN_NOISE]

    def forget(self, m: int) -> None:
        """Vehicle m of the chain is another one now."""
        gone = slice(STATE * m, STATE * (m + 1))
        self.d_mean[:, gone] = 0.0
        self.d_covariance[:, gone, :] = 0.0
        self.d_covariance[:, :, gone] = 0.0
