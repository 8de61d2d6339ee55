"""What a driver wants: the anticipated utility of holding an acceleration, and the Boltzmann mean action.

Sections 3.1, 3.2 and 3.4.1 of the paper. A driver sees the gap [m], their own speed [m/s] and the leader's speed [m/s].
The gap is infinite without a leader. All functions are compiled. The parameters of a driver are a vector in the order
of ``driver.parameters``, rescaled to the period.
"""

from typing import Any, TypeAlias

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.exponential import exponential
from sugiyama_ros.driver.parameters import (
    KAPPA_1,
    KAPPA_C,
    KAPPA_D,
    KAPPA_V,
    OMEGA_2,
    RATIONALITY,
    V_STAR,
)
from sugiyama_ros.jit import kernel

#: The paper's grid of candidate accelerations [m/s^2]; section 3.4.1.
ACTIONS: Array = np.linspace(-6.0, 4.0, 41, dtype=np.float64)

#: The parameters of the utility as scalars, in the order of ``parameters.UTILITY``.
Preferences: TypeAlias = tuple[float, float, float, float, float, float, float]

# exp(-10 (v + 0.25)) overflows at backward speeds that no car reaches, so its exponent is at most this.
_EXPONENT_CAP = 600.0
# Utility of an entry that only fills up a row and must never be chosen.
_NEVER = -1e300
# Rows of the scratch array in which a driver considers the actions. Two rows have two uses.
UTILITY_ROW, GRID_ROW, _HANDICAP, _GAP, _SCALE = range(5)
_WEIGHT, _WEIGHTED = _GAP, _SCALE
#: A row that is free between ``utilities`` and ``boltzmann_mean``.
FREE_ROW = _GAP
# The length of a row is a multiple of this number, and a row is summed in this number of partial sums. A vector
# instruction then adds several entries, in a fixed order. With fastmath, compilers would choose the order, and the
# rounding would differ from one compilation to the next.
_SUMS = 16
#: Gap [m] of a driver without a leader, in place of an infinite gap: no risk, and all numbers stay finite.
FAR = 1e9
#: Speed [m/s] above which driving backward costs less than 1e-20.
FORWARD = 4.35


@kernel(vectorised=True)
def forward_reward(speed: float, v_star: float, kappa_1: float) -> float:
    """Compute the first term of phi1: the reward, from 0 to 1, of a speed [m/s] near the desired speed [m/s]."""
    # all actions share the reciprocal, so compilers compute it once
    off = (speed - v_star) * (1.0 / (kappa_1 * v_star))
    return exponential(-off * off)


@kernel(vectorised=True)
def backward_penalty(speed: float) -> float:
    """Compute the second term of phi1: the cost of driving backward at a speed [m/s]."""
    exponent = -10.0 * (speed + 0.25)
    return exponential(exponent if exponent < _EXPONENT_CAP else _EXPONENT_CAP)


@kernel(vectorised=True)
def gap_scale(speed: float, leader_speed: float, kappa_c: float, kappa_v: float, kappa_d: float) -> float:
    """Compute sigma [m], the gap within which a driver feels at risk; text below Eq. PairwiseCollisionPenalty."""
    closing = speed - leader_speed
    return kappa_c + kappa_v * abs(speed) + kappa_d * (closing if closing > 0.0 else 0.0)


@kernel(vectorised=True)
def collision_penalty(ratio: float) -> float:
    """Compute phi2, the risk at a ratio of gap to scale, 1 at contact; Eq. PairwiseCollisionPenalty."""
    inside = ratio if ratio > 0.0 else 0.0
    return exponential(-inside * (inside + 2.0))


@kernel(vectorised=True)
def anticipate(
    action: float, tau: float, gap: float, speed: float, leader_speed: float, period: float
) -> tuple[float, float]:
    """Predict the gap [m] and the speed [m/s] after ``tau`` periods if the driver holds an action [m/s^2].

    The leader keeps their speed. Euler's rule as in Eq. ssm_form: x_{t+1} = x_t + dt v_t, v_{t+1} = v_t + dt a.
    """
    gap_ahead = gap + period * tau * (leader_speed - speed) - period * period * action * (0.5 * tau * (tau - 1))
    return gap_ahead, speed + tau * period * action


