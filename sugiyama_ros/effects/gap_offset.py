"""The measured gap has an error: a marker is off the car's centre, a length is wrong, or clocks differ."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import MEASUREMENT, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def _perceive(seen: Seen, p: Array) -> tuple[float, float, float]:
    """Compute the true gap, which the driver sees: the measured gap plus ``p[0]`` [m]."""
    return seen.gap + p[0], seen.speed, seen.leader_speed


@kernel
def _perceive_later(seen: Seen, p: Array) -> tuple[float, float, float]:
    """Compute what the driver sees of a leader whose clock differs by ``p[0]`` [s], to first order."""
    leader_speed = max(seen.leader_speed + p[0] * seen.leader_acceleration, 0.0)
    return seen.gap + p[0] * seen.leader_speed, seen.speed, leader_speed


_CLOCK = Effect(
    name="clock_offset",
    stage=MEASUREMENT,
    title="clocks that differ",
    summary="a leader was measured somewhat earlier or later than the driver behind (each with a clock of its own)",
    term="gap, v_lead -> gap + offset v_lead, v_lead + offset a_lead",
    source="kinematics: a leader drives on between two clocks, to first order",
    parameters=(Parameter("offset", "δ_t", "s", 0.0, -1.0, 1.0, "the driver's own clock minus the leader's"),),
    starts=at({"offset": 0.05}),
    function=_perceive_later,
    individual=True,
    sees_accelerations=True,
)

EFFECT = Effect(
    name="gap_offset",
    stage=MEASUREMENT,
    title="constant error of the gap",
    summary="a car's measured gap is off by a constant (marker off the centre, or a wrong length)",
    term="gap -> gap + offset",
    source="Punzo, Borzacchiello and Ciuffo, Transp. Res. C 19 (2011) 1243",
    parameters=(Parameter("offset", "δ", "m", 0.0, -5.0, 5.0, "true gap minus measured gap"),),
    starts=at({"offset": 0.1}),
    function=_perceive,
    individual=True,
    forms=(_CLOCK,),
)
