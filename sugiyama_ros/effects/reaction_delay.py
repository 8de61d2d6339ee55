"""Drivers react to what they saw some time ago."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PERCEPTION, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def perceive(seen: Seen, p: Array) -> tuple[float, float, float]:
    """Estimate the gap [m] and the speeds [m/s] ``p[0]`` seconds ago, to first order in the delay."""
    delay = p[0]
    return (
        seen.gap - delay * (seen.leader_speed - seen.speed),
        seen.speed - delay * seen.acceleration,
        seen.leader_speed - delay * seen.leader_acceleration,
    )


EFFECT = Effect(
    name="reaction_delay",
    stage=PERCEPTION,
    title="reaction time",
    summary="drivers act on the gap and the speeds of some time ago",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 12.2",
    parameters=(Parameter("delay", "T_r", "s", 0.0, 0.0, 2.0, "reaction time"),),
    starts=at({"delay": 0.03}, {"delay": 0.1}, {"delay": 0.3}),
    function=perceive,
    sees_accelerations=True,
    bank={"delay": 0.1},
    benchmark=({"delay": 0.18}, {"delay": 0.1}),
)
