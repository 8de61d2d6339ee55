"""The mean action at many moments at once, and its derivatives: most of the work of the paper's likelihood.

The formulas are the formulas of ``utility``, which takes one moment at a time. Here the loops run over the moments, so
that compilers turn them into vector instructions.
"""

from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.exponential import exponential
from sugiyama_ros.driver.parameters import UTILITY
from sugiyama_ros.driver.utility import (
    FAR,
    FORWARD,
    Preferences,
    backward_penalty,
    collision_penalty,
    forward_reward,
    gap_and_scale,
    preferences,
)
from sugiyama_ros.jit import kernel

#: Number of moments in a block. The arrays of a block fit into the processor's cache.
BLOCK = 128
_V_STAR, _KAPPA_V, _KAPPA_1, _KAPPA_C, _KAPPA_D, _OMEGA_2, _RATIONALITY = range(len(UTILITY))


class Considered(NamedTuple):
    """Every action at every moment of a block, for the derivatives.

    ratio: (K, B), smallest ratio of gap to gap scale in the look-ahead, for K actions at B moments; per_metre: (K, B),
    reciprocal of the gap scale [1/m]; tau: (K, B), periods ahead at which the ratio is smallest; reward, risk: (K, B),
    first term of phi1, and phi2; utility: (K, B), effective utility; weight: (K, B), boltzmann weight relative to the
    weight of the best action.
    """

    ratio: Array
    per_metre: Array
    tau: Array
    reward: Array
    risk: Array
    utility: Array
    weight: Array


# An action with less weight than this, relative to the weight of the best action, cannot change a mean.
_NO_CHANCE = 1e-20


@kernel(vectorised=True)
def _closest(
    actions: Array,
    gap: Array,
    speed: Array,
    leader_speed: Array,
    driver: Preferences,
    period: float,
    ahead: tuple[int, ...],
    smallest: Array,
    scale: Array,
    tau: Array,
) -> None:
    """Find the smallest ratio of gap [m] to scale [m] in the look-ahead, and its period, (K, B) each; section 3.2.2."""
    for k in range(len(actions)):
        for t in range(len(gap)):
            near, wide = gap_and_scale(actions[k], 1, gap[t], speed[t], leader_speed[t], driver, period)
            when = 1.0
            for i in range(1, len(ahead)):
                near_then, wide_then = gap_and_scale(
                    actions[k], ahead[i], gap[t], speed[t], leader_speed[t], driver, period
                )
                closer = near_then * wide < near * wide_then
                near = near_then if closer else near
                wide = wide_then if closer else wide
                when = float(ahead[i]) if closer else when
            smallest[k, t], scale[k, t], tau[k, t] = near, wide, when


@kernel(vectorised=True)
def _add_up(
    actions: Array,
    speed: Array,
    driver: Preferences,
    period: float,
    ratio: Array,
    scale: Array,
    reward: Array,
    risk: Array,
    utility: Array,
    best: Array,
) -> None:
    """Compute reward, risk and utility, (K, B) each, and the largest utility, (B,); Eq. EffectiveUtilityTilde.

    ``ratio`` and ``scale``, (K, B), hold the gap and its scale at first, then their ratio and the scale's reciprocal.
    """
    v_star, _, kappa_1, _, _, omega_2, _ = driver
    slowest = np.min(speed)
    best[:] = -np.inf
    for k in range(len(actions)):
        for t in range(len(speed)):
            reward[k, t] = forward_reward(speed[t] + period * actions[k], v_star, kappa_1)
        for t in range(len(speed)):
            scale[k, t] = 1.0 / scale[k, t]
            ratio[k, t] *= scale[k, t]
            risk[k, t] = collision_penalty(ratio[k, t])
            utility[k, t] = reward[k, t] + omega_2 * risk[k, t]
        if slowest + period * actions[k] < FORWARD:
            for t in range(len(speed)):
                utility[k, t] -= backward_penalty(speed[t] + period * actions[k])
        for t in range(len(speed)):
            best[t] = utility[k, t] if utility[k, t] > best[t] else best[t]


@kernel(vectorised=True)
def _weigh(
    actions: Array, utility: Array, best: Array, rationality: float, weight: Array, partition: Array, mean: Array
) -> None:
    """Compute Boltzmann weights relative to the best action, (K, B), their sums and the mean actions, (B,) each."""
    partition[:], mean[:] = 0.0, 0.0
    for k in range(len(actions)):
        for t in range(len(best)):
            w = exponential(rationality * (utility[k, t] - best[t]))
            weight[k, t] = w
            partition[t] += w
            mean[t] += w * actions[k]
    for t in range(len(best)):
        mean[t] /= partition[t]


