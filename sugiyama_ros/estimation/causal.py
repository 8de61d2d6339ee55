"""The strictly causal filter: drivers act on the filtered states of themselves and of those ahead.

The paper takes what a driver perceives from smoothed measurements, which know the future, as a given control. Here the
mean action is a function of the filtered state and enters the covariance, so that an innovation depends on the past
alone. A driver is filtered together with a chain of vehicles ahead,

    own -> leader -> ... -> last.

Each but the last drives by the paper's model (Eq. ssm_form) behind the next; the last moves with an AR(1) acceleration,
because nobody tells what he follows. For a driver the state is (position, speed, noise), where the noise
n_t = rho n_{t-1} + shock is what his acceleration mean_action(s_t) + n_t has beyond the mean action; for the last
vehicle it is the whole acceleration. Parameters that are adapted online follow as logarithms that wander
around their prior (Ornstein-Uhlenbeck), so that one which the data do not hold cannot run away.

The mean action is linearised statistically, over what the driver may be seeing: its Jacobian at a point makes an
extended Kalman filter whose likelihood is chaotic, because close to contact the mean action jumps.

One function, ``linearise``, states the model; the compiled ``run`` and the filterpy filter of ``online`` both use it.
"""

import math
from dataclasses import dataclass
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
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Array, Ints
from sugiyama_ros.trajectories import Trajectories

#: Vehicles in a chain: own, leader and the leader's leader.
CHAIN = 3
#: Acceleration of the last vehicle of a chain: correlation over the reference period and std [m/s^2] of its shock.
LAST_RHO, LAST_SHOCK_STD = 0.9, 0.7
#: Samples after the start of a vehicle's record (or after a break) whose innovations are not scored.
SETTLING = 6
#: A vehicle is known by nothing, by one position, or by position and speed.
UNKNOWN, POSITION, MOVING = 0, 1, 2
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


@njit(cache=True)
def _looked_at(m: int, led: bool, vehicles: int, adapted: int) -> tuple[Ints, Ints]:
    """What the action of driver m depends on, as differences of state entries: places to add and to take off, or -1.

    These are the gap (lengths aside), the own and the leader's speed, or without a leader the own speed alone; then the
    logarithms of the adapted parameters.
    """
    x, v = 3 * m, 3 * m + 1
    seen = 3 if led else 1
    plus, minus = np.empty(seen + adapted, np.int64), np.full(seen + adapted, -1)
    if led:
        plus[0], plus[1], plus[2], minus[0] = x + 3, v, v + 3, x
    else:
        plus[0] = v
    for k in range(adapted):
        plus[seen + k] = 3 * vehicles + k
    return plus, minus


@njit(cache=True)
def _root(covariance: Array, plus: Ints, minus: Ints) -> Array:
    """Lower Cholesky factor (D, D) of the covariance of differences of state entries, as ``_looked_at`` gives them."""
    size = len(plus)
    root = np.zeros((size, size))
    for i in range(size):
        for j in range(i + 1):
            entry = covariance[plus[i], plus[j]]
            if minus[i] >= 0:
                entry -= covariance[minus[i], plus[j]]
            if minus[j] >= 0:
                entry -= covariance[plus[i], minus[j]]
            if minus[i] >= 0 and minus[j] >= 0:
                entry += covariance[minus[i], minus[j]]
            for k in range(j):
                entry -= root[i, k] * root[j, k]
            root[i, j] = math.sqrt(max(entry, _KNOWN_VAR)) if i == j else entry / root[j, j]
    return root


