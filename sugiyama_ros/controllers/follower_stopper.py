"""FollowerStopper: a chosen speed, reduced within three envelopes around the leader."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.controllers.controller import Controller, acceleration_to
from sugiyama_ros.controllers.shared import TARGET

# Gaps [m] where the envelopes begin behind a leader who is not slower, and decelerations [m/s^2] they are made for.
_GAPS_M, _DECELERATIONS = (4.5, 5.25, 6.0), (1.5, 1.0, 0.5)


def _commanded_speed(gap: float, speed: float, leader_speed: float, target: float) -> float:
    """Compute the commanded speed [m/s]: 0, up to the leader's speed, from there to the target, or the target."""
    closing = max(speed - leader_speed, 0.0)
    first, second, third = (x + closing * closing / (2.0 * d) for x, d in zip(_GAPS_M, _DECELERATIONS, strict=True))
    ahead = min(max(leader_speed, 0.0), target)
    if gap <= first:
        return 0.0
    if gap <= second:
        return ahead * (gap - first) / (second - first)
    if gap <= third:
        return ahead + (target - ahead) * (gap - second) / (third - second)
    return target


def _follower_stopper(gap: float, speed: float, leader_speed: float, memory: Array, period: float, p: Array) -> float:
    """Follow the commanded speed of FollowerStopper, p = target."""
    return acceleration_to(_commanded_speed(gap, speed, leader_speed, p[0]), speed, period)


CONTROLLER = Controller(
    name="follower_stopper",
    title="FollowerStopper",
    summary="a chosen speed; less of it within envelopes of gap and closing speed around the leader",
    source="Stern et al., Transp. Res. C 89 (2018) 205; Bhadani et al., IEEE Conf. Decision and Control (2018)",
    parameters=(TARGET,),
    function=_follower_stopper,
)
