"""Something outside pushes or brakes one car for a moment."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ENVIRONMENT, Effect, Seen
from sugiyama_ros.jit import kernel


@kernel
def _push(seen: Seen, p: Array) -> float:
    """Compute a Gaussian pulse [m/s^2] in time, with height ``p[0]``, centre ``p[1]`` [s] and std ``p[2]`` [s]."""
    if p[3] != 0.0:
        return 0.0
    off = (seen.time - p[1]) / p[2]
    return p[0] * math.exp(-0.5 * off * off) if abs(off) < 6.0 else 0.0


EFFECT = Effect(
    name="external_push",
    stage=ENVIRONMENT,
    title="push from outside",
    summary="one car is pushed or braked by something else at one moment",
    term="+ strength exp(-((t - time) / duration)²/2)",
    source="as the perturbations of Tadaki et al., New J. Phys. 15 (2013) 103034",
    parameters=(
        Parameter("strength", "f", "m/s^2", 0.0, -20.0, 20.0, "acceleration at the peak of the push"),
        Parameter("time", "t_0", "s", 0.0, -1e12, 1e12, "time of the recording at which the push is strongest", "time"),
        Parameter("duration", "d", "s", 0.0, 0.1, 60.0, "duration of the push, as a std in time"),
        Parameter("spared", "", "1", 0.0, 0.0, 1.0, "1 for a car that is not pushed"),
    ),
    function=_push,
    individual=True,
)
