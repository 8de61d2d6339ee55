"""Drivers see late who goes first, because something hides the other road."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.line import smooth_step
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ATTENTION, YIELDS, Effect, Seen, at_lines
from sugiyama_ros.jit import kernel

# Gap [m] within which the other road comes into view.
_SOFT_M = 0.5


@kernel
def _attend(attention: float, seen: Seen, p: Array) -> float:
    """Pay no attention to a line that is farther away than the sight reaches; a red signal is seen from afar."""
    if seen.arrive_s <= 0.0:
        return attention
    return attention * smooth_step((p[0] - seen.line_gap) / _SOFT_M)


EFFECT = Effect(
    name="blind_sector",
    stage=ATTENTION,
    title="blind sector",
    summary="drivers see who goes first only from near the line",
    term="attention -> 0 while the line is farther away than the sight",
    source="AASHTO, A Policy on Geometric Design of Highways and Streets (2018), section 9.5 (sight triangles)",
    parameters=(Parameter("sight", "d_s", "m", 0.0, 1.0, 200.0, "gap to the line from which on others are seen"),),
    needs=(YIELDS,),
    starts=at_lines({"sight": 5.0}, {"sight": 10.0}, {"sight": 20.0}),
    is_limit=True,
    function=_attend,
)
