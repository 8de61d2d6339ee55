"""The mean actions of many drivers at many moments at once: most of the work of the causal filter.

The formulas are the formulas of ``utility``, which takes one moment at a time. Here one vector instruction works on
several moments. A moment is a lane: what one driver sees and prefers. Lanes do not depend on each other, so that the
result of a lane is the same whatever stands beside it.

A block is one array with the rows of LANES lanes, one after the other, and then the utilities of the actions. All
places in a block are constants. Compilers then know that two rows do not overlap, and make vector instructions.
"""

from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.exponential import exponential
from sugiyama_ros.driver.utility import FAR, Preferences, backward_penalty, collision_penalty, gap_scale
from sugiyama_ros.jit import kernel

#: Number of lanes in a block. Compilers make no vector instructions of shorter loops, which they unroll.
LANES = 16
# Where the rows of a block begin: what the driver sees and prefers, then intermediate results.
_GAP, _SPEED, _LEADER_SPEED = 0, LANES, 2 * LANES
_V_STAR, _KAPPA_V, _KAPPA_1, _KAPPA_C, _KAPPA_D, _OMEGA_2, _RATIONALITY = (LANES * row for row in range(3, 10))
_NEAR, _SCALE, _UTILITY, _BEST, _BACKWARD, _PER_SPEED, _OPENING, _PARTITION, MEAN = (
    LANES * row for row in range(10, 19)
)
#: Where the utilities of the actions begin, LANES numbers for each action.
UTILITIES = 19 * LANES
# What an unused lane sees and prefers: nothing that takes long or overflows.
_UNUSED = (FAR, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, 1.0)


class ActionGrid(NamedTuple):
    """The actions that drivers consider, at one period.

    Parameters
    ----------
    actions : ndarray, shape (K,)
        Accelerations [m/s^2].
    backward : ndarray, shape (K,)
        Factor of the cost of driving backward after one period of each action; ``backward_penalty`` is exponential.
    braking : int
        Number of actions up to the last one that is negative.
    """

    actions: Array
    backward: Array
    braking: int


@kernel
def grid_for(actions: Array, period: float) -> ActionGrid:
    """Return the actions (K,) [m/s^2] that drivers consider, with what does not depend on the driver."""
    braking = 0
    for k in range(len(actions)):
        if actions[k] < 0.0:
            braking = k + 1
    return ActionGrid(actions, np.exp(-10.0 * period * actions), braking)


