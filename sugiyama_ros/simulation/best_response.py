"""Two lanes that become one: what drivers do if each responds to what the others do (betaNash).

In adaptiveSeek a driver assumes that all others keep their speed. In betaNash the actions are an equilibrium: each is
the best response to the actions of the others. Drivers of different lanes meet behind the merge point. Each sees the
other there as a leader, or as a follower, with the roles exchanged. On one lane a driver sees the vehicles ahead alone.
Then no action depends on the action of a vehicle behind, and there is nothing to bargain.

References
----------
Dai et al., arXiv 2009.12213 (2020), for best responses; the equations of the merge are this package's.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON, REFERENCE_PERIOD_S
from sugiyama_ros.driver.utility import (
    ACTIONS,
    FAR,
    GRID_ROW,
    UTILITY_ROW,
    Preferences,
    backward_penalty,
    boltzmann_mean,
    collision_penalty,
    forward_reward,
    gap_scale,
    preferences,
    scratch_for,
)
from sugiyama_ros.errors import InputError
from sugiyama_ros.jit import kernel

#: Share of the way to the best response that a round goes.
BETA = 0.5
#: Largest difference [m/s^2] from the best response in an equilibrium, and rounds after which the search ends.
TOLERANCE, ROUNDS = 0.01, 50
# Equilibria whose actions [m/s^2] differ by less than the actions that drivers consider are one equilibrium.
_SAME = float(ACTIONS[1] - ACTIONS[0])
# A driver looks at most this many times the usual look-ahead as far as the merge.
_FURTHEST = 3


class Merge(NamedTuple):
    """N drivers on two lanes that become one at position 0.

    Parameters
    ----------
    position_m : ndarray, shape (N,)
        Positions [m] of the centres along the common path; negative before the merge point.
    speed : ndarray, shape (N,)
        Speeds [m/s].
    length_m : ndarray, shape (N,)
        Lengths [m].
    is_blocked : ndarray of int, shape (N,)
        1 on the lane with the barrier, 0 on the open lane.
    parameters : ndarray, shape (N, P)
        Parameters of the drivers, at the reference period.
    """

    position_m: Array
    speed: Array
    length_m: Array
    is_blocked: Ints
    parameters: Array


class Equilibrium(NamedTuple):
    """Actions to which rounds of best responses lead.

    Parameters
    ----------
    actions : ndarray, shape (N,)
        Accelerations [m/s^2].
    residual : float
        Largest difference [m/s^2] between an action and the best response to the others.
    rounds : int
        Rounds that were needed.
    is_cycle : bool
        Whether the actions came back to those of an earlier round, so that no round leads to an equilibrium.
    """

    actions: Array
    residual: float
    rounds: int
    is_cycle: bool


class _Other(NamedTuple):
    """Another vehicle: its lead [m] from centre to centre, speed, action, and the first period in which it counts.

    room_m: distance of the centres [m] at contact; is_follower: whether it counts as a follower, too.
    """

    lead_m: float
    speed: float
    action: float
    room_m: float
    first: int
    is_follower: bool


@kernel
def _ratio(action: float, speed: float, other: _Other, driver: Preferences, period: float, horizon: int) -> float:
    """Compute the smallest ratio of the gap to its scale in the look-ahead; both stop rather than drive backward."""
    _, kappa_v, _, kappa_c, kappa_d, _, _ = driver
    lead, own, theirs, least = other.lead_m, speed, other.speed, FAR
    for tau in range(1, other.first + horizon):
        lead += period * (theirs - own)
        own, theirs = max(own + period * action, 0.0), max(theirs + period * other.action, 0.0)
        if tau < other.first:
            continue
        if lead > 0.0:
            least = min(least, (lead - other.room_m) / gap_scale(own, theirs, kappa_c, kappa_v, kappa_d))
        elif other.is_follower:
            least = min(least, (-lead - other.room_m) / gap_scale(theirs, own, kappa_c, kappa_v, kappa_d))
    return least


@kernel
def _first_period(merge: Merge, i: int, j: int, period: float, horizon: int) -> int:
    """Return the first period in which two vehicles share a lane, if the one on the blocked lane keeps the speed."""
    if merge.is_blocked[i] == merge.is_blocked[j]:
        return 1
    k = i if merge.is_blocked[i] == 1 else j
    furthest = _FURTHEST * horizon
    reach = max(merge.speed[k], 0.0) * period * furthest
    if -merge.position_m[k] >= reach:
        return furthest
    return max(1, int(np.ceil(-merge.position_m[k] / (max(merge.speed[k], 1e-9) * period))))


@kernel
def respond(merge: Merge, actions: Array, grid: Array, period: float, horizon: int) -> Array:
    """Compute the best responses (N,) [m/s^2]: each driver's mean action if the others hold ``actions`` (N,)."""
    scratch = scratch_for(grid)
    best = np.empty(len(actions))
    for i in range(len(actions)):
        driver = preferences(merge.parameters[i])
        v_star, _, kappa_1, _, _, omega_2, rationality = driver
        speed = merge.speed[i]
        for k in range(scratch.shape[1]):
            action = scratch[GRID_ROW, k]
            least = FAR
            for j in range(len(actions)):
                lead, is_other_lane = (
                    merge.position_m[j] - merge.position_m[i],
                    merge.is_blocked[i] != merge.is_blocked[j],
                )
                if j == i or (lead <= 0.0 and not is_other_lane):
                    continue
                first = _first_period(merge, i, j, period, horizon)
                room = 0.5 * (merge.length_m[i] + merge.length_m[j])
                other = _Other(lead, merge.speed[j], actions[j], room, first, is_other_lane)
                least = min(least, _ratio(action, speed, other, driver, period, horizon))
            then = speed + period * action
            scratch[UTILITY_ROW, k] = forward_reward(then, v_star, kappa_1) - backward_penalty(then)
            scratch[UTILITY_ROW, k] += omega_2 * collision_penalty(least)
        best[i] = boltzmann_mean(scratch, rationality)
    return best


