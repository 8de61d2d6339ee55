"""How a vehicle enters the state of a chain, and how it leaves the state."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import RHO, SIGMA_A
from sugiyama_ros.effects.control import remembers
from sugiyama_ros.filters.measurement import measurement, noise_var_at
from sugiyama_ros.filters.state import MOVING, POSITION, STATE, UNKNOWN, Scene, State, is_last
from sugiyama_ros.jit import kernel

#: Squared normalised innovation of a gross error, and of a sample that is far off where outliers are part of the model.
GROSS, FAR = 36.0, 9.0
#: How many of them in a row can be errors of the measurement.
MOST_GROSS = 3
# Acceleration [m/s^2] for which a speed from two positions allows.
_START_ACCELERATION_STD = 1.0


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
    measured -= measurement(measured, parameters[m], circumference)[0]
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
    is_gross = y * y > (FAR if contaminated else GROSS) * variance
    if not is_gross:
        return 0
    if before < MOST_GROSS:
        return before + 1
    x, v, over = STATE * m, STATE * m + 1, (MOST_GROSS + 1) * scene.period_s
    covariance = state.covariance
    covariance[x, x] += y * y
    covariance[x, v] += y * y / over
    covariance[v, x] += y * y / over
    covariance[v, v] += 2.0 * y * y / over**2
    return 0
