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
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_NU
from sugiyama_ros.filters.predict import transform
from sugiyama_ros.filters.state import STATE, Linearised
from sugiyama_ros.jit import kernel

#: The noises that are learnt, as places in a driver's row.
NOISES = [SIGMA_NU, SIGMA_A]
# Squared normalised innovation beyond which a sample teaches no more: a gross error is not the noise.
_LARGEST = 16.0
# Step of a logarithm at most, at one sample.
_STEP = 0.1
_NU, _A = range(len(NOISES))
# Place of the driver's own acceleration noise in the state.
_OWN_NOISE = 2


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


class Noises(NamedTuple):
    """What is known of the noises, with J interacting models; J = 0 where they are not learnt.

    mean, covariance: (2,) and (2, 2) of the logarithms; weight: (J,); means, covariances: (J, 2) and (J, 2, 2) of each
    model; d_mean, d_covariance: derivatives (2, N) and (2, N, N) of the state by the logarithms; kept: (J, 2) of the
    logarithms in a period; prior_mean, prior_var: (2,); stay: (1,) probability of the same model in the next period;
    outliers: (2,); share, were, spread: (J,), (J, 2) and (J, 2, 2), overwritten.
    """

    mean: Array
    covariance: Array
    weight: Array
    means: Array
    covariances: Array
    d_mean: Array
    d_covariance: Array
    kept: Array
    prior_mean: Array
    prior_var: Array
    stay: Array
    outliers: Array
    share: Array
    were: Array
    spread: Array

    def begin(self, learning: Learning, prior_mean: Array, period_s: float) -> None:
        """Put in how noises are learnt, and the prior mean (2,) of their logarithms."""
        self.kept[:] = np.exp(-period_s / np.array(learning.relaxations_s))
        self.prior_mean[:], self.prior_var[:] = prior_mean, np.square(learning.prior_std)
        self.stay[0] = math.exp(-period_s / learning.dwell_s)
        self.outliers[:] = learning.outliers
        self.weight[:] = 1.0 / len(self.weight)
        self.recall(prior_mean, np.diag(self.prior_var))

    def recall(self, mean: Array, covariance: Array) -> None:
        """Go on from a mean (2,) of the logarithms and its covariance (2, 2)."""
        self.mean[:] = self.means[:] = mean
        self.covariance[:] = self.covariances[:] = covariance


@kernel(allocates=False)
def predict_noises(noises: Noises, linearised: Linearised, shared: Array, half: Array, periods: float) -> None:
    """Go on by some periods, and forget a little; shared, half: (N,) and (N, N), overwritten."""
    for k in range(2):
        _move(noises.d_mean[k], linearised, shared)
        transform(noises.d_covariance[k], linearised, half)
    noises.d_covariance[_A, _OWN_NOISE, _OWN_NOISE] += 2.0 * linearised.noise[_OWN_NOISE, _OWN_NOISE]
    _mix(noises, periods)
    for j in range(len(noises.weight)):
        for a in range(2):
            kept = noises.kept[j, a] ** periods
            noises.means[j, a] = noises.prior_mean[a] + kept * (noises.means[j, a] - noises.prior_mean[a])
            for b in range(2):
                both = kept * noises.kept[j, b] ** periods
                prior = noises.prior_var[a] if a == b else 0.0
                noises.covariances[j, a, b] = both * noises.covariances[j, a, b] + (1.0 - both) * prior
    _moments(noises.weight, noises.means, noises.covariances, noises.mean, noises.covariance)


@kernel(allocates=False)
def _move(vector: Array, linearised: Linearised, moved: Array) -> None:
    """F x in place; moved: (N,), overwritten."""
    for i in range(len(vector)):
        moved[i] = 0.0
        for c in range(linearised.counts[i]):
            k = linearised.columns[i, c]
            moved[i] += linearised.jacobian[i, k] * vector[k]
    for i in range(len(vector)):
        vector[i] = moved[i]


@kernel(allocates=False)
def _mix(noises: Noises, periods: float) -> None:
    """Mix the models before some periods: a driver who follows a model now may have followed another one before."""
    weight, share = noises.weight, noises.share
    models = len(weight)
    if models == 1:
        return
    stay = noises.stay[0] ** periods
    changes = (1.0 - stay) / (models - 1)
    for j in range(models):
        for a in range(2):
            noises.were[j, a] = noises.means[j, a]
            for b in range(2):
                noises.spread[j, a, b] = noises.covariances[j, a, b]
    # the probabilities add up to 1
    for j in range(models):
        after = stay * weight[j] + changes * (1.0 - weight[j])
        for i in range(models):
            share[i] = (stay if i == j else changes) * weight[i] / after
        _moments(share, noises.were, noises.spread, noises.means[j], noises.covariances[j])
    for j in range(models):
        weight[j] = stay * weight[j] + changes * (1.0 - weight[j])


@kernel(allocates=False)
def _moments(weight: Array, means: Array, covariances: Array, mean: Array, covariance: Array) -> None:
    """Fill in the mean (2,) and the covariance (2, 2) of a mixture."""
    for a in range(2):
        mean[a] = 0.0
        for j in range(len(weight)):
            mean[a] += weight[j] * means[j, a]
    for a in range(2):
        for b in range(2):
            covariance[a, b] = 0.0
            for j in range(len(weight)):
                off = (means[j, a] - mean[a]) * (means[j, b] - mean[b])
                covariance[a, b] += weight[j] * (covariances[j, a, b] + off)


