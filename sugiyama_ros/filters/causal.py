"""The strictly causal filter: drivers act on the filtered states of themselves and of those ahead.

The paper takes what a driver perceives from smoothed measurements, which know the future, as a given control. Here the
mean action is a function of the filtered state and enters the covariance, so that an innovation depends on the past
alone. A driver is filtered together with a chain of vehicles ahead,

    own -> leader -> ... -> last.

Each but the last drives by the paper's model (Eq. ssm_form) behind the next; the last moves with an AR(1) acceleration,
because nobody tells what he follows. For a driver the state is (position, speed, noise, held), where the noise
n_t = rho n_{t-1} + shock is what his acceleration has beyond what he means and the environment adds, and held is the
acceleration that he made his car do in the last period (the mean action, but for effects); for the last vehicle the
noise is the whole acceleration. Parameters that are adapted online follow as logarithms that wander around their prior
(Ornstein-Uhlenbeck), so that one which the data do not hold cannot run away.

Effects act where they do in ``effects.control``. What they take from beyond a driver's own speed and his leader's
position and speed (the vehicle behind, the second one ahead) enters with its mean, and so do the accelerations, but for
drivers who see late.

The mean action is linearised statistically, over what the driver may be seeing: its Jacobian at a point makes an
extended Kalman filter whose likelihood is chaotic, because close to contact the mean action jumps.

One function, ``linearise``, states the model; the compiled ``run`` and the filterpy filter of ``online`` both use it.
What it calls for every driver and sample makes no arrays and counts no references to those that it is given.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sugiyama_ros.driver.parameters import (
    NAMES,
    OMEGA_2,
    REFERENCE_HORIZON,
    RHO,
    SIGMA_A,
    SIGMA_NU,
    SIGMA_V,
    SIGMA_X,
    UTILITY,
    at_period,
    horizon_at,
    population,
)
from sugiyama_ros.driver.utility import ACTIONS, room_for
from sugiyama_ros.effects.control import expect_change, intend, lean, noise_factor, remembers
from sugiyama_ros.effects.effect import Seen
from sugiyama_ros.effects.outlier_noise import weigh
from sugiyama_ros.effects.registry import WIDTH, place, whole
from sugiyama_ros.effects.sensor_eccentricity import displacement
from sugiyama_ros.effects.uneven_noise import factor as noise_std_factor
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Array, Ints
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Vehicles in a chain: own, leader and the leader's leader.
CHAIN = 3
#: Acceleration of the last vehicle of a chain: correlation over the reference period and std [m/s^2] of its shock.
LAST_RHO, LAST_SHOCK_STD = 0.9, 0.7
#: Samples after the start of a vehicle's record (or after a break) whose innovations are not scored.
SETTLING = 6
#: A vehicle is known by nothing, by one position, or by position and speed.
UNKNOWN, POSITION, MOVING = 0, 1, 2
#: Entries of the state for each vehicle: position, speed, noise, held acceleration.
STATE = 4
_OUTLIERS, _OFF_CENTRE = place("outlier_noise", "share"), place("sensor_eccentricity", "cosine")
_UNEVEN = place("uneven_noise", "cosine")
_DRIFT, _DELAY = place("preference_drift", "std"), place("reaction_delay", "delay")
# Acceleration [m/s^2] for which a speed from two positions allows.
_START_ACCELERATION_STD = 1.0
# Variance below which a direction of what the driver sees counts as known; keeps the Cholesky factor invertible.
_KNOWN_VAR = 1e-12


class Scene(NamedTuple):
    """What a chain's filter needs besides the drivers' parameters; ``scene_at`` makes it."""

    period_s: float
    horizon: int
    circumference_m: float
    last_rho: float
    last_shock_std: float
    memory: float


def scene_at(period_s: float, circumference_m: float, relaxation_s: float = math.inf) -> Scene:
    """Scene for a period [s] on a ring of ``circumference_m`` [m] (0: open road).

    relaxation_s: time [s] in which adapted parameters return to their prior; its correlation over a period is kept.
    """
    rho = LAST_RHO ** (REFERENCE_HORIZON / horizon_at(period_s))
    shock = LAST_SHOCK_STD * math.sqrt((1.0 - rho * rho) / (1.0 - LAST_RHO**2))
    return Scene(period_s, horizon_at(period_s), circumference_m, rho, shock, math.exp(-period_s / relaxation_s))


class Workspace(NamedTuple):
    """Where a chain's filter works out the expected actions; ``workspace_for`` makes it.

    room: of ``room_for`` the drivers' actions; places: (2, 5 + A) of what an action depends on; root: (9 + A, 5 + A),
    of its covariance, and rows below; slope, held_slope: (4 M + A,) regressions on the state.
    """

    room: Array
    places: Ints
    root: Array
    slope: Array
    held_slope: Array


@njit(cache=True)
def workspace_for(actions: Array, vehicles: int, adapted: int) -> Workspace:
    """Workspace of chains of M ``vehicles`` with A ``adapted`` parameters, whose drivers consider actions (K,)."""
    size, most = STATE * vehicles + adapted, 5 + adapted
    places, root = np.empty((2, most), np.int64), np.empty((4 + most, most))
    return Workspace(room_for(actions), places, root, np.empty(size), np.empty(size))


@lean
def _look(m: int, led: bool, delayed: bool, vehicles: int, adapted: int, places: Ints) -> int:
    """What the action of driver m depends on, as differences of state entries: to add and to take off, or -1.

    These are the gap (lengths aside), the own and the leader's speed, or without a leader the own speed alone; for one
    who sees late also the noises of both, part of the accelerations; then the logarithms of the adapted parameters.
    Filled: the first of places (2, at least 5 + A), whose number is returned.
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


