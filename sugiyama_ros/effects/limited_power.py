"""The engine's power limits the acceleration."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def _actuate(acceleration: float, seen: Seen, p: Array) -> float:
    """Keep the acceleration [m/s^2] at or below P / v; speeds below 0.1 m/s count as 0.1 m/s."""
    return min(acceleration, float(p[0]) / max(seen.speed, 0.1))


EFFECT = Effect(
    name="limited_power",
    stage=ACTUATION,
    title="limited engine power",
    summary="the engine gives no more than P/v",
    term="a -> min(a, power / v)",
    source="Rakha and Lucic, J. Transp. Eng. 128 (2002) 161",
    parameters=(Parameter("power", "P", "m^2/s^3", 0.0, 0.2, 1e3, "power per mass of vehicle; 0 for no limit"),),
    starts=at({"power": 4.0}, {"power": 9.0}, {"power": 20.0}),
    function=_actuate,
    is_limit=True,
    bank={"power": 10.0},
    benchmark=({"power": 13.0}, {"power": 17.0}),
)
