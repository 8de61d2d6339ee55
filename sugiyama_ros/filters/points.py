"""The points at which the mean actions of a chain's drivers are wanted, and what the drivers see there.

A driver's action is expected over everything that the driver may be seeing: a cubature of the normal distribution of
the state. These functions run for every driver and sample. They make no arrays.

References
----------
I. Arasaratnam and S. Haykin, Cubature Kalman Filters, IEEE Trans. Automatic Control 54 (2009) 1254.
"""

import math

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.lanes import Lanes, put_into
from sugiyama_ros.driver.parameters import RHO, UTILITY
from sugiyama_ros.driver.utility import preferences
from sugiyama_ros.effects.control import feels_accelerations, looks_back, perceive, prefer, seeks, sees_as_it_is
from sugiyama_ros.effects.effect import Seen
from sugiyama_ros.filters.past import recall, recalled_at
from sugiyama_ros.filters.state import MOVING, STATE, Drivers, Moment, Scene, State, Workspace, is_last
from sugiyama_ros.jit import kernel

#: Variance below which a direction of what the driver sees counts as known; keeps the Cholesky factor invertible.
KNOWN_VAR = 1e-12
#: What a driver looks at: nobody ahead; the vehicle ahead; also at accelerations; at the vehicle ahead as it was.
ALONE, LED, FEELING, RECALLING = range(4)


@kernel(allocates=False)
def view_of(m: int, state: State, drivers: Drivers) -> int:
    """Return what driver m looks at: ALONE, LED, FEELING or RECALLING."""
    if state.known[m + 1] != MOVING:
        return ALONE
    if recalled_at(m, state, drivers) >= 0:
        return RECALLING
    return FEELING if feels_accelerations(drivers.parameters[m]) else LED


@kernel(allocates=False)
def _look(m: int, view: int, recalled: int, vehicles: int, adapted: int, places: Ints) -> int:
    """Fill in what the action of driver m depends on, and return the number of these quantities.

    Each is an entry of the state less another one. places: (2, at least 5 + A), the entry to add and the entry to take
    off, or -1. The quantities are the gap (without lengths), the own and the leader's speed, or the own speed alone
    where there is no leader. A driver who feels accelerations also depends on the noises of both, which are part of the
    accelerations. A driver who recalls, from entry ``recalled`` on, depends on the gap of then, the own speed of now,
    and both speeds of then. Then follow the logarithms of the adapted parameters.
    """
    x, v = STATE * m, STATE * m + 1
    places[1] = -1
    if view == ALONE:
        seen = 1
        places[0, 0] = v
    elif view == RECALLING:
        seen = 4
        places[0, 0], places[0, 1], places[0, 2], places[0, 3] = recalled, v, recalled + 2, recalled + 1
    else:
        seen = 5 if view == FEELING else 3
        places[0, 0], places[0, 1], places[0, 2], places[1, 0] = x + STATE, v, v + STATE, x
        if view == FEELING:
            places[0, 3], places[0, 4] = x + 2, x + STATE + 2
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
            root[i, j] = math.sqrt(max(entry, KNOWN_VAR)) if i == j else entry / root[j, j]
        for j in range(i + 1, size):
            root[i, j] = 0.0


@kernel(allocates=False)
def rows_of(m: int, workspace: Workspace) -> tuple[int, int]:
    """Return the first rows of driver m in ``places`` and in ``root``."""
    return 2 * m, m * (3 + workspace.places.shape[1])


@kernel(allocates=False)
def aim(
    m: int, state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace, lanes: Lanes, free: int
) -> int:
    """Find the points at which the action of driver m is wanted, and put them into lanes.

    workspace: keeps the root and the points for ``expected_action``.
    """
    mean, known, driver = state.mean, state.known, drivers.parameters[m]
    adapted = drivers.adapted if m == 0 else drivers.adapted[:0]
    place, row = rows_of(m, workspace)
    places, work = workspace.places[place : place + 2], workspace.root[row:]
    recalled = recall(m, state, drivers, scene.period_s)
    view = view_of(m, state, drivers)
    size = _look(m, view, recalled, len(known), len(adapted), places)
    workspace.points[m, 0], workspace.points[m, 1] = size, free
    _root(state.covariance, places, size, work)
    centre = size
    for i in range(size):
        work[centre, i] = mean[places[0, i]] - (mean[places[1, i]] if places[1, i] >= 0 else 0.0)
    if view != ALONE:
        work[centre, 0] -= 0.5 * (moment.length[m] + moment.length[m + 1])
    if not seeks(driver):
        return free
    first_adapted, look = size - len(adapted), centre + 1
    if len(adapted) == 0 and view != RECALLING and sees_as_it_is(driver):
        _put_as_it_is(work, size, view, driver, lanes, free)
        return free + 2 * size
    here = surroundings(m, state, drivers.parameters, moment, scene)
    for point in range(2 * size):
        look_around(work, size, point)
        for k in range(len(adapted)):
            driver[UTILITY[adapted[k]]] = math.exp(work[look, first_adapted + k])
        perceived = perceive(seen_at(here, work, m, size, view, known, drivers.parameters, scene), driver)
        wanted = prefer(perceived, driver)
        put_into(lanes, free + point, perceived.gap, perceived.speed, perceived.leader_speed, wanted)
    for k in range(len(adapted)):
        driver[UTILITY[adapted[k]]] = math.exp(mean[STATE * len(known) + k])
    return free + 2 * size