@kernel(vectorised=True)
def _add_partials(
    actions: Array,
    speed: Array,
    leader_speed: Array,
    v_star: float,
    period: float,
    considered: Considered,
    mean: Array,
    wanted: Array,
    out: Array,
) -> None:
    """Add up the covariances of the action and the utility's derivatives into ``out`` (7, B), without ``_factors``.

    Every wanted parameter has its own loop. The rows of the other parameters stay 0.
    """
    ratio, per_metre, tau, reward, risk, utility, weight = considered
    out[:] = 0.0
    off_mean = np.empty(len(speed))
    for k in range(len(actions)):
        mattering = 0
        for t in range(len(speed)):
            off_mean[t] = weight[k, t] * (actions[k] - mean[t])
            mattering += weight[k, t] > _NO_CHANCE
        if mattering == 0:
            continue
        step = period * actions[k]
        if wanted[_V_STAR]:
            for t in range(len(speed)):
                next_speed = speed[t] + step
                out[_V_STAR, t] += off_mean[t] * (next_speed - v_star) * reward[k, t] * next_speed
        if wanted[_KAPPA_1]:
            for t in range(len(speed)):
                short = speed[t] + step - v_star
                out[_KAPPA_1, t] += off_mean[t] * short * short * reward[k, t]
        if wanted[_OMEGA_2]:
            for t in range(len(speed)):
                out[_OMEGA_2, t] += off_mean[t] * risk[k, t]
        if wanted[_RATIONALITY]:
            for t in range(len(speed)):
                out[_RATIONALITY, t] += off_mean[t] * utility[k, t]
        if wanted[_KAPPA_C] or wanted[_KAPPA_V] or wanted[_KAPPA_D]:
            for t in range(len(speed)):
                inside = ratio[k, t] if ratio[k, t] > 0.0 else 0.0
                off_mean[t] *= inside * (inside + 1.0) * risk[k, t] * per_metre[k, t]
        if wanted[_KAPPA_C]:
            for t in range(len(speed)):
                out[_KAPPA_C, t] += off_mean[t]
        if wanted[_KAPPA_V]:
            for t in range(len(speed)):
                out[_KAPPA_V, t] += off_mean[t] * abs(speed[t] + tau[k, t] * step)
        if wanted[_KAPPA_D]:
            for t in range(len(speed)):
                closing = speed[t] + tau[k, t] * step - leader_speed[t]
                out[_KAPPA_D, t] += off_mean[t] * (closing if closing > 0.0 else 0.0)


@kernel
def _factors(driver: Preferences) -> Array:
    """Factors (7,) of the sums of ``_add_partials``. All but the last contain the rationality."""
    v_star, _, kappa_1, _, _, omega_2, rationality = driver
    factors = np.full(len(UTILITY), rationality)
    factors[_V_STAR] *= 2.0 / (kappa_1 * kappa_1 * v_star**3)
    factors[_KAPPA_1] *= 2.0 / (kappa_1**3 * v_star * v_star)
    for j in (_KAPPA_C, _KAPPA_V, _KAPPA_D):
        factors[j] *= 2.0 * omega_2
    factors[_RATIONALITY] = 1.0
    return factors


@kernel
def mean_actions(
    gap: Array,
    speed: Array,
    leader_speed: Array,
    parameters: Array,
    actions: Array,
    period: float,
    periods_ahead: tuple[int, ...],
    wanted: Array,
    mean: Array,
    partials: Array,
) -> None:
    """Compute mean actions [m/s^2] at T moments and their derivatives by the utility's parameters, where ``wanted``.

    The derivative of a Boltzmann mean is a covariance: d mean(a) = lambda cov(a, d utility).

    parameters: (P,), at this period; wanted: (7,); mean, partials: (T,) and (T, 7), filled, with 0 elsewhere.
    """
    driver, shape = preferences(parameters), (len(actions), BLOCK)
    v_star, rationality, factors = driver[0], driver[-1], _factors(driver)
    smallest, scale, tau, reward = np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape)
    risk, utility, weight = np.empty(shape), np.empty(shape), np.empty(shape)
    own, leader, near = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    best, partition, average, sums = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty((len(UTILITY), BLOCK))
    for first in range(0, len(gap), BLOCK):
        taken = min(BLOCK, len(gap) - first)
        for t in range(BLOCK):
            # copies of the last moment fill up the last block
            at = first + min(t, taken - 1)
            near[t], own[t], leader[t] = min(gap[at], FAR), speed[at], leader_speed[at]
        _closest(actions, near, own, leader, driver, period, periods_ahead, smallest, scale, tau)
        _add_up(actions, own, driver, period, smallest, scale, reward, risk, utility, best)
        _weigh(actions, utility, best, rationality, weight, partition, average)
        considered = Considered(smallest, scale, tau, reward, risk, utility, weight)
        _add_partials(actions, own, leader, v_star, period, considered, average, wanted, sums)
        for t in range(taken):
            mean[first + t] = average[t]
            for j in range(len(UTILITY)):
                partials[first + t, j] = factors[j] * sums[j, t] / partition[t]
