"""The prediction of the causal filter: from what is known of a chain to what is expected one period later.

Aim: a driver's action is expected over everything that the driver may be seeing, a cubature of the normal distribution
of the state. The points of all drivers are put into a batch, in which all mean actions are worked out at once. Act: the
actions at the points give the expected action and its regression on the state. This linearises the mean action
statistically: its Jacobian at a point would make an extended Kalman filter whose likelihood is chaotic, because the
mean action jumps close to contact. Predict: the chain moves, which gives F, Q and F P F' + Q. ``update`` takes in the
measured positions. ``abreast`` has the algebra for several filters side by side.

These functions run for every driver and sample. They make no arrays.

References
----------
I. Arasaratnam and S. Haykin, Cubature Kalman Filters, IEEE Trans. Automatic Control 54 (2009) 1254.
"""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.batch import SLOTS, UTILITIES, consider, decide, mean_in, put_into
from sugiyama_ros.driver.parameters import RHO, SIGMA_A, SIGMA_V, SIGMA_X, UTILITY
from sugiyama_ros.driver.utility import advance, preferences
from sugiyama_ros.effects.control import (
    act,
    acts_on_intention,
    add_components,
    expect_change,
    feels_accelerations,
    has_components,
    law_action,
    looks_back,
    noise_factor,
    perceive,
    prefer,
    remembers,
    seeks,
    sees_as_it_is,
)
from sugiyama_ros.effects.effect import Seen, with_motion
from sugiyama_ros.filters.state import (
    MOVING,
    STATE,
    Drivers,
    FilterStep,
    Linearised,
    State,
    is_last,
    note_recalled,
    recall,
    recalled_at,
    shift,
)
from sugiyama_ros.jit import kernel

# Variance below which a direction of what the driver sees counts as known; keeps the Cholesky factor invertible.
_KNOWN_VAR = 1e-12
# What a driver looks at: nobody ahead; the vehicle ahead; also at accelerations; at the vehicle ahead as it was.
_ALONE, _LED, _FEELING, _RECALLING = range(4)
# The noise of a driver is at least this part of their sigma_a: a filter that is too sure could not be corrected.
_LEAST_FACTOR = 0.02


@kernel(allocates=False)
def linearise_chain(step: FilterStep) -> float:
    """Let the drivers of one chain decide, and linearise one period of Eq. ssm_form; returns as ``linearise``."""
    used = aim(step, 0)
    consider(used, step.scene.period_s, step.scene.horizon, step.batch)
    decide(used, step.batch, add_all_components(step))
    clear(step.out)
    return linearise(step, 1.0)


# Aim: the points at which mean actions are wanted.


@kernel(allocates=False)
def aim(step: FilterStep, free: int) -> int:
    """Aim for all drivers of a chain; returns the first slot of the batch that is free then."""
    for m in range(len(step.state.known) - 1):
        if step.state.known[m] == MOVING and not is_last(m, step.state.known):
            free = _aim_driver(m, step, free)
    return free


@kernel(allocates=False)
def _aim_driver(m: int, step: FilterStep, free: int) -> int:
    """Find the points at which the action of driver m is wanted, and put them into the batch, from slot ``free`` on."""
    state, drivers, batch = step.state, step.drivers, step.batch
    mean, known, driver = state.mean, state.known, drivers.parameters[m]
    adapted = drivers.adapted if m == 0 else drivers.adapted[:0]
    places, work, _, _ = _cubature_of(m, step)
    recalled = recall(m, state, drivers, step.scene.period_s)
    view = _view_of(m, state, drivers)
    size = _look(m, view, recalled, len(known), len(adapted), has_line(m, step.around), places)
    step.points[m, 0], step.points[m, 1] = size, free
    cholesky(state.covariance, places, size, work)
    centre = size
    for i in range(size):
        work[centre, i] = mean[places[0, i]] - (mean[places[1, i]] if places[1, i] >= 0 else 0.0)
    if view != _ALONE:
        work[centre, 0] -= 0.5 * (step.length[m] + step.length[m + 1])
    if not seeks(driver):
        return free
    first_adapted, look = size - len(adapted), centre + 1
    if len(adapted) == 0 and view != _RECALLING and sees_as_it_is(driver):
        wanted = preferences(driver)
        for point in range(2 * size):
            look_around(work, size, point)
            if view == _ALONE:
                put_into(batch, free + point, np.inf, work[look, 0], 0.0, wanted)
            else:
                put_into(batch, free + point, work[look, 0], work[look, 1], work[look, 2], wanted)
        return free + 2 * size
    here = _surroundings(m, step)
    for point in range(2 * size):
        look_around(work, size, point)
        for k in range(len(adapted)):
            driver[UTILITY[adapted[k]]] = math.exp(work[look, first_adapted + k])
        perceived = perceive(_seen_at(here, work, m, size, view, step), driver)
        wanted = prefer(perceived, driver)
        put_into(batch, free + point, perceived.gap, perceived.speed, perceived.leader_speed, wanted)
    for k in range(len(adapted)):
        driver[UTILITY[adapted[k]]] = math.exp(mean[STATE * len(known) + k])
    return free + 2 * size