@kernel(allocates=False)
def learn_noises(noises: Noises, y: float, variance: float, noise_var: float, factor: float) -> None:
    """Take in the driver's own innovation, before the filter is updated with it.

    y, variance: innovation [m] and its variance [m^2]; noise_var: variance [m^2] of the measurement noise.
    """
    weight, density = noises.weight, noises.share
    slope_nu = factor * factor * noises.d_covariance[_NU, 0, 0] + 2.0 * noise_var
    slope_a = factor * factor * noises.d_covariance[_A, 0, 0]
    shift_nu, shift_a = -factor * noises.d_mean[_NU, 0], -factor * noises.d_mean[_A, 0]
    best = -math.inf
    for j in range(len(weight)):
        mean, covariance = noises.means[j], noises.covariances[j]
        off_nu, off_a = mean[_NU] - noises.mean[_NU], mean[_A] - noises.mean[_A]
        own_y = y + shift_nu * off_nu + shift_a * off_a
        own_var = variance * math.exp((slope_nu * off_nu + slope_a * off_a) / variance)
        scale = min(own_y * own_y / own_var, _LARGEST)
        density[j] = -0.5 * (math.log(own_var) + scale)
        best = max(best, density[j])
        bounded = math.copysign(math.sqrt(scale * own_var), own_y) / own_var
        score_nu = -0.5 * slope_nu / variance * (1.0 - scale) - bounded * shift_nu
        score_a = -0.5 * slope_a / variance * (1.0 - scale) - bounded * shift_a
        squared, half = variance * variance, 0.5
        _inform(
            covariance,
            half * slope_nu * slope_nu / squared + shift_nu * shift_nu / own_var,
            half * slope_nu * slope_a / squared + shift_nu * shift_a / own_var,
            half * slope_a * slope_a / squared + shift_a * shift_a / own_var,
        )
        for a in range(2):
            step = covariance[a, _NU] * score_nu + covariance[a, _A] * score_a
            mean[a] += min(max(step, -_STEP), _STEP)
    total = 0.0
    for j in range(len(weight)):
        weight[j] *= math.exp(density[j] - best)
        total += weight[j]
    for j in range(len(weight)):
        weight[j] /= total
    _moments(weight, noises.means, noises.covariances, noises.mean, noises.covariance)


@kernel(allocates=False)
def _inform(covariance: Array, first: float, both: float, second: float) -> None:
    """Add information, a symmetric matrix (2, 2), to what is known with a covariance (2, 2)."""
    known = covariance[0, 0] * covariance[1, 1] - covariance[0, 1] * covariance[1, 0]
    first += covariance[1, 1] / known
    second += covariance[0, 0] / known
    both -= covariance[0, 1] / known
    certain = first * second - both * both
    covariance[0, 0], covariance[1, 1] = second / certain, first / certain
    covariance[0, 1] = covariance[1, 0] = -both / certain


@kernel(allocates=False)
def update_noises(
    noises: Noises, measured: int, gain: Array, factor: float, weighted: float, own_noise_var: float, shared: Array
) -> None:
    """Change the derivatives after the filter's update with one position.

    weighted: innovation times what it counts [1/m]; own_noise_var: variance [m^2] of the measurement noise if it is the
    driver's own position, else 0.
    """
    size = len(gain)
    for k in range(2):
        d_noise = 2.0 * own_noise_var if k == _NU else 0.0
        mean, covariance = noises.d_mean[k], noises.d_covariance[k]
        for i in range(size):
            shared[i] = factor * covariance[i, measured]
        moved = factor * (mean[measured] + shared[measured] * weighted) + d_noise * weighted
        both = factor * shared[measured] + d_noise
        for i in range(size):
            mean[i] += shared[i] * weighted - gain[i] * moved
            for j in range(size):
                covariance[i, j] += both * (gain[i] * gain[j]) - (gain[i] * shared[j] + shared[i] * gain[j])


@kernel(allocates=False)
def start_noises(noises: Noises, covariance: Array) -> None:
    """Begin with the filter, which has just begun to follow the driver with this covariance (N, N) of the state."""
    noises.d_mean[:] = 0.0
    noises.d_covariance[:] = 0.0
    for i in range(_OWN_NOISE):
        for j in range(_OWN_NOISE):
            noises.d_covariance[_NU, i, j] = 2.0 * covariance[i, j]
    noises.d_covariance[_A, _OWN_NOISE, _OWN_NOISE] = 2.0 * covariance[_OWN_NOISE, _OWN_NOISE]


@kernel(allocates=False)
def forget_noises(noises: Noises, m: int) -> None:
    """Vehicle m of the chain is another one now."""
    for k in range(STATE * m, STATE * (m + 1)):
        for d in range(2):
            noises.d_mean[d, k] = 0.0
            noises.d_covariance[d, k, :] = 0.0
            noises.d_covariance[d, :, k] = 0.0
