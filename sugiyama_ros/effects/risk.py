"""The risk of a collision with another vehicle than the leader, for components of the utility."""

from sugiyama_ros.driver.utility import Preferences, anticipate, collision_penalty, gap_and_scale, gap_scale
from sugiyama_ros.jit import kernel


@kernel(vectorised=True)
def risk_ahead(
    gap: float, speed: float, other_speed: float, action: float, period: float, horizon: int, driver: Preferences
) -> float:
    """Compute the largest risk, from 0 to 1, of a vehicle ahead in the look-ahead, as phi2 of the paper does.

    gap, speed, other_speed: gap [m], and speeds [m/s] of the driver and of the vehicle ahead; action: acceleration
    [m/s^2] that the driver holds; period: length of a period [s].
    """
    near, wide = gap_and_scale(action, 1, gap, speed, other_speed, driver, period)
    for tau in range(2, horizon + 1):
        gap_then, wide_then = gap_and_scale(action, tau, gap, speed, other_speed, driver, period)
        if gap_then * wide < near * wide_then:
            near, wide = gap_then, wide_then
    return collision_penalty(near / wide)


@kernel(vectorised=True)
def risk_behind(
    gap: float, speed: float, other_speed: float, action: float, period: float, horizon: int, driver: Preferences
) -> float:
    """Compute the largest risk of a vehicle behind, which keeps its speed; arguments as for ``risk_ahead``."""
    near, wide = _gap_behind(action, 1, gap, speed, other_speed, period, driver)
    for tau in range(2, horizon + 1):
        gap_then, wide_then = _gap_behind(action, tau, gap, speed, other_speed, period, driver)
        if gap_then * wide < near * wide_then:
            near, wide = gap_then, wide_then
    return collision_penalty(near / wide)


@kernel(vectorised=True)
def _gap_behind(
    action: float, tau: int, gap: float, speed: float, other_speed: float, period: float, driver: Preferences
) -> tuple[float, float]:
    """Compute the gap [m] to the vehicle behind, and its scale [m], ``tau`` periods ahead."""
    gap_ahead, _ = anticipate(-action, tau, gap, other_speed, speed, period)
    return gap_ahead, gap_scale(other_speed, speed + tau * period * action, driver[3], driver[1], driver[4])
