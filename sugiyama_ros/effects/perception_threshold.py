"""Drivers hold their acceleration until they would have to change it by enough: action points."""

from numba import njit

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PERCEPTION, Effect, at
from sugiyama_ros.road import Array


@njit(cache=True)
def hold(meant: float, held: float, p: Array) -> float:
    """The acceleration held, unless the one meant differs by more than the threshold."""
    return held if abs(meant - held) < p[0] else meant


EFFECT = Effect(
    name="perception_threshold",
    stage=PERCEPTION,
    summary="drivers hold their acceleration until a change exceeds a threshold (action points)",
    source="Todosiev and Barbosa, Traffic Eng. 34 (1963) 17; Wagner, Eur. Phys. J. B 84 (2011) 713",
    parameters=(Parameter("threshold", "θ", "m/s^2", 0.0, 0.0, 5.0, "smallest change of the acceleration"),),
    starts=at({"threshold": 0.3}, {"threshold": 0.8}),
)
