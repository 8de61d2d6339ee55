"""The strictly causal filter: drivers act on the filtered states of themselves and of the vehicles ahead.

The paper takes what a driver perceives from smoothed measurements, which know the future, as a given control. Here the
mean action is a function of the filtered state and enters the covariance, so that an innovation depends on the past
alone. A driver is filtered together with a chain of vehicles ahead,

    own -> leader -> ... -> last.

Each but the last drives by the paper's model (Eq. ssm_form) behind the next. The last moves with an AR(1) acceleration,
because its leader is not known. For a driver the state is (position, speed, noise, held). The noise
n_t = rho n_{t-1} + shock is the acceleration beyond what the driver means and the environment adds. The held
acceleration is what the driver made the car do in the last period (the mean action, except for effects). For the last
vehicle the noise is the whole acceleration. Parameters that are adapted online follow as logarithms that wander around
their prior (Ornstein-Uhlenbeck), so that a parameter that the data do not determine stays near its prior.

``linearisation`` states the model; this module filters a recording with it, and ``online`` filters sample by sample.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import UTILITY
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.filters.chain import NOT_ADAPTED, Adaptation, Chain, adaptation_of, chain_parameters
from sugiyama_ros.filters.linearisation import linearise
from sugiyama_ros.filters.measurement import measurement, noise_var_at, robust
from sugiyama_ros.filters.state import (
    MOVING,
    STATE,
    Drivers,
    Linearised,
    Moment,
    Scene,
    State,
    drivers_at,
    scene_at,
    workspace_for,
)
from sugiyama_ros.filters.vehicles import forget_vehicle, start_vehicle
from sugiyama_ros.jit import kernel

#: Samples after the start of a vehicle's record (or after a break) whose innovations are not scored.
SETTLING = 6


class Observed(NamedTuple):
    """A chain's recording, as in ``Chain``: position and length (T, M) [m], identity (T, M), rear (T, 3)."""

    position: Array
    identity: Ints
    length: Array
    rear: Array


class Predicted(NamedTuple):
    """Innovation [m], its variance [m^2] and its log-likelihood, (T,) each, of the own position; NaN where none."""

    innovation: Array
    innovation_var: Array
    log_likelihood: Array


class Trace(NamedTuple):
    """Arrays for what is known after the update with each sample; an array of length 0 is not filled.

    means: (T, 4 M + A); covariances: (T, 4 M + A, 4 M + A); motion: (T, 2), own acceleration and what the driver means
    to do [m/s^2], filled together with the covariances.
    """

    means: Array
    covariances: Array
    motion: Array


@kernel(allocates=False)
def _predict(covariance: Array, jacobian: Array, noise: Array, half: Array, filled: Ints) -> None:
    """F P F' + Q in place, of which one triangle is worked out: the covariance stays symmetric.

    half: (size, size), overwritten with (F P)'; filled: (size, size + 1), overwritten with the places of each row of F
    that are not 0, and their number in the last column.
    """
    size = len(covariance)
    for i in range(size):
        count = 0
        for k in range(size):
            if jacobian[i, k] != 0.0:
                filled[i, count] = k
                count += 1
        filled[i, size] = count
    for i in range(size):
        for j in range(size):
            half[i, j] = 0.0
        for c in range(filled[i, size]):
            k = filled[i, c]
            factor = jacobian[i, k]
            for j in range(size):
                half[i, j] += factor * covariance[k, j]
    for i in range(size):
        for j in range(i + 1):
            entry = noise[i, j]
            for c in range(filled[j, size]):
                k = filled[j, c]
                entry += jacobian[j, k] * half[i, k]
            covariance[i, j] = entry
            covariance[j, i] = entry


@kernel(allocates=False)
def _update(state: State, gain: Array, y: float, step: float, shrink: float) -> None:
    """Take in an innovation; gain: (4 M + A,), P H'; step, shrink: as ``robust`` returns them."""
    mean, covariance = state.mean, state.covariance
    for i in range(len(gain)):
        mean[i] += gain[i] * step * y
        for j in range(len(gain)):
            covariance[i, j] -= gain[i] * gain[j] * shrink


