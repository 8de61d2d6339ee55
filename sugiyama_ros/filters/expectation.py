"""The expected action of a driver in a chain, over everything that the driver may be seeing, and its regressions.

The mean action is linearised statistically: its Jacobian at a point would make an extended Kalman filter whose
likelihood is chaotic, because the mean action jumps close to contact.

These functions run for every driver and sample. They make no arrays.
"""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import RHO, UTILITY
from sugiyama_ros.effects.control import expect_change, feels_accelerations, intend, remembers
from sugiyama_ros.effects.effect import Seen
from sugiyama_ros.filters.state import MOVING, STATE, Drivers, Moment, Scene, State, Workspace
from sugiyama_ros.jit import kernel

# Variance below which a direction of what the driver sees counts as known; keeps the Cholesky factor invertible.
_KNOWN_VAR = 1e-12


class Expected(NamedTuple):
    """Expectations of an action [m/s^2], and the variances [m^2/s^4] that their regressions on the state leave.

    held: what the driver holds; action: the same with what the environment adds; held_var, action_var: of both.
    """

    held: float
    action: float
    held_var: float
    action_var: float


@kernel(allocates=False)
def _look(m: int, led: bool, delayed: bool, vehicles: int, adapted: int, places: Ints) -> int:
    """Fill in what the action of driver m depends on, and return the number of these quantities.

    Each is an entry of the state less another one. places: (2, at least 5 + A), the entry to add and the entry to take
    off, or -1. The quantities are the gap (without lengths), the own and the leader's speed, or the own speed alone
    where there is no leader. A driver with a reaction delay also depends on the noises of both, which are part of the
    accelerations. Then follow the logarithms of the adapted parameters.
    """
    x, v = STATE * m, STATE * m + 1
    seen = (5 if delayed else 3) if led else 1
    places[1] = -1
    if led:
        places[0, 0], places[0, 1], places[0, 2], places[1, 0] = x + STATE, v, v + STATE, x
        if delayed:
            places[0, 3], places[0, 4] = x + 2, x + STATE + 2
    else:
        places[0, 0] = v
    for k in range(adapted):
        places[0, seen + k] = STATE * vehicles + k
    return seen + adapted


@kernel(allocates=False)
def _root(covariance: Array, places: Ints, size: int, root: Array) -> None:
    """Fill in the lower Cholesky factor of the covariance of the quantities in ``places`` of ``_look``."""
    for i in range(size):
        plus, minus = places[0, i], places[1, i]
        for j in range(i + 1):
            entry = covariance[plus, places[0, j]]
            if minus >= 0:
                entry -= covariance[minus, places[0, j]]
            if places[1, j] >= 0:
                entry -= covariance[plus, places[1, j]]
            if minus >= 0 and places[1, j] >= 0:
                entry += covariance[minus, places[1, j]]
            for k in range(j):
                entry -= root[i, k] * root[j, k]
            root[i, j] = math.sqrt(max(entry, _KNOWN_VAR)) if i == j else entry / root[j, j]
        for j in range(i + 1, size):
            root[i, j] = 0.0


@kernel(allocates=False)
def _regress(work: Array, row: int, places: Ints, size: int, slope: Array) -> None:
    """Fill in the regression of an action on the state.

    work: the root, and in ``row`` what the action shares with each column of the root; that row is overwritten.
    """
    # The action and the quantities have the covariance root @ cross, the quantities root @ root.T.
    slope[:] = 0.0
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            work[row, i] -= work[k, i] * work[row, k]
        work[row, i] /= work[i, i]
        slope[places[0, i]] += work[row, i]
        if places[1, i] >= 0:
            slope[places[1, i]] -= work[row, i]


@kernel(allocates=False)
def _variance_along(slope: Array, covariance: Array) -> float:
    """Return the variance of a quantity that changes with the state by ``slope``."""
    variance = 0.0
    for i in range(len(slope)):
        for j in range(len(slope)):
            variance += slope[i] * covariance[i, j] * slope[j]
    return variance


