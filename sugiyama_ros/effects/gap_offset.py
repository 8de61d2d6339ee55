"""The measured gap has a constant error: the marker is off the car's centre, or the length is wrong."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import MEASUREMENT, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def perceive(seen: Seen, p: Array) -> tuple[float, float, float]:
    """Compute the true gap, which the driver sees: the measured gap plus ``p[0]`` [m]."""
    return seen.gap + p[0], seen.speed, seen.leader_speed


EFFECT = Effect(
    name="gap_offset",
    stage=MEASUREMENT,
    title="constant error of the gap",
    summary="a car's measured gap is off by a constant (marker off the centre, or a wrong length)",
    source="Punzo, Borzacchiello and Ciuffo, Transp. Res. C 19 (2011) 1243",
    parameters=(Parameter("offset", "δ", "m", 0.0, -5.0, 5.0, "true gap minus measured gap"),),
    starts=at({"offset": 0.1}),
    function=perceive,
    individual=True,
)
