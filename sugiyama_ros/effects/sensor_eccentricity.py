"""The camera stands off the centre of the ring."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import MEASUREMENT, Effect, RecordingExtent, Values
from sugiyama_ros.jit import kernel


@kernel
def displacement(position: float, circumference: float, p: Array) -> tuple[float, float]:
    """Compute the measured minus the true position [m] and its derivative: one wave around the ring."""
    if circumference == 0.0:
        return 0.0, 0.0
    turn = 2.0 * math.pi / circumference
    cosine, sine = math.cos(turn * position), math.sin(turn * position)
    return p[0] * cosine + p[1] * sine, turn * (p[1] * cosine - p[0] * sine)


def _starts(recording: RecordingExtent) -> tuple[Values, ...]:
    return ({"cosine": 0.1, "sine": 0.1},) if recording.circumference_m else ()


EFFECT = Effect(
    name="sensor_eccentricity",
    stage=MEASUREMENT,
    title="camera beside the centre",
    summary="the camera stands off the centre of the ring: positions are displaced by one wave around it",
    source="geometry: an angle seen from a point beside the centre, to first order",
    parameters=(
        Parameter("cosine", "e_c", "m", 0.0, -20.0, 20.0, "displacement at position 0"),
        Parameter("sine", "e_s", "m", 0.0, -20.0, 20.0, "displacement a quarter of the ring further on"),
    ),
    starts=_starts,
    strengths=("cosine", "sine"),
    displacement=displacement,
    benchmark=({"cosine": 0.8, "sine": 0.6}, {"cosine": 0.3, "sine": 0.2}),
)
