"""A missing force without a known cause: a curve over one covariate, learnt from the data."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ENVIRONMENT, Effect, Seen
from sugiyama_ros.jit import kernel

#: What the force may depend on. The first parameter of the effect is a number in this order, counted from 1.
COVARIATES = (
    "gap",
    "speed",
    "approach_rate",
    "place",
    "time",
    "leader_acceleration",
    "rear_gap",
    "second_gap",
    "acceleration",
    "rear_approach_rate",
    "second_approach_rate",
    "time_gap",
)
KNOTS = 8
#: A time gap [s] is meaningful above this speed [m/s], and up to this length [s].
MOVING, LONGEST_S = 1.0, 10.0


@kernel
def _push(seen: Seen, p: Array) -> float:
    """Compute the force [m/s^2]: straight lines between the values ``p[3:]`` at knots from ``p[1]`` to ``p[2]``.

    The knots are evenly spaced, and the curve is flat outside them. Over the place on a ring the curve is periodic: the
    first knot follows the last knot. There is no force along the approach rate of a vehicle that is not there.
    """
    covariate = p[0]
    if covariate == 1.0:
        x = seen.gap
    elif covariate == 2.0:
        x = seen.speed
    elif covariate == 3.0:
        x = seen.speed - seen.leader_speed
    elif covariate == 4.0:
        x = seen.position
    elif covariate == 5.0:
        x = seen.time
    elif covariate == 6.0:
        x = seen.leader_acceleration
    elif covariate == 7.0:
        x = seen.rear_gap
    elif covariate == 8.0:
        x = seen.second_gap
    elif covariate == 9.0:
        x = seen.acceleration
    elif covariate == 10.0:
        x = seen.rear_speed - seen.speed
        if math.isinf(seen.rear_gap):
            return 0.0
    elif covariate == 11.0:
        x = seen.speed - seen.second_speed
        if math.isinf(seen.second_gap):
            return 0.0
    else:
        x = min(seen.gap / max(seen.speed, MOVING), LONGEST_S)
    if covariate == 4.0 and seen.circumference > 0.0:
        s = (x - p[1]) / seen.circumference
        s = KNOTS * (s - math.floor(s))
        k = min(int(s), KNOTS - 1)
        return float(p[3 + k] + (s - k) * (p[3 + (k + 1) % KNOTS] - p[3 + k]))
    s = (KNOTS - 1) * min(max((x - p[1]) / (p[2] - p[1]), 0.0), 1.0)
    k = min(int(s), KNOTS - 2)
    return float(p[3 + k] + (s - k) * (p[4 + k] - p[3 + k]))


EFFECT = Effect(
    name="discovered_force",
    stage=ENVIRONMENT,
    title="force without a name",
    summary="a force learnt from the data as a curve over one covariate",
    term="+ force(covariate)",
    source="Kristensen, Madsen and Jørgensen, Automatica 40 (2004) 225",
    parameters=(
        Parameter(
            "covariate",
            "",
            "1",
            0.0,
            1.0,
            float(len(COVARIATES)),
            "number of one of " + ", ".join(COVARIATES),
            is_whole=True,
        ),
        Parameter("first", "", "1", 0.0, -1e12, 1e12, "covariate at the first knot"),
        Parameter("last", "", "1", 0.0, -1e12, 1e12, "covariate at the last knot"),
        *(Parameter(f"force_{k}", f"f_{k}", "m/s^2", 0.0, -10.0, 10.0, f"force at knot {k}") for k in range(KNOTS)),
    ),
    function=_push,
    ascending=(("first", "last"),),
    fixed=("covariate", "first", "last"),
)
