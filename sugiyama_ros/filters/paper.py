"""The paper's formulation: what a driver perceives is smoothed from the measurements and enters as a given control.

Sections 2.3 (smoothing), 3.3 and 3.4 (state space and likelihood). The perceived state of sample t uses measurements up
to t + 3, so this likelihood is not causal; it is kept because it is the paper's.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.moments import mean_actions
from sugiyama_ros.driver.parameters import (
    COUNT,
    RHO,
    SIGMA_A,
    SIGMA_NU,
    SIGMA_V,
    SIGMA_X,
    UTILITY,
    at_period,
    horizon_at,
    jacobian_at_reference,
)
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.errors import InputError
from sugiyama_ros.jit import kernel
from sugiyama_ros.trajectories.dense import DenseTracks

# Samples without a perceived state at the start and at the end: the smoothed speed reaches from t - 2 to t + 3.
_MARGIN_BEFORE, _MARGIN_AFTER = 2, 3
#: First innovations, which are not scored: the filter settles.
UNSCORED = 3
# Variances at the start of position [m^2], smoothed speed [m^2/s^2] and acceleration [m^2/s^4].
_START_VAR = 1.0
# Change from one sample to the next below which covariances count as being at rest.
_AT_REST = 1e-15
_NOISES = (SIGMA_NU, SIGMA_A, RHO, SIGMA_X, SIGMA_V)
# Parameters as the derivatives have them, and the place of rho there.
_ORDER = (*UTILITY, *_NOISES)
_BY_RHO = _ORDER.index(RHO)


def smooth(position_m: Array, times: int) -> Array:
    """Smooth positions (T, ...) [m] with ``times`` passes of the (1, 2, 1) / 4 filter of section 2.3, NaN at ends."""
    smoothed = position_m
    for _ in range(times):
        inner = 0.25 * (smoothed[:-2] + 2.0 * smoothed[1:-1] + smoothed[2:])
        smoothed = np.full_like(smoothed, np.nan)
        smoothed[1:-1] = inner
    return smoothed


def smoothed_speed(position_m: Array, times: int, period_s: float) -> Array:
    """Return the naive speed (T, ...) [m/s] of positions smoothed ``times`` times; Eq. SmoothedState."""
    speed = np.full_like(position_m, np.nan)
    speed[:-1] = np.diff(smooth(position_m, times), axis=0) / period_s
    return speed


@dataclass(frozen=True, eq=False)
class Perceived:
    """What one driver perceives by section 2.3, and the measured positions, over the T' samples where both are known.

    gap_m: (T',) smoothed once; speed, leader_speed: (T',) [m/s] smoothed twice; measured_m: (T',) continuous positions;
    period_s: time [s] between two samples.
    """

    gap_m: Array
    speed: Array
    leader_speed: Array
    measured_m: Array
    period_s: float


def perceive(trajectories: DenseTracks, driver: int) -> Perceived:
    """Return what a driver perceives. Raises InputError."""
    where = f"{trajectories.source or 'trajectories'}: vehicle {trajectories.name[driver]}"
    leaders = np.unique(trajectories.leader[:, driver])
    if len(leaders) > 1:
        raise InputError(f"{where}: its leader changes; the paper's formulation cannot follow that, the causal one can")
    leader = int(leaders[0])
    pair = trajectories.road.unwrap(trajectories.position_m[:, [driver, leader] if leader >= 0 else [driver]])
    if np.isnan(pair).any():
        raise InputError(
            f"{where}: a sample is missing; the paper's smoothing cannot skip it, the causal formulation can"
        )
    kept = slice(_MARGIN_BEFORE, len(pair) - _MARGIN_AFTER)
    if len(pair) - _MARGIN_BEFORE - _MARGIN_AFTER <= UNSCORED:
        raise InputError(f"{where}: {len(pair)} samples are too few for the paper's smoothing")
    once, speed = smooth(pair, 1)[kept], smoothed_speed(pair, 2, trajectories.period_s)[kept]
    gap: Array = np.full(len(once), np.inf)
    leader_speed: Array = np.zeros(len(once))
    if leader >= 0:
        # the leader's lap number is arbitrary: bring the first headway into one circumference
        headway = once[:, 1] - once[:, 0]
        headway += float(trajectories.road.wrap(headway[:1])[0]) - headway[0]
        gap = headway - 0.5 * (trajectories.length_m[leader] + trajectories.length_m[driver])
        leader_speed = speed[:, 1]
    return Perceived(
        gap_m=gap,
        speed=np.ascontiguousarray(speed[:, 0]),
        leader_speed=np.ascontiguousarray(leader_speed),
        measured_m=np.ascontiguousarray(pair[kept, 0]),
        period_s=trajectories.period_s,
    )


@dataclass(frozen=True, eq=False)
class Scored:
    """Log-likelihood (no 2 pi term), its gradient (P,) and its expected information (P, P).

    scatter: (P, P), the sum over the samples of the outer product of the sample's gradient, where it is known; it
    estimates the same information from the data.
    """

    log_likelihood: float
    gradient: Array
    information: Array
    scatter: Array | None = None


def score(perceived: Perceived, parameters: Array, places: Collection[int] = range(COUNT)) -> Scored:
    """Return Eq. SSM_Likelihood of one driver and its derivatives."""
    samples, scaled = len(perceived.measured_m), at_period(parameters, perceived.period_s)
    wanted = np.array([k in places for k in UTILITY])
    action, partials = np.empty(samples), np.empty((samples, len(UTILITY)))
    seen = (perceived.gap_m, perceived.speed, perceived.leader_speed)
    ahead = tuple(range(1, 1 + horizon_at(perceived.period_s)))
    mean_actions(*seen, scaled, ACTIONS, perceived.period_s, ahead, wanted, action, partials)
    derivatives = LikelihoodDerivatives(np.empty(COUNT), np.empty((COUNT, COUNT)))
    value = run(
        Control(action, partials),
        perceived.measured_m,
        perceived.speed[0],
        scaled,
        perceived.period_s,
        np.empty(samples),
        np.empty(samples),
        np.empty((0, 3)),
        derivatives,
    )
    jacobian = jacobian_at_reference(parameters, scaled, perceived.period_s)
    return Scored(float(value), jacobian @ derivatives.gradient, jacobian @ derivatives.information @ jacobian.T)


def log_likelihood(perceived: Perceived, parameters: Array) -> tuple[float, Array]:
    """Return the log-likelihood of parameters (P,), without the term of 2 pi, and its gradient (P,)."""
    scored = score(perceived, parameters)
    return scored.log_likelihood, scored.gradient


class Control(NamedTuple):
    """The mean action at T' samples, (T',) [m/s^2], and its derivatives by the utility's parameters, (T', 7)."""

    action: Array
    partials: Array


class LikelihoodDerivatives(NamedTuple):
    """Of the log-likelihood by the parameters: gradient (P,) and expected information (P, P)."""

    gradient: Array
    information: Array


def phi(rho: float, period_s: float) -> Array:
    """Return Phi (3, 3), the transition of position, speed and acceleration over a period [s]; section 3.4."""
    return np.array([[1.0, period_s, 0.0], [0.0, 1.0, period_s], [0.0, 0.0, rho]])


#: A (1, 3), what is measured of the state; section 3.4.
A: Array = np.array([[1.0, 0.0, 0.0]])


def omega(parameters: Array) -> Array:
    """Return Omega_mu (3, 3), the covariance of the process noise, for parameters (P,); section 3.4."""
    return np.diag(parameters[[SIGMA_X, SIGMA_V, SIGMA_A]] ** 2)


@kernel
def _predict(covariance: Array, period: float, rho: float, out: Array) -> None:
    """Phi P Phi' of a symmetric P (3, 3) into ``out``."""
    xx, xv, xa = covariance[0, 0], covariance[0, 1], covariance[0, 2]
    vv, va, aa = covariance[1, 1], covariance[1, 2], covariance[2, 2]
    out[0, 0] = xx + 2.0 * period * xv + period * period * vv
    out[0, 1] = out[1, 0] = xv + period * (xa + vv) + period * period * va
    out[0, 2] = out[2, 0] = rho * (xa + period * va)
    out[1, 1] = vv + 2.0 * period * va + period * period * aa
    out[1, 2] = out[2, 1] = rho * (va + period * aa)
    out[2, 2] = rho * rho * aa


