"""Drivers' preferences change slowly."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PREFERENCE, Effect, Extent, Seen, Values, at
from sugiyama_ros.jit import kernel

_SOURCE = "Hoogendoorn, Ossen and Schreuder, Transp. Res. Rec. 1965 (2006) 112"
# Correlation time [s] of a random walk: far longer than recordings are.
_FOREVER_S = 3000.0


@kernel
def _trend(v_star: float, kappa_v: float, seen: Seen, p: Array) -> tuple[float, float]:
    """Change the preferences in proportion to the time since ``p[2]`` [s], in their logarithms."""
    since = seen.time - p[2]
    return (
        v_star * math.exp(min(max(p[0] * since, -2.0), 2.0)),
        kappa_v * math.exp(min(max(p[1] * since, -2.0), 2.0)),
    )


def _trends(recording: Extent) -> tuple[Values, ...]:
    length, middle = recording.end_s - recording.start_s, 0.5 * (recording.start_s + recording.end_s)
    rate = 0.05 / max(length, 1.0)
    return ({"v_star_rate": -rate, "kappa_v_rate": rate, "time": middle},)


_TREND = Effect(
    name="preference_drift_trend",
    stage=PREFERENCE,
    title="preferences with a trend",
    summary="desired speed and risk premium grow or fall steadily over the recording",
    term="log v*, log kappa_v + (v_star_rate, kappa_v_rate) (t - time)",
    source=_SOURCE,
    parameters=(
        Parameter("v_star_rate", "r_v", "1/s", 0.0, -0.1, 0.1, "growth of log v* in a second"),
        Parameter("kappa_v_rate", "r_κ", "1/s", 0.0, -0.1, 0.1, "growth of log κ_v in a second"),
        Parameter("time", "t_m", "s", 0.0, -1e12, 1e12, "time at which the preferences are the driver's own", "time"),
    ),
    starts=_trends,
    function=_trend,
    strengths=("v_star_rate", "kappa_v_rate"),
    fixed=("time",),
)
_STD = Parameter("std", "σ_d", "1", 0.0, 0.0, 2.0, "std of log v* and log κ_v over a long time")
_TIME = Parameter("time_constant", "T_d", "s", 0.0, 1.0, 1e5, "time after which a mood is forgotten")
_WALK = Effect(
    name="preference_drift_walk",
    stage=PREFERENCE,
    title="desired speed that walks at random",
    summary="the desired speed of each driver is a random walk: it wanders and is never forgotten",
    term="log v* wanders with std and time_constant",
    source=_SOURCE,
    parameters=(_STD, _TIME),
    starts=at({"std": 0.2, "time_constant": _FOREVER_S}),
    wanders=("v_star",),
    fixed=("time_constant",),
)
EFFECT = Effect(
    name="preference_drift",
    stage=PREFERENCE,
    title="slowly changing mood",
    summary="desired speed and risk premium wander at random (Ornstein-Uhlenbeck in their logarithms)",
    term="log v*, log kappa_v wander with std and time_constant",
    source=_SOURCE,
    parameters=(_STD, _TIME),
    starts=at({"std": 0.1, "time_constant": 30.0}, {"std": 0.03, "time_constant": 30.0}),
    wanders=("v_star", "kappa_v"),
    benchmark=({"std": 0.03, "time_constant": 30.0}, {"std": 0.018, "time_constant": 30.0}),
    advice={"preference_switch": "record for longer"},
    forms=(_WALK, _TREND),
)