@lean
def _root(covariance: Array, places: Ints, size: int, root: Array) -> None:
    """Lower Cholesky factor of the covariance of what is looked at, as ``_look`` gives it, into ``root``."""
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


@lean
def _regress(work: Array, row: int, places: Ints, size: int, slope: Array) -> None:
    """Regression on the state into ``slope``, from what an action shares with each column of the root; spoils it.

    work: the root, and in ``row`` what is shared.
    """
    # The covariance of the action with what is looked at is root @ cross, that of the latter root @ root.T.
    slope[:] = 0.0
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            work[row, i] -= work[k, i] * work[row, k]
        work[row, i] /= work[i, i]
        slope[places[0, i]] += work[row, i]
        if places[1, i] >= 0:
            slope[places[1, i]] -= work[row, i]


@lean
def _variance_along(slope: Array, covariance: Array) -> float:
    """Variance of what changes with the state by ``slope``."""
    variance = 0.0
    for i in range(len(slope)):
        for j in range(len(slope)):
            variance += slope[i] * covariance[i, j] * slope[j]
    return variance


@lean
def _surroundings(
    m: int,
    known: Ints,
    mean: Array,
    length: Array,
    rear: Array,
    parameters: Array,
    time: float,
    scene: Scene,
) -> Seen:
    """What driver m of a chain sees at the state ``mean``; rear: position [m], speed and length of the one behind."""
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
        gap,
        mean[x + 1],
        leader_speed,
        mean[x],
        time,
        scene.circumference_m,
        mean[x + 3] + parameters[m, RHO] * mean[x + 2],
        leader_acceleration,
        second_gap,
        second_speed,
        rear_gap,
        rear_speed,
    )


