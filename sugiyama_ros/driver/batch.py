"""The mean actions of many drivers at many moments at once: most of the work of the causal filter.

The formulas are the formulas of ``utility``, which takes one moment at a time. Here one vector instruction works on
several moments. A moment is a slot: what one driver sees and prefers. Slots do not depend on each other, so that the
result of a slot is the same whatever stands beside it.

The reward of a speed is a Gaussian of the action, and the actions are evenly spaced. So the ratio of one reward to the
reward before changes by a constant factor, and only few rewards need an exponential. Rounding errors add up, so the
rewards begin anew after some actions.

Blocks have double precision, or single precision for screening, which takes half of the time. What all slots share is
therefore converted to the precision of the block.

A block is one array with the rows of SLOTS slots, one after the other, and then the utilities of the actions. All
places in a block are constants. Compilers then know that two rows do not overlap, and make vector instructions.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types

from sugiyama_ros.arrays import Array
from sugiyama_ros.by_address import BATCH_AT, calling, offer, type_of
from sugiyama_ros.driver.exponential import exponential, like, multiply_add
from sugiyama_ros.driver.utility import FAR, Preferences, backward_penalty
from sugiyama_ros.jit import kernel

#: Number of slots in a block. Compilers make no vector instructions of shorter loops, which they unroll.
SLOTS = 16
# Where the rows of a block begin: what the driver sees and prefers, then intermediate results.
_GAP, _SPEED, _LEADER_SPEED = 0, SLOTS, 2 * SLOTS
_V_STAR, _KAPPA_V, _KAPPA_1, _KAPPA_C, _KAPPA_D, _OMEGA_2, _RATIONALITY = (SLOTS * row for row in range(3, 10))
_NEAR, _SCALE, _UTILITY, _BEST, _BACKWARD, _PER_SPEED, _OPENING, _PARTITION, MEAN = (
    SLOTS * row for row in range(10, 19)
)
_REWARD, _GROWTH, _CURVE, _IS_STEEP, _SOON, _LATE = (SLOTS * row for row in range(19, 25))
#: Where the utilities of the actions begin, SLOTS numbers for each action.
UTILITIES = 25 * SLOTS
# Two numbers are for double and for single precision, here and below.
# Number of rewards that follow from one another before one is computed anew.
_STRETCH = 14, 4
# The reward of a speed that is more than this many widths away from the desired speed is below 1e-170, or 1e-35 in
# single precision, and no other reward can follow from it. Slots in which it occurs take the exponential for every
# action.
_STEEP = 20.0, 9.0
# Smallest cost of driving backward. Processors take their time over numbers below 1e-38 in single precision.
_FAINT = 0.0, 1e-30
# Largest cost of driving backward. With this much, drivers accelerate as strongly as they can.
_WORST = 1e8
# What an unused slot sees and prefers: nothing that takes long or overflows.
_UNUSED = (FAR, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, 1.0)


class ActionGrid(NamedTuple):
    """The actions that drivers consider, at one period.

    actions: (K,), accelerations [m/s^2], evenly spaced; backward: (K,), factor of the cost of driving backward after
    one period of each action; ``backward_penalty`` is exponential; braking: number of actions up to the last one that
    is negative.
    """

    actions: Array
    backward: Array
    braking: int


@kernel
def grid_for(actions: Array, period: float) -> ActionGrid:
    """Return the evenly spaced actions (K,) [m/s^2] that drivers consider, with what does not depend on the driver."""
    braking, exact = 0, actions.astype(np.float64)
    for k in range(len(actions)):
        if actions[k] < 0.0:
            braking = k + 1
    return ActionGrid(exact, np.exp(-10.0 * period * exact), braking)


@kernel
def blocks_for(slots: int, actions: Array) -> Array:
    """Return blocks (B, .) for at least ``slots`` slots and for actions (K,), in their precision; ready to be used."""
    blocks = np.zeros((-(-slots // SLOTS), UTILITIES + SLOTS * len(actions)), actions.dtype)
    clear(blocks)
    return blocks


@kernel(allocates=False)
def clear(blocks: Array) -> None:
    """Make all slots unused."""
    for b in range(len(blocks)):
        for row in range(len(_UNUSED)):
            for t in range(SLOTS):
                blocks[b, SLOTS * row + t] = _UNUSED[row]


@kernel(allocates=False)
def put(block: Array, slot: int, gap: float, speed: float, leader_speed: float, driver: Preferences) -> None:
    """Put what a driver sees and prefers into a slot of a block; arguments as for ``utility.utilities``."""
    block[_GAP + slot], block[_SPEED + slot], block[_LEADER_SPEED + slot] = min(gap, FAR), speed, leader_speed
    v_star, kappa_v, kappa_1, kappa_c, kappa_d, omega_2, rationality = driver
    block[_V_STAR + slot], block[_KAPPA_V + slot], block[_KAPPA_1 + slot] = v_star, kappa_v, kappa_1
    block[_KAPPA_C + slot], block[_KAPPA_D + slot] = kappa_c, kappa_d
    block[_OMEGA_2 + slot], block[_RATIONALITY + slot] = omega_2, rationality


@kernel(allocates=False)
def value_actions(block: Array, grid: ActionGrid, period: float, horizon: int) -> None:
    """Compute the effective utility of every action in every slot, and the largest; Eq. EffectiveUtilityTilde.

    block: one row of ``blocks_for``; ``put`` has filled its slots; period: length of a period [s].
    """
    actions = grid.actions
    first, last = actions[0], actions[len(actions) - 1]
    step = (last - first) / max(len(actions) - 1, 1)
    _begin(block, period, horizon, step)
    any_steep = _find_steep(block, first, last, period)
    stretch = _STRETCH[0] if block.itemsize == 8 else _STRETCH[1]
    for k in range(len(actions)):
        action = actions[k]
        _look_at_ends(block, action, period, horizon)
        # Where a driver does not brake, the gap is a concave function of the time and its scale a convex one. Their
        # ratio is then smallest at one end of the look-ahead, or not positive there, which counts as no gap.
        if k < grid.braking:
            for tau in range(2, horizon, 2):
                _look_between(block, action, period, tau, tau + 1)
        if k % stretch == 0:
            _reward(block, action, period, step)
        if any_steep:
            _reward_steep(block, action, period)
        _value(block, grid.backward[k])
        _keep(block, UTILITIES + SLOTS * k)


@kernel(vectorised=True)
def _begin(block: Array, period: float, horizon: int, step: float) -> None:
    """Compute what all actions share."""
    faint = _FAINT[0] if block.itemsize == 8 else _FAINT[1]
    for t in range(SLOTS):
        block[_BEST + t] = -np.inf
        block[_BACKWARD + t] = min(max(backward_penalty(block[_SPEED + t]), faint), _WORST)
        per_speed = 1.0 / (block[_KAPPA_1 + t] * block[_V_STAR + t])
        width = period * step * per_speed
        block[_PER_SPEED + t] = per_speed
        block[_CURVE + t] = exponential(-2.0 * width * width)
        opening = block[_LEADER_SPEED + t] - block[_SPEED + t]
        block[_OPENING + t] = opening
        block[_SOON + t] = multiply_add(period, opening, block[_GAP + t])
        block[_LATE + t] = multiply_add(period * horizon, opening, block[_GAP + t])


@kernel(vectorised=True)
def _look_at_ends(block: Array, action: float, period: float, horizon: int) -> None:
    """Find the gap and the scale with the smaller ratio: one period ahead, or ``horizon`` periods ahead."""
    one = block[0]
    way, then, later = like(_way(action, period, horizon), one), period * action, period * horizon * action
    for t in range(SLOTS):
        near, far = block[_SOON + t], block[_LATE + t] - way
        scale, wide = _scale(block, t, then), _scale(block, t, later)
        closer = far * scale < near * wide
        block[_NEAR + t] = far if closer else near
        block[_SCALE + t] = wide if closer else scale


@kernel(vectorised=True)
def _look_between(block: Array, action: float, period: float, first: int, second: int) -> None:
    """Go on with the gap and the scale with the smallest ratio, ``first`` and ``second`` periods ahead."""
    one = block[0]
    first_way, second_way = like(_way(action, period, first), one), like(_way(action, period, second), one)
    for t in range(SLOTS):
        near, scale = block[_NEAR + t], block[_SCALE + t]
        for_first = multiply_add(block[_OPENING + t], period * first, block[_GAP + t] - first_way)
        wide = _scale(block, t, period * first * action)
        closer = for_first * scale < near * wide
        near, scale = for_first if closer else near, wide if closer else scale
        for_second = multiply_add(block[_OPENING + t], period * second, block[_GAP + t] - second_way)
        wide = _scale(block, t, period * second * action)
        closer = for_second * scale < near * wide
        block[_NEAR + t] = for_second if closer else near
        block[_SCALE + t] = wide if closer else scale


@kernel(vectorised=True)
def _way(action: float, period: float, tau: int) -> float:
    """Compute the way [m] that an action adds in ``tau`` periods, by Euler's rule."""
    return period * period * action * (0.5 * tau * (tau - 1))


