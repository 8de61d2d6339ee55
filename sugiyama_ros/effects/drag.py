"""Rolling resistance and air drag for which the driver does not compensate."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ENVIRONMENT, Effect, Seen, at
from sugiyama_ros.jit import kernel


@kernel
def _push(seen: Seen, p: Array) -> float:
    """Compute -c0 - c2 v^2 [m/s^2]; c0 fades at walking pace, because resistance pushes no car backward."""
    return _resistance(seen.speed, 1.0, p)


@kernel
def _push_to_standstill(seen: Seen, p: Array) -> float:
    """Compute -c0 - c2 v^2 [m/s^2]; c0 fades below 0.25 m/s only."""
    return _resistance(seen.speed, 4.0, p)


@kernel
def _resistance(speed: float, rise: float, p: Array) -> float:
    """Resistance [m/s^2]; ``rise``: by how much the share of ``p[0]`` rises with the speed [s/m], up to 1."""
    moving = min(max(rise * speed, 0.0), 1.0)
    return float(-p[0] * moving - p[1] * speed * abs(speed))


_PARAMETERS = (
    Parameter("c0", "c_0", "m/s^2", 0.0, -2.0, 5.0, "constant resistance"),
    Parameter("c2", "c_2", "1/m", 0.0, -0.1, 0.1, "resistance that grows with the speed squared"),
)
_TO_STANDSTILL = Effect(
    name="drag_to_standstill",
    stage=ENVIRONMENT,
    title="drag down to a standstill",
    summary="resistance -c0 - c2 v² of which c0 also acts at walking pace",
    term="- c0 - c2 v|v|",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 21.2",
    parameters=_PARAMETERS,
    starts=at({"c0": 0.1, "c2": 0.001}),
    least={"c0": 0.0, "c2": 0.0},
    function=_push_to_standstill,
    strengths=("c0", "c2"),
)
EFFECT = Effect(
    name="drag",
    stage=ENVIRONMENT,
    title="drag",
    summary="resistance -c0 - c2 v² beyond what the driver makes up for",
    term="- c0 - c2 v|v|",
    source="Treiber and Kesting, Traffic Flow Dynamics (2013), section 21.2",
    parameters=_PARAMETERS,
    starts=at({"c0": 0.05, "c2": 0.001}),
    least={"c0": 0.0, "c2": 0.0},
    function=_push,
    strengths=("c0", "c2"),
    bank={"c0": 0.1, "c2": 0.003},
    benchmark=({"c0": 0.3, "c2": 0.004}, {"c0": 0.18, "c2": 0.002}),
    advice={"limited_power": "record coasting, or accelerations at several speeds"},
    forms=(_TO_STANDSTILL,),
)