@lean
def expected_action(
    m: int,
    known: Ints,
    mean: Array,
    covariance: Array,
    length: Array,
    rear: Array,
    parameters: Array,
    adapted: Ints,
    workspace: Workspace,
    time: float,
    scene: Scene,
) -> tuple[float, float, float, float]:
    """Expectation [m/s^2] over what a chain's driver m may be seeing: of what he holds, and of that with what pushes.

    Third-degree spherical cubature (Arasaratnam and Haykin 2009) over the gap, the speeds, and the adapted parameters.
    ``held_slope`` and ``slope`` of the workspace take the regressions of both on the state; returned are both
    expectations and both variances [m^2/s^4] that the regressions leave. The adapted entries of the driver's row are
    changed on the way and put back.
    """
    places, work, slope, held_slope = workspace.places, workspace.root, workspace.slope, workspace.held_slope
    led = known[m + 1] == MOVING
    driver = parameters[m]
    delayed = led and driver[_DELAY] != 0.0
    size = _look(m, led, delayed, len(known), len(adapted), places)
    # the root, and below it rows of their own
    centre, look, cross, held_cross = size, size + 1, size + 2, size + 3
    _root(covariance, places, size, work)
    for i in range(size):
        work[centre, i] = mean[places[0, i]]
        work[cross, i] = work[held_cross, i] = 0.0
    here = _surroundings(m, known, mean, length, rear, parameters, time, scene)
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
            if led:
                gap, speed, leader_speed = work[look, 0], work[look, 1], work[look, 2]
            else:
                gap, speed, leader_speed = np.inf, work[look, 0], 0.0
            acceleration, leader_acceleration = here.acceleration, here.leader_acceleration
            if delayed:
                acceleration += driver[RHO] * (work[look, 3] - work[centre, 3])
                leader_acceleration += leader_rho * (work[look, 4] - work[centre, 4])
            seen = Seen(
                gap,
                speed,
                leader_speed,
                here.position,
                time,
                here.circumference,
                acceleration,
                leader_acceleration,
                here.second_gap,
                here.second_speed,
                here.rear_gap,
                here.rear_speed,
            )
            held, pushed = intend(seen, driver, workspace.room, scene.period_s, scene.horizon)
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
    _regress(work, cross, places, size, slope)
    _regress(work, held_cross, places, size, held_slope)
    if not remembers(driver):
        return held_expected, expected, held_spread, spread
    # what he means goes with what he has held to what he holds now; what pushes does not
    pushed, pushed_spread = expected - held_expected, max(spread - held_spread, 0.0)
    slope -= held_slope
    place = STATE * m + 3
    held_slope[place] -= 1.0
    variance: float = max(_variance_along(held_slope, covariance) + held_spread, _KNOWN_VAR)
    change, share, left = expect_change(held_expected - mean[place], variance, driver, scene.period_s)
    held_slope *= share
    held_slope[place] += 1.0
    slope += held_slope
    held_expected, held_spread = mean[place] + change, share * share * held_spread + left
    return held_expected, held_expected + pushed, held_spread, held_spread + pushed_spread