@kernel(vectorised=True)
def _scale(block: Array, t: int, faster: float) -> float:
    """Compute the scale [m] of the gap of slot t at a speed that is so much larger [m/s], as ``utility.gap_scale``."""
    faster = like(faster, block[0])
    speed, closing = block[_SPEED + t] + faster, faster - block[_OPENING + t]
    closing = closing if closing > 0.0 else like(0.0, closing)
    steady = multiply_add(block[_KAPPA_V + t], abs(speed), block[_KAPPA_C + t])
    return multiply_add(block[_KAPPA_D + t], closing, steady)


@kernel(vectorised=True)
def _find_steep(block: Array, first: float, last: float, period: float) -> bool:
    """Find the slots in which some rewards are too small for other rewards to follow from; whether there are any."""
    count = 0.0
    steep = _STEEP[0] if block.itemsize == 8 else _STEEP[1]
    for t in range(SLOTS):
        off = block[_SPEED + t] - block[_V_STAR + t]
        most = max(-(off + period * first), off + period * last) * block[_PER_SPEED + t]
        block[_IS_STEEP + t] = 1.0 if most > steep else 0.0
        count += block[_IS_STEEP + t]
    return count > 0.0


@kernel(vectorised=True)
def _reward(block: Array, action: float, period: float, step: float) -> None:
    """Compute the reward of the speed after one period of an action, and its ratio to the reward of the next action."""
    one = block[0]
    faster, wide = like(period * action, one), like(period * step, one)
    for t in range(SLOTS):
        off = (block[_SPEED + t] + faster - block[_V_STAR + t]) * block[_PER_SPEED + t]
        width = wide * block[_PER_SPEED + t]
        block[_REWARD + t] = exponential(-off * off)
        block[_GROWTH + t] = exponential(-width * (off + off + width))


