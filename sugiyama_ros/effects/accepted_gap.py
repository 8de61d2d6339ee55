"""Drivers accept shorter or longer time gaps than usual before those who go first."""

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.line import TIME_GAP_S
from sugiyama_ros.driver.line import attention as attention_of
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ATTENTION, SIGNALS, YIELDS, Effect, Seen, at_lines
from sugiyama_ros.jit import kernel


@kernel
def _attend(attention: float, seen: Seen, p: Array) -> float:
    """Compute the attention anew, with another time gap; other effects on the attention come after this one."""
    return attention_of(seen.line_gap, seen.speed, seen.arrive_s, seen.clear_s, TIME_GAP_S + p[0])


EFFECT = Effect(
    name="accepted_gap",
    stage=ATTENTION,
    title="other accepted gaps",
    summary="drivers go before shorter, or only before longer, time gaps than usual",
    term="time gap -> time gap + longer",
    source="Highway Capacity Manual, 6th edition (2016), chapters 20 and 22 (critical headway)",
    parameters=(Parameter("longer", "dt_g", "s", 0.0, -4.0, 10.0, "time that is added to the usual time gap"),),
    needs=(YIELDS, SIGNALS),
    starts=at_lines({"longer": -1.0}, {"longer": 1.0}),
    function=_attend,
)