@lean
def linearise(
    mean: Array,
    covariance: Array,
    known: Ints,
    length: Array,
    rear: Array,
    parameters: Array,
    adapted: Ints,
    prior_mean: Array,
    prior_var: Array,
    workspace: Workspace,
    time: float,
    scene: Scene,
    next_mean: Array,
    jacobian: Array,
    noise: Array,
) -> float:
    """One period of Eq. ssm_form for a whole chain; returns what the own driver means to do [m/s^2].

    mean: (4 M + A,) and its covariance; known: (M,) of UNKNOWN, POSITION, MOVING; length: (M,) [m]; rear: (3,) position
    [m], speed and length of the vehicle behind, NaN for none; parameters: (M, WIDTH) at this period, row 0 with the
    present value of the adapted ones; adapted: (A,) places in UTILITY; prior_mean, prior_var: (A,) of their logarithms;
    workspace: of ``workspace_for`` the chain; time [s] of the recording.
    Overwritten: next_mean (4 M + A,), jacobian and the process noise Q, both (4 M + A, 4 M + A).
    """
    vehicles = len(known)
    period = scene.period_s
    own_action = 0.0
    for k in range(len(mean)):
        next_mean[k] = mean[k]
    jacobian[:] = 0.0
    noise[:] = 0.0
    for k in range(len(adapted)):
        p = STATE * vehicles + k
        next_mean[p] = prior_mean[k] + scene.memory * (mean[p] - prior_mean[k])
        jacobian[p, p] = scene.memory
        noise[p, p] = prior_var[k] * (1.0 - scene.memory**2)
    for m in range(vehicles):
        x, v, n, b = STATE * m, STATE * m + 1, STATE * m + 2, STATE * m + 3
        jacobian[x, x] = jacobian[v, v] = 1.0
        if known[m] != MOVING:
            continue
        jacobian[x, v] = jacobian[v, n] = period
        next_mean[x] = mean[x] + period * mean[v]
        noise[x, x], noise[v, v] = parameters[m, SIGMA_X] ** 2, parameters[m, SIGMA_V] ** 2
        if m == vehicles - 1:
            action, rho, shock_std = 0.0, scene.last_rho, scene.last_shock_std
            next_mean[b] = 0.0
        else:
            held, action, held_spread, spread = expected_action(
                m,
                known,
                mean,
                covariance,
                length,
                rear,
                parameters,
                adapted if m == 0 else adapted[:0],
                workspace,
                time,
                scene,
            )
            noise[v, v] += period * period * spread
            noise[b, b] = held_spread
            noise[v, b] = noise[b, v] = period * math.sqrt(spread * held_spread)
            next_mean[b] = held
            for k in range(len(mean)):
                jacobian[v, k] += period * workspace.slope[k]
                jacobian[b, k] = workspace.held_slope[k]
            if m == 0:
                own_action = held
            rho = parameters[m, RHO]
            shock_std = parameters[m, SIGMA_A] * noise_factor(mean[v], parameters[m])
        next_mean[v] = mean[v] + period * (action + mean[n])
        next_mean[n] = rho * mean[n]
        jacobian[n, n] = rho
        noise[n, n] = shock_std**2
    return own_action


@lean
def _predict(covariance: Array, jacobian: Array, noise: Array, half: Array) -> None:
    """F P F' + Q in place; most of F is 0.

    half: (size + 1, size), overwritten, with (F P)' so that all rows run on, and below it one row of F P.
    """
    size = len(covariance)
    for i in range(size):
        for j in range(size):
            half[size, j] = 0.0
        for k in range(size):
            factor = jacobian[i, k]
            if factor != 0.0:
                for j in range(size):
                    half[size, j] += factor * covariance[k, j]
        for j in range(size):
            half[j, i] = half[size, j]
    for i in range(size):
        for j in range(size):
            covariance[i, j] = noise[i, j]
        for k in range(size):
            factor = jacobian[i, k]
            if factor != 0.0:
                for j in range(size):
                    covariance[i, j] += factor * half[k, j]


@njit(cache=True)
def forget_vehicle(m: int, mean: Array, covariance: Array, known: Ints) -> None:
    """Make vehicle m of a chain UNKNOWN, uncorrelated with all else."""
    known[m] = UNKNOWN
    for k in range(STATE * m, STATE * (m + 1)):
        mean[k] = 0.0
        covariance[k, :] = 0.0
        covariance[:, k] = 0.0


@njit(cache=True)
def start_vehicle(
    m: int,
    measured: float,
    elapsed: float,
    mean: Array,
    covariance: Array,
    known: Ints,
    parameters: Array,
    scene: Scene,
) -> None:
    """Take in a sample [m] of a vehicle that is not MOVING yet: the first gives its position, the second its speed.

    Two-point initialisation (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation,
    section 5.5.3); ``elapsed``: time [s] since the first.
    """
    x, v, n, b = STATE * m, STATE * m + 1, STATE * m + 2, STATE * m + 3
    circumference = scene.circumference_m
    measured -= measurement(measured, parameters[m], scene)[0]
    if known[m] == UNKNOWN:
        known[m] = POSITION
        mean[x] = measured
        if m > 0 and known[m - 1] != UNKNOWN and circumference > 0.0:
            headway = measured - mean[x - STATE]
            mean[x] = mean[x - STATE] + headway - circumference * math.floor(headway / circumference)
        return
    known[m] = MOVING
    way = measured - mean[x]
    if circumference > 0.0:
        way -= circumference * round(way / circumference)
    mean[x] += way
    mean[v] = way / elapsed
    noise_var = noise_var_at(mean[x], parameters[m], scene)
    covariance[x, x] = noise_var
    covariance[x, v] = covariance[v, x] = noise_var / elapsed
    covariance[v, v] = 2.0 * noise_var / elapsed**2 + (elapsed * _START_ACCELERATION_STD) ** 2
    if m < len(known) - 1:
        covariance[n, n] = parameters[m, SIGMA_A] ** 2 / (1.0 - parameters[m, RHO] ** 2)
        covariance[b, b] = _START_ACCELERATION_STD**2 if remembers(parameters[m]) else 0.0
    else:
        covariance[n, n] = scene.last_shock_std**2 / (1.0 - scene.last_rho**2)