@njit(cache=True)
def expected_action(
    m: int,
    known: Ints,
    mean: Array,
    covariance: Array,
    length: Array,
    parameters: Array,
    adapted: Ints,
    actions: Array,
    scene: Scene,
    slope: Array,
) -> tuple[float, float]:
    """Expectation [m/s^2] of the mean action of a chain's driver m over what he may be seeing, and its spread.

    Third-degree spherical cubature (Arasaratnam and Haykin 2009) over the gap, the speeds, and the adapted parameters.
    ``slope`` (3 M + A,) takes the regression of the mean action on the state; the spread [m^2/s^4] is the variance that
    this regression leaves.
    """
    led = known[m + 1] == MOVING
    plus, minus = _looked_at(m, led, len(known), len(adapted))
    size = len(plus)
    root = _root(covariance, plus, minus)
    centre = mean[plus]
    if led:
        centre[0] -= mean[minus[0]] + 0.5 * (length[m] + length[m + 1])
    driver = parameters.copy()
    look, cross = np.empty(size), np.zeros(size)
    total, squares = 0.0, 0.0
    for j in range(size):
        for side in (math.sqrt(size), -math.sqrt(size)):
            for i in range(size):
                look[i] = centre[i] + side * root[i, j]
            for k in range(len(adapted)):
                driver[UTILITY[adapted[k]]] = math.exp(look[size - len(adapted) + k])
            gap, speed, leader_speed = (look[0], look[1], look[2]) if led else (np.inf, look[0], 0.0)
            action = mean_action(gap, speed, leader_speed, driver, actions, scene.period_s, scene.horizon)
            total += action
            squares += action * action
            cross[j] += action * side
    weight = 0.5 / size
    expected = weight * total
    cross *= weight
    spread = max(weight * squares - expected * expected - np.sum(cross * cross), 0.0)
    # The covariance of the action with what is looked at is root @ cross, that of the latter root @ root.T.
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            cross[i] -= root[k, i] * cross[k]
        cross[i] /= root[i, i]
    slope[:] = 0.0
    for i in range(size):
        slope[plus[i]] += cross[i]
        if minus[i] >= 0:
            slope[minus[i]] -= cross[i]
    return expected, spread


@njit(cache=True)
def linearise(
    mean: Array,
    covariance: Array,
    known: Ints,
    length: Array,
    parameters: Array,
    adapted: Ints,
    prior_mean: Array,
    prior_var: Array,
    actions: Array,
    scene: Scene,
    next_mean: Array,
    jacobian: Array,
    noise: Array,
) -> float:
    """One period of Eq. ssm_form for a whole chain; returns the own mean action [m/s^2].

    mean: (3 M + A,) and its covariance; known: (M,) of UNKNOWN, POSITION, MOVING; length: (M,) [m]; parameters: (M, P)
    at this period, row 0 with the present value of the adapted ones; adapted: (A,) places in UTILITY; prior_mean,
    prior_var: (A,) of their logarithms.
    Overwritten: next_mean (3 M + A,), jacobian (3 M + A, 3 M + A), and the diagonal of Q, noise (3 M + A,).
    """
    vehicles = len(known)
    period = scene.period_s
    slope = np.empty(len(mean))
    own_action = 0.0
    next_mean[:] = mean
    jacobian[:, :] = 0.0
    noise[:] = 0.0
    for k in range(len(adapted)):
        p = 3 * vehicles + k
        next_mean[p] = prior_mean[k] + scene.memory * (mean[p] - prior_mean[k])
        jacobian[p, p] = scene.memory
        noise[p] = prior_var[k] * (1.0 - scene.memory**2)
    for m in range(vehicles):
        x, v, n = 3 * m, 3 * m + 1, 3 * m + 2
        jacobian[x, x] = jacobian[v, v] = 1.0
        if known[m] != MOVING:
            continue
        jacobian[x, v] = jacobian[v, n] = period
        next_mean[x] = mean[x] + period * mean[v]
        noise[x], noise[v] = parameters[m, SIGMA_X] ** 2, parameters[m, SIGMA_V] ** 2
        if m == vehicles - 1:
            action, rho, shock_std = 0.0, scene.last_rho, scene.last_shock_std
        else:
            action, spread = expected_action(
                m,
                known,
                mean,
                covariance,
                length,
                parameters[m],
                adapted if m == 0 else adapted[:0],
                actions,
                scene,
                slope,
            )
            noise[v] += period * period * spread
            jacobian[v] += period * slope
            if m == 0:
                own_action = action
            rho, shock_std = parameters[m, RHO], parameters[m, SIGMA_A]
        next_mean[v] = mean[v] + period * (action + mean[n])
        next_mean[n] = rho * mean[n]
        jacobian[n, n] = rho
        noise[n] = shock_std**2
    return own_action