@kernel
def _gains(parameters: Array, period: float, gain: Array, variance: Array, d_gain: Array, d_variance: Array) -> int:
    """Gain (T', 3) and variance of the innovation (T',), and their derivatives by the noises (T', 5, 3), (T', 5).

    They depend on no data, and come to rest. Returns the number of samples until then; the rest is not filled.
    """
    noises = len(_NOISES)
    rho, noise_var = parameters[RHO], parameters[SIGMA_NU] ** 2
    covariance, ahead = np.diag(np.full(3, _START_VAR)), np.diag(np.full(3, _START_VAR))
    d_covariance, d_ahead = np.zeros((noises, 3, 3)), np.zeros((noises, 3, 3))
    for t in range(len(variance)):
        if t > 0:
            _predict(covariance, period, rho, ahead)
            ahead[0, 0] += parameters[SIGMA_X] ** 2
            ahead[1, 1] += parameters[SIGMA_V] ** 2
            ahead[2, 2] += parameters[SIGMA_A] ** 2
            for k in range(noises):
                _predict(d_covariance[k], period, rho, d_ahead[k])
            # d (Phi P Phi') / d rho
            for k in range(2):
                by_rho = covariance[k, 2] + period * covariance[k + 1, 2]
                d_ahead[2, k, 2] += by_rho
                d_ahead[2, 2, k] += by_rho
            d_ahead[2, 2, 2] += 2.0 * rho * covariance[2, 2]
            d_ahead[1, 2, 2] += 2.0 * parameters[SIGMA_A]
            d_ahead[3, 0, 0] += 2.0 * parameters[SIGMA_X]
            d_ahead[4, 1, 1] += 2.0 * parameters[SIGMA_V]
        s = ahead[0, 0] + noise_var
        moved = abs(s - variance[t - 1]) if t > 0 else np.inf
        variance[t] = s
        for i in range(3):
            gain[t, i] = ahead[i, 0] / s
        for k in range(noises):
            d_s = d_ahead[k, 0, 0] + (2.0 * parameters[SIGMA_NU] if k == 0 else 0.0)
            d_variance[t, k] = d_s
            for i in range(3):
                d_gain[t, k, i] = (d_ahead[k, i, 0] - gain[t, i] * d_s) / s
        for i in range(3):
            for j in range(3):
                both = gain[t, i] * gain[t, j]
                after = ahead[i, j] - both * s
                moved = max(moved, abs(after - covariance[i, j]))
                covariance[i, j] = after
                for k in range(noises):
                    by_gains = (d_gain[t, k, i] * gain[t, j] + gain[t, i] * d_gain[t, k, j]) * s
                    d_after = d_ahead[k, i, j] - (by_gains + both * d_variance[t, k])
                    moved = max(moved, abs(d_after - d_covariance[k, i, j]))
                    d_covariance[k, i, j] = d_after
        if moved < _AT_REST:
            return t + 1
    return len(variance)


