"""What a driver wants: the utility of holding an acceleration, its anticipation, and the Boltzmann mean action.

Sections 3.1, 3.2 and 3.4.1 of the paper. A driver sees (gap [m], speed [m/s], leader_speed [m/s]); without a leader the
gap is infinite. All functions are pure and compiled; a driver's parameters are a vector ordered as in
``driver.parameters`` and already rescaled to ``period`` [s].
"""

from typing import TypeAlias

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

#: The utility's parameters as scalars, in the order of ``parameters.UTILITY``.
Preferences: TypeAlias = tuple[float, float, float, float, float, float, float]

# exp(-10 (v + 0.25)) overflows for speeds that nobody drives backward; its exponent is capped here.
_EXPONENT_CAP = 600.0
# Utility of an action that is none.
_NEVER = -1e300
# Rows of the scratch array in which actions are considered; two of them are used twice.
UTILITY_ROW, GRID_ROW, _HANDICAP, _GAP, _SCALE = range(5)
_WEIGHT, _WEIGHTED = _GAP, _SCALE
# Rows are a multiple of this long, and summed in as many lanes: several elements per vector instruction, in an order
# that is written down. No compiler may choose one (no fastmath): each time that it compiles, it would round otherwise.
_LANES = 16
#: Gap [m] that stands for an infinite one, of a driver without a leader: no risk, and all numbers stay finite.
FAR = 1e9
#: Speed [m/s] above which driving backward costs less than 1e-20.
FORWARD = 4.35


@kernel(vectorised=True)
def forward_reward(speed: float, v_star: float, kappa_1: float) -> float:
    """First term of phi1: what a speed near the desired one is worth."""
    # the reciprocal is that of all actions
    off = (speed - v_star) * (1.0 / (kappa_1 * v_star))
    return exponential(-off * off)


@kernel(vectorised=True)
def backward_penalty(speed: float) -> float:
    """Second term of phi1: what driving backward costs."""
    exponent = -10.0 * (speed + 0.25)
    return exponential(exponent if exponent < _EXPONENT_CAP else _EXPONENT_CAP)


@kernel
def desired_speed_reward(speed: float, v_star: float, kappa_1: float) -> float:
    """phi1: reward of driving forward near the desired speed; first equation of section 3.2.1."""
    return forward_reward(speed, v_star, kappa_1) - backward_penalty(speed)


@kernel(vectorised=True)
def gap_scale(speed: float, leader_speed: float, kappa_c: float, kappa_v: float, kappa_d: float) -> float:
    """sigma [m]: the gap within which a driver feels at risk; text below Eq. PairwiseCollisionPenalty."""
    closing = speed - leader_speed
    return kappa_c + kappa_v * abs(speed) + kappa_d * (closing if closing > 0.0 else 0.0)


@kernel(vectorised=True)
def collision_penalty(ratio: float) -> float:
    """phi2: subjective risk at a gap of ``ratio`` scales; 1 at contact; Eq. PairwiseCollisionPenalty."""
    inside = ratio if ratio > 0.0 else 0.0
    return exponential(-inside * (inside + 2.0))


@kernel(vectorised=True)
def anticipate(
    action: float, tau: int, gap: float, speed: float, leader_speed: float, period: float
) -> tuple[float, float]:
    """Gap [m] and speed [m/s] expected ``tau`` periods ahead if ``action`` is held and the leader keeps his speed.

    Euler's rule as in Eq. ssm_form: x_{t+1} = x_t + dt v_t, v_{t+1} = v_t + dt a.
    """
    gap_ahead = gap + period * tau * (leader_speed - speed) - period * period * action * (0.5 * tau * (tau - 1))
    return gap_ahead, speed + tau * period * action


@kernel
def preferences(parameters: Array) -> Preferences:
    """The utility's parameters out of all (P,), as scalars, which compiled code keeps in registers."""
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
    action: float, tau: int, gap: float, speed: float, leader_speed: float, driver: Preferences, period: float
) -> tuple[float, float]:
    """Gap [m] expected ``tau`` periods ahead, and sigma [m] there."""
    _, kappa_v, _, kappa_c, kappa_d, _, _ = driver
    gap_ahead, speed_ahead = anticipate(action, tau, gap, speed, leader_speed, period)
    return gap_ahead, gap_scale(speed_ahead, leader_speed, kappa_c, kappa_v, kappa_d)


@kernel(vectorised=True)
def reward_and_risk(next_speed: float, gap: float, scale: float, driver: Preferences) -> float:
    """Eq. EffectiveUtilityTilde but for the second term of phi1: g1 of the first and omega2 times g2 of phi2.

    F falls with its argument, so g2, the largest penalty of the look-ahead (section 3.2.2), is that of the smallest gap
    over scale, which are these.
    """
    v_star, _, kappa_1, _, _, omega_2, _ = driver
    return forward_reward(next_speed, v_star, kappa_1) + omega_2 * collision_penalty(gap / scale)


