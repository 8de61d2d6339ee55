"""The past in the state of a chain, for drivers who act on what they saw some time ago.

After the vehicles and the adapted parameters, the state then holds what each driver recalls (gap without lengths, own
speed, leader's speed), and below this what there was one period ago, two periods ago, and so on: the gaps of all
drivers and the speeds of all vehicles. The past is therefore as uncertain as it is, and every measurement improves it:
a fixed-lag smoother (B. D. O. Anderson and J. B. Moore, Optimal Filtering (1979), section 7.3). What a driver recalls
lies on a straight line between two periods.
"""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects.control import LOOKING_BACK, looks_back
from sugiyama_ros.filters.state import MOVING, STATE, Drivers, Linearised, State
from sugiyama_ros.jit import kernel

# What a driver recalls: gap, own speed, leader's speed.
_RECALLED = 3


def periods_back(rows: Array, period_s: float) -> int:
    """Return the largest number of periods that the drivers of rows (..., WIDTH) look back."""
    return math.ceil(float(rows[..., LOOKING_BACK].max(initial=0.0)) / period_s)


@kernel
def entries_of_past(vehicles: int, periods: int) -> int:
    """Return how many entries a number of periods adds to the state of a chain of M ``vehicles``."""
    return _RECALLED * (vehicles - 1) + periods * (2 * vehicles - 1) if periods > 0 else 0


@kernel(allocates=False)
def _first(state: State, drivers: Drivers) -> int:
    """Return the first entry of the past; the size of the state if it holds none."""
    return STATE * len(state.known) + len(drivers.adapted)


@kernel(allocates=False)
def recalled_at(m: int, state: State, drivers: Drivers) -> int:
    """Return the first entry of what driver m recalls; -1 if they see what there is now.

    A driver without a leader, and every driver whose chain holds no past, sees what there is now.
    """
    first = _first(state, drivers)
    if first == len(state.mean) or state.known[m + 1] != MOVING or looks_back(drivers.parameters[m]) == 0.0:
        return -1
    return first + _RECALLED * m


@kernel(allocates=False)
def _then(what: int, ago: int, state: State, first: int) -> tuple[int, int]:
    """Return the entry to add and the entry to take off, or -1, for a quantity some periods ago.

    what: m for the gap of driver m, M - 1 + m for the speed of vehicle m.
    """
    vehicles = len(state.known)
    if ago > 0:
        return first + _RECALLED * (vehicles - 1) + (ago - 1) * (2 * vehicles - 1) + what, -1
    if what < vehicles - 1:
        return STATE * (what + 1), STATE * what
    return STATE * (what - vehicles + 1) + 1, -1


@kernel(allocates=False)
def _combine(into: int, state: State, now: tuple[int, int], before: tuple[int, int], share: float) -> None:
    """Make an entry of the state a point on the line from ``now`` to ``before``, as ``_then`` returns them."""
    mean, covariance = state.mean, state.covariance
    mean[into] = 0.0
    for j in range(len(mean)):
        covariance[into, j] = 0.0
    for weight, (plus, minus) in ((1.0 - share, now), (share, before)):
        mean[into] += weight * mean[plus]
        if minus >= 0:
            mean[into] -= weight * mean[minus]
        for j in range(len(mean)):
            covariance[into, j] += weight * covariance[plus, j]
            if minus >= 0:
                covariance[into, j] -= weight * covariance[minus, j]
    variance = 0.0
    for weight, (plus, minus) in ((1.0 - share, now), (share, before)):
        variance += weight * covariance[into, plus]
        if minus >= 0:
            variance -= weight * covariance[into, minus]
    for j in range(len(mean)):
        covariance[j, into] = covariance[into, j]
    covariance[into, into] = variance


@kernel(allocates=False)
def recall(m: int, state: State, drivers: Drivers, period_s: float) -> int:
    """Put into the state what driver m recalls now; returns as ``recalled_at``."""
    at = recalled_at(m, state, drivers)
    if at < 0:
        return at
    first, vehicles = _first(state, drivers), len(state.known)
    ago = looks_back(drivers.parameters[m]) / period_s
    before = math.ceil(ago)
    share = ago - (before - 1)
    for k, what in ((0, m), (1, vehicles - 1 + m), (2, vehicles + m)):
        _combine(at + k, state, _then(what, before - 1, state, first), _then(what, before, state, first), share)
    return at


