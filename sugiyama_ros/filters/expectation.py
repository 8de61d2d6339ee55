"""The expected action of a driver in a chain, over everything that the driver may be seeing, and its regressions.

The mean action is linearised statistically: its Jacobian at a point would make an extended Kalman filter whose
likelihood is chaotic, because the mean action jumps close to contact. First ``points.aim`` puts the points of the
cubature into lanes, then the drivers in all lanes decide at once, and then follow the expectations.

These functions run for every driver and sample. They make no arrays.
"""

from typing import NamedTuple

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.lanes import LANES, UTILITIES, Lanes, mean_in
from sugiyama_ros.effects.control import (
    act,
    acts_on_intention,
    add_components,
    expect_change,
    law_acceleration,
    perceive,
    prefer,
    remembers,
    seeks,
)
from sugiyama_ros.filters.points import KNOWN_VAR, look_around, rows_of, seen_at, side_of, surroundings, view_of
from sugiyama_ros.filters.state import STATE, Drivers, Moment, Scene, State, Workspace
from sugiyama_ros.jit import kernel


class Expected(NamedTuple):
    """Expectations of an action [m/s^2], and the variances [m^2/s^4] that their regressions on the state leave.

    held: what the driver holds; action: the same with what the environment adds; held_var, action_var: of both.
    """

    held: float
    action: float
    held_var: float
    action_var: float


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
def value_components(
    m: int, state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace, lanes: Lanes
) -> None:
    """Add what effects add to the utilities of driver m; arguments as for ``aim``, which was called before."""
    driver, actions = drivers.parameters[m], lanes.grid.actions
    size, first = workspace.points[m, 0], workspace.points[m, 1]
    work = workspace.root[rows_of(m, workspace)[1] :]
    view = view_of(m, state, drivers)
    here = surroundings(m, state, drivers.parameters, moment, scene)
    for point in range(2 * size):
        look_around(work, size, point)
        seen = seen_at(here, work, m, size, view, state.known, drivers.parameters, scene)
        perceived = perceive(seen, driver)
        preferences = prefer(perceived, driver)
        block, lane, shared = (first + point) // LANES, UTILITIES + (first + point) % LANES, (actions, scene.period_s)
        if len(lanes.blocks) > 0:
            utility = lanes.blocks[block, lane:]
            add_components(perceived, *shared, scene.horizon, driver, preferences, lanes.added, utility, LANES)
        else:
            rough = lanes.rough[block, lane:]
            add_components(perceived, *shared, scene.horizon, driver, preferences, lanes.added, rough, LANES)


@kernel(allocates=False)
def expected_action(
    m: int, state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace, lanes: Lanes
) -> Expected:
    """Return the expected action of driver m of a chain, after ``aim`` and ``decide``.

    The expectation runs over the gap, the speeds and the adapted parameters. What the driver takes from elsewhere (the
    vehicle behind, the second vehicle ahead) enters with its mean, and so do the accelerations, unless the driver has a
    reaction delay.

    m, state, drivers, moment, scene, lanes: as for ``aim``; workspace: its ``slope`` and ``held_slope`` take the
    regressions of ``action`` and ``held`` on the state. Returns expectations [m/s^2] and the variances that the
    regressions leave.
    """
    driver, chosen = drivers.parameters[m], workspace.chosen
    size, first = workspace.points[m, 0], workspace.points[m, 1]
    place, row = rows_of(m, workspace)
    places, work = workspace.places[place : place + 2], workspace.root[row:]
    changed = acts_on_intention(driver) or not seeks(driver)
    if changed:
        _choose(m, state, drivers, moment, scene, workspace, lanes)
    else:
        for point in range(2 * size):
            action = mean_in(lanes, first + point)
            chosen[0, point] = chosen[1, point] = action
    # below the root stand rows of their own
    cross = size + 2
    held, held_var = _moments(chosen[0], work[cross], size)
    _regress(work, cross, places, size, workspace.held_slope)
    if changed:
        action, action_var = _moments(chosen[1], work[cross], size)
        _regress(work, cross, places, size, workspace.slope)
    else:
        action, action_var = held, held_var
        for i in range(len(workspace.slope)):
            workspace.slope[i] = workspace.held_slope[i]
    meant = Expected(held, action, held_var, action_var)
    return _carried_out(m, meant, state, driver, scene.period_s, workspace) if remembers(driver) else meant


@kernel(allocates=False)
def _choose(
    m: int, state: State, drivers: Drivers, moment: Moment, scene: Scene, workspace: Workspace, lanes: Lanes
) -> None:
    """Fill in ``chosen`` for a driver with another law, or with effects that act on what the driver intends."""
    driver, chosen = drivers.parameters[m], workspace.chosen
    size, first = workspace.points[m, 0], workspace.points[m, 1]
    work = workspace.root[rows_of(m, workspace)[1] :]
    view, by_law = view_of(m, state, drivers), not seeks(driver)
    here = surroundings(m, state, drivers.parameters, moment, scene)
    for point in range(2 * size):
        look_around(work, size, point)
        seen = seen_at(here, work, m, size, view, state.known, drivers.parameters, scene)
        if by_law:
            perceived = perceive(seen, driver)
            action = law_acceleration(perceived.gap, perceived.speed, perceived.leader_speed, driver)
        else:
            action = mean_in(lanes, first + point)
        held, pushed = act(action, seen, driver)
        chosen[0, point], chosen[1, point] = held, held + pushed


@kernel(allocates=False)
def _moments(chosen: Array, cross: Array, size: int) -> tuple[float, float]:
    """Return the mean of what was chosen at the points, and the variance that no regression on the state explains.

    cross: (size,), overwritten with the covariances of what was chosen with the columns of the root.
    """
    side, weight = side_of(size, 0), 0.5 / size
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
def _carried_out(m: int, meant: Expected, state: State, row: Array, period: float, workspace: Workspace) -> Expected:
    """Return what driver m carries out, who means ``meant`` and remembers what was held in the last period.

    The regressions in the workspace change with it. What the environment adds does not depend on the memory.
    """
    slope, held_slope = workspace.slope, workspace.held_slope
    pushed, pushed_var = meant.action - meant.held, max(meant.action_var - meant.held_var, 0.0)
    slope -= held_slope
    held = STATE * m + 3
    held_slope[held] -= 1.0
    variance: float = max(_variance_along(held_slope, state.covariance) + meant.held_var, KNOWN_VAR)
    change, share, left = expect_change(meant.held - state.mean[held], variance, row, period)
    held_slope *= share
    held_slope[held] += 1.0
    slope += held_slope
    expected, held_var = state.mean[held] + change, share * share * meant.held_var + left
    return Expected(expected, expected + pushed, held_var, held_var + pushed_var)
