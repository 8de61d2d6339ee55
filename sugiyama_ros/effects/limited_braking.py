"""Drivers or brakes limit the deceleration."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def _actuate(acceleration: float, seen: Seen, p: Array) -> float:
    """Keep the acceleration [m/s^2] at or above -B."""
    return max(acceleration, -float(p[0]))


EFFECT = Effect(
    name="limited_braking",
    stage=ACTUATION,
    title="limited braking",
    summary="no harder braking than B",
    term="a -> max(a, -limit)",
    source="Gipps, Transp. Res. B 15 (1981) 105",
    parameters=(Parameter("limit", "B", "m/s^2", 0.0, 0.1, 20.0, "hardest braking; 0 for no limit"),),
    starts=at({"limit": 1.0}, {"limit": 2.0}, {"limit": 3.5}),
    function=_actuate,
    is_limit=True,
    bank={"limit": 2.5},
    benchmark=({"limit": 0.8}, {"limit": 1.05}),
)
