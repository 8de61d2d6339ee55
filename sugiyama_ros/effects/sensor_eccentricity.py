"""The camera stands off the centre of the ring, or its picture is distorted."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import MEASUREMENT, RING, Effect, Extent, Values
from sugiyama_ros.jit import kernel


@kernel
def _displacement(position: float, circumference: float, p: Array) -> tuple[float, float]:
    """Compute the measured minus the true position [m] and its derivative: one wave around the ring."""
    if circumference == 0.0:
        return 0.0, 0.0
    turn = 2.0 * math.pi / circumference
    cosine, sine = math.cos(turn * position), math.sin(turn * position)
    return p[0] * cosine + p[1] * sine, turn * (p[1] * cosine - p[0] * sine)


@kernel
def _distortion(position: float, circumference: float, p: Array) -> tuple[float, float]:
    """Compute the measured minus the true position [m] and its derivative: two and three waves around the ring."""
    if circumference == 0.0:
        return 0.0, 0.0
    turn = 2.0 * math.pi / circumference
    second, third = 2.0 * turn * position, 3.0 * turn * position
    offset = p[0] * math.cos(second) + p[1] * math.sin(second) + p[2] * math.cos(third) + p[3] * math.sin(third)
    slope = 2.0 * (p[1] * math.cos(second) - p[0] * math.sin(second))
    slope += 3.0 * (p[3] * math.cos(third) - p[2] * math.sin(third))
    return offset, turn * slope


def _starts(recording: Extent) -> tuple[Values, ...]:
    return ({"cosine": 0.1, "sine": 0.1},) if recording.circumference_m else ()


def _starts_of_distortion(recording: Extent) -> tuple[Values, ...]:
    some = {"cosine_2": 0.1, "sine_2": 0.1, "cosine_3": 0.1, "sine_3": 0.1}
    return (some,) if recording.circumference_m else ()


_DISTORTION = Effect(
    name="sensor_distortion",
    stage=MEASUREMENT,
    title="distorted picture",
    summary="the camera's picture is distorted: positions are displaced by two and three waves around the ring",
    term="measured x = x + two and three waves around the ring",
    source="geometry: a ring seen at an angle is an ellipse (two waves); a lens adds further harmonics",
    parameters=(
        Parameter("cosine_2", "e_c2", "m", 0.0, -20.0, 20.0, "displacement by two waves at position 0"),
        Parameter("sine_2", "e_s2", "m", 0.0, -20.0, 20.0, "displacement by two waves an eighth further on"),
        Parameter("cosine_3", "e_c3", "m", 0.0, -20.0, 20.0, "displacement by three waves at position 0"),
        Parameter("sine_3", "e_s3", "m", 0.0, -20.0, 20.0, "displacement by three waves a twelfth further on"),
    ),
    needs=(RING,),
    starts=_starts_of_distortion,
    strengths=("cosine_2", "sine_2", "cosine_3", "sine_3"),
    displacement=_distortion,
)

EFFECT = Effect(
    name="sensor_eccentricity",
    stage=MEASUREMENT,
    title="camera beside the centre",
    summary="the camera stands off the centre of the ring: positions are displaced by one wave around it",
    term="measured x = x + cosine cos(2 pi x / L) + sine sin(2 pi x / L)",
    source="geometry: an angle seen from a point beside the centre, to first order",
    parameters=(
        Parameter("cosine", "e_c", "m", 0.0, -20.0, 20.0, "displacement at position 0"),
        Parameter("sine", "e_s", "m", 0.0, -20.0, 20.0, "displacement a quarter of the ring further on"),
    ),
    needs=(RING,),
    starts=_starts,
    strengths=("cosine", "sine"),
    displacement=_displacement,
    benchmark=({"cosine": 0.8, "sine": 0.6}, {"cosine": 0.3, "sine": 0.2}),
    forms=(_DISTORTION,),
)
