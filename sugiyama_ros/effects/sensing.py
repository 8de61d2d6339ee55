"""How effects change a measurement of a position: displacement, uneven noise and bad samples."""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.by_address import part_of
from sugiyama_ros.effects.hooks import (
    DISPLACE,
    PARAMETERS,
    UNEVEN,
    WEIGH,
    WORDS,
    acts,
    call_displace,
    call_uneven,
    call_weigh,
    end_of,
    first_of,
    is_on,
)
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.jit import kernel


@kernel(allocates=False)
def displacement(position: float, circumference: float, row: Array) -> tuple[float, float]:
    """Compute how far a position is displaced when it is measured.

    position, circumference: true position [m], and circumference [m] of the ring; 0 for an open road; row: (width,),
    row of the driver. Returns measured minus true position [m], and its derivative by the position.
    """
    offset, slope = 0.0, 0.0
    for f in range(first_of(DISPLACE), end_of(DISPLACE), WORDS):
        if is_on(f, row):
            more, steeper = call_displace(f, position, circumference, part_of(row, f + PARAMETERS))
            offset, slope = offset + more, slope + steeper
    return offset, slope


@kernel(allocates=False)
def noise_std_factor(position: float, circumference: float, row: Array) -> float:
    """Compute the factor of the std of the measurement noise; arguments as for ``displacement``."""
    factor = 1.0
    for f in range(first_of(UNEVEN), end_of(UNEVEN), WORDS):
        if is_on(f, row):
            factor *= call_uneven(f, position, circumference, part_of(row, f + PARAMETERS))
    return factor


@kernel(allocates=False)
def is_contaminated(row: Array) -> bool:
    """Whether an effect in a row (width,) makes some measurements worse than others."""
    return acts(WEIGH, row)


@kernel(allocates=False)
def weigh(innovation: float, variance: float, noise_var: float, row: Array) -> tuple[float, float, float]:
    """Weigh a sample from a mixture of good and bad measurements.

    innovation: measured minus predicted position [m]; variance, noise_var: variances [m^2] of the innovation and of the
    noise of a good measurement; row: (width,), row of the driver, with an effect for which ``is_contaminated`` is true.
    Returns probability that the sample is bad, variance [m^2] of the innovation of a bad sample, and log-likelihood of
    the sample.
    """
    probability, wide, density = 0.0, variance, 0.0
    for f in range(first_of(WEIGH), end_of(WEIGH), WORDS):
        if is_on(f, row):
            probability, wide, density = call_weigh(f, innovation, variance, noise_var, part_of(row, f + PARAMETERS))
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

    noise: (N,), measurement noise [m] of N vehicles; rows: (N, width), rows of the drivers. Returns (N,), measurement
    noise [m] with the bad measurements.
    """
    for effect in EFFECTS.values():
        values = rows[:, ROW.places[effect.name]]
        if effect.contamination is not None and rows[:, ROW.index_of(effect.name, effect.switches[0])].any():
            noise = effect.contamination.sample(noise, values, rng)
    return noise
