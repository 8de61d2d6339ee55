"""What a step of the causal filter works on: the chain's state, its drivers, and the arrays that the step fills.

All of these are named tuples, so that compiled code and Python share them.

For drivers who act on what they saw some time ago, the state holds the past too. After the vehicles and the adapted
parameters stands what each driver recalls (gap without lengths, own speed, leader's speed), and below this what there
was one period ago, two periods ago, and so on: the gaps of all drivers and the speeds of all vehicles. The past is
therefore as uncertain as it is, and every measurement improves it: a fixed-lag smoother (B. D. O. Anderson and
J. B. Moore, Optimal Filtering (1979), section 7.3). What a driver recalls lies on a straight line between two periods.
"""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.batch import Batch, batch_for
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON, horizon_at
from sugiyama_ros.effects.control import LOOKING_BACK, looks_back
from sugiyama_ros.filters.chain import AROUND
from sugiyama_ros.jit import kernel

#: Acceleration of the last vehicle of a chain: correlation over the reference period and std [m/s^2] of its shock.
#: Maximum likelihood on the positions of single vehicles gives a std of 0.2 to 0.4 in the Sugiyama ring, and 0.1 (free
#: flow) to 0.6 (dense traffic) in simulations. The less it is, the larger is kappa_v: at 0.5 it is 0.2 standard errors
#: too large on the ring, and 0.4 too small in a short platoon behind a first car.
LAST_RHO, LAST_SHOCK_STD = 0.9, 0.5
#: A vehicle is known by nothing, by one position, or by position and speed.
UNKNOWN, POSITION, MOVING = range(3)
#: Quantities on which an action may depend: gap, speeds, and accelerations or the past; position, before a line.
LOOKED_AT = 6
#: Entries of the state for each vehicle: position, speed, noise, held acceleration.
STATE = 4
# What a driver recalls: gap, own speed, leader's speed.
_RECALLED = 3


@kernel(allocates=False)
def is_last(m: int, known: Ints) -> bool:
    """Whether vehicle m ends the chain, so that its leader is not known: there is none in the chain, or none is seen.

    The driver alone, whose chain it is, is on a free road then.
    """
    return bool(m == len(known) - 1 or (m > 0 and known[m + 1] == UNKNOWN))


class Scene(NamedTuple):
    """What the filter of a chain needs besides the state and the drivers; ``scene_at`` makes it.

    period_s: time [s] between two samples; horizon: periods of look-ahead; circumference_m: of the ring, 0 for an open
    road; last_rho, last_shock_std: of the last vehicle's acceleration; memory: correlation of adapted parameters over
    one period.
    """

    period_s: float
    horizon: int
    circumference_m: float
    last_rho: float
    last_shock_std: float
    memory: float


def scene_at(period_s: float, circumference_m: float, relaxation_s: float = math.inf) -> Scene:
    """Return the scene for a period between samples.

    period_s: time between two samples [s]; circumference_m: length of the ring [m], 0 for an open road; relaxation_s:
    time in which adapted parameters return to their prior [s].
    """
    rho = LAST_RHO ** (REFERENCE_HORIZON / horizon_at(period_s))
    shock = LAST_SHOCK_STD * math.sqrt((1.0 - rho * rho) / (1.0 - LAST_RHO**2))
    return Scene(period_s, horizon_at(period_s), circumference_m, rho, shock, math.exp(-period_s / relaxation_s))


class State(NamedTuple):
    """What is known of a chain of M vehicles with A adapted parameters, as a normal distribution.

    mean: (4 M + A,), four entries for each vehicle, then the logarithms of the adapted parameters, and then, if drivers
    look back, the past; covariance: (4 M + A, 4 M + A); known: (M,), each UNKNOWN, POSITION or MOVING.
    """

    mean: Array
    covariance: Array
    known: Ints


class Drivers(NamedTuple):
    """The drivers of a chain, and which parameters of the own driver are adapted.

    parameters: (M, WIDTH) at the period of the samples, row 0 with the present values of the adapted ones; adapted:
    (A,) places in ``parameters.UTILITY``; prior_mean, prior_var: (A,) of the logarithms of the adapted parameters.
    """

    parameters: Array
    adapted: Ints
    prior_mean: Array
    prior_var: Array


class Linearised(NamedTuple):
    """One period of the model, linearised; arrays that ``linearise`` overwrites.

    next_mean: (4 M + A,); jacobian: F, (4 M + A, 4 M + A); noise: the process noise Q, (4 M + A, 4 M + A); columns:
    (4 M + A, 4 M + A), for each row of F the columns whose entries may differ from 0; counts: (4 M + A,), their
    numbers. live: the entries of the state whose covariances matter, which ``linearise`` does not change.
    """

    next_mean: Array
    jacobian: Array
    noise: Array
    columns: Ints
    counts: Ints
    live: Ints