@kernel(allocates=False)
def _put_as_it_is(work: Array, size: int, view: int, driver: Array, lanes: Lanes, free: int) -> None:
    """Put the points into lanes, as ``aim``, of a driver whose perception and preferences no effect changes."""
    look, wanted = size + 1, preferences(driver)
    for point in range(2 * size):
        look_around(work, size, point)
        if view == ALONE:
            put_into(lanes, free + point, np.inf, work[look, 0], 0.0, wanted)
        else:
            put_into(lanes, free + point, work[look, 0], work[look, 1], work[look, 2], wanted)


@kernel(allocates=False)
def side_of(size: int, point: int) -> float:
    """Return how far a point is from the centre, along its column of the root."""
    return math.sqrt(size) if point % 2 == 0 else -math.sqrt(size)


@kernel(allocates=False)
def look_around(work: Array, size: int, point: int) -> None:
    """Fill in the row below the centre with one of the points of the cubature."""
    side = side_of(size, point)
    for i in range(size):
        work[size + 1, i] = work[size, i] + side * work[i, point // 2]


@kernel(allocates=False)
def surroundings(m: int, state: State, parameters: Array, moment: Moment, scene: Scene) -> Seen:
    """Return what driver m of a chain sees at the mean of the state."""
    mean, known, length, rear = state.mean, state.known, moment.length, moment.rear
    last = len(known) - 1
    x = STATE * m
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
    elif not math.isnan(rear[0]):
        headway = mean[x] - rear[0]
        if scene.circumference_m > 0.0:
            headway -= scene.circumference_m * math.floor(headway / scene.circumference_m)
        rear_gap, rear_speed = headway - 0.5 * (length[m] + rear[2]), rear[1]
    acceleration = mean[x + 3] + parameters[m, RHO] * mean[x + 2]
    # where the chain holds no past: as far as the present accelerations tell
    ago = looks_back(parameters[m])
    return Seen(
        gap=gap,
        speed=mean[x + 1],
        leader_speed=leader_speed,
        position=mean[x],
        time=moment.time_s,
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
    )


@kernel(allocates=False)
def seen_at(
    here: Seen, work: Array, m: int, size: int, view: int, known: Ints, parameters: Array, scene: Scene
) -> Seen:
    """Return what driver m sees at the point of the cubature that ``look_around`` has filled in."""
    centre, look = size, size + 1
    acceleration, leader_acceleration = here.acceleration, here.leader_acceleration
    if view == ALONE:
        gap, speed, leader_speed = np.inf, work[look, 0], 0.0
    elif view == RECALLING:
        gap, speed, leader_speed = here.gap, work[look, 1], here.leader_speed
    else:
        gap, speed, leader_speed = work[look, 0], work[look, 1], work[look, 2]
    past_gap = gap + (here.past_gap - here.gap) if view != ALONE else gap
    past_speed = speed + (here.past_speed - here.speed)
    past_leader_speed = leader_speed + (here.past_leader_speed - here.leader_speed)
    if view == RECALLING:
        past_gap, past_leader_speed, past_speed = work[look, 0], work[look, 2], work[look, 3]
    if view == FEELING:
        leader_rho = scene.last_rho if is_last(m + 1, known) else parameters[m + 1, RHO]
        acceleration += parameters[m, RHO] * (work[look, 3] - work[centre, 3])
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
        past_gap=past_gap,
        past_speed=past_speed,
        past_leader_speed=past_leader_speed,
    )
