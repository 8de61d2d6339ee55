"""Drivers who stand at a signal start some time after it has turned green."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.line import smooth_step
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ATTENTION, SIGNALS, Effect, Seen, at_lines
from sugiyama_ros.jit import kernel

# Time [s] within which the attention goes, and speed [m/s] up to which a driver stands.
_SOFT_S, _STANDING = 0.1, 0.5


@kernel
def _attend(attention: float, seen: Seen, p: Array) -> float:
    """Go on paying attention to a line that has become free, for a driver who stands before it."""
    if not 0.0 < seen.line_gap < math.inf or seen.clear_s > 0.0:
        return attention
    standing = smooth_step((_STANDING - seen.speed) / (0.2 * _STANDING))
    return max(attention, standing * smooth_step((p[0] + seen.clear_s) / _SOFT_S))


EFFECT = Effect(
    name="late_start",
    stage=ATTENTION,
    title="late start at green",
    summary="drivers who stand at a signal start some time after it has turned green",
    term="attention stays for a delay after green while the driver stands",
    source="Highway Capacity Manual, 6th edition (2016), chapter 19 (start-up lost time)",
    parameters=(Parameter("delay", "t_g", "s", 0.0, 0.0, 10.0, "time after green"),),
    needs=(SIGNALS,),
    starts=at_lines({"delay": 0.6}, {"delay": 1.5}),
    function=_attend,
)