@kernel(allocates=False)
def _view_of(m: int, state: State, drivers: Drivers) -> int:
    """Return what driver m looks at: _ALONE, _LED, _FEELING or _RECALLING."""
    if state.known[m + 1] != MOVING:
        return _ALONE
    if recalled_at(m, state, drivers) >= 0:
        return _RECALLING
    return _FEELING if feels_accelerations(drivers.parameters[m]) else _LED


@kernel(allocates=False)
def has_line(m: int, around: Array) -> bool:
    """Whether driver m comes to a line before which they may have to wait; around: (11,) as of ``Chain``."""
    return m < 2 and not math.isnan(around[3 + 4 * m])


@kernel(allocates=False)
def _look(m: int, view: int, recalled: int, vehicles: int, adapted: int, has_line: bool, places: Ints) -> int:
    """Fill in what the action of driver m depends on, and return the number of these quantities.

    Each is an entry of the state less another one. places: (2, .), the entry to add and the entry to take off, or -1:
    of the gap (without lengths) and both speeds, or of the own speed alone. _FEELING adds the noises of both, which are
    part of the accelerations. _RECALLING, from entry ``recalled`` on, means the gap of then, the own speed of now and
    both speeds of then. A line adds the own position. Then follow the logarithms of the adapted parameters.
    """
    x, v = STATE * m, STATE * m + 1
    places[1] = -1
    if view == _ALONE:
        seen = 1
        places[0, 0] = v
    elif view == _RECALLING:
        seen = 4
        places[0, 0], places[0, 1], places[0, 2], places[0, 3] = recalled, v, recalled + 2, recalled + 1
    else:
        seen = 5 if view == _FEELING else 3
        places[0, 0], places[0, 1], places[0, 2], places[1, 0] = x + STATE, v, v + STATE, x
        if view == _FEELING:
            places[0, 3], places[0, 4] = x + 2, x + STATE + 2
    if has_line:
        places[0, seen] = x
        seen += 1
    for k in range(adapted):
        places[0, seen + k] = STATE * vehicles + k
    return seen + adapted


@kernel(allocates=False)
def cholesky(covariance: Array, places: Ints, size: int, root: Array) -> None:
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
def _cubature_of(m: int, step: FilterStep) -> tuple[Ints, Array, int, int]:
    """Return the points at which the action of driver m is wanted.

    Returns ``places`` (2, .) of ``_look``, the root of their covariance with the rows below it, the number of
    quantities that the action depends on, and the first slot of the batch.
    """
    rows = 3 + step.places.shape[1]
    return step.places[2 * m : 2 * m + 2], step.root[rows * m :], step.points[m, 0], step.points[m, 1]


@kernel(allocates=False)
def _side_of(size: int, point: int) -> float:
    """Return how far a point is from the centre, along its column of the root."""
    return math.sqrt(size) if point % 2 == 0 else -math.sqrt(size)


