"""Drivers look further ahead than the paper's four periods, or less far."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import REFERENCE_PERIOD_S, Parameter
from sugiyama_ros.driver.utility import FAR, Preferences, collision_penalty, gap_and_scale
from sugiyama_ros.effects.effect import UTILITY, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel(vectorised=True)
def _component(seen: Seen, action: float, period: float, horizon: int, p: Array, driver: Preferences) -> float:
    """Compute the risk of the whole look-ahead in place of the risk of the usual one.

    The look-ahead ends between two periods, too, so that its length [s] is a continuous parameter. What lies beyond
    the usual one is looked at as often as at the reference period.
    """
    gap, speed, leader_speed = min(seen.gap, FAR), seen.speed, seen.leader_speed
    end = max(horizon + p[0] / period, 1.0)
    # smallest ratio of gap to scale: in the usual look-ahead, and in the whole one
    usual_gap, usual_scale = gap_and_scale(action, 1, gap, speed, leader_speed, driver, period)
    least_gap, least_scale = gap_and_scale(action, end, gap, speed, leader_speed, driver, period)
    for tau in range(1, horizon + 1):
        ahead, scale = gap_and_scale(action, tau, gap, speed, leader_speed, driver, period)
        if ahead * usual_scale < usual_gap * scale:
            usual_gap, usual_scale = ahead, scale
        if tau <= end and ahead * least_scale < least_gap * scale:
            least_gap, least_scale = ahead, scale
    for further in range(1, int((end - horizon) * period / REFERENCE_PERIOD_S + 1e-6) + 1):
        beyond = horizon + further * REFERENCE_PERIOD_S / period
        ahead, scale = gap_and_scale(action, beyond, gap, speed, leader_speed, driver, period)
        if ahead * least_scale < least_gap * scale:
            least_gap, least_scale = ahead, scale
    risk = collision_penalty(least_gap / least_scale) - collision_penalty(usual_gap / usual_scale)
    _, _, _, _, _, omega_2, _ = driver
    return float(omega_2 * risk)


EFFECT = Effect(
    name="look_ahead",
    stage=UTILITY,
    title="longer look-ahead",
    summary="the collision risk is anticipated for longer than the paper's 4/3 s, or less long",
    term="omega2 (largest risk in the whole look-ahead - largest risk in the usual one)",
    source="paper, sections 3.1 and 3.2.2: the look-ahead is a choice of the model",
    parameters=(Parameter("extra", "T+", "s", 0.0, -1.0, 10.0, "time beyond the usual look-ahead of 4/3 s"),),
    starts=at({"extra": 0.5}, {"extra": 2.0}),
    function=_component,
    is_constant=True,
)
