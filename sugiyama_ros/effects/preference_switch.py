"""Drivers' preferences change at one moment."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PREFERENCE, Effect, Extent, Seen, Values
from sugiyama_ros.jit import kernel

# Time [s] that the switch takes. The switch is smooth, so that an optimiser can search for its moment.
_RISE_S = 0.5
_TIMES = 9


@kernel
def _prefer(v_star: float, kappa_v: float, seen: Seen, p: Array) -> tuple[float, float]:
    """Change the preferences smoothly around the time ``p[2]`` [s]."""
    share = 1.0 / (1.0 + math.exp(min(max((p[2] - seen.time) / _RISE_S, -50.0), 50.0)))
    return v_star * math.exp(p[0] * share), kappa_v * math.exp(p[1] * share)


def _starts(recording: Extent) -> tuple[Values, ...]:
    length = recording.end_s - recording.start_s
    return tuple(
        {"v_star_change": -0.05, "kappa_v_change": 0.05, "time": recording.start_s + (k + 1) / (_TIMES + 1) * length}
        for k in range(_TIMES)
    )


EFFECT = Effect(
    name="preference_switch",
    stage=PREFERENCE,
    title="sudden change of mind",
    summary="desired speed and risk premium change at one moment",
    term="log v*, log kappa_v + v_star_change, kappa_v_change after time",
    source="Hamdar, Treiber, Mahmassani and Kesting, Transp. Res. Rec. 2088 (2008) 208",
    parameters=(
        Parameter("v_star_change", "Δv", "1", 0.0, -2.0, 2.0, "change of log v*"),
        Parameter("kappa_v_change", "Δκ", "1", 0.0, -3.0, 3.0, "change of log κ_v"),
        Parameter("time", "t_s", "s", 0.0, -1e12, 1e12, "time of the recording at which the switch happens", "time"),
    ),
    starts=_starts,
    function=_prefer,
    strengths=("v_star_change", "kappa_v_change"),
    benchmark=(
        {"v_star_change": -0.04, "kappa_v_change": 0.08},
        {"v_star_change": -0.018, "kappa_v_change": 0.035},
    ),
)