@njit(cache=True)
def forget_vehicle(m: int, mean: Array, covariance: Array, known: Ints) -> None:
    """Make vehicle m of a chain UNKNOWN, uncorrelated with all else."""
    known[m] = UNKNOWN
    for k in range(3 * m, 3 * m + 3):
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
    x, v, n = 3 * m, 3 * m + 1, 3 * m + 2
    circumference = scene.circumference_m
    if known[m] == UNKNOWN:
        known[m] = POSITION
        mean[x] = measured
        if m > 0 and known[m - 1] != UNKNOWN and circumference > 0.0:
            headway = measured - mean[x - 3]
            mean[x] = mean[x - 3] + headway - circumference * math.floor(headway / circumference)
        return
    known[m] = MOVING
    way = measured - mean[x]
    if circumference > 0.0:
        way -= circumference * round(way / circumference)
    mean[x] += way
    mean[v] = way / elapsed
    noise_var = parameters[m, SIGMA_NU] ** 2
    covariance[x, x] = noise_var
    covariance[x, v] = covariance[v, x] = noise_var / elapsed
    covariance[v, v] = 2.0 * noise_var / elapsed**2 + (elapsed * _START_ACCELERATION_STD) ** 2
    if m < len(known) - 1:
        covariance[n, n] = parameters[m, SIGMA_A] ** 2 / (1.0 - parameters[m, RHO] ** 2)
    else:
        covariance[n, n] = scene.last_shock_std**2 / (1.0 - scene.last_rho**2)


@njit(cache=True)
def run(
    position: Array,
    identity: Ints,
    length: Array,
    parameters: Array,
    adapted: Ints,
    prior_var: Array,
    actions: Array,
    scene: Scene,
    innovation: Array,
    innovation_var: Array,
    scored: NDArray[np.bool_],
    means: Array,
    covariances: Array,
    motion: Array,
) -> float:
    """Filter one chain over T samples; returns the log-likelihood of Eq. SSM_Likelihood (no 2 pi term).

    position: (T, M) [m], NaN where missing; identity: (T, M) which vehicle it is, -1 for none; length: (T, M) [m];
    parameters: (M, P) at this period; adapted, prior_var: (A,). Filled where they have room: innovation [m],
    innovation_var [m^2] and scored (T,) of the own position; means (T, 3 M + A) and covariances (T, 3 M + A, 3 M + A)
    after the update; motion (T, 2), own acceleration and mean action [m/s^2] there.
    """
    samples, vehicles = position.shape
    size = 3 * vehicles + len(adapted)
    circumference = scene.circumference_m
    parameters = parameters.copy()
    mean, covariance, known = np.zeros(size), np.zeros((size, size)), np.zeros(vehicles, np.int64)
    next_mean, jacobian, noise = np.zeros(size), np.zeros((size, size)), np.zeros(size)
    prior_mean = np.empty(len(adapted))
    for k in range(len(adapted)):
        prior_mean[k] = math.log(parameters[0, UTILITY[adapted[k]]])
        mean[3 * vehicles + k] = prior_mean[k]
        covariance[3 * vehicles + k, 3 * vehicles + k] = prior_var[k]
    waited = np.zeros(vehicles, np.int64)
    settled = 0
    log_likelihood = 0.0
    for t in range(samples):
        if t > 0:
            mean[:] = next_mean
            covariance[:, :] = jacobian @ covariance @ jacobian.T
            for k in range(size):
                covariance[k, k] += noise[k]
        innovation[t], innovation_var[t], scored[t] = np.nan, np.nan, False
        settled += 1
        for m in range(vehicles):
            waited[m] += 1
            if identity[t, m] < 0 or (t > 0 and identity[t, m] != identity[t - 1, m]):
                forget_vehicle(m, mean, covariance, known)
                if m == 0:
                    settled = 0
            if identity[t, m] < 0:
                continue
            x = 3 * m
            variance = covariance[x, x] + parameters[m, SIGMA_NU] ** 2
            if m == 0 and known[0] == MOVING:
                innovation_var[t] = variance
            if math.isnan(position[t, m]):
                continue
            if known[m] != MOVING:
                start_vehicle(m, position[t, m], waited[m] * scene.period_s, mean, covariance, known, parameters, scene)
                waited[m] = 0
                continue
            y = position[t, m] - mean[x]
            if circumference > 0.0:
                y -= circumference * round(y / circumference)
            if m == 0:
                innovation[t] = y
                if settled > SETTLING:
                    scored[t] = True
                    log_likelihood -= 0.5 * (math.log(variance) + y * y / variance)
            gain = covariance[:, x] / variance
            mean += gain * y
            covariance -= np.outer(gain, gain) * variance
        for k in range(len(adapted)):
            parameters[0, UTILITY[adapted[k]]] = math.exp(mean[3 * vehicles + k])
        action = linearise(
            mean,
            covariance,
            known,
            length[t],
            parameters,
            adapted,
            prior_mean,
            prior_var,
            actions,
            scene,
            next_mean,
            jacobian,
            noise,
        )
        if len(means) > 0:
            means[t], covariances[t] = mean, covariance
            motion[t, 0], motion[t, 1] = (next_mean[1] - mean[1]) / scene.period_s, action
    return log_likelihood