@kernel
def run(
    observed: Observed,
    drivers: Drivers,
    actions: Array,
    start_s: float,
    scene: Scene,
    predicted: Predicted,
    trace: Trace,
) -> float:
    """Filter one chain over T samples.

    Parameters
    ----------
    observed
        The recording.
    drivers
        Of ``drivers_at``; row 0 of the parameters is overwritten with the adapted values.
    actions
        Accelerations that the drivers consider [m/s^2], (K,).
    start_s
        Time of the first sample [s].
    scene
        Period and road.
    predicted, trace
        Filled. The log-likelihood is also NaN where a sample does not count.

    Returns
    -------
    float
        Log-likelihood of Eq. SSM_Likelihood, without the term of 2 pi.
    """
    position, identity = observed.position, observed.identity
    samples, vehicles = position.shape
    adapted, parameters = drivers.adapted, drivers.parameters
    size = STATE * vehicles + len(adapted)
    circumference = scene.circumference_m
    workspace = workspace_for(actions, vehicles, len(adapted))
    mean, covariance, known = np.zeros(size), np.zeros((size, size)), np.zeros(vehicles, np.int64)
    next_mean, gain = np.zeros(size), np.zeros(size)
    jacobian, noise, half = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    filled = np.zeros((size, size + 1), np.int64)
    state, linearised = State(mean, covariance, known), Linearised(next_mean, jacobian, noise)
    for k in range(len(adapted)):
        mean[STATE * vehicles + k] = drivers.prior_mean[k]
        covariance[STATE * vehicles + k, STATE * vehicles + k] = drivers.prior_var[k]
    waited = np.zeros(vehicles, np.int64)
    settled = 0
    total = 0.0
    for t in range(samples):
        if t > 0:
            mean[:] = next_mean
            _predict(covariance, jacobian, noise, half, filled)
        predicted.innovation[t], predicted.innovation_var[t], predicted.log_likelihood[t] = np.nan, np.nan, np.nan
        settled += 1
        for m in range(vehicles):
            waited[m] += 1
            if identity[t, m] < 0 or (t > 0 and identity[t, m] != identity[t - 1, m]):
                forget_vehicle(m, state)
                if m == 0:
                    settled = 0
            if identity[t, m] < 0:
                continue
            x = STATE * m
            off, factor = measurement(mean[x], parameters[m], circumference)
            variance = factor * factor * covariance[x, x] + noise_var_at(mean[x], parameters[m], circumference)
            if m == 0 and known[0] == MOVING:
                predicted.innovation_var[t] = variance
            if math.isnan(position[t, m]):
                continue
            if known[m] != MOVING:
                start_vehicle(m, position[t, m], waited[m] * scene.period_s, state, parameters, scene)
                waited[m] = 0
                continue
            y = position[t, m] - mean[x] - off
            if circumference > 0.0:
                y -= circumference * round(y / circumference)
            step, shrink, density = robust(y, variance, parameters[m])
            if m == 0:
                predicted.innovation[t] = y
                if settled > SETTLING:
                    predicted.log_likelihood[t] = density
                    total += density
            for i in range(size):
                gain[i] = factor * covariance[i, x]
            _update(state, gain, y, step, shrink)
        for k in range(len(adapted)):
            parameters[0, UTILITY[adapted[k]]] = math.exp(mean[STATE * vehicles + k])
        moment = Moment(observed.length[t], observed.rear[t], start_s + t * scene.period_s)
        action = linearise(state, drivers, moment, scene, workspace, linearised)
        if len(trace.means) > 0:
            trace.means[t] = mean
        if len(trace.covariances) > 0:
            trace.covariances[t] = covariance
            trace.motion[t, 0], trace.motion[t, 1] = (next_mean[1] - mean[1]) / scene.period_s, action
    return total


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


def filter_chain(
    chain: Chain, parameters: Array, adaptation: Adaptation = NOT_ADAPTED, ahead: Array | None = None
) -> Filtered:
    """Filter one driver's chain.

    Parameters
    ----------
    chain
        T samples of M vehicles.
    parameters
        The driver's parameters at the reference period, (P,) or (WIDTH,).
    adaptation
        Which A parameters are adapted online.
    ahead
        Parameters of the drivers ahead, as for ``chain_parameters``.

    Returns
    -------
    Filtered
        State and predictions at every sample.
    """
    samples, vehicles = chain.position_m.shape
    size = STATE * vehicles + len(adaptation_of(parameters, adaptation).names)
    trace = Trace(np.empty((samples, size)), np.empty((samples, size, size)), np.empty((samples, 2)))
    predicted, total = _run(chain, parameters, adaptation, ahead, trace)
    motion = trace.motion
    return Filtered(*predicted, trace.means, trace.covariances, motion[:, 0], motion[:, 1], total)


def predict_samples(chain: Chain, parameters: Array, ahead: Array | None = None) -> Predicted:
    """Return how well each sample is predicted; arguments as for ``filter_chain``.

    Returns
    -------
    Predicted
        Innovation, its variance and its log-likelihood, (T,) each.
    """
    return _run(chain, parameters, NOT_ADAPTED, ahead, _no_trace())[0]


def predict_states(chain: Chain, parameters: Array, ahead: Array | None = None) -> tuple[Array, Array, Array, Array]:
    """Return how well each sample is predicted, and the driver's state; arguments as for ``filter_chain``.

    Returns
    -------
    innovation_m, innovation_var, sample_log_likelihood
        As in ``Filtered``, (T,) each.
    state
        The driver's own four entries of the state after the update with each sample, (T, STATE).
    """
    size = STATE * chain.position_m.shape[1] + len(adaptation_of(parameters).names)
    trace = _no_trace()._replace(means=np.empty((len(chain.position_m), size)))
    predicted, _ = _run(chain, parameters, NOT_ADAPTED, ahead, trace)
    return *predicted, trace.means[:, :STATE]


def log_likelihood(chain: Chain, parameters: Array, ahead: Array | None = None) -> float:
    """Return the log-likelihood of one driver's chain, Eq. SSM_Likelihood without the term of 2 pi.

    Arguments as for ``filter_chain``.
    """
    return _run(chain, parameters, NOT_ADAPTED, ahead, _no_trace())[1]


def _no_trace() -> Trace:
    return Trace(np.empty((0, 0)), np.empty((0, 0, 0)), np.empty((0, 0)))


def _run(
    chain: Chain, parameters: Array, adaptation: Adaptation, ahead: Array | None, trace: Trace
) -> tuple[Predicted, float]:
    """Run the compiled filter with fresh arrays; returns the predictions and the log-likelihood."""
    period, (samples, vehicles) = chain.period_s, chain.position_m.shape
    adaptation = adaptation_of(parameters, adaptation)
    predicted = Predicted(np.empty(samples), np.empty(samples), np.empty(samples))
    total = run(
        Observed(chain.position_m, chain.identity, chain.length_m, chain.rear),
        drivers_at(chain_parameters(parameters, ahead, vehicles, period), *adaptation.arrays),
        ACTIONS,
        chain.start_s,
        scene_at(period, chain.circumference_m, adaptation.relaxation_s),
        predicted,
        trace,
    )
    return predicted, float(total)