@lean
def measurement(position: float, parameters: Array, scene: Scene) -> tuple[float, float]:
    """What a measured position has beyond the true one [m] but noise, and one plus its derivative: an entry of H."""
    if parameters[_OFF_CENTRE] == 0.0 and parameters[_OFF_CENTRE + 1] == 0.0:
        return 0.0, 1.0
    off, slope = displacement(position, scene.circumference_m, parameters[_OFF_CENTRE : _OFF_CENTRE + 2])
    return off, 1.0 + slope


@lean
def noise_var_at(position: float, parameters: Array, scene: Scene) -> float:
    """Variance [m^2] of the measurement noise at a position [m]."""
    variance: float = parameters[SIGMA_NU] ** 2
    if parameters[_UNEVEN] == 0.0 and parameters[_UNEVEN + 1] == 0.0:
        return variance
    return variance * noise_std_factor(position, scene.circumference_m, parameters[_UNEVEN : _UNEVEN + 2]) ** 2


@lean
def robust(y: float, variance: float, parameters: Array) -> tuple[float, float, float]:
    """How much of P H' y is added to the mean, how much of P H' H P is taken off P, and the sample's log-likelihood.

    Both are 1/S but for outliers: then the mixture of both updates is replaced by its mean and covariance.
    """
    if parameters[_OUTLIERS] == 0.0:
        return 1.0 / variance, 1.0 / variance, -0.5 * (math.log(variance) + y * y / variance)
    bad, wide, density = weigh(y, variance, parameters[SIGMA_NU] ** 2, parameters[_OUTLIERS : _OUTLIERS + 2])
    gain = (1.0 - bad) / variance + bad / wide
    between = (1.0 - bad) / variance**2 + bad / wide**2 - gain * gain
    return gain, gain - y * y * between, density


@njit(cache=True, nogil=True)
def weigh_samples(y: Array, variance: Array, parameters: Array, weight: Array, density: Array) -> None:
    """What each innovation (T,) counts, 1 but for outliers, and its log-likelihood; into the last two, (T,) each."""
    for t in range(len(y)):
        gain, _, density[t] = robust(y[t], variance[t], parameters)
        weight[t] = gain * variance[t]


