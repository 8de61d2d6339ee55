"""The update of the causal filter: the innovation of a measured position, what it counts, and how vehicles come and go.

Positions are taken in one after the other: ``innovation``, ``weights``, ``update``. ``abreast`` updates several filters
side by side.
"""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import RHO, SIGMA_A, SIGMA_NU
from sugiyama_ros.effects.control import displacement, is_contaminated, noise_std_factor, remembers, weigh
from sugiyama_ros.filters.state import MOVING, POSITION, STATE, UNKNOWN, Scene, State, is_last
from sugiyama_ros.jit import kernel

#: Samples after the start of a vehicle's record (or after a break) whose innovations are not scored.
SETTLING = 6
#: Squared normalised innovation of a gross error.
GROSS = 36.0
# The same where outliers are part of the model, and how many gross errors in a row can be errors of the measurement.
_GROSS_OUTLIER, _MOST_GROSS = 9.0, 3
# Squared normalised innovation that shows that a driver at a line does the other thing: goes on, or stops.
_OTHER_WAY = 9.0
# Periods over which the speed has been wrong then: what a driver chooses shows in the position a period later.
_DECIDED = 2
# Acceleration [m/s^2] for which a speed from two positions allows.
_START_ACCELERATION_STD = 1.0


@kernel(allocates=False)
def noise_var_at(position: float, parameters: Array, circumference_m: float) -> float:
    """Return the variance of the measurement noise [m^2] at a position [m]."""
    variance: float = parameters[SIGMA_NU] ** 2
    return variance * noise_std_factor(position, circumference_m, parameters) ** 2


@kernel(allocates=False)
def innovation(m: int, measured: float, state: State, parameters: Array, scene: Scene) -> tuple[float, float, float]:
    """Return the innovation [m] of vehicle m, its variance [m^2], and the entry of H.

    measured: its measured position [m]; where it is NaN, so is the innovation. parameters: (WIDTH,) of the vehicle.
    """
    position, circumference = state.mean[STATE * m], scene.circumference_m
    offset, slope = displacement(position, circumference, parameters)
    slope += 1.0
    variance = slope * slope * state.covariance[STATE * m, STATE * m]
    variance += noise_var_at(position, parameters, circumference)
    y = measured - position - offset
    if circumference > 0.0 and not math.isnan(y):
        y -= circumference * round(y / circumference)
    return y, variance, slope


@kernel(allocates=False)
def weights(y: float, variance: float, parameters: Array) -> tuple[float, float]:
    """Return how much an innovation counts.

    Without outliers both weights are 1 / S. With outliers the update is a mixture of two updates; the weights make its
    mean and its covariance.

    y: innovation [m]; variance: its variance S [m^2]. Returns step: factor of P H' y in what is added to the mean
    [1/m^2]; shrink: factor of P H' H P in what is taken off P [1/m^2].
    """
    if not is_contaminated(parameters):
        return 1.0 / variance, 1.0 / variance
    bad, wide, _ = weigh(y, variance, parameters[SIGMA_NU] ** 2, parameters)
    gain = (1.0 - bad) / variance + bad / wide
    between = (1.0 - bad) / variance**2 + bad / wide**2 - gain * gain
    return gain, gain - y * y * between


@kernel(allocates=False)
def log_density(y: float, variance: float, parameters: Array) -> float:
    """Return the log-likelihood of an innovation, without the term of 2 pi; arguments as for ``weights``."""
    if not is_contaminated(parameters):
        return -0.5 * (math.log(variance) + y * y / variance)
    density: float = weigh(y, variance, parameters[SIGMA_NU] ** 2, parameters)[2]
    return density


@kernel(allocates=False)
def update(state: State, gain: Array, step: float, shrink: float) -> None:
    """Take in a sample; gain: P H'; step: what is added to the mean along it; shrink: as of ``weights``."""
    for i in range(len(gain)):
        state.mean[i] += gain[i] * step
        for j in range(len(gain)):
            state.covariance[i, j] -= shrink * (gain[i] * gain[j])


@kernel
def weigh_samples(y: Array, variance: Array, parameters: Array, weight: Array, density: Array) -> None:
    """Fill in how much each of T innovations counts, and its log-likelihood.

    y, variance: innovations [m] and their variances [m^2], (T,) each.
    """
    for t in range(len(y)):
        weight[t] = weights(y[t], variance[t], parameters)[0] * variance[t]
        density[t] = log_density(y[t], variance[t], parameters)