@kernel(vectorised=True)
def _reward_steep(block: Array, action: float, period: float) -> None:
    """Compute the reward of the speed after one period of an action in the slots where it cannot follow from others."""
    faster = like(period * action, block[0])
    for t in range(SLOTS):
        off = (block[_SPEED + t] + faster - block[_V_STAR + t]) * block[_PER_SPEED + t]
        block[_REWARD + t] = exponential(-off * off) if block[_IS_STEEP + t] > 0.0 else block[_REWARD + t]


@kernel(vectorised=True)
def _value(block: Array, backward: float) -> None:
    """Compute the utility of one action in every slot, and go on to the reward of the next action."""
    for t in range(SLOTS):
        ratio = block[_NEAR + t] / block[_SCALE + t]
        # -x (x + 2), as utility.collision_penalty, with one operation less
        beyond = like(1.0, ratio) + (ratio if ratio > 0.0 else like(0.0, ratio))
        risk = exponential(multiply_add(-beyond, beyond, 1.0))
        known = multiply_add(block[_BACKWARD + t], -backward, block[_REWARD + t])
        utility = multiply_add(block[_OMEGA_2 + t], risk, known)
        block[_UTILITY + t] = utility
        block[_BEST + t] = utility if utility > block[_BEST + t] else block[_BEST + t]
        block[_REWARD + t] *= block[_GROWTH + t]
        block[_GROWTH + t] *= block[_CURVE + t]


@kernel(vectorised=True)
def _keep(block: Array, at: int) -> None:
    """Copy the utilities of one action to their place."""
    for t in range(SLOTS):
        block[at + t] = block[_UTILITY + t]


@kernel(vectorised=True)
def find_best(block: Array, actions: int) -> None:
    """Find the largest utility again, after something was added to utilities of the ``actions`` actions."""
    for t in range(SLOTS):
        block[_BEST + t] = -np.inf
    for k in range(actions):
        at = UTILITIES + SLOTS * k
        for t in range(SLOTS):
            block[_BEST + t] = block[at + t] if block[at + t] > block[_BEST + t] else block[_BEST + t]


