"""Some drivers do not let those pass who go first."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ATTENTION, YIELDS, Effect, Seen, at_lines
from sugiyama_ros.jit import kernel


@kernel
def _attend(attention: float, seen: Seen, p: Array) -> float:
    """Pay less attention to a line while who goes first is still on the way; a place that is taken counts in full."""
    return attention * (1.0 - p[0]) if seen.arrive_s > 0.0 else attention


EFFECT = Effect(
    name="ignored_yield",
    stage=ATTENTION,
    title="ignored right of way",
    summary="the driver pays less attention to those who go first",
    term="attention -> (1 - share) attention while who goes first is on the way",
    source="paper, section 7 (merging and roundabouts); the form is this package's: 1 - share is a yield weight",
    parameters=(Parameter("share", "q_y", "1", 0.0, -2.0, 1.0, "part of the attention that is lacking"),),
    needs=(YIELDS,),
    starts=at_lines({"share": 0.5}, {"share": 0.98}),
    function=_attend,
    least={"share": 0.0},
)