@kernel
def preferences(parameters: Array) -> Preferences:
    """Take the parameters of the utility out of all parameters (P,), as scalars that fit into registers."""
    return (
        parameters[V_STAR],
        parameters[KAPPA_V],
        parameters[KAPPA_1],
        parameters[KAPPA_C],
        parameters[KAPPA_D],
        parameters[OMEGA_2],
        parameters[RATIONALITY],
    )


@kernel(vectorised=True)
def gap_and_scale(
    action: float, tau: float, gap: float, speed: float, leader_speed: float, driver: Preferences, period: float
) -> tuple[float, float]:
    """Predict the gap [m] and its scale sigma [m] ``tau`` periods ahead; arguments as for ``anticipate``."""
    _, kappa_v, _, kappa_c, kappa_d, _, _ = driver
    gap_ahead, speed_ahead = anticipate(action, tau, gap, speed, leader_speed, period)
    return gap_ahead, gap_scale(speed_ahead, leader_speed, kappa_c, kappa_v, kappa_d)


@kernel(vectorised=True)
def risk_ahead(
    gap: float, speed: float, other_speed: float, action: float, period: float, horizon: int, driver: Preferences
) -> float:
    """Compute the largest risk, from 0 to 1, of a vehicle ahead in the look-ahead, as phi2 of the paper does."""
    near, wide = gap_and_scale(action, 1, gap, speed, other_speed, driver, period)
    for tau in range(2, horizon + 1):
        gap_then, wide_then = gap_and_scale(action, tau, gap, speed, other_speed, driver, period)
        if gap_then * wide < near * wide_then:
            near, wide = gap_then, wide_then
    return collision_penalty(near / wide)


@kernel(vectorised=True)
def _gap_behind(
    action: float, tau: int, gap: float, speed: float, other_speed: float, period: float, driver: Preferences
) -> tuple[float, float]:
    """Compute the gap [m] to the vehicle behind, and its scale [m], ``tau`` periods ahead."""
    gap_ahead, _ = anticipate(-action, tau, gap, other_speed, speed, period)
    return gap_ahead, gap_scale(other_speed, speed + tau * period * action, driver[3], driver[1], driver[4])


@kernel(vectorised=True)
def risk_behind(
    gap: float, speed: float, other_speed: float, action: float, period: float, horizon: int, driver: Preferences
) -> float:
    """Compute the largest risk, from 0 to 1, of a vehicle behind in the look-ahead, which keeps its speed."""
    near, wide = _gap_behind(action, 1, gap, speed, other_speed, period, driver)
    for tau in range(2, horizon + 1):
        gap_then, wide_then = _gap_behind(action, tau, gap, speed, other_speed, period, driver)
        if gap_then * wide < near * wide_then:
            near, wide = gap_then, wide_then
    return collision_penalty(near / wide)


@kernel(vectorised=True)
def _smallest_gaps(
    gap: float, speed: float, leader_speed: float, driver: Preferences, scratch: Array, period: float, horizon: int
) -> None:
    """Find the gap [m] and the scale [m] with the smallest ratio in the look-ahead, for each action."""
    for k in range(scratch.shape[1]):
        scratch[_GAP, k], scratch[_SCALE, k] = gap_and_scale(
            scratch[GRID_ROW, k], 1, gap, speed, leader_speed, driver, period
        )
    for tau in range(2, horizon + 1):
        for k in range(scratch.shape[1]):
            gap_ahead, scale_ahead = gap_and_scale(scratch[GRID_ROW, k], tau, gap, speed, leader_speed, driver, period)
            closer = gap_ahead * scratch[_SCALE, k] < scratch[_GAP, k] * scale_ahead
            scratch[_GAP, k] = gap_ahead if closer else scratch[_GAP, k]
            scratch[_SCALE, k] = scale_ahead if closer else scratch[_SCALE, k]


@kernel(vectorised=True)
def _add_up(speed: float, driver: Preferences, scratch: Array, period: float) -> None:
    """Compute the utility of each action without the cost of driving backward; Eq. EffectiveUtilityTilde.

    The penalty falls as its argument grows. So the largest penalty in the look-ahead, g2 of section 3.2.2, is the
    penalty at the smallest ratio of gap to scale.
    """
    v_star, _, kappa_1, _, _, omega_2, _ = driver
    for k in range(scratch.shape[1]):
        reward = forward_reward(speed + period * scratch[GRID_ROW, k], v_star, kappa_1)
        scratch[UTILITY_ROW, k] = reward + omega_2 * collision_penalty(scratch[_GAP, k] / scratch[_SCALE, k])