@kernel(vectorised=True)
def average_actions(block: Array, actions: Array) -> None:
    """Compute the Boltzmann mean of the actions (K,) [m/s^2] in every slot, at ``MEAN``; Eq. MeanAction."""
    for t in range(SLOTS):
        block[_PARTITION + t] = block[MEAN + t] = 0.0
    for k in range(len(actions)):
        at = UTILITIES + SLOTS * k
        for t in range(SLOTS):
            weight = exponential(block[_RATIONALITY + t] * (block[at + t] - block[_BEST + t]))
            block[_PARTITION + t] += weight
            block[MEAN + t] = multiply_add(weight, actions[k], block[MEAN + t])
    for t in range(SLOTS):
        block[MEAN + t] /= block[_PARTITION + t]


@kernel(allocates=False)
def conclude_actions(block: Array, actions: Array, changed: bool) -> None:
    """Call ``average_actions``, and ``find_best`` before it where something was added to utilities: ``changed``."""
    if changed:
        find_best(block, len(actions))
    average_actions(block, actions)


# Both filters call these functions by their address, in either precision: they are half of a filter's code.
_VALUE, _VALUE_ROUGH, _CONCLUDE, _CONCLUDE_ROUGH = range(BATCH_AT, BATCH_AT + 4)
_numbers, _roughly = types.float64[::1], types.float32[::1]
_grid: Any = type_of(ActionGrid(np.zeros(1), np.zeros(1), 0))
_of_value, _call_value = calling(types.void, _numbers, _grid, types.float64, types.int64)
_of_value_rough, _call_value_rough = calling(types.void, _roughly, _grid, types.float64, types.int64)
_of_conclude, _call_conclude = calling(types.void, _numbers, _numbers, types.boolean)
_of_conclude_rough, _call_conclude_rough = calling(types.void, _roughly, _numbers, types.boolean)
offer(_VALUE, lambda: value_actions, _of_value)
offer(_VALUE_ROUGH, lambda: value_actions, _of_value_rough)
offer(_CONCLUDE, lambda: conclude_actions, _of_conclude)
offer(_CONCLUDE_ROUGH, lambda: conclude_actions, _of_conclude_rough)


class Batch(NamedTuple):
    """Where drivers consider their actions.

    blocks, rough: blocks in double precision, and in single precision; one of them has length 0; grid: the actions;
    added: (K,), overwritten.
    """

    blocks: Array
    rough: Any
    grid: ActionGrid
    added: Array


@kernel
def batch_for(slots: int, actions: Array, period: float, is_rough: bool) -> Batch:
    """Return slots for actions (K,) [m/s^2], in double precision, or in single precision if ``is_rough``."""
    blocks = blocks_for(0 if is_rough else slots, actions)
    rough = blocks_for(slots if is_rough else 0, actions.astype(np.float32))
    return Batch(blocks, rough, grid_for(actions, period), np.zeros(len(actions)))


@kernel(allocates=False)
def put_into(batch: Batch, k: int, gap: float, speed: float, leader_speed: float, driver: Preferences) -> None:
    """Put what a driver sees and prefers into slot k; the other arguments as for ``put``."""
    if len(batch.blocks) > 0:
        put(batch.blocks[k // SLOTS], k % SLOTS, gap, speed, leader_speed, driver)
    else:
        put(batch.rough[k // SLOTS], k % SLOTS, gap, speed, leader_speed, driver)


@kernel(allocates=False)
def consider(used: int, period: float, horizon: int, batch: Batch) -> None:
    """Let the drivers in the first ``used`` slots value their actions."""
    for b in range(-(-used // SLOTS)):
        if len(batch.blocks) > 0:
            _call_value(_VALUE, batch.blocks[b], batch.grid, period, horizon)
        else:
            _call_value_rough(_VALUE_ROUGH, batch.rough[b], batch.grid, period, horizon)


@kernel(allocates=False)
def decide(used: int, batch: Batch, changed: bool) -> None:
    """Let the drivers in the first ``used`` slots decide on the mean of their actions.

    changed: whether something was added to the utilities after ``consider``.
    """
    for b in range(-(-used // SLOTS)):
        if len(batch.blocks) > 0:
            _call_conclude(_CONCLUDE, batch.blocks[b], batch.grid.actions, changed)
        else:
            _call_conclude_rough(_CONCLUDE_ROUGH, batch.rough[b], batch.grid.actions, changed)


@kernel(allocates=False)
def mean_in(batch: Batch, k: int) -> float:
    """Return the mean action [m/s^2] in slot k, after ``decide``."""
    if len(batch.blocks) > 0:
        return float(batch.blocks[k // SLOTS, MEAN + k % SLOTS])
    return float(batch.rough[k // SLOTS, MEAN + k % SLOTS])