@kernel
def run(
    control: Control,
    measured: Array,
    first_speed: float,
    parameters: Array,
    period: float,
    innovation: Array,
    innovation_var: Array,
    means: Array,
    derivatives: LikelihoodDerivatives,
) -> float:
    """Filter one driver with the mean action as control.

    measured: positions [m], (T',); first_speed: speed [m/s] that is perceived with the first sample; period: time
    between two samples [s]; innovation, innovation_var: filled: innovation [m] and its variance [m^2], (T',) each.
    """
    action, partials = control.action, control.partials
    samples, noises, rho = len(measured), len(_NOISES), parameters[RHO]
    gain, d_gain, d_variance = np.empty((samples, 3)), np.empty((samples, noises, 3)), np.empty((samples, noises))
    moving = _gains(parameters, period, gain, innovation_var, d_gain, d_variance)
    innovation_var[moving:] = innovation_var[moving - 1]
    x, v, a = measured[0], first_speed, 0.0
    # derivatives of the mean by the parameters, first the utility's, then the noises; those of x at every sample
    slopes, d_v, d_a = np.zeros((samples, COUNT)), np.zeros(COUNT), np.zeros(COUNT)
    d_x = np.zeros(COUNT)
    for t in range(samples):
        now = min(t, moving - 1)
        if t > 0:
            for j in range(COUNT):
                d_x[j] += period * d_v[j]
                d_v[j] += period * d_a[j]
                d_a[j] *= rho
            for j in range(len(UTILITY)):
                d_a[j] += partials[t, j] - rho * partials[t - 1, j]
            d_a[_BY_RHO] += a - action[t - 1]
            x, v, a = x + period * v, v + period * a, rho * a + action[t] - rho * action[t - 1]
        y = measured[t] - x
        innovation[t] = y
        by_x, by_v, by_a = gain[now, 0], gain[now, 1], gain[now, 2]
        for j in range(COUNT):
            slope = d_x[j]
            slopes[t, j] = slope
            d_x[j] = slope - by_x * slope
            d_v[j] -= by_v * slope
            d_a[j] -= by_a * slope
        for k in range(noises):
            d_x[len(UTILITY) + k] += d_gain[now, k, 0] * y
            d_v[len(UTILITY) + k] += d_gain[now, k, 1] * y
            d_a[len(UTILITY) + k] += d_gain[now, k, 2] * y
        x, v, a = x + by_x * y, v + by_v * y, a + by_a * y
        if len(means) > 0:
            means[t, 0], means[t, 1], means[t, 2] = x, v, a
    return _sum_up(innovation, innovation_var, slopes, d_variance, moving, derivatives)


