"""How effects change a measurement of a position: displacement, uneven noise and bad samples."""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects import chains
from sugiyama_ros.effects.chains import any_of, chain, having, switches
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.jit import kernel

_DISPLACE, _UNEVEN, _BAD = having("displacement"), having("measurement_noise_factor"), having("contamination")
_displaced = chain(chains.no_displacement, chains.then_displace, _DISPLACE)
_factor = chain(chains.no_measurement_factor, chains.then_measurement_factor, _UNEVEN)
_weighed = chain(chains.never_bad, chains.then_weigh, _BAD)
_DISPLACING, _CHANGING, _SPOILING = switches(_DISPLACE), switches(_UNEVEN), switches(_BAD)


@kernel(allocates=False)
def displacement(position: float, circumference: float, row: Array) -> tuple[float, float]:
    """Compute how far a position is displaced when it is measured.

    Parameters
    ----------
    position, circumference : float
        True position [m], and circumference [m] of the ring; 0 for an open road.
    row : ndarray, shape (width,)
        Row of the driver.

    Returns
    -------
    offset, slope : float
        Measured minus true position [m], and its derivative by the position.
    """
    if not any_of(_DISPLACING, row):
        return 0.0, 0.0
    offset, slope = _displaced(position, circumference, row)
    return offset, slope


@kernel(allocates=False)
def noise_std_factor(position: float, circumference: float, row: Array) -> float:
    """Compute the factor of the std of the measurement noise; arguments as for ``displacement``."""
    if not any_of(_CHANGING, row):
        return 1.0
    factor: float = _factor(position, circumference, row)
    return factor


@kernel(allocates=False)
def is_contaminated(row: Array) -> bool:
    """Whether an effect in a row (width,) makes some measurements worse than others."""
    return any_of(_SPOILING, row)


@kernel(allocates=False)
def weigh(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
    """Weigh a sample from a mixture of good and bad measurements.

    Parameters
    ----------
    innovation : float
        Measured minus predicted position [m].
    variance, noise_var : float
        Variances [m^2] of the innovation and of the noise of a good measurement.
    row : ndarray, shape (width,)
        Row of the driver, with an effect for which ``is_contaminated`` is true.

    Returns
    -------
    probability, wide, density : float
        Probability that the sample is bad, variance [m^2] of the innovation of a bad sample, and log-likelihood of the
        sample.
    """
    probability, wide, density = _weighed(innovation, variance, noise_var, row)
    return probability, wide, density


@kernel
def displacements(position: Array, circumference: float, rows: Array) -> Array:
    """Compute the displacements (N,) [m] of N vehicles at positions (N,) [m], with rows (N, width)."""
    return np.array([displacement(position[i], circumference, rows[i])[0] for i in range(len(position))])


@kernel
def noise_std_factors(position: Array, circumference: float, rows: Array) -> Array:
    """Compute the factors (N,) of the measurement noise of N vehicles at positions (N,) [m], with rows (N, width)."""
    return np.array([noise_std_factor(position[i], circumference, rows[i]) for i in range(len(position))])


def spoil(noise: Array, rows: Array, rng: np.random.Generator) -> Array:
    """Make some measurements worse than others.

    Parameters
    ----------
    noise : ndarray, shape (N,)
        Measurement noise [m] of N vehicles.
    rows : ndarray, shape (N, width)
        Rows of the drivers.
    rng : numpy.random.Generator
        Draws which measurements are bad.

    Returns
    -------
    ndarray, shape (N,)
        Measurement noise [m] with the bad measurements.
    """
    for effect in _BAD:
        values = rows[:, ROW.places[effect.name]]
        if effect.contamination is not None and rows[:, ROW.index_of(effect.name, effect.switches[0])].any():
            noise = effect.contamination.sample(noise, values, rng)
    return noise