@njit(cache=True, nogil=True)
def run(
    position: Array,
    identity: Ints,
    length: Array,
    rear: Array,
    parameters: Array,
    adapted: Ints,
    prior_var: Array,
    actions: Array,
    start_s: float,
    scene: Scene,
    innovation: Array,
    innovation_var: Array,
    log_likelihood: Array,
    means: Array,
    covariances: Array,
    motion: Array,
) -> float:
    """Filter one chain over T samples; returns the log-likelihood of Eq. SSM_Likelihood (no 2 pi term).

    position: (T, M) [m], NaN where missing; identity: (T, M) which vehicle it is, -1 for none; length: (T, M) [m];
    rear: (T, 3) of the vehicle behind as for ``linearise``; parameters: (M, WIDTH) at this period; adapted, prior_var:
    (A,); start_s: time [s] of the first sample. Filled: innovation [m], innovation_var [m^2] and log_likelihood (T,) of
    the own position, NaN where there is none or where it does not count. Filled where they have room: means
    (T, 4 M + A) after the update; covariances (T, 4 M + A, 4 M + A) there, and with them motion (T, 2), own
    acceleration and what he means to do [m/s^2].
    """
    samples, vehicles = position.shape
    size = STATE * vehicles + len(adapted)
    circumference = scene.circumference_m
    parameters, workspace = parameters.copy(), workspace_for(actions, vehicles, len(adapted))
    mean, covariance, known = np.zeros(size), np.zeros((size, size)), np.zeros(vehicles, np.int64)
    next_mean, gain = np.zeros(size), np.zeros(size)
    jacobian, noise, half = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size + 1, size))
    prior_mean = np.empty(len(adapted))
    for k in range(len(adapted)):
        prior_mean[k] = math.log(parameters[0, UTILITY[adapted[k]]])
        mean[STATE * vehicles + k] = prior_mean[k]
        covariance[STATE * vehicles + k, STATE * vehicles + k] = prior_var[k]
    waited = np.zeros(vehicles, np.int64)
    settled = 0
    total = 0.0
    for t in range(samples):
        if t > 0:
            mean[:] = next_mean
            _predict(covariance, jacobian, noise, half)
        innovation[t], innovation_var[t], log_likelihood[t] = np.nan, np.nan, np.nan
        settled += 1
        for m in range(vehicles):
            waited[m] += 1
            if identity[t, m] < 0 or (t > 0 and identity[t, m] != identity[t - 1, m]):
                forget_vehicle(m, mean, covariance, known)
                if m == 0:
                    settled = 0
            if identity[t, m] < 0:
                continue
            x = STATE * m
            off, factor = measurement(mean[x], parameters[m], scene)
            variance = factor * factor * covariance[x, x] + noise_var_at(mean[x], parameters[m], scene)
            if m == 0 and known[0] == MOVING:
                innovation_var[t] = variance
            if math.isnan(position[t, m]):
                continue
            if known[m] != MOVING:
                start_vehicle(m, position[t, m], waited[m] * scene.period_s, mean, covariance, known, parameters, scene)
                waited[m] = 0
                continue
            y = position[t, m] - mean[x] - off
            if circumference > 0.0:
                y -= circumference * round(y / circumference)
            step, shrink, density = robust(y, variance, parameters[m])
            if m == 0:
                innovation[t] = y
                if settled > SETTLING:
                    log_likelihood[t] = density
                    total += density
            for i in range(size):
                gain[i] = factor * covariance[i, x]
            for i in range(size):
                mean[i] += gain[i] * step * y
                for j in range(size):
                    covariance[i, j] -= gain[i] * gain[j] * shrink
        for k in range(len(adapted)):
            parameters[0, UTILITY[adapted[k]]] = math.exp(mean[STATE * vehicles + k])
        action = linearise(
            mean,
            covariance,
            known,
            length[t],
            rear[t],
            parameters,
            adapted,
            prior_mean,
            prior_var,
            workspace,
            start_s + t * scene.period_s,
            scene,
            next_mean,
            jacobian,
            noise,
        )
        if len(means) > 0:
            means[t] = mean
        if len(covariances) > 0:
            covariances[t] = covariance
            motion[t, 0], motion[t, 1] = (next_mean[1] - mean[1]) / scene.period_s, action
    return total


@dataclass(frozen=True, eq=False)
class Chain:
    """What is measured of one driver and of the vehicles ahead of him, M in all, own first.

    position_m: (T, M), NaN where missing; identity: (T, M) number of the vehicle, -1 for none; length_m: (T, M);
    rear: (T, 3) filtered position [m] and speed [m/s], and length [m], of the vehicle behind, NaN where there is none;
    start_s: time [s] of the first sample.
    """

    position_m: Array
    identity: Ints
    length_m: Array
    rear: Array
    period_s: float
    start_s: float
    circumference_m: float


