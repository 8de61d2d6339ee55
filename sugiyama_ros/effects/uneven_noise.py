"""The camera measures less accurately on one side of the ring."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import MEASUREMENT, RING, Effect, Extent, Values
from sugiyama_ros.jit import kernel


@kernel
def _factor(position: float, circumference: float, p: Array) -> float:
    """Compute the factor of the std of the measurement noise; its logarithm is one wave around the ring."""
    if circumference == 0.0:
        return 1.0
    angle = 2.0 * math.pi * position / circumference
    return math.exp(p[0] * math.cos(angle) + p[1] * math.sin(angle))


def _starts(recording: Extent) -> tuple[Values, ...]:
    waves = ({"cosine": 0.15, "sine": 0.0}, {"cosine": 0.0, "sine": 0.15})
    return waves if recording.circumference_m else ()


EFFECT = Effect(
    name="uneven_noise",
    stage=MEASUREMENT,
    title="uneven measurement noise",
    summary="the measurement noise changes by one wave around the ring",
    term="log sigma_nu + cosine cos(2 pi x / L) + sine sin(2 pi x / L)",
    source="the image scale and the light of one camera for the whole ring, to first order",
    parameters=(
        Parameter("cosine", "a_c", "1", 0.0, -2.0, 2.0, "logarithm of the factor of the noise's std at position 0"),
        Parameter("sine", "a_s", "1", 0.0, -2.0, 2.0, "logarithm of the factor a quarter of the ring further on"),
    ),
    needs=(RING,),
    starts=_starts,
    strengths=("cosine", "sine"),
    measurement_noise_factor=_factor,
    benchmark=({"cosine": 0.14, "sine": 0.1}, {"cosine": 0.08, "sine": 0.05}),
)