@kernel
def forget_vehicle(m: int, state: State) -> None:
    """Make vehicle m of a chain UNKNOWN, uncorrelated with everything else."""
    state.known[m] = UNKNOWN
    for k in range(STATE * m, STATE * (m + 1)):
        state.mean[k] = 0.0
        state.covariance[k, :] = 0.0
        state.covariance[:, k] = 0.0


@kernel
def start_vehicle(m: int, measured: float, elapsed: float, state: State, parameters: Array, scene: Scene) -> None:
    """Take in a sample of a vehicle that is not MOVING yet: the first gives its position, the second its speed.

    measured: its measured position [m]; elapsed: time since the first sample [s].

    References
    ----------
    Two-point initialisation: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to Tracking and
    Navigation (2001), section 5.5.3.
    """
    mean, covariance, known = state.mean, state.covariance, state.known
    x, v, n, b = STATE * m, STATE * m + 1, STATE * m + 2, STATE * m + 3
    circumference = scene.circumference_m
    measured -= displacement(measured, circumference, parameters[m])[0]
    if known[m] == UNKNOWN:
        known[m] = POSITION
        mean[x] = measured
        if circumference > 0.0:
            # as many turns of the ring as its neighbours in the chain have made
            if m > 0 and known[m - 1] != UNKNOWN:
                mean[x] -= circumference * math.floor((measured - mean[x - STATE]) / circumference)
            elif m + 1 < len(known) and known[m + 1] != UNKNOWN:
                mean[x] += circumference * math.floor((mean[x + STATE] - measured) / circumference)
        return
    known[m] = MOVING
    way = measured - mean[x]
    if circumference > 0.0:
        way -= circumference * round(way / circumference)
    mean[x] += way
    mean[v] = way / elapsed
    noise_var = noise_var_at(mean[x], parameters[m], circumference)
    covariance[x, x] = noise_var
    covariance[x, v] = covariance[v, x] = noise_var / elapsed
    covariance[v, v] = 2.0 * noise_var / elapsed**2 + (elapsed * _START_ACCELERATION_STD) ** 2
    if not is_last(m, known):
        covariance[n, n] = parameters[m, SIGMA_A] ** 2 / (1.0 - parameters[m, RHO] ** 2)
        covariance[b, b] = _START_ACCELERATION_STD**2 if remembers(parameters[m]) else 0.0
    else:
        covariance[n, n] = scene.last_shock_std**2 / (1.0 - scene.last_rho**2)


@kernel(allocates=False)
def gross_in_a_row(
    m: int, before: int, y: float, variance: float, contaminated: bool, state: State, scene: Scene
) -> int:
    """Return how many samples of vehicle m in a row are gross errors, 0 after more than can be errors of measurement.

    Then it is the state that must be wrong, as after a start from an outlier, and it would stay wrong: its covariance
    is small, and so is what an outlier changes. So the vehicle is let go where it is measured. The position is wrong by
    as much as the innovation says. The speed may have been wrong by this over the time of these samples, or it may not:
    half of its variance goes with the position.

    y: its innovation [m]; variance: the variance of the innovation [m^2].
    """
    is_gross = y * y > (_GROSS_OUTLIER if contaminated else GROSS) * variance
    if not is_gross:
        return 0
    if before < _MOST_GROSS:
        return before + 1
    _let_go(m, y, (_MOST_GROSS + 1) * scene.period_s, state)
    return 0


@kernel(allocates=False)
def decides_otherwise(m: int, y: float, variance: float, state: State, scene: Scene) -> bool:
    """Whether the driver of vehicle m, who is at a line, does not do what the filter is sure of; then it is let go.

    At a line a driver stops or goes on, and a small difference of speed or place decides it. The filter's normal
    distribution holds one of both. If that is the wrong one, the filter is soon sure of it, and cannot be corrected.
    Arguments as of ``gross_in_a_row``.
    """
    if y * y <= _OTHER_WAY * variance:
        return False
    _let_go(m, y, _DECIDED * scene.period_s, state)
    return True


@kernel(allocates=False)
def _let_go(m: int, y: float, over: float, state: State) -> None:
    """Let the position of vehicle m be wrong by an innovation y [m], and the speed by as much over some time [s]."""
    x, v, covariance = STATE * m, STATE * m + 1, state.covariance
    covariance[x, x] += y * y
    covariance[x, v] += y * y / over
    covariance[v, x] += y * y / over
    covariance[v, v] += 2.0 * y * y / over**2