def chain_behind(trajectories: Trajectories, driver: int, vehicles: int = CHAIN, segment: Ints | None = None) -> Chain:
    """The chain of ``vehicles`` vehicles that starts with the driver of column ``driver`` and looks ahead.

    Where ``segment`` (T,) changes, the recording is broken: from there on the vehicles count as others.
    """
    samples = np.arange(len(trajectories.position_m))
    column = np.where(trajectories.present[:, driver], driver, -1)
    columns = [column]
    for _ in range(vehicles - 1):
        column = np.where(column >= 0, trajectories.leader[samples, column], -1)
        # on a ring with few vehicles the chain ends before it bites its own tail
        column = np.where(np.any([column == before for before in columns], axis=0), -1, column)
        columns.append(column)
    chain = _of_columns(trajectories, np.stack(columns, axis=1), segment)
    follows = (trajectories.leader == driver) & trajectories.present
    behind = np.where(follows.any(axis=1), follows.argmax(axis=1), -1)
    return replace(chain, rear=track(_of_columns(trajectories, behind[:, None], segment)))


def _of_columns(trajectories: Trajectories, columns: Ints, segment: Ints | None) -> Chain:
    """Chain of the vehicles in ``columns`` (T, M), -1 for none, with nobody behind."""
    samples = np.arange(len(columns))
    there = columns >= 0
    identity = trajectories.vehicle[columns]
    if segment is not None:
        identity = identity + (int(trajectories.vehicle.max()) + 1) * segment[:, None]
    return Chain(
        position_m=np.where(there, trajectories.position_m[samples[:, None], columns], np.nan),
        identity=np.where(there, identity, -1),
        length_m=np.where(there, trajectories.length_m[columns], 0.0),
        rear=np.full((len(columns), 3), np.nan),
        period_s=trajectories.period_s,
        start_s=trajectories.start_s,
        circumference_m=trajectories.road.circumference_m,
    )


def track(alone: Chain) -> Array:
    """Filtered position [m] and speed [m/s], and length [m], (T, 3), of one vehicle with an AR(1) acceleration."""
    filtered = filter_chain(alone, population())
    tracked = np.column_stack([filtered.mean[:, :2], alone.length_m[:, 0]])
    tracked[~np.isfinite(filtered.innovation_var)] = np.nan
    return tracked


@dataclass(frozen=True, eq=False)
class Filtered:
    """What the causal filter says of one driver over T samples, after the update with each.

    innovation_m, innovation_var: (T,), NaN where nothing was predicted or measured; sample_log_likelihood: (T,), NaN
    where a sample does not count; mean: (T, 4 M + A), covariance: (T, 4 M + A, 4 M + A) of the chain's state and the
    adapted log parameters; acceleration, mean_action: (T,) [m/s^2] own. The own position is continuous, not wrapped.
    """

    innovation_m: Array
    innovation_var: Array
    sample_log_likelihood: Array
    mean: Array
    covariance: Array
    acceleration: Array
    mean_action: Array
    log_likelihood: float

    @property
    def scored(self) -> NDArray[np.bool_]:
        """(T,): whether a sample counts."""
        return np.isfinite(self.sample_log_likelihood)


@dataclass(frozen=True)
class Adaptation:
    """Which of the utility's parameters are adapted online, and the prior std of their logarithms.

    relaxation_s: time [s] in which they forget what was learnt; infinite for drivers who never change.
    """

    names: tuple[str, ...] = ()
    prior_std: tuple[float, ...] = ()
    relaxation_s: float = math.inf

    def __post_init__(self) -> None:
        # omega_2 is negative, so it has no logarithm
        adaptable = [NAMES[k] for k in UTILITY if k != OMEGA_2]
        if len(self.names) != len(self.prior_std):
            raise InputError(f"adapt: {len(self.names)} names and {len(self.prior_std)} prior stds; give one each")
        for name in self.names:
            if name not in adaptable:
                raise InputError(f"adapt: {name!r} cannot be adapted online; choose among {', '.join(adaptable)}")

    @property
    def arrays(self) -> tuple[Ints, Array]:
        """Places in UTILITY and prior variances of the logarithms, (A,) each."""
        places = np.array([UTILITY.index(NAMES.index(name)) for name in self.names], dtype=np.int64)
        return places, np.array(self.prior_std, dtype=np.float64) ** 2


