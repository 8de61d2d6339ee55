"""Gipps' law of safe speeds."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.jit import in_python_too, kernel
from sugiyama_ros.laws.law import Law, bounded


@in_python_too
def safe_speed(room: float, speed: float, leader_speed: float, tau: float, b: float, b_leader: float) -> float:
    """Compute the speed [m/s] from which a driver can still stop within the room [m] behind the leader.

    room: gap less the gap at standstill [m]; speed: own speed [m/s], not below 0; tau: reaction time [s]; b, b_leader:
    braking [m/s^2] of the driver and of the leader.
    """
    reach = b * tau
    square = reach * reach + b * (2.0 * room - speed * tau + leader_speed * abs(leader_speed) / b_leader)
    return max(math.sqrt(square) - reach, 0.0) if square > 0.0 else 0.0


@kernel
def _gipps(gap: float, speed: float, leader_speed: float, p: Array) -> float:
    """Compute the acceleration [m/s^2] of Gipps' law, p = v0, a, b, b_leader, tau, s0.

    The law gives the speed after the reaction time tau. The acceleration is the change of speed over tau. The driver
    chooses the smaller of two speeds: the speed of a free driver, and the speed from which the driver can still stop
    behind a leader who brakes with b_leader.
    """
    own = max(speed, 0.0)
    share = own / p[0]
    free = own + 2.5 * p[1] * p[4] * (1.0 - share) * math.sqrt(0.025 + share)
    if gap == math.inf:
        return bounded((free - speed) / p[4])
    safe = safe_speed(gap - p[5], own, leader_speed, p[4], p[2], p[3])
    return bounded((min(free, safe) - speed) / p[4])


LAW = Law(
    name="gipps",
    title="Gipps",
    summary="the speed from which the driver can still stop behind a braking leader",
    source="Gipps, Transp. Res. B 15 (1981) 105",
    parameters=(
        Parameter("v0", "V", "m/s", 10.0, 1.0, 80.0, "desired speed"),
        Parameter("a", "a", "m/s^2", 1.5, 0.05, 10.0, "maximum acceleration"),
        Parameter("b", "b", "m/s^2", 3.0, 0.1, 20.0, "hardest braking that the driver is ready for"),
        Parameter("b_leader", "b̂", "m/s^2", 3.0, 0.1, 20.0, "braking that the driver expects ahead"),
        Parameter("tau", "τ", "s", 0.7, 0.1, 3.0, "reaction time"),
        Parameter("s0", "s_0", "m", 1.5, 0.0, 20.0, "gap at standstill"),
    ),
    function=_gipps,
)
