"""What a step of the causal filter works on: the chain's state, its drivers, and the arrays that the step fills.

All of these are named tuples, so that compiled code and Python share them.
"""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.batch import Batch, batch_for
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON, UTILITY, horizon_at
from sugiyama_ros.jit import kernel

#: Acceleration of the last vehicle of a chain: correlation over the reference period and std [m/s^2] of its shock.
#: Maximum likelihood on the positions of single vehicles gives a std of 0.2 to 0.4 in the Sugiyama ring, and 0.1 (free
#: flow) to 0.6 (dense traffic) in simulations. The less it is, the larger is kappa_v: at 0.5 it is 0.2 standard errors
#: too large on the ring, and 0.4 too small in a short platoon behind a first car.
LAST_RHO, LAST_SHOCK_STD = 0.9, 0.5
#: A vehicle is known by nothing, by one position, or by position and speed.
UNKNOWN, POSITION, MOVING = 0, 1, 2
#: Entries of the state for each vehicle: position, speed, noise, held acceleration.
STATE = 4


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
    look back, the entries of ``past``; covariance: (4 M + A, 4 M + A); known: (M,), each UNKNOWN, POSITION or MOVING.
    """

    mean: Array
    covariance: Array
    known: Ints


class Drivers(NamedTuple):
    """The drivers of a chain, and which parameters of the own driver are adapted.

    parameters: (M, WIDTH) at the period of the samples, row 0 with the present values of the adapted ones; adapted:
    (A,) places in ``UTILITY``; prior_mean, prior_var: (A,) of the logarithms of the adapted parameters.
    """

    parameters: Array
    adapted: Ints
    prior_mean: Array
    prior_var: Array


@kernel
def drivers_at(parameters: Array, adapted: Ints, prior_var: Array) -> Drivers:
    """Return the drivers of C chains, whose adapted parameters have their present values as the prior mean.

    parameters: (C, M, WIDTH); prior_mean of the result: (C, A); all other arrays as in ``Drivers``.
    """
    prior_mean = np.empty((len(parameters), len(adapted)))
    for c in range(len(parameters)):
        for k in range(len(adapted)):
            prior_mean[c, k] = math.log(parameters[c, 0, UTILITY[adapted[k]]])
    return Drivers(parameters.copy(), adapted, prior_mean, prior_var)


class Moment(NamedTuple):
    """What changes from sample to sample besides the state.

    length: (M,) of the vehicles [m]; rear: (3,) position [m], speed [m/s] and length [m] of the vehicle behind, NaN
    where there is none; time_s: time of the recording [s].
    """

    length: Array
    rear: Array
    time_s: float


class Workspace(NamedTuple):
    """Arrays in which the expected actions of a chain's drivers are worked out; ``workspace_for`` makes them.

    places: two rows for each driver, what an action depends on, (2 (M - 1), 5 + A); root: 8 + A rows for each driver,
    root of its covariance, and rows below, (.., 5 + A); points: (M - 1, 2), for each driver the number of quantities
    that the action depends on, and the first slot of the batch; chosen: (2, 2 (5 + A)), what one driver holds at each
    point, and the same with what the environment adds; slope, held_slope: (4 M + A,), regressions of the action and of
    the held acceleration on the state.
    """

    places: Ints
    root: Array
    points: Ints
    chosen: Array
    slope: Array
    held_slope: Array


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
    """All that one step of a chain's filter reads and fills: what is known, and the arrays that it overwrites."""

    state: State
    drivers: Drivers
    moment: Moment
    scene: Scene
    workspace: Workspace
    batch: Batch
    out: Linearised


@kernel
def points_of(vehicles: int, adapted: int) -> int:
    """Return the largest number of points at which the drivers of a chain of M vehicles consider their actions."""
    return 2 * (vehicles - 1) * (5 + adapted)


@kernel
def workspace_for(vehicles: int, adapted: int, past: int) -> Workspace:
    """Return the workspace of a chain whose state has some entries for the ``past``."""
    size, most, drivers = STATE * vehicles + adapted + past, 5 + adapted, max(vehicles - 1, 1)
    places, root = np.zeros((2 * drivers, most), np.int64), np.zeros((drivers * (3 + most), most))
    chosen = np.zeros((2, 2 * most))
    return Workspace(places, root, np.zeros((drivers, 2), np.int64), chosen, np.zeros(size), np.zeros(size))


def step_for(state: State, drivers: Drivers, moment: Moment, scene: Scene, actions: Array) -> FilterStep:
    """Return a step of one chain with fresh arrays, all of whose covariances matter; actions: (K,) [m/s^2]."""
    vehicles, adapted, size = len(state.known), len(drivers.adapted), len(state.mean)
    batch = batch_for(points_of(vehicles, adapted), actions, scene.period_s, False)
    square, counts = (size, size), np.zeros(size, np.int64)
    of_period = np.zeros(size), np.zeros(square), np.zeros(square), np.zeros(square, np.int64), counts
    out = Linearised(*of_period, np.arange(size))
    return FilterStep(state, drivers, moment, scene, workspace_for(vehicles, adapted, 0), batch, out)