class FilterStep(NamedTuple):
    """All that one step of a chain's filter reads and fills: what is known, and the arrays that it overwrites.

    length: (M,) of the vehicles [m]; around: (AROUND,) what else the driver sees, as of ``Chain``; time_s: time of the
    recording [s]. Overwritten: places: two rows for each driver, what an action depends on, (2 (M - 1), 6 + A); root: 9
    + A rows for each driver, root of its covariance, and rows below, (.., 6 + A); points: (M - 1, 2), for each driver
    the number of quantities that the action depends on, and the first slot of the batch; chosen: (2, 2 (6 + A)), what
    one driver holds at each point, and the same with what the environment adds; slope, held_slope: (N,), regressions of
    the action and of the held acceleration on the state.
    """

    state: State
    drivers: Drivers
    scene: Scene
    out: Linearised
    batch: Batch
    length: Array
    around: Array
    time_s: float
    places: Ints
    root: Array
    points: Ints
    chosen: Array
    slope: Array
    held_slope: Array


@kernel
def points_of(vehicles: int, adapted: int) -> int:
    """Return the largest number of points at which the drivers of a chain of M vehicles consider their actions."""
    return 2 * (vehicles - 1) * (LOOKED_AT + adapted)


def step_for(state: State, drivers: Drivers, length: Array, scene: Scene, actions: Array) -> FilterStep:
    """Return a step of one chain with fresh arrays and no vehicle behind, all of whose covariances matter.

    length: (M,) of the vehicles [m]; actions: (K,) [m/s^2].
    """
    vehicles, n, most = len(state.known), len(state.mean), LOOKED_AT + len(drivers.adapted)
    square, counts, columns = (n, n), np.zeros(n, np.int64), np.zeros((n, n), np.int64)
    return FilterStep(
        state,
        drivers,
        scene,
        Linearised(np.zeros(n), np.zeros(square), np.zeros(square), columns, counts, np.arange(n)),
        batch_for(points_of(vehicles, len(drivers.adapted)), actions, scene.period_s, False),
        length,
        around=np.full(AROUND, np.nan),
        time_s=0.0,
        places=np.zeros((2 * vehicles, most), np.int64),
        root=np.zeros((vehicles * (3 + most), most)),
        points=np.zeros((vehicles, 2), np.int64),
        chosen=np.zeros((2, 2 * most)),
        slope=np.zeros(n),
        held_slope=np.zeros(n),
    )


# The past.


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
def _combine(into: int, state: State, terms: tuple[tuple[int, float], ...]) -> None:
    """Make an entry of the state a sum of other entries; terms: number (-1 for none) and factor of each of them."""
    mean, covariance = state.mean, state.covariance
    mean[into] = 0.0
    for j in range(len(mean)):
        covariance[into, j] = 0.0
    for entry, factor in terms:
        if entry >= 0:
            mean[into] += factor * mean[entry]
            for j in range(len(mean)):
                covariance[into, j] += factor * covariance[entry, j]
    variance = 0.0
    for entry, factor in terms:
        if entry >= 0:
            variance += factor * covariance[into, entry]
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
        late, early = _then(what, before - 1, state, first), _then(what, before, state, first)
        terms = (late[0], 1.0 - share), (late[1], share - 1.0), (early[0], share), (early[1], -share)
        _combine(at + k, state, terms)
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
    periods = (len(state.mean) - first - _RECALLED * (vehicles - 1)) // (2 * vehicles - 1)
    for ago in range(1, periods + 1):
        for what in (m - 1, m, vehicles - 1 + m):
            is_gap = what < vehicles - 1
            # the last vehicle has no gap
            if what < 0 or (what == m and not is_gap):
                continue
            if is_gap and (known[what] != MOVING or known[what + 1] != MOVING):
                continue
            plus, minus = _then(what, 0, state, first)
            # the gap of then is less by what it has grown since
            older_s = ago * period_s
            own, leader = (STATE * what + 1, STATE * what + STATE + 1) if is_gap else (-1, -1)
            terms = (plus, 1.0), (minus, -1.0), (leader, -older_s), (own, older_s)
            _combine(_then(what, ago, state, first)[0], state, terms)


@kernel(allocates=False)
def note_recalled(at: int, row: int, out: Linearised) -> None:
    """Note that a row of F depends on what a driver recalls, which begins at entry ``at``."""
    for k in range(_RECALLED):
        out.columns[row, out.counts[row]] = at + k
        out.counts[row] += 1
