"""What the benchmark of the diagnosis hides in recordings, and what a diagnosis says of a recording."""

from collections.abc import Mapping
from dataclasses import dataclass

from sugiyama_ros.studies.hiding import DURATION_S, RING_M

#: What is hidden: nothing, two effects, or a force that is not in the catalogue of effects.
NONE, PAIR, FORM = "none", "pair", "form"
#: Pairs of effects, both in their strong form.
PAIRS = (
    ("slow_patch", "actuation_lag"),
    ("drag", "outlier_noise"),
    ("second_leader", "sensor_eccentricity"),
    ("limited_power", "preference_switch"),
)
#: Forces [m/s^2] that are not in the catalogue: covariate, lower and upper end of its range, values at knots.
FORMS: Mapping[str, tuple[str, float, float, tuple[float, ...]]] = {
    "hurry at medium gaps": ("gap", 1.0, 12.0, (0.0, 0.0, 0.6, 0.9, 0.6, 0.0, 0.0, 0.0)),
    "reluctance at medium speed": ("speed", 2.0, 10.0, (0.0, 0.0, -0.4, -0.8, -0.8, -0.4, 0.0, 0.0)),
    "overreaction to approach": ("approach_rate", -2.0, 2.0, (0.8, 0.5, 0.2, 0.0, 0.0, -0.2, -0.5, -0.8)),
    "brake lights": ("leader_acceleration", -3.0, 3.0, (-0.9, -0.6, -0.3, 0.0, 0.0, 0.0, 0.0, 0.0)),
    "two rough places": ("place", 0.0, RING_M, (0.0, -0.5, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0)),
    "tiring": ("time", 0.0, DURATION_S, (0.3, 0.2, 0.1, 0.0, -0.1, -0.2, -0.3, -0.4)),
}


@dataclass(frozen=True)
class Judgement:
    """What a diagnosis says of one recording.

    hidden: name of the hidden effect or form, two names joined by ``+``, or ``NONE``; strength: ``strong``, ``weak``,
    ``NONE``, ``PAIR`` or ``FORM``; seed: seed of the recording; first: name of the first addition, or ``NONE``; named:
    names of all additions; indistinguishable: names of the effects that cannot be told apart from the first addition;
    p_value: p-value of the first addition; gain: held-out gain of the first addition over all horizons together [nats];
    oracle_gain: gain that the score of the true effect predicts, in sample [nats]; oracle_heldout: held-out gain of the
    true effect alone, as ``gain``; 0 if it was not fitted; discovered: covariates of the forces without a name that
    were added; wall_s: time that the diagnosis took [s].
    """

    hidden: str
    strength: str
    seed: int
    first: str
    named: tuple[str, ...]
    indistinguishable: tuple[str, ...]
    p_value: float
    gain: float
    oracle_gain: float
    oracle_heldout: float
    discovered: tuple[str, ...]
    wall_s: float