@kernel
def blocks_for(lanes: int, actions: int) -> Array:
    """Return blocks for at least ``lanes`` lanes and for ``actions`` actions, ready to be used; 2-dimensional."""
    blocks = np.zeros((-(-lanes // LANES), UTILITIES + LANES * actions))
    clear(blocks)
    return blocks


@kernel(allocates=False)
def clear(blocks: Array) -> None:
    """Make all lanes unused."""
    for b in range(len(blocks)):
        for row in range(len(_UNUSED)):
            for t in range(LANES):
                blocks[b, LANES * row + t] = _UNUSED[row]


@kernel(allocates=False)
def put(block: Array, lane: int, gap: float, speed: float, leader_speed: float, driver: Preferences) -> None:
    """Put what a driver sees and prefers into a lane of a block; arguments as for ``utility.utilities``."""
    block[_GAP + lane], block[_SPEED + lane], block[_LEADER_SPEED + lane] = min(gap, FAR), speed, leader_speed
    v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality = driver
    block[_V_STAR + lane], block[_KAPPA_V + lane], block[_KAPPA_1 + lane] = v_star, kappa_v, kappa_1
    block[_KAPPA_C + lane], block[_KAPPA_D + lane] = kappa_c, kappa_d
    block[_OMEGA_2 + lane], block[_RATIONALITY + lane] = omega_2, rationality


@kernel(allocates=False)
def value_actions(block: Array, grid: ActionGrid, period: float, horizon: int) -> None:
    """Compute the effective utility of every action in every lane, and the largest; Eq. EffectiveUtilityTilde.

    Parameters
    ----------
    block : ndarray
        One row of ``blocks_for``; ``put`` has filled its lanes.
    grid : ActionGrid
        The actions.
    period : float
        Length of a period [s].
    horizon : int
        Periods of look-ahead.
    """
    _begin(block)
    for k in range(len(grid.actions)):
        action = grid.actions[k]
        _look_at_ends(block, action, period, horizon)
        # Where a driver does not brake, the gap is a concave function of the time and its scale a convex one. Their
        # ratio is then smallest at one end of the look-ahead, or not positive there, which counts as no gap.
        if k < grid.braking:
            for tau in range(2, horizon, 2):
                _look_between(block, action, period, tau, tau + 1)
        _value(block, action, period, grid.backward[k])
        _keep(block, UTILITIES + LANES * k)


@kernel(vectorised=True)
def _begin(block: Array) -> None:
    """Compute what all actions share."""
    for t in range(LANES):
        block[_BEST + t] = -np.inf
        block[_BACKWARD + t] = backward_penalty(block[_SPEED + t])
        block[_PER_SPEED + t] = 1.0 / (block[_KAPPA_1 + t] * block[_V_STAR + t])
        block[_OPENING + t] = block[_LEADER_SPEED + t] - block[_SPEED + t]


@kernel(vectorised=True)
def _look_at_ends(block: Array, action: float, period: float, horizon: int) -> None:
    """Find the gap and the scale with the smaller ratio: one period ahead, or ``horizon`` periods ahead."""
    for t in range(LANES):
        near, scale = _ahead(block, t, action, period, 1)
        far, wide = _ahead(block, t, action, period, horizon)
        closer = far * scale < near * wide
        block[_NEAR + t] = far if closer else near
        block[_SCALE + t] = wide if closer else scale


@kernel(vectorised=True)
def _look_between(block: Array, action: float, period: float, first: int, second: int) -> None:
    """Go on with the gap and the scale with the smallest ratio, ``first`` and ``second`` periods ahead."""
    for t in range(LANES):
        near, scale = block[_NEAR + t], block[_SCALE + t]
        for_first, wide = _ahead(block, t, action, period, first)
        closer = for_first * scale < near * wide
        near, scale = for_first if closer else near, wide if closer else scale
        for_second, wide = _ahead(block, t, action, period, second)
        closer = for_second * scale < near * wide
        block[_NEAR + t] = for_second if closer else near
        block[_SCALE + t] = wide if closer else scale


@kernel(vectorised=True)
def _ahead(block: Array, t: int, action: float, period: float, tau: int) -> tuple[float, float]:
    """Compute the gap [m] of lane t and its scale [m] ``tau`` periods ahead, as ``utility.gap_and_scale`` does."""
    speed, leader_speed = block[_SPEED + t] + period * tau * action, block[_LEADER_SPEED + t]
    scale = gap_scale(speed, leader_speed, block[_KAPPA_C + t], block[_KAPPA_V + t], block[_KAPPA_D + t])
    way = period * period * action * (0.5 * tau * (tau - 1))
    return block[_GAP + t] + period * tau * block[_OPENING + t] - way, scale


@kernel(vectorised=True)
def _value(block: Array, action: float, period: float, backward: float) -> None:
    """Compute the utility of one action in every lane."""
    for t in range(LANES):
        short = (block[_SPEED + t] + period * action - block[_V_STAR + t]) * block[_PER_SPEED + t]
        risk = collision_penalty(block[_NEAR + t] / block[_SCALE + t])
        utility = exponential(-short * short) + block[_OMEGA_2 + t] * risk - block[_BACKWARD + t] * backward
        block[_UTILITY + t] = utility
        block[_BEST + t] = utility if utility > block[_BEST + t] else block[_BEST + t]


@kernel(vectorised=True)
def _keep(block: Array, at: int) -> None:
    """Copy the utilities of one action to their place."""
    for t in range(LANES):
        block[at + t] = block[_UTILITY + t]


@kernel(allocates=False)
def find_best(block: Array, actions: int) -> None:
    """Find the largest utility again, after something was added to utilities of the ``actions`` actions."""
    for t in range(LANES):
        block[_BEST + t] = -np.inf
    for k in range(actions):
        for t in range(LANES):
            block[_BEST + t] = max(block[_BEST + t], block[UTILITIES + LANES * k + t])


@kernel(vectorised=True)
def average_actions(block: Array, actions: Array) -> None:
    """Compute the Boltzmann mean of the actions (K,) [m/s^2] in every lane, at ``MEAN``; Eq. MeanAction."""
    for t in range(LANES):
        block[_PARTITION + t] = block[MEAN + t] = 0.0
    for k in range(len(actions)):
        at = UTILITIES + LANES * k
        for t in range(LANES):
            weight = exponential(block[_RATIONALITY + t] * (block[at + t] - block[_BEST + t]))
            block[_PARTITION + t] += weight
            block[MEAN + t] += weight * actions[k]
    for t in range(LANES):
        block[MEAN + t] /= block[_PARTITION + t]
