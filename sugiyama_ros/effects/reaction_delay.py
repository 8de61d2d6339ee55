"""Drivers react to what they saw some time ago."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PERCEPTION, Effect, Seen, at
from sugiyama_ros.jit import kernel

_SOURCE = "Treiber and Kesting, Traffic Flow Dynamics (2013), section 12.2"
_DELAY = (Parameter("delay", "T_r", "s", 0.0, 0.0, 2.0, "reaction time"),)


@kernel
def _perceive(seen: Seen, p: Array) -> tuple[float, float, float]:
    """Estimate the gap [m] and the speeds [m/s] ``p[0]`` seconds ago, to first order in the delay."""
    delay = p[0]
    return (
        seen.gap - delay * (seen.leader_speed - seen.speed),
        seen.speed - delay * seen.acceleration,
        seen.leader_speed - delay * seen.leader_acceleration,
    )


@kernel
def _others_late(seen: Seen, p: Array) -> tuple[float, float, float]:
    """Return the gap [m] and the leader's speed [m/s] of the past, and the own speed [m/s] of now."""
    return seen.past_gap, seen.speed, seen.past_leader_speed


@kernel
def _all_late(seen: Seen, p: Array) -> tuple[float, float, float]:
    """Return the gap [m] and both speeds [m/s] of the past."""
    return seen.past_gap, seen.past_speed, seen.past_leader_speed


_OTHERS = Effect(
    name="reaction_delay_others",
    stage=PERCEPTION,
    title="reaction time to others",
    summary="drivers act on the gap and the leader's speed of some time ago, and on their own speed of now",
    term="gap, v_lead -> those of a time delay ago",
    source=_SOURCE,
    parameters=_DELAY,
    starts=at({"delay": 0.3}, {"delay": 0.6}, {"delay": 1.1}),
    function=_others_late,
    looks_back=True,
)
_ALL = Effect(
    name="reaction_delay_all",
    stage=PERCEPTION,
    title="reaction time to everything",
    summary="drivers act on the gap and both speeds of some time ago, kept in a memory: exact for long delays",
    term="gap, v, v_lead -> those of a time delay ago",
    source=_SOURCE,
    parameters=_DELAY,
    starts=at({"delay": 0.3}, {"delay": 0.6}, {"delay": 1.1}),
    function=_all_late,
    looks_back=True,
)
EFFECT = Effect(
    name="reaction_delay",
    stage=PERCEPTION,
    title="reaction time",
    summary="drivers act on the gap and the speeds of a short time ago, extrapolated by the present rates of change",
    term="gap, v, v_lead -> those of a time delay ago, to first order",
    source=_SOURCE,
    parameters=_DELAY,
    starts=at({"delay": 0.03}, {"delay": 0.1}, {"delay": 0.3}),
    function=_perceive,
    sees_accelerations=True,
    bank={"delay": 0.1},
    benchmark=({"delay": 0.18}, {"delay": 0.1}),
    forms=(_OTHERS, _ALL),
)