@kernel
def _sum_up(
    innovation: Array,
    variance: Array,
    slopes: Array,
    d_variance: Array,
    moving: int,
    derivatives: LikelihoodDerivatives,
) -> float:
    """Return Eq. SSM_Likelihood and fill in its derivatives, from the derivatives of innovation and variance.

    slopes: (T', P) of the predicted position; d_variance: (moving, 5), the last one for all later samples.
    """
    gradient, information = derivatives.gradient, derivatives.information
    y, s, by = innovation[UNSCORED:], variance[UNSCORED:], slopes[UNSCORED:]
    relative = by * (1.0 / s).reshape(-1, 1)
    slope_sum, curvature = y @ relative, by.T @ relative
    total = 0.0
    by_variance = np.zeros(len(_NOISES))
    noise_curvature = np.zeros((len(_NOISES), len(_NOISES)))
    at_rest, rest = 0.0, 0
    for t in range(UNSCORED, len(innovation)):
        nis = innovation[t] * innovation[t] / variance[t]
        if t < moving:
            total -= 0.5 * (math.log(variance[t]) + nis)
            _add_variance(d_variance[t], variance[t], 1.0 - nis, 1.0, by_variance, noise_curvature)
        else:
            at_rest += nis
            rest += 1
    if rest:
        total -= 0.5 * (rest * math.log(variance[-1]) + at_rest)
        _add_variance(d_variance[moving - 1], variance[-1], rest - at_rest, float(rest), by_variance, noise_curvature)
    for i in range(COUNT):
        gradient[_ORDER[i]] = slope_sum[i]
        for j in range(COUNT):
            information[_ORDER[i], _ORDER[j]] = curvature[i, j]
    for i in range(len(_NOISES)):
        gradient[_NOISES[i]] -= by_variance[i]
        for j in range(len(_NOISES)):
            information[_NOISES[i], _NOISES[j]] += noise_curvature[i, j]
    return total


@kernel
def _add_variance(d_variance: Array, s: float, less: float, samples: float, gradient: Array, curvature: Array) -> None:
    for i in range(len(_NOISES)):
        gradient[i] += 0.5 * d_variance[i] / s * less
        for j in range(len(_NOISES)):
            curvature[i, j] += 0.5 * samples * d_variance[i] * d_variance[j] / s**2
