"""Drivers are less precise at some speeds than at others."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, Effect, at
from sugiyama_ros.jit import kernel

# Speed [m/s] at which the std of the noise is the driver's sigma_a.
_REFERENCE_SPEED = 5.0


@kernel
def _noise_factor(speed: float, p: Array) -> float:
    """Compute the factor of the std of the acceleration noise at a speed [m/s]."""
    return math.exp(p[0] * (min(max(speed, 0.0), 8.0 * _REFERENCE_SPEED) / _REFERENCE_SPEED - 1.0))


@kernel
def _fading(speed: float, p: Array) -> float:
    """Compute the factor of the paper: it grows from 0 at standstill to 1 at the speed ``p[0]`` [m/s]."""
    return float(min(max(speed, 0.0) / p[0], 1.0))


_FADING = Effect(
    name="speed_dependent_noise_fading",
    stage=ACTUATION,
    title="steady hand at low speed",
    summary="the acceleration noise grows in proportion to the speed, up to one speed, and is the same above",
    term="sigma_a -> sigma_a min(v / full_speed, 1)",
    source="paper, section 6 (footnote on the noise at low speed)",
    parameters=(Parameter("full_speed", "v_n", "m/s", 0.0, 0.0, 50.0, "speed from which on the noise is whole"),),
    starts=at({"full_speed": 1.0}, {"full_speed": 4.0}),
    noise_factor=_fading,
)
EFFECT = Effect(
    name="speed_dependent_noise",
    stage=ACTUATION,
    title="unsteadiness that depends on the speed",
    summary="the acceleration noise grows (or shrinks) with the speed",
    term="sigma_a -> sigma_a exp(exponent (v / 5 m/s - 1))",
    source="after the paper, section 6 (footnote on the noise at low speed)",
    parameters=(Parameter("exponent", "e_n", "1", 0.0, -3.0, 3.0, "growth of log sigma_a over 5 m/s of speed"),),
    starts=at({"exponent": 0.2}, {"exponent": -0.2}),
    noise_factor=_noise_factor,
    bank={"exponent": 0.3},
    benchmark=({"exponent": 0.6}, {"exponent": 0.25}),
    forms=(_FADING,),
)