def chain_parameters(own: Array, ahead: Array | None, vehicles: int, period_s: float) -> Array:
    """Rows (M, WIDTH) at ``period_s`` of a chain: ``own`` (P,), then ``ahead`` (P,) for all vehicles ahead.

    Either may be a whole row (WIDTH,) with effects; ``ahead`` may be rows, (M - 1, P), for each vehicle ahead.
    """
    rows = np.empty((vehicles, WIDTH))
    rows[1:] = whole(population() if ahead is None else ahead)
    rows[0] = whole(own)
    return at_period(rows, period_s)


def adaptation_of(parameters: Array, given: Adaptation = Adaptation()) -> Adaptation:
    """How a driver's preferences wander by the effect preference_drift of his row, if it is there; else as given."""
    if len(parameters) <= _DRIFT or parameters[_DRIFT] == 0.0:
        return given
    std = float(parameters[_DRIFT])
    return Adaptation(("v_star", "kappa_v"), (std, std), float(parameters[_DRIFT + 1]))


def filter_chain(
    chain: Chain, parameters: Array, adaptation: Adaptation = Adaptation(), ahead: Array | None = None
) -> Filtered:
    """Filter one driver's chain with his parameters (P,) and those of the drivers ahead (P,), else ``population()``."""
    samples, vehicles = chain.position_m.shape
    size = STATE * vehicles + len(adaptation_of(parameters, adaptation).names)
    means, covariances, motion = np.empty((samples, size)), np.empty((samples, size, size)), np.empty((samples, 2))
    innovation, variance, of_sample, total = _run(chain, parameters, adaptation, ahead, means, covariances, motion)
    return Filtered(innovation, variance, of_sample, means, covariances, motion[:, 0], motion[:, 1], total)


def predict_samples(chain: Chain, parameters: Array, ahead: Array | None = None) -> tuple[Array, Array, Array]:
    """Innovation [m], its variance [m^2] and the log-likelihood of every sample, (T,) each; as in ``Filtered``."""
    nothing = np.empty((0, 0))
    return _run(chain, parameters, Adaptation(), ahead, nothing, np.empty((0, 0, 0)), nothing)[:3]


def predict_states(chain: Chain, parameters: Array, ahead: Array | None = None) -> tuple[Array, Array, Array, Array]:
    """As ``predict_samples``, and the own state (T, STATE) after the update with each sample; as in ``Filtered``."""
    nothing = np.empty((0, 0))
    size = STATE * chain.position_m.shape[1] + len(adaptation_of(parameters).names)
    means = np.empty((len(chain.position_m), size))
    y, variance, density, _ = _run(chain, parameters, Adaptation(), ahead, means, np.empty((0, 0, 0)), nothing)
    return y, variance, density, means[:, :STATE]


def log_likelihood(chain: Chain, parameters: Array, ahead: Array | None = None) -> float:
    """Log-likelihood of one driver's chain in the causal formulation; Eq. SSM_Likelihood (no 2 pi term)."""
    nothing = np.empty((0, 0))
    return _run(chain, parameters, Adaptation(), ahead, nothing, np.empty((0, 0, 0)), nothing)[3]


def _run(
    chain: Chain,
    parameters: Array,
    adaptation: Adaptation,
    ahead: Array | None,
    means: Array,
    covariances: Array,
    motion: Array,
) -> tuple[Array, Array, Array, float]:
    period, samples = chain.period_s, len(chain.position_m)
    adaptation = adaptation_of(parameters, adaptation)
    outputs = np.empty(samples), np.empty(samples), np.empty(samples)
    total = run(
        chain.position_m,
        chain.identity,
        chain.length_m,
        chain.rear,
        chain_parameters(parameters, ahead, chain.position_m.shape[1], period),
        *adaptation.arrays,
        ACTIONS,
        chain.start_s,
        scene_at(period, chain.circumference_m, adaptation.relaxation_s),
        *outputs,
        means,
        covariances,
        motion,
    )
    return *outputs, float(total)
