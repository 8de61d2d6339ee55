"""A driver's noises learnt online: measurement noise sigma_nu and acceleration noise sigma_a.

A filter cannot hold them in its state, because they move no mean. They follow the likelihood instead: by recursive
prediction error (Ljung and Soderstrom, Theory and Practice of Recursive Identification, 1983, section 3.8), with the
exact sensitivities of the filter's mean and covariance, so that in the long run they end where the batch fit does.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_NU
from sugiyama_ros.estimation.causal import STATE
from sugiyama_ros.road import Array

#: The noises that are learnt, as places in a driver's row.
NOISES = [SIGMA_NU, SIGMA_A]


@dataclass(frozen=True)
class Learning:
    """How noises are learnt: prior std of their logarithms, and the time [s] in which they forget what was learnt."""

    prior_std: tuple[float, float] = (0.3, 0.7)
    relaxation_s: float = 300.0


# Squared normalised innovation beyond which a sample teaches no more: a gross error is not the noise.
_LARGEST = 16.0
# Step of a logarithm at most, at one sample.
_STEP = 0.1
_NU, _A = 0, 1
# Place of the driver's own acceleration noise in the state.
_OWN_NOISE = 2


@njit(cache=True)
def _predict(jacobian: Array, noise: Array, d_mean: Array, d_covariance: Array) -> None:
    """Sensitivities after F x and F P F' + Q; d Q / d log sigma_a is twice the variance of the shock."""
    for k in range(2):
        d_mean[k] = jacobian @ d_mean[k]
        d_covariance[k] = jacobian @ d_covariance[k] @ jacobian.T
    d_covariance[_A, _OWN_NOISE, _OWN_NOISE] += 2.0 * noise[_OWN_NOISE, _OWN_NOISE]


@njit(cache=True)
def _update(
    measures: Array, gain: Array, weight: Array, y: Array, own_noise_var: float, d_mean: Array, d_covariance: Array
) -> None:
    """Sensitivities after a Kalman update with H, K, S^-1 and y; own_noise_var: of the first of y, if that is his own.

    The gain is the best one, so its own change moves the covariance in second order only.
    """
    rest = np.eye(len(d_mean[0])) - gain @ measures
    weighted = weight @ y
    own = np.ascontiguousarray(gain[:, 0])
    for k in range(2):
        d_noise = 2.0 * own_noise_var if k == _NU else 0.0
        moved = d_mean[k] + d_covariance[k] @ (measures.T @ weighted)
        d_mean[k] = rest @ moved - own * (d_noise * weighted[0])
        d_covariance[k] = rest @ d_covariance[k] @ rest.T + d_noise * np.outer(own, own)


@njit(cache=True)
def _learn(
    y: float, variance: float, noise_var: float, factor: float, d_mean: Array, d_covariance: Array
) -> tuple[Array, Array]:
    """Score (2,) of a sample's log-likelihood by the logarithms of the noises, and its expected information (2, 2)."""
    scale = min(y * y / variance, _LARGEST)
    score, slopes, shifts = np.empty(2), np.empty(2), np.empty(2)
    for k in range(2):
        slopes[k] = factor * factor * d_covariance[k, 0, 0] + (2.0 * noise_var if k == _NU else 0.0)
        shifts[k] = -factor * d_mean[k, 0]
        bounded = math.copysign(math.sqrt(scale * variance), y)
        score[k] = -0.5 * slopes[k] / variance * (1.0 - scale) - bounded * shifts[k] / variance
    information = 0.5 * np.outer(slopes, slopes) / variance**2 + np.outer(shifts, shifts) / variance
    return score, information


class NoiseLearner:
    """Logarithms (2,) of a driver's noises, at the period of the samples, and their covariance (2, 2).

    prior_mean: (2,) of the logarithms; period_s: time [s] between two samples; size: of the filter's state.
    """

    def __init__(self, learning: Learning, prior_mean: Array, period_s: float, size: int) -> None:
        self._prior_mean, self._prior_var = prior_mean, np.diag(np.square(learning.prior_std))
        self._memory = math.exp(-period_s / learning.relaxation_s)
        self.mean: Array = prior_mean.copy()
        self.covariance: Array = self._prior_var.copy()
        self._d_mean, self._d_covariance = np.zeros((2, size)), np.zeros((2, size, size))

    @property
    def values(self) -> Array:
        """The noises (2,) themselves."""
        return np.exp(self.mean)

    def predict(self, jacobian: Array, noise: Array) -> None:
        """Go on by one period with the filter's F and Q, and forget a little."""
        _predict(jacobian, noise, self._d_mean, self._d_covariance)
        kept = self._memory
        self.mean = self._prior_mean + kept * (self.mean - self._prior_mean)
        self.covariance = kept**2 * self.covariance + (1.0 - kept**2) * self._prior_var

    def learn(self, y: float, variance: float, noise_var: float, factor: float) -> None:
        """Take in the driver's own innovation [m] and its variance, before the filter is updated with it."""
        score, information = _learn(y, variance, noise_var, factor, self._d_mean, self._d_covariance)
        self.covariance = np.asarray(np.linalg.inv(np.linalg.inv(self.covariance) + information), dtype=np.float64)
        self.mean = self.mean + np.clip(self.covariance @ score, -_STEP, _STEP)

    def update(self, kalman: Any, measures: Array, own_noise_var: float) -> None:
        """After the filter's update; own_noise_var: of the first measured position, 0 if it is not the driver's."""
        _update(measures, kalman.K, kalman.SI, kalman.y, own_noise_var, self._d_mean, self._d_covariance)

    def start(self, covariance: Array) -> None:
        """The filter has just begun to follow the driver, with this covariance, or has lost him."""
        self._d_mean[:], self._d_covariance[:] = 0.0, 0.0
        own = slice(0, _OWN_NOISE)
        self._d_covariance[_NU, own, own] = 2.0 * covariance[own, own]
        self._d_covariance[_A, _OWN_NOISE, _OWN_NOISE] = 2.0 * covariance[_OWN_NOISE, _OWN_NOISE]

    def forget(self, m: int) -> None:
        """Vehicle m of the chain is another one now."""
        gone = slice(STATE * m, STATE * (m + 1))
        self._d_mean[:, gone] = 0.0
        self._d_covariance[:, gone, :] = 0.0
        self._d_covariance[:, :, gone] = 0.0