@kernel
def _seek(
    merge: Merge, start: Array, grid: Array, period: float, horizon: int, beta: float, rounds: int
) -> tuple[Array, float, int, bool]:
    """Respond, round after round; the fields of `Equilibrium`."""
    actions, history, residual, is_cycle = start.copy(), np.empty((rounds + 1, len(start))), np.inf, False
    for m in range(rounds + 1):
        best = respond(merge, actions, grid, period, horizon)
        residual = np.max(np.abs(best - actions))
        if residual <= TOLERANCE:
            return actions, residual, m, False
        for earlier in range(m - 1):
            is_cycle = is_cycle or np.max(np.abs(history[earlier] - actions)) <= TOLERANCE
        history[m] = actions
        if m < rounds:
            actions = (1.0 - beta) * actions + beta * best
    return actions, residual, rounds, is_cycle


def keep_speed(merge: Merge) -> Array:
    """Compute what adaptiveSeek does, shape (N,) [m/s^2]: the responses if all others keep their speeds."""
    return respond(merge, np.zeros(len(merge.speed)), ACTIONS, REFERENCE_PERIOD_S, REFERENCE_HORIZON)


def best_response(merge: Merge, start: Array | None = None, beta: float = BETA, rounds: int = ROUNDS) -> Equilibrium:
    """Find an equilibrium by rounds of best responses.

    Each round goes the share ``beta`` of the way to the best responses: a <- (1 - beta) a + beta abar(. | others' a).

    Parameters
    ----------
    merge : Merge
        The drivers.
    start : ndarray, shape (N,), optional
        Accelerations [m/s^2] at which the rounds begin; 0 if left out, as adaptiveSeek assumes of others.
    beta : float
        Share of the way to the best responses, above 0, at most 1.
    rounds : int
        Rounds after which the search ends.

    Returns
    -------
    Equilibrium
        The actions, whose residual is at most `TOLERANCE` if they are an equilibrium.

    Raises
    ------
    InputError
        For a share outside of its bounds.

    References
    ----------
    Dai et al., arXiv 2009.12213 (2020).

    Examples
    --------
    >>> import numpy as np
    >>> from sugiyama_ros.driver.parameters import defaults
    >>> place, alike = np.array([-20.0, -23.0]), np.full(2, 8.0)
    >>> merge = Merge(place, alike, np.full(2, 4.33), np.array([0, 1]), defaults(2))
    >>> found = best_response(merge)
    >>> bool(found.residual < 0.01), bool(found.actions[0] > found.actions[1])
    (True, True)
    """
    if not 0.0 < beta <= 1.0:
        raise InputError(f"best response: beta = {beta:g} is out of bounds; give more than 0, and at most 1")
    begin = np.zeros(len(merge.speed)) if start is None else np.asarray(start, dtype=np.float64)
    return Equilibrium(*_seek(merge, begin, ACTIONS, REFERENCE_PERIOD_S, REFERENCE_HORIZON, beta, rounds))


def equilibria(merge: Merge) -> tuple[Equilibrium, ...]:
    """Find equilibria from five starts.

    The starts are: all keep the speed, all brake, all accelerate, and one lane brakes while the other one accelerates,
    both ways round.
    """
    brake, accelerate = float(ACTIONS[0]), float(ACTIONS[-1])
    alike = (np.full(len(merge.speed), action) for action in (0.0, brake, accelerate))
    mixed = (np.where(merge.is_blocked == lane, brake, accelerate) for lane in (0, 1))
    return tuple(best_response(merge, start) for start in (*alike, *mixed))


def chosen(found: Sequence[Equilibrium]) -> Equilibrium:
    """Return the first equilibrium of those found; what comes nearest to one where none was found."""
    return next((one for one in found if one.residual <= TOLERANCE), min(found, key=lambda one: one.residual))


def distinct(found: Sequence[Equilibrium]) -> int:
    """Count the different equilibria among those found; actions that are no equilibrium do not count."""
    kept: list[Array] = []
    for one in found:
        if one.residual <= TOLERANCE and all(np.max(np.abs(one.actions - other)) >= _SAME for other in kept):
            kept.append(one.actions)
    return len(kept)
