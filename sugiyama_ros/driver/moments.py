"""The mean action at many moments at once, and its derivatives: most of the work of the paper's likelihood.

The same formulas as in ``utility``, which takes one moment at a time. Here what a driver perceives is given for all of
them, so that the loops run over the moments and compilers make vector instructions of them.
"""

import numpy as np
from numba import njit

from sugiyama_ros.driver.exponential import exponential
from sugiyama_ros.driver.parameters import UTILITY
from sugiyama_ros.driver.utility import (
    FAR,
    FAST,
    FORWARD,
    Preferences,
    backward_penalty,
    collision_penalty,
    forward_reward,
    gap_and_scale,
    preferences,
    reward_and_risk,
)
from sugiyama_ros.road import Array

#: Moments that are taken together; what is kept of them stays in the processor's nearest memory.
BLOCK = 256
_V_STAR, _KAPPA_V, _KAPPA_1, _KAPPA_C, _KAPPA_D, _OMEGA_2, _RATIONALITY = range(len(UTILITY))
# Weight of an action that cannot change a mean, relative to the best one's.
_NO_CHANCE = 1e-20


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _closest(
    action: float,
    gap: Array,
    speed: Array,
    leader_speed: Array,
    driver: Preferences,
    period: float,
    horizon: int,
    smallest: Array,
    scale: Array,
    tau: Array,
) -> None:
    """Gap [m], scale [m] and period of the look-ahead where their ratio is smallest, (B,) each; section 3.2.2."""
    for t in range(len(gap)):
        smallest[t], scale[t] = gap_and_scale(action, 1, gap[t], speed[t], leader_speed[t], driver, period)
        tau[t] = 1.0
    for ahead in range(2, horizon + 1):
        for t in range(len(gap)):
            gap_ahead, scale_ahead = gap_and_scale(action, ahead, gap[t], speed[t], leader_speed[t], driver, period)
            closer = gap_ahead * scale[t] < smallest[t] * scale_ahead
            smallest[t] = gap_ahead if closer else smallest[t]
            scale[t] = scale_ahead if closer else scale[t]
            tau[t] = float(ahead) if closer else tau[t]


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _add_up(
    action: float, speed: Array, driver: Preferences, period: float, smallest: Array, scale: Array, out: Array
) -> None:
    for t in range(len(speed)):
        out[t] = reward_and_risk(speed[t] + period * action, smallest[t], scale[t], driver)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _take_off_backward(action: float, speed: Array, period: float, out: Array) -> None:
    """The second term of phi1."""
    for t in range(len(speed)):
        out[t] -= backward_penalty(speed[t] + period * action)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _highest(utility: Array, best: Array) -> None:
    for t in range(len(best)):
        best[t] = utility[t] if utility[t] > best[t] else best[t]


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _weigh(
    utility: Array, best: Array, rationality: float, action: float, weight: Array, partition: Array, mean: Array
) -> float:
    """Boltzmann weights relative to the best action's; adds them up, and the action with them; the largest one."""
    largest = 0.0
    for t in range(len(utility)):
        w = exponential(rationality * (utility[t] - best[t]))
        weight[t] = w
        partition[t] += w
        mean[t] += w * action
        largest = w if w > largest else largest
    return largest


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _add_partials(
    action: float,
    speed: Array,
    leader_speed: Array,
    driver: Preferences,
    period: float,
    smallest: Array,
    scale: Array,
    tau: Array,
    utility: Array,
    weight: Array,
    mean: Array,
    out: Array,
) -> None:
    """Add to ``out`` (7, B) an action's part of the covariance of actions and utilities' derivatives."""
    v_star, _, kappa_1, _, _, omega_2, _ = driver
    for t in range(len(speed)):
        off_mean = weight[t] * (action - mean[t])
        next_speed = speed[t] + period * action
        off = (next_speed - v_star) / (kappa_1 * v_star)
        slope = -2.0 * off * forward_reward(next_speed, v_star, kappa_1)
        ratio = smallest[t] / scale[t]
        ratio = ratio if ratio > 0.0 else 0.0
        penalty = collision_penalty(ratio)
        by_scale = 2.0 * omega_2 * ratio * (ratio + 1.0) * penalty / scale[t]
        speed_ahead = speed[t] + tau[t] * period * action
        closing = speed_ahead - leader_speed[t]
        out[_V_STAR, t] -= off_mean * slope * next_speed / (kappa_1 * v_star * v_star)
        out[_KAPPA_1, t] -= off_mean * slope * off / kappa_1
        out[_OMEGA_2, t] += off_mean * penalty
        out[_KAPPA_C, t] += off_mean * by_scale
        out[_KAPPA_V, t] += off_mean * by_scale * abs(speed_ahead)
        out[_KAPPA_D, t] += off_mean * by_scale * (closing if closing > 0.0 else 0.0)
        out[_RATIONALITY, t] += off_mean * utility[t]


@njit(cache=True, nogil=True)
def mean_actions(
    gap: Array,
    speed: Array,
    leader_speed: Array,
    parameters: Array,
    actions: Array,
    period: float,
    horizon: int,
    mean: Array,
    partials: Array,
) -> None:
    """Mean actions [m/s^2] into ``mean`` (T,), and their derivatives by the utility's parameters into (7, T).

    gap [m] (infinite without a leader), speed, leader_speed: (T,); parameters: (P,) at this period; actions: (K,).
    The derivative of a Boltzmann mean is a covariance: d mean(a) = lambda cov(a, d utility).
    """
    driver = preferences(parameters)
    rationality, count = driver[-1], len(actions)
    utility, weight = np.empty((count, BLOCK)), np.empty((count, BLOCK))
    smallest, scale, tau = np.empty((count, BLOCK)), np.empty((count, BLOCK)), np.empty((count, BLOCK))
    seen, best, partition, average = np.empty((3, BLOCK)), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    sums, largest = np.empty((len(UTILITY), BLOCK)), np.empty(count)
    for first in range(0, len(gap), BLOCK):
        taken = min(BLOCK, len(gap) - first)
        for t in range(BLOCK):
            # the last block is filled up with its last moment
            at = first + min(t, taken - 1)
            seen[0, t], seen[1, t], seen[2, t] = min(gap[at], FAR), speed[at], leader_speed[at]
        slowest = np.min(seen[1])
        best[:], partition[:], average[:], sums[:] = -np.inf, 0.0, 0.0, 0.0
        for k in range(count):
            a = actions[k]
            _closest(a, seen[0], seen[1], seen[2], driver, period, horizon, smallest[k], scale[k], tau[k])
            _add_up(a, seen[1], driver, period, smallest[k], scale[k], utility[k])
            if slowest + period * a < FORWARD:
                _take_off_backward(a, seen[1], period, utility[k])
            _highest(utility[k], best)
        for k in range(count):
            largest[k] = _weigh(utility[k], best, rationality, actions[k], weight[k], partition, average)
        average /= partition
        for k in range(count):
            if largest[k] > _NO_CHANCE:
                _add_partials(
                    actions[k],
                    seen[1],
                    seen[2],
                    driver,
                    period,
                    smallest[k],
                    scale[k],
                    tau[k],
                    utility[k],
                    weight[k],
                    average,
                    sums,
                )
        for t in range(taken):
            mean[first + t] = average[t]
            for j in range(len(UTILITY)):
                factor = 1.0 if j == _RATIONALITY else rationality
                partials[j, first + t] = factor * sums[j, t] / partition[t]
