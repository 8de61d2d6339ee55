"""Drivers expect their leader to go on accelerating or braking, instead of keeping the speed."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.driver.utility import Preferences, anticipate, collision_penalty, gap_scale
from sugiyama_ros.effects.effect import UTILITY, Effect, Seen
from sugiyama_ros.jit import kernel


@kernel(vectorised=True)
def _gap_and_scale(
    action: float, tau: int, seen: Seen, expected: float, period: float, driver: Preferences
) -> tuple[float, float]:
    """Compute the gap [m] and its scale [m] ``tau`` periods ahead of a leader who holds ``expected`` [m/s^2]."""
    gap_then, _ = anticipate(action - expected, tau, seen.gap, seen.speed, seen.leader_speed, period)
    own, other = seen.speed + tau * period * action, seen.leader_speed + tau * period * expected
    return gap_then, gap_scale(own, other, driver[3], driver[1], driver[4])


@kernel(vectorised=True)
def _risk(action: float, seen: Seen, expected: float, period: float, horizon: int, driver: Preferences) -> float:
    """Compute the largest risk, from 0 to 1, in the look-ahead behind a leader who holds ``expected`` [m/s^2]."""
    near, wide = _gap_and_scale(action, 1, seen, expected, period, driver)
    for tau in range(2, horizon + 1):
        gap_then, wide_then = _gap_and_scale(action, tau, seen, expected, period, driver)
        if gap_then * wide < near * wide_then:
            near, wide = gap_then, wide_then
    return collision_penalty(near / wide)


@kernel(vectorised=True)
def _component(seen: Seen, action: float, period: float, horizon: int, p: Array, driver: Preferences) -> float:
    """Compute the risk behind the accelerating leader in place of the risk behind a leader of constant speed."""
    if math.isinf(seen.gap):
        return 0.0
    # a leader brakes to a standstill, and does not drive backward
    expected = max(float(p[0]) * seen.leader_acceleration, -max(seen.leader_speed, 0.0) / (horizon * period))
    risk = _risk(action, seen, expected, period, horizon, driver) - _risk(action, seen, 0.0, period, horizon, driver)
    return float(driver[5] * risk)


EFFECT = Effect(
    name="anticipated_leader",
    stage=UTILITY,
    title="foresight of the leader's acceleration",
    summary="drivers expect that the leader goes on accelerating or braking during the look-ahead",
    term="x_lead + v_lead tau -> x_lead + v_lead tau + weight a_lead tau (tau - 1) / 2",
    source="paper, section 3.1: the leader's action counts as 0, other than in betaNash of Dai et al. (2020)",
    parameters=(
        Parameter("weight", "w_a", "1", 0.0, -2.0, 2.0, "share of the leader's acceleration that the driver expects"),
    ),
    function=_component,
    sees_accelerations=True,
)