@kernel(vectorised=True)
def _smallest_gaps(
    gap: float, speed: float, leader_speed: float, driver: Preferences, scratch: Array, period: float, horizon: int
) -> None:
    """Gap [m] and scale [m] where their ratio is smallest in the look-ahead, for each action."""
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
    for k in range(scratch.shape[1]):
        scratch[UTILITY_ROW, k] = reward_and_risk(
            speed + period * scratch[GRID_ROW, k], scratch[_GAP, k], scratch[_SCALE, k], driver
        )


@kernel(vectorised=True)
def _take_off_backward(speed: float, scratch: Array, period: float) -> None:
    """g1 of phi1's second term."""
    for k in range(scratch.shape[1]):
        scratch[UTILITY_ROW, k] -= backward_penalty(speed + period * scratch[GRID_ROW, k])


@kernel(inline=True)
def utilities(
    gap: float, speed: float, leader_speed: float, driver: Preferences, scratch: Array, period: float, horizon: int
) -> None:
    """Effective utility of holding each action in a scratch array, into its UTILITY_ROW; Eq. EffectiveUtilityTilde.

    Every loop runs over the actions and is a function of its own, because compilers make vector instructions of that.
    Each takes the scratch array, not rows of it, and the functions in between are always inlined: otherwise references
    to arrays would be counted.
    """
    _smallest_gaps(min(gap, FAR), speed, leader_speed, driver, scratch, period, horizon)
    _add_up(speed, driver, scratch, period)
    if speed + period * scratch[GRID_ROW, 0] < FORWARD:
        _take_off_backward(speed, scratch, period)


@kernel(vectorised=True)
def _best(scratch: Array) -> float:
    """The largest utility."""
    for k in range(_LANES):
        scratch[_WEIGHT, k] = scratch[UTILITY_ROW, k]
    for start in range(_LANES, scratch.shape[1], _LANES):
        for lane in range(_LANES):
            other = scratch[UTILITY_ROW, start + lane]
            scratch[_WEIGHT, lane] = other if other > scratch[_WEIGHT, lane] else scratch[_WEIGHT, lane]
    best: float = scratch[_WEIGHT, 0]
    for lane in range(1, _LANES):
        best = scratch[_WEIGHT, lane] if scratch[_WEIGHT, lane] > best else best
    return best


@kernel(vectorised=True)
def _sum(scratch: Array, row: int) -> float:
    """Sum of a row of the scratch array, which is overwritten."""
    for start in range(_LANES, scratch.shape[1], _LANES):
        for lane in range(_LANES):
            scratch[row, lane] += scratch[row, start + lane]
    for lane in range(8):
        scratch[row, lane] += scratch[row, lane + 8]
    for lane in range(4):
        scratch[row, lane] += scratch[row, lane + 4]
    total: float = (scratch[row, 0] + scratch[row, 1]) + (scratch[row, 2] + scratch[row, 3])
    return total


@kernel(vectorised=True, inline=True)
def boltzmann_mean(scratch: Array, rationality: float) -> float:
    """Boltzmann mean of the actions."""
    best = _best(scratch)
    for k in range(scratch.shape[1]):
        scratch[_WEIGHT, k] = exponential(rationality * (scratch[UTILITY_ROW, k] + scratch[_HANDICAP, k] - best))
    for k in range(scratch.shape[1]):
        scratch[_WEIGHTED, k] = scratch[_WEIGHT, k] * scratch[GRID_ROW, k]
    return _sum(scratch, _WEIGHTED) / _sum(scratch, _WEIGHT)


@kernel
def scratch_for(actions: Array) -> Array:
    """Return the scratch array (5, at least K) in which a driver considers the actions (K,), moment after moment.

    Rows: utilities, actions, what an action that only fills the row up is worth less, and two of scratch.
    """
    count = len(actions)
    scratch = np.zeros((5, -(-count // _LANES) * _LANES))
    scratch[GRID_ROW, :count] = actions
    scratch[GRID_ROW, count:] = actions[count - 1]
    scratch[_HANDICAP, count:] = _NEVER
    return scratch


@kernel(inline=True)
def considered_action(
    gap: float, speed: float, leader_speed: float, parameters: Array, scratch: Array, period: float, horizon: int
) -> float:
    """``mean_action`` over the actions in an array of ``scratch_for``, which may be used again and again."""
    driver = preferences(parameters)
    utilities(gap, speed, leader_speed, driver, scratch, period, horizon)
    return boltzmann_mean(scratch, driver[-1])


@kernel
def mean_action(
    gap: float, speed: float, leader_speed: float, parameters: Array, actions: Array, period: float, horizon: int
) -> float:
    """Boltzmann mean [m/s^2] of the action over the grid ``actions`` (K,); Eqs. MeanAction to PartitionFunction.

    parameters: (P,); horizon: periods of look-ahead.
    """
    return considered_action(gap, speed, leader_speed, parameters, scratch_for(actions), period, horizon)