@kernel(allocates=False)
def _surroundings(m: int, state: State, parameters: Array, moment: Moment, scene: Scene) -> Seen:
    """Return what driver m of a chain sees at the mean of the state."""
    mean, known, length, rear = state.mean, state.known, moment.length, moment.rear
    last = len(known) - 1
    x = STATE * m
    gap, leader_speed, leader_acceleration = np.inf, 0.0, 0.0
    second_gap, second_speed, rear_gap, rear_speed = np.inf, 0.0, np.inf, 0.0
    if m < last and known[m + 1] == MOVING:
        gap = mean[x + STATE] - mean[x] - 0.5 * (length[m] + length[m + 1])
        leader_speed = mean[x + STATE + 1]
        rho = parameters[m + 1, RHO] if m + 1 < last else scene.last_rho
        leader_acceleration = mean[x + STATE + 3] + rho * mean[x + STATE + 2]
        if m + 1 < last and known[m + 2] == MOVING:
            second_gap = mean[x + 2 * STATE] - mean[x + STATE] - 0.5 * (length[m + 1] + length[m + 2])
            second_speed = mean[x + 2 * STATE + 1]
    if m > 0:
        if known[m - 1] == MOVING:
            rear_gap = mean[x] - mean[x - STATE] - 0.5 * (length[m] + length[m - 1])
            rear_speed = mean[x - STATE + 1]
    elif not math.isnan(rear[0]):
        headway = mean[x] - rear[0]
        if scene.circumference_m > 0.0:
            headway -= scene.circumference_m * math.floor(headway / scene.circumference_m)
        rear_gap, rear_speed = headway - 0.5 * (length[m] + rear[2]), rear[1]
    return Seen(
        gap=gap,
        speed=mean[x + 1],
        leader_speed=leader_speed,
        position=mean[x],
        time=moment.time_s,
        circumference=scene.circumference_m,
        acceleration=mean[x + 3] + parameters[m, RHO] * mean[x + 2],
        leader_acceleration=leader_acceleration,
        second_gap=second_gap,
        second_speed=second_speed,
        rear_gap=rear_gap,
        rear_speed=rear_speed,
    )


