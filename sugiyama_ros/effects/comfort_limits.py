"""The driver limits acceleration and braking softly and equally."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def _actuate(acceleration: float, seen: Seen, p: Array) -> float:
    """Compute A tanh(a / A) [m/s^2], a smooth saturation."""
    return float(p[0]) * math.tanh(acceleration / p[0])


EFFECT = Effect(
    name="comfort_limits",
    stage=ACTUATION,
    title="soft limits of acceleration",
    summary="a smooth saturation of acceleration and braking alike",
    term="a -> limit tanh(a / limit)",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 11.3",
    parameters=(
        Parameter("limit", "A", "m/s^2", 0.0, 0.1, 50.0, "limit of the acceleration, never reached; 0 for no limit"),
    ),
    starts=at({"limit": 1.5}, {"limit": 3.0}, {"limit": 6.0}),
    function=_actuate,
    is_limit=True,
    bank={"limit": 4.0},
    benchmark=({"limit": 1.05}, {"limit": 1.3}),
    advice={
        "limited_braking": "record hard accelerations, as from traffic lights",
        "limited_power": "record hard braking",
    },
)
