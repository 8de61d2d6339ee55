"""What a measurement has beyond the true position, with all effects: displacement, uneven noise, bad samples."""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects import chains
from sugiyama_ros.effects.chains import any_of, chain, having, switches
from sugiyama_ros.effects.effect import MEASUREMENT
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.jit import kernel

_DISPLACE, _UNEVEN, _BAD = having("displacement"), having("measurement_noise_factor"), having("contamination")
_displaced = chain(chains.no_displacement, chains.then_displace, _DISPLACE)
_factor = chain(chains.no_measurement_factor, chains.then_measurement_factor, _UNEVEN)
_weighed = chain(chains.never_bad, chains.then_weigh, _BAD)
_DISPLACING, _CHANGING, _SPOILING = switches(_DISPLACE), switches(_UNEVEN), switches(_BAD)
#: Names of the effects of the measurement.
OF_MEASUREMENT = tuple(name for name, e in EFFECTS.items() if e.stage == MEASUREMENT)


@kernel(allocates=False)
def displacement(position: float, circumference: float, row: Array) -> tuple[float, float]:
    """Measured minus true position [m] at a position [m], and its derivative."""
    if not any_of(_DISPLACING, row):
        return 0.0, 0.0
    offset, slope = _displaced(position, circumference, row)
    return offset, slope


@kernel(allocates=False)
def noise_std_factor(position: float, circumference: float, row: Array) -> float:
    """Factor of the std of the measurement noise at a position [m]."""
    if not any_of(_CHANGING, row):
        return 1.0
    factor: float = _factor(position, circumference, row)
    return factor


@kernel(allocates=False)
def is_contaminated(row: Array) -> bool:
    """Whether some measurements are worse than others."""
    return any_of(_SPOILING, row)


@kernel(allocates=False)
def weigh(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
    """Probability that a sample is a bad one, the variance of its innovation then, and its log-likelihood."""
    probability, wide, density = _weighed(innovation, variance, noise_var, row)
    return probability, wide, density


@kernel
def displacements(position: Array, circumference: float, rows: Array) -> Array:
    """Displacements (N,) [m] of the measured positions of N vehicles at positions (N,) [m]; rows: (N, WIDTH)."""
    return np.array([displacement(position[i], circumference, rows[i])[0] for i in range(len(position))])


@kernel
def noise_std_factors(position: Array, circumference: float, rows: Array) -> Array:
    """Factors (N,) of the std of the measurement noise of N vehicles at positions (N,) [m]; rows: (N, WIDTH)."""
    return np.array([noise_std_factor(position[i], circumference, rows[i]) for i in range(len(position))])


def spoil(noise: Array, rows: Array, rng: np.random.Generator) -> Array:
    """Measurement noise (N,) [m] of N vehicles in which some samples are worse than others; rows: (N, WIDTH)."""
    for effect in _BAD:
        values = rows[:, ROW.places[effect.name]]
        if effect.contamination is not None and rows[:, ROW.index_of(effect.name, effect.switches[0])].any():
            noise = effect.contamination.sample(noise, values, rng)
    return noise