@kernel(allocates=False)
def shift(state: State, drivers: Drivers, out: Linearised) -> None:
    """Linearise the change of the past over one period: everything becomes older."""
    first, vehicles = _first(state, drivers), len(state.known)
    if first == len(state.mean):
        return
    mean, next_mean = state.mean, out.next_mean
    oldest = first + _RECALLED * (vehicles - 1)
    for k in range(first, oldest):
        # worked out anew in every period
        next_mean[k] = 0.0
        out.counts[k] = 0
    for k in range(oldest, len(mean)):
        ago, what = (k - oldest) // (2 * vehicles - 1), (k - oldest) % (2 * vehicles - 1)
        plus, minus = _then(what, ago, state, first)
        next_mean[k] = mean[plus]
        out.jacobian[k, plus] = 1.0
        out.columns[k, 0], out.counts[k] = plus, 1
        if minus >= 0:
            next_mean[k] -= mean[minus]
            out.jacobian[k, minus] = -1.0
            out.columns[k, 1], out.counts[k] = minus, 2


@kernel(allocates=False)
def forget_past(m: int, state: State, drivers: Drivers) -> None:
    """Forget what there was of vehicle m: its speed, its gap, and the gap of the vehicle behind it."""
    first, vehicles = _first(state, drivers), len(state.known)
    for k in range(first + _RECALLED * (vehicles - 1), len(state.mean)):
        what = (k - first - _RECALLED * (vehicles - 1)) % (2 * vehicles - 1)
        is_gap = what < vehicles - 1
        if (is_gap and (what == m or what == m - 1)) or what == vehicles - 1 + m:
            state.mean[k] = 0.0
            for j in range(len(state.mean)):
                state.covariance[k, j] = state.covariance[j, k] = 0.0


@kernel(allocates=False)
def begin_past(m: int, state: State, drivers: Drivers, period_s: float) -> None:
    """Give vehicle m, which has just begun to move, a past in which it and its neighbours kept their speeds."""
    first, vehicles = _first(state, drivers), len(state.known)
    if first == len(state.mean):
        return
    known = state.known
    mean, covariance = state.mean, state.covariance
    periods = (len(mean) - first - _RECALLED * (vehicles - 1)) // (2 * vehicles - 1)
    for ago in range(1, periods + 1):
        for what in (m - 1, m, vehicles - 1 + m):
            is_gap = what < vehicles - 1
            # the last vehicle has no gap
            if what < 0 or (what == m and not is_gap):
                continue
            if is_gap and (known[what] != MOVING or known[what + 1] != MOVING):
                continue
            into = _then(what, ago, state, first)[0]
            now = _then(what, 0, state, first)
            _combine(into, state, now, now, 0.0)
            if is_gap:
                # the gap of then: less by what it has grown since
                for sign, v in ((-1.0, STATE * (what + 1) + 1), (1.0, STATE * what + 1)):
                    _add(into, v, sign * ago * period_s, mean, covariance)


@kernel(allocates=False)
def _add(into: int, entry: int, factor: float, mean: Array, covariance: Array) -> None:
    """Add a multiple of an entry of the state to another entry."""
    mean[into] += factor * mean[entry]
    for j in range(len(mean)):
        if j != into:
            covariance[into, j] += factor * covariance[entry, j]
            covariance[j, into] = covariance[into, j]
    covariance[into, into] += factor * (2.0 * covariance[into, entry] - factor * covariance[entry, entry])


@kernel(allocates=False)
def note_recalled(at: int, row: int, out: Linearised) -> None:
    """Note that a row of F depends on what a driver recalls, which begins at entry ``at``."""
    for k in range(_RECALLED):
        out.columns[row, out.counts[row]] = at + k
        out.counts[row] += 1
