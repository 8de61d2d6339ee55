"""Drivers hold their acceleration until the wanted change exceeds a threshold: action points."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PERCEPTION, Effect, Memory, at
from sugiyama_ros.jit import kernel


@kernel
def change(wanted: float, period: float, p: Array) -> float:
    """Compute the change [m/s^2] that the driver carries out: 0 below the threshold."""
    return 0.0 if abs(wanted) < p[0] else wanted


@kernel
def expected_change(wanted: float, variance: float, period: float, p: Array) -> tuple[float, float, float]:
    """Compute the moments of the change that the driver carries out, for a normally distributed wanted change.

    Statistical linearisation, exact in the three moments that are returned.

    References
    ----------
    Gelb, Applied Optimal Estimation (1974), section 6.2.
    """
    std = math.sqrt(variance)
    low, high = (-p[0] - wanted) / std, (p[0] - wanted) / std
    at_low = math.exp(-0.5 * low * low) / math.sqrt(2.0 * math.pi)
    at_high = math.exp(-0.5 * high * high) / math.sqrt(2.0 * math.pi)
    below = 0.5 * (math.erf(high / math.sqrt(2.0)) - math.erf(low / math.sqrt(2.0)))
    held_mean = wanted * below + std * (at_low - at_high)
    held_square = (
        wanted * wanted * below
        + 2.0 * wanted * std * (at_low - at_high)
        + variance * (below + low * at_low - high * at_high)
    )
    mean, square = wanted - held_mean, wanted * wanted + variance - held_square
    # the change carried out is either 0 or the wanted change, so its product with the wanted change is its own square
    slope = (square - mean * wanted) / variance
    return mean, slope, max(square - mean * mean - slope * slope * variance, 0.0)


EFFECT = Effect(
    name="perception_threshold",
    stage=PERCEPTION,
    title="action points",
    summary="drivers hold their acceleration until a change exceeds a threshold (action points)",
    term="a changes by threshold or more, or not at all",
    source="Todosiev and Barbosa, Traffic Eng. 34 (1963) 17; Wagner, Eur. Phys. J. B 84 (2011) 713",
    parameters=(Parameter("threshold", "θ", "m/s^2", 0.0, 0.0, 5.0, "smallest change of the acceleration"),),
    starts=at({"threshold": 0.3}, {"threshold": 0.8}),
    memory=Memory(change, expected_change),
    benchmark=({"threshold": 1.0}, {"threshold": 0.55}),
)