@dataclass(frozen=True, eq=False)
class Chain:
    """What is measured of one driver and of the vehicles ahead of him, M in all, own first.

    position_m: (T, M), NaN where missing; identity: (T, M) number of the vehicle, -1 for none; length_m: (T, M).
    """

    position_m: Array
    identity: Ints
    length_m: Array
    period_s: float
    circumference_m: float


def chain_behind(trajectories: Trajectories, driver: int, vehicles: int = CHAIN) -> Chain:
    """The chain of ``vehicles`` vehicles that starts with the driver of column ``driver`` and looks ahead."""
    samples = np.arange(len(trajectories.position_m))
    column = np.where(trajectories.present[:, driver], driver, -1)
    columns = [column]
    for _ in range(vehicles - 1):
        column = np.where(column >= 0, trajectories.leader[samples, column], -1)
        # on a ring with few vehicles the chain ends before it bites its own tail
        column = np.where(np.any([column == before for before in columns], axis=0), -1, column)
        columns.append(column)
    chain = np.stack(columns, axis=1)
    there = chain >= 0
    return Chain(
        position_m=np.where(there, trajectories.position_m[samples[:, None], chain], np.nan),
        identity=np.where(there, trajectories.vehicle[chain], -1),
        length_m=np.where(there, trajectories.length_m[chain], 0.0),
        period_s=trajectories.period_s,
        circumference_m=trajectories.road.circumference_m,
    )


@dataclass(frozen=True, eq=False)
class Filtered:
    """What the causal filter says of one driver over T samples, after the update with each.

    innovation_m, innovation_var: (T,), NaN where nothing was predicted or measured; scored: (T,);
    mean: (T, 3 M + A), covariance: (T, 3 M + A, 3 M + A) of the chain's state and the adapted log parameters;
    acceleration, mean_action: (T,) [m/s^2] own. The own position is continuous, not wrapped.
    """

    innovation_m: Array
    innovation_var: Array
    scored: NDArray[np.bool_]
    mean: Array
    covariance: Array
    acceleration: Array
    mean_action: Array
    log_likelihood: float


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
    """Parameters (M, P) at ``period_s`` of a chain: ``own`` (P,), then ``ahead`` (P,) for all vehicles ahead."""
    rows = np.tile(population() if ahead is None else ahead, (vehicles, 1))
    rows[0] = own
    return at_period(rows, period_s)


def filter_chain(
    chain: Chain, parameters: Array, adaptation: Adaptation = Adaptation(), ahead: Array | None = None
) -> Filtered:
    """Filter one driver's chain with his parameters (P,) and those of the drivers ahead (P,), else ``population()``."""
    samples, vehicles = chain.position_m.shape
    size = 3 * vehicles + len(adaptation.names)
    innovation, innovation_var, scored = np.empty(samples), np.empty(samples), np.empty(samples, np.bool_)
    means, covariances, motion = np.empty((samples, size)), np.empty((samples, size, size)), np.empty((samples, 2))
    log_likelihood = _run(
        chain, parameters, adaptation, ahead, innovation, innovation_var, scored, means, covariances, motion
    )
    return Filtered(innovation, innovation_var, scored, means, covariances, motion[:, 0], motion[:, 1], log_likelihood)


def log_likelihood(chain: Chain, parameters: Array, ahead: Array | None = None) -> float:
    """Log-likelihood of one driver's chain in the causal formulation; Eq. SSM_Likelihood (no 2 pi term)."""
    samples = len(chain.position_m)
    nothing = np.empty((0, 0))
    outputs = np.empty(samples), np.empty(samples), np.empty(samples, np.bool_)
    return _run(chain, parameters, Adaptation(), ahead, *outputs, nothing, np.empty((0, 0, 0)), nothing)


def _run(
    chain: Chain,
    parameters: Array,
    adaptation: Adaptation,
    ahead: Array | None,
    innovation: Array,
    innovation_var: Array,
    scored: NDArray[np.bool_],
    means: Array,
    covariances: Array,
    motion: Array,
) -> float:
    period = chain.period_s
    return float(
        run(
            chain.position_m,
            chain.identity,
            chain.length_m,
            chain_parameters(parameters, ahead, chain.position_m.shape[1], period),
            *adaptation.arrays,
            ACTIONS,
            scene_at(period, chain.circumference_m, adaptation.relaxation_s),
            innovation,
            innovation_var,
            scored,
            means,
            covariances,
            motion,
        )
    )