@kernel(allocates=False)
def expected_action(
    m: int, state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace
) -> Expected:
    """Return the expected action of driver m of a chain.

    The expectation runs over the gap, the speeds and the adapted parameters. What the driver takes from elsewhere (the
    vehicle behind, the second vehicle ahead) enters with its mean, and so do the accelerations, unless the driver has a
    reaction delay.

    Parameters
    ----------
    m
        Number of the driver in the chain, not the last one.
    state, drivers, moment, scene
        The chain. The adapted entries of row m are changed on the way and restored.
    workspace
        Its ``slope`` and ``held_slope`` take the regressions of ``action`` and ``held`` on the state.

    Returns
    -------
    Expected
        Expectations [m/s^2] and the variances that the regressions leave.

    References
    ----------
    I. Arasaratnam and S. Haykin, Cubature Kalman Filters, IEEE Trans. Automatic Control 54 (2009) 1254.
    """
    mean, known, parameters = state.mean, state.known, drivers.parameters
    adapted = drivers.adapted if m == 0 else drivers.adapted[:0]
    places, work = workspace.places, workspace.root
    led = known[m + 1] == MOVING
    driver = parameters[m]
    delayed = led and feels_accelerations(driver)
    size = _look(m, led, delayed, len(known), len(adapted), places)
    # the root, and below it rows of their own
    centre, look, cross, held_cross = size, size + 1, size + 2, size + 3
    _root(state.covariance, places, size, work)
    for i in range(size):
        work[centre, i] = mean[places[0, i]]
        work[cross, i] = work[held_cross, i] = 0.0
    here = _surroundings(m, state, parameters, moment, scene)
    if led:
        work[centre, 0] = here.gap
    total, squares, held_total, held_squares = 0.0, 0.0, 0.0, 0.0
    first_adapted = size - len(adapted)
    leader_rho = parameters[m + 1, RHO] if m + 2 < len(known) else scene.last_rho
    for j in range(size):
        for side in (math.sqrt(size), -math.sqrt(size)):
            for i in range(size):
                work[look, i] = work[centre, i] + side * work[i, j]
            for k in range(len(adapted)):
                driver[UTILITY[adapted[k]]] = math.exp(work[look, first_adapted + k])
            seen = _seen_at(here, work, centre, led, delayed, driver[RHO], leader_rho)
            held, pushed = intend(seen, driver, workspace.scratch, scene.period_s, scene.horizon)
            action = held + pushed
            total += action
            squares += action * action
            work[cross, j] += action * side
            held_total += held
            held_squares += held * held
            work[held_cross, j] += held * side
    for k in range(len(adapted)):
        driver[UTILITY[adapted[k]]] = math.exp(mean[STATE * len(known) + k])
    weight = 0.5 / size
    expected, held_expected = weight * total, weight * held_total
    explained, held_explained = 0.0, 0.0
    for j in range(size):
        work[cross, j] *= weight
        work[held_cross, j] *= weight
        explained += work[cross, j] ** 2
        held_explained += work[held_cross, j] ** 2
    spread = max(weight * squares - expected * expected - explained, 0.0)
    held_spread = max(weight * held_squares - held_expected * held_expected - held_explained, 0.0)
    _regress(work, cross, places, size, workspace.slope)
    _regress(work, held_cross, places, size, workspace.held_slope)
    meant = Expected(held_expected, expected, held_spread, spread)
    return _carried_out(m, meant, state, driver, scene.period_s, workspace) if remembers(driver) else meant


@kernel(allocates=False)
def _seen_at(here: Seen, work: Array, centre: int, led: bool, delayed: bool, rho: float, leader_rho: float) -> Seen:
    """Return what the driver sees at one point of the cubature, which stands in the row below ``centre``."""
    look = centre + 1
    if led:
        gap, speed, leader_speed = work[look, 0], work[look, 1], work[look, 2]
    else:
        gap, speed, leader_speed = np.inf, work[look, 0], 0.0
    acceleration, leader_acceleration = here.acceleration, here.leader_acceleration
    if delayed:
        acceleration += rho * (work[look, 3] - work[centre, 3])
        leader_acceleration += leader_rho * (work[look, 4] - work[centre, 4])
    return Seen(
        gap=gap,
        speed=speed,
        leader_speed=leader_speed,
        position=here.position,
        time=here.time,
        circumference=here.circumference,
        acceleration=acceleration,
        leader_acceleration=leader_acceleration,
        second_gap=here.second_gap,
        second_speed=here.second_speed,
        rear_gap=here.rear_gap,
        rear_speed=here.rear_speed,
    )


@kernel(allocates=False)
def _carried_out(m: int, meant: Expected, state: State, row: Array, period: float, workspace: Workspace) -> Expected:
    """Return what driver m carries out, who means ``meant`` and remembers what was held in the last period.

    The regressions in the workspace change with it. What the environment adds does not depend on the memory.
    """
    slope, held_slope = workspace.slope, workspace.held_slope
    pushed, pushed_var = meant.action - meant.held, max(meant.action_var - meant.held_var, 0.0)
    slope -= held_slope
    held = STATE * m + 3
    held_slope[held] -= 1.0
    variance: float = max(_variance_along(held_slope, state.covariance) + meant.held_var, _KNOWN_VAR)
    change, share, left = expect_change(meant.held - state.mean[held], variance, row, period)
    held_slope *= share
    held_slope[held] += 1.0
    slope += held_slope
    expected, held_var = state.mean[held] + change, share * share * meant.held_var + left
    return Expected(expected, expected + pushed, held_var, held_var + pushed_var)
