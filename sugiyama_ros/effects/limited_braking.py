"""Drivers, or brakes, give no more than a certain deceleration."""

from numba import njit

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, Effect, Seen, at
from sugiyama_ros.road import Array


@njit(cache=True)
def actuate(acceleration: float, seen: Seen, p: Array) -> float:
    """At least -B."""
    return max(acceleration, -float(p[0]))


EFFECT = Effect(
    name="limited_braking",
    stage=ACTUATION,
    summary="no harder braking than B",
    source="Gipps, Transp. Res. B 15 (1981) 105",
    parameters=(Parameter("limit", "B", "m/s^2", 0.0, 0.1, 20.0, "hardest braking; 0 for no limit"),),
    starts=at({"limit": 1.0}, {"limit": 2.0}, {"limit": 3.5}),
    function=actuate,
)
