"""Drivers' preferences change slowly and at random."""

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import PREFERENCE, Effect, at

EFFECT = Effect(
    name="preference_drift",
    stage=PREFERENCE,
    title="slowly changing mood",
    summary="desired speed and risk premium wander at random (Ornstein-Uhlenbeck in their logarithms)",
    source="Hoogendoorn, Ossen and Schreuder, Transp. Res. Rec. 1965 (2006) 112",
    parameters=(
        Parameter("std", "σ_d", "1", 0.0, 0.0, 2.0, "std of log v* and log κ_v over a long time"),
        Parameter("time_constant", "T_d", "s", 0.0, 1.0, 1e5, "time after which a mood is forgotten"),
    ),
    starts=at({"std": 0.1, "time_constant": 30.0}, {"std": 0.03, "time_constant": 30.0}),
    wanders=("v_star", "kappa_v"),
    benchmark=({"std": 0.03, "time_constant": 30.0}, {"std": 0.018, "time_constant": 30.0}),
    advice={"preference_switch": "record for longer"},
)
