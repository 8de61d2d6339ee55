"""The risk of a collision with another vehicle than the leader, for components of the utility."""

from sugiyama_ros.driver.utility import Preferences, anticipate, collision_penalty, gap_scale
from sugiyama_ros.jit import kernel


@kernel
def risk_ahead(
    gap: float, speed: float, other_speed: float, action: float, period: float, horizon: int, driver: Preferences
) -> float:
    """Compute the largest risk, from 0 to 1, of a vehicle ahead in the look-ahead, as phi2 of the paper does.

    Parameters
    ----------
    gap, speed, other_speed : float
        Gap [m], and speeds [m/s] of the driver and of the vehicle ahead.
    action : float
        Acceleration [m/s^2] that the driver holds.
    period : float
        Length of a period [s].
    horizon : int
        Periods of look-ahead.
    driver : Preferences
        Parameters of the utility.

    Returns
    -------
    float
        Risk.
    """
    smallest = 1e9
    for tau in range(1, horizon + 1):
        gap_ahead, speed_ahead = anticipate(action, tau, gap, speed, other_speed, period)
        smallest = min(smallest, gap_ahead / gap_scale(speed_ahead, other_speed, driver[3], driver[1], driver[4]))
    return collision_penalty(smallest)


@kernel
def risk_behind(
    gap: float, speed: float, other_speed: float, action: float, period: float, horizon: int, driver: Preferences
) -> float:
    """Compute the largest risk of a vehicle behind, which keeps its speed; arguments as for ``risk_ahead``."""
    smallest = 1e9
    for tau in range(1, horizon + 1):
        gap_ahead, _ = anticipate(-action, tau, gap, other_speed, speed, period)
        scale = gap_scale(other_speed, speed + tau * period * action, driver[3], driver[1], driver[4])
        smallest = min(smallest, gap_ahead / scale)
    return collision_penalty(smallest)