@kernel(allocates=False)
def look_around(work: Array, size: int, point: int) -> None:
    """Fill in the row below the centre with one of the points of the cubature."""
    side = _side_of(size, point)
    for i in range(size):
        work[size + 1, i] = work[size, i] + side * work[i, point // 2]


@kernel(allocates=False)
def _surroundings(m: int, step: FilterStep) -> Seen:
    """Return what driver m of a chain sees at the mean of the state."""
    mean, known, scene, parameters = step.state.mean, step.state.known, step.scene, step.drivers.parameters
    length, around, last, x = step.length, step.around, len(known) - 1, STATE * m
    gap, leader_speed, leader_acceleration = np.inf, 0.0, 0.0
    second_gap, second_speed, rear_gap, rear_speed = np.inf, 0.0, np.inf, 0.0
    if m < last and known[m + 1] == MOVING:
        gap = mean[x + STATE] - mean[x] - 0.5 * (length[m] + length[m + 1])
        leader_speed = mean[x + STATE + 1]
        rho = scene.last_rho if is_last(m + 1, known) else parameters[m + 1, RHO]
        leader_acceleration = mean[x + STATE + 3] + rho * mean[x + STATE + 2]
        if m + 1 < last and known[m + 2] == MOVING:
            second_gap = mean[x + 2 * STATE] - mean[x + STATE] - 0.5 * (length[m + 1] + length[m + 2])
            second_speed = mean[x + 2 * STATE + 1]
    if m > 0:
        if known[m - 1] == MOVING:
            rear_gap = mean[x] - mean[x - STATE] - 0.5 * (length[m] + length[m - 1])
            rear_speed = mean[x - STATE + 1]
    elif not math.isnan(around[0]):
        headway = mean[x] - around[0]
        if scene.circumference_m > 0.0:
            headway -= scene.circumference_m * math.floor(headway / scene.circumference_m)
        rear_gap, rear_speed = headway - 0.5 * (length[m] + around[2]), around[1]
    line, line_gap, arrive_s, clear_s, curvature = 3 + 4 * m, np.inf, np.inf, np.inf, 0.0
    if m < 2 and not math.isnan(around[line + 3]):
        curvature = around[line + 3]
    if has_line(m, step.around):
        line_gap, arrive_s, clear_s = around[line] - mean[x] - 0.5 * length[m], around[line + 1], around[line + 2]
    acceleration = mean[x + 3] + parameters[m, RHO] * mean[x + 2]
    # where the chain holds no past: as far as the present accelerations tell
    ago = looks_back(parameters[m])
    return Seen(
        gap=gap,
        speed=mean[x + 1],
        leader_speed=leader_speed,
        position=mean[x],
        time=step.time_s,
        circumference=scene.circumference_m,
        acceleration=acceleration,
        leader_acceleration=leader_acceleration,
        second_gap=second_gap,
        second_speed=second_speed,
        rear_gap=rear_gap,
        rear_speed=rear_speed,
        past_gap=gap - ago * (leader_speed - mean[x + 1]),
        past_speed=mean[x + 1] - ago * acceleration,
        past_leader_speed=leader_speed - ago * leader_acceleration,
        line_gap=line_gap,
        arrive_s=arrive_s,
        clear_s=clear_s,
        curvature=curvature,
    )


@kernel(allocates=False)
def _seen_at(here: Seen, work: Array, m: int, size: int, view: int, step: FilterStep) -> Seen:
    """Return what driver m sees at the point of the cubature that ``look_around`` has filled in."""
    known, parameters = step.state.known, step.drivers.parameters
    centre, look = size, size + 1
    acceleration, leader_acceleration = here.acceleration, here.leader_acceleration
    if view == _ALONE:
        gap, speed, leader_speed = np.inf, work[look, 0], 0.0
    elif view == _RECALLING:
        gap, speed, leader_speed = here.gap, work[look, 1], here.leader_speed
    else:
        gap, speed, leader_speed = work[look, 0], work[look, 1], work[look, 2]
    past_gap = gap + (here.past_gap - here.gap) if view != _ALONE else gap
    past_speed = speed + (here.past_speed - here.speed)
    past_leader_speed = leader_speed + (here.past_leader_speed - here.leader_speed)
    if view == _RECALLING:
        past_gap, past_leader_speed, past_speed = work[look, 0], work[look, 2], work[look, 3]
    if view == _FEELING:
        leader_rho = step.scene.last_rho if is_last(m + 1, known) else parameters[m + 1, RHO]
        acceleration += parameters[m, RHO] * (work[look, 3] - work[centre, 3])
        leader_acceleration += leader_rho * (work[look, 4] - work[centre, 4])
    line_gap = here.line_gap
    if has_line(m, step.around):
        own = size - 1 - (len(step.drivers.adapted) if m == 0 else 0)
        line_gap -= work[look, own] - work[centre, own]
    past = past_gap, past_speed, past_leader_speed
    return with_motion(here, (gap, speed, leader_speed), (acceleration, leader_acceleration), past, line_gap)


# Act: from the mean actions at the points to the expected action.


@kernel(allocates=False)
def add_all_components(step: FilterStep) -> bool:
    """Add what effects add to the utilities of the drivers who have such effects; returns whether there are any."""
    found = False
    for m in range(len(step.state.known) - 1):
        moves = step.state.known[m] == MOVING and not is_last(m, step.state.known)
        if moves and (has_components(step.drivers.parameters[m]) or has_line(m, step.around)):
            _add_components(m, step)
            found = True
    return found


@kernel(allocates=False)
def _add_components(m: int, step: FilterStep) -> None:
    """Add what effects add to the utilities of driver m, at the points in the batch."""
    driver, batch, (_, work, size, first) = step.drivers.parameters[m], step.batch, _cubature_of(m, step)
    view = _view_of(m, step.state, step.drivers)
    here, shared = _surroundings(m, step), (batch.grid.actions, step.scene.period_s, step.scene.horizon, driver)
    for point in range(2 * size):
        look_around(work, size, point)
        perceived = perceive(_seen_at(here, work, m, size, view, step), driver)
        wanted = prefer(perceived, driver)
        block, slot = (first + point) // SLOTS, UTILITIES + (first + point) % SLOTS
        if len(batch.blocks) > 0:
            add_components(perceived, *shared, wanted, batch.added, batch.blocks[block, slot:], SLOTS)
        else:
            add_components(perceived, *shared, wanted, batch.added, batch.rough[block, slot:], SLOTS)


class _Expected(NamedTuple):
    """Expectations of an action [m/s^2], and the variances [m^2/s^4] that their regressions on the state leave.

    held: what the driver holds; action: the same with what the environment adds; held_var, action_var: of both.
    """

    held: float
    action: float
    held_var: float
    action_var: float


@kernel(allocates=False)
def _expected_action(m: int, step: FilterStep, period_s: float) -> _Expected:
    """Return the expected action of driver m over some time; ``slope`` and ``held_slope`` take its regressions.

    What ``_look`` does not list enters with its mean, such as the vehicle behind and the second vehicle ahead.
    """
    driver, chosen = step.drivers.parameters[m], step.chosen
    places, work, size, first = _cubature_of(m, step)
    changed = acts_on_intention(driver) or not seeks(driver)
    if changed:
        _choose(m, step)
    else:
        for point in range(2 * size):
            action = mean_in(step.batch, first + point)
            chosen[0, point] = chosen[1, point] = action
    # below the root stand rows of their own
    cross = size + 2
    held, held_var = moments(chosen[0], work[cross], size)
    regress(work, cross, places, size, step.held_slope)
    if changed:
        action, action_var = moments(chosen[1], work[cross], size)
        regress(work, cross, places, size, step.slope)
    else:
        action, action_var = held, held_var
        for i in range(len(step.slope)):
            step.slope[i] = step.held_slope[i]
    meant = _Expected(held, action, held_var, action_var)
    return _carried_out(m, meant, step, period_s) if remembers(driver) else meant


@kernel(allocates=False)
def _choose(m: int, step: FilterStep) -> None:
    """Fill in ``chosen`` for a driver with another law, or with effects that act on what the driver intends."""
    driver, chosen = step.drivers.parameters[m], step.chosen
    _, work, size, first = _cubature_of(m, step)
    view, by_law = _view_of(m, step.state, step.drivers), not seeks(driver)
    here = _surroundings(m, step)
    for point in range(2 * size):
        look_around(work, size, point)
        seen = _seen_at(here, work, m, size, view, step)
        if by_law:
            perceived = perceive(seen, driver)
            action = law_action(perceived, driver)
        else:
            action = mean_in(step.batch, first + point)
        held, pushed = act(action, seen, driver)
        chosen[0, point], chosen[1, point] = held, held + pushed


@kernel(allocates=False)
def moments(chosen: Array, cross: Array, size: int) -> tuple[float, float]:
    """Return the mean of what was chosen at the points, and the variance that no regression on the state explains.

    cross: (size,), overwritten with the covariances of what was chosen with the columns of the root.
    """
    side, weight = _side_of(size, 0), 0.5 / size
    total, squares, explained = 0.0, 0.0, 0.0
    for j in range(size):
        there, back = chosen[2 * j], chosen[2 * j + 1]
        total += there
        total += back
        squares += there * there
        squares += back * back
        cross[j] = weight * (there * side - back * side)
        explained += cross[j] ** 2
    mean = weight * total
    return mean, max(weight * squares - mean * mean - explained, 0.0)


@kernel(allocates=False)
def regress(work: Array, row: int, places: Ints, size: int, slope: Array) -> None:
    """Fill in the regression of an action on the state.

    work: the root, and in ``row`` what the action shares with each column of the root; that row is overwritten.
    """
    # the action and the quantities have the covariance root @ cross, the quantities root @ root.T
    slope[:] = 0.0
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            work[row, i] -= work[k, i] * work[row, k]
        work[row, i] /= work[i, i]
        slope[places[0, i]] += work[row, i]
        if places[1, i] >= 0:
            slope[places[1, i]] -= work[row, i]


@kernel(allocates=False)
def _carried_out(m: int, meant: _Expected, step: FilterStep, period_s: float) -> _Expected:
    """Return what driver m carries out, who means ``meant`` and remembers what was held in the last period.

    The regressions change with it. What the environment adds does not depend on the memory.
    """
    state, slope, held_slope = step.state, step.slope, step.held_slope
    pushed, pushed_var = meant.action - meant.held, max(meant.action_var - meant.held_var, 0.0)
    slope -= held_slope
    held = STATE * m + 3
    held_slope[held] -= 1.0
    variance = 0.0
    for i in range(len(held_slope)):
        for j in range(len(held_slope)):
            variance += held_slope[i] * state.covariance[i, j] * held_slope[j]
    variance = max(variance + meant.held_var, _KNOWN_VAR)
    row = step.drivers.parameters[m]
    change, share, left = expect_change(meant.held - state.mean[held], variance, row, period_s)
    held_slope *= share
    held_slope[held] += 1.0
    slope += held_slope
    expected, held_var = state.mean[held] + change, share * share * meant.held_var + left
    return _Expected(expected, expected + pushed, held_var, held_var + pushed_var)


# Predict: the next mean, F and Q, and then F P F' + Q.


@kernel(allocates=False)
def clear(out: Linearised) -> None:
    """Make the Jacobian and the process noise 0."""
    out.jacobian[:] = 0.0
    out.noise[:] = 0.0


@kernel(allocates=False)
def linearise(step: FilterStep, periods: float) -> float:
    """Linearise some periods, in which the drivers do what they have decided; F and Q are 0 before.

    Returns what the own driver means to do [m/s^2].
    """
    state, drivers, scene, out = step.state, step.drivers, step.scene, step.out
    mean, known, parameters = state.mean, state.known, drivers.parameters
    next_mean, jacobian, noise = out.next_mean, out.jacobian, out.noise
    vehicles, adapted = len(known), len(drivers.adapted)
    period, memory, own_action = scene.period_s, scene.memory, 0.0
    if periods != 1.0:
        period, memory = periods * period, memory**periods
    for k in range(adapted):
        p = STATE * vehicles + k
        next_mean[p] = drivers.prior_mean[k] + memory * (mean[p] - drivers.prior_mean[k])
        jacobian[p, p] = memory
        noise[p, p] = drivers.prior_var[k] * (1.0 - memory**2)
        out.columns[p, 0], out.counts[p] = p, 1
    for m in range(vehicles):
        x, v, n, b = STATE * m, STATE * m + 1, STATE * m + 2, STATE * m + 3
        jacobian[x, x] = jacobian[v, v] = 1.0
        if known[m] != MOVING:
            for k in range(x, x + STATE):
                next_mean[k] = mean[k]
                out.columns[k, 0], out.counts[k] = k, 1
            continue
        jacobian[x, v] = jacobian[v, n] = period
        noise[x, x], noise[v, v] = parameters[m, SIGMA_X] ** 2, parameters[m, SIGMA_V] ** 2
        _note_columns(m, state, drivers, out)
        if is_last(m, known):
            action, rho, shock_std = 0.0, scene.last_rho, scene.last_shock_std
            next_mean[b] = 0.0
        else:
            expected = _expected_action(m, step, period)
            action = expected.action
            noise[v, v] += period * period * expected.action_var
            noise[b, b] = expected.held_var
            noise[v, b] = noise[b, v] = period * math.sqrt(expected.action_var * expected.held_var)
            next_mean[b] = expected.held
            for c in range(out.counts[v]):
                k = out.columns[v, c]
                jacobian[v, k] += period * step.slope[k]
                jacobian[b, k] = step.held_slope[k]
            if m == 0:
                own_action = expected.held
            rho = parameters[m, RHO]
            shock_std = parameters[m, SIGMA_A] * max(noise_factor(mean[v], parameters[m]), _LEAST_FACTOR)
        next_mean[x], next_mean[v] = advance(mean[x], mean[v], action + mean[n], period)
        next_mean[n] = rho * mean[n]
        jacobian[n, n] = rho
        noise[n, n] = shock_std**2
    shift(state, drivers, out)
    return own_action


@kernel(allocates=False)
def _note_columns(m: int, state: State, drivers: Drivers, out: Linearised) -> None:
    """Note which entries of the rows of a moving vehicle in F may differ from 0."""
    x, v, n, b = STATE * m, STATE * m + 1, STATE * m + 2, STATE * m + 3
    known, columns, counts = state.known, out.columns, out.counts
    columns[x, 0], columns[x, 1], counts[x] = x, v, 2
    columns[n, 0], counts[n] = n, 1
    columns[v, 0], columns[v, 1], columns[v, 2], counts[v], counts[b] = x, v, n, 3, 0
    if is_last(m, known):
        return
    view = _view_of(m, state, drivers)
    if view == _RECALLING:
        note_recalled(recalled_at(m, state, drivers), v, out)
    elif view != _ALONE:
        columns[v, 3], columns[v, 4], counts[v] = x + STATE, v + STATE, 5
        if view == _FEELING:
            columns[v, 5], counts[v] = n + STATE, 6
    if remembers(drivers.parameters[m]):
        columns[v, counts[v]] = b
        counts[v] += 1
    if m == 0:
        for k in range(len(drivers.adapted)):
            columns[v, counts[v]] = STATE * len(known) + k
            counts[v] += 1
    # the held acceleration depends on the same entries
    for c in range(counts[v]):
        columns[b, c] = columns[v, c]
    counts[b] = counts[v]


@kernel(allocates=False)
def predict(state: State, out: Linearised, half: Array) -> None:
    """Go on by the linearised period: F P F' + Q, for the live entries of the state; half: (N, N), overwritten."""
    transform(state.covariance, out, half)
    for i in out.live:  # the process noise correlates only entries of the same vehicle
        first = i - i % STATE
        for j in range(first, min(first + STATE, len(state.mean))):
            state.covariance[i, j] += out.noise[i, j]
    for i in range(len(state.mean)):
        state.mean[i] = out.next_mean[i]


@kernel(allocates=False)
def transform(symmetric: Array, out: Linearised, half: Array) -> None:
    """F P F' in place, of the entries of F that may differ from 0, and exactly symmetric; half: (N, N), overwritten."""
    jacobian, columns, counts, live = out.jacobian, out.columns, out.counts, out.live
    size = len(symmetric)
    for i in live:
        k = columns[i, 0]
        factor = jacobian[i, k]
        for j in range(size):
            half[i, j] = factor * symmetric[k, j]
        for c in range(1, counts[i]):
            k = columns[i, c]
            factor = jacobian[i, k]
            for j in range(size):
                half[i, j] += factor * symmetric[k, j]
    for a in range(len(live)):
        j = live[a]
        k, count = columns[j, 0], counts[j]
        factor = jacobian[j, k]
        if count == 1:
            for d in range(a, len(live)):
                i = live[d]
                symmetric[i, j] = symmetric[j, i] = half[i, k] * factor
            continue
        other = columns[j, 1]
        other_factor = jacobian[j, other]
        for d in range(a, len(live)):
            i = live[d]
            total = half[i, k] * factor + half[i, other] * other_factor
            for c in range(2, count):
                total += half[i, columns[j, c]] * jacobian[j, columns[j, c]]
            symmetric[i, j] = symmetric[j, i] = total