@kernel(vectorised=True)
def _take_off_backward(speed: float, scratch: Array, period: float) -> None:
    """Subtract the cost of driving backward: g1 of phi1's second term."""
    for k in range(scratch.shape[1]):
        scratch[UTILITY_ROW, k] -= backward_penalty(speed + period * scratch[GRID_ROW, k])


@kernel(allocates=False)
def utilities(
    gap: float, speed: float, leader_speed: float, driver: Preferences, scratch: Array, period: float, horizon: int
) -> None:
    """Compute the effective utility of holding each action into UTILITY_ROW of ``scratch_for``.

    Every loop over the actions stands in its own function, so that compilers turn it into vector instructions. The
    functions take the whole scratch array, and their caller is inlined; otherwise compiled code would count references
    to arrays.
    """
    _smallest_gaps(min(gap, FAR), speed, leader_speed, driver, scratch, period, horizon)
    _add_up(speed, driver, scratch, period)
    if speed + period * scratch[GRID_ROW, 0] < FORWARD:
        _take_off_backward(speed, scratch, period)


@kernel(vectorised=True)
def _best(scratch: Array) -> float:
    """Find the largest utility."""
    for k in range(_SUMS):
        scratch[_WEIGHT, k] = scratch[UTILITY_ROW, k]
    for start in range(_SUMS, scratch.shape[1], _SUMS):
        for part in range(_SUMS):
            other = scratch[UTILITY_ROW, start + part]
            scratch[_WEIGHT, part] = other if other > scratch[_WEIGHT, part] else scratch[_WEIGHT, part]
    best: float = scratch[_WEIGHT, 0]
    for part in range(1, _SUMS):
        best = scratch[_WEIGHT, part] if scratch[_WEIGHT, part] > best else best
    return best


@kernel(vectorised=True)
def _sum(scratch: Array, row: int) -> float:
    """Sum up a row of the scratch array, and overwrite it."""
    for start in range(_SUMS, scratch.shape[1], _SUMS):
        for part in range(_SUMS):
            scratch[row, part] += scratch[row, start + part]
    for part in range(8):
        scratch[row, part] += scratch[row, part + 8]
    for part in range(4):
        scratch[row, part] += scratch[row, part + 4]
    total: float = (scratch[row, 0] + scratch[row, 1]) + (scratch[row, 2] + scratch[row, 3])
    return total


@kernel(allocates=False, vectorised=True)
def boltzmann_mean(scratch: Array, rationality: float) -> float:
    """Compute the Boltzmann mean of the actions [m/s^2] in ``scratch``, which ``utilities`` has filled."""
    best = _best(scratch)
    for k in range(scratch.shape[1]):
        scratch[_WEIGHT, k] = exponential(rationality * (scratch[UTILITY_ROW, k] + scratch[_HANDICAP, k] - best))
    for k in range(scratch.shape[1]):
        scratch[_WEIGHTED, k] = scratch[_WEIGHT, k] * scratch[GRID_ROW, k]
    return _sum(scratch, _WEIGHTED) / _sum(scratch, _WEIGHT)


@kernel
def scratch_for(actions: Array) -> Array:
    """Make the array (5, at least K) in which a driver considers actions (K,) [m/s^2], moment after moment.

    Its rows: utilities; actions; 0 for an action, and a very low utility for an entry that only fills up the row; two
    rows for intermediate results.
    """
    count = len(actions)
    scratch = np.zeros((5, -(-count // _SUMS) * _SUMS))
    for k in range(scratch.shape[1]):
        scratch[GRID_ROW, k] = actions[min(k, count - 1)]
        if k >= count:
            scratch[_HANDICAP, k] = _NEVER
    return scratch


@kernel
def mean_action(
    gap: float, speed: float, leader_speed: float, parameters: Array, actions: Array, period: float, horizon: int
) -> float:
    """Compute the Boltzmann mean [m/s^2] of actions (K,) for parameters (P,); Eqs. MeanAction to PartitionFunction."""
    driver, scratch = preferences(parameters), scratch_for(actions)
    utilities(gap, speed, leader_speed, driver, scratch, period, horizon)
    return boltzmann_mean(scratch, driver[-1])


@kernel
def advance(position: Any, speed: Any, acceleration: Any, period: float) -> tuple[Any, Any]:
    """Return positions [m] and speeds [m/s] of vehicles one period [s] later, by Euler's rule (Eq. ssm_form)."""
    return position + period * speed, speed + period * acceleration
