"""What was found about a candidate, judged against what chance gives on recordings in which nothing is missing."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.screen import Screened
from sugiyama_ros.effects.registry import effect
from sugiyama_ros.fit.joint import JointFit

#: A gain is not believed below this [nats], whatever the p-value.
LEAST_GAIN = 5.0
# Least spread of simulated gains [nats].
_LEAST_SPREAD = 1.5
# Prior weight of the common spread in the spread of one candidate, as a number of simulated recordings.
_COMMON = 4


@dataclass(frozen=True, eq=False)
class Candidacy:
    """What was found about one candidate in one round; gains in nats.

    look: the quick look; fit: the model with the candidate; gain: over the model without it; expected, spread: mean and
    spread of the gain by chance; p_value: corrected for the number of candidates; p_alone: not corrected; refined:
    whether ``fit`` is a full fit.
    """

    look: Screened
    fit: JointFit
    gain: float
    expected: float
    spread: float
    p_value: float
    p_alone: float
    refined: bool

    @property
    def candidate(self) -> Candidate:
        """The candidate itself."""
        return self.look.candidate

    @property
    def score(self) -> float:
        """Gain above what chance gives."""
        return self.gain - self.expected


@dataclass(frozen=True, eq=False)
class NullGains:
    """Gains of candidates on simulated recordings in which nothing is missing.

    gains: of each candidate [nats], one per recording; scale: std of half a chi-squared variable with as many degrees
    of freedom as the candidate has parameters.
    """

    gains: dict[str, list[float]]
    scale: dict[str, float]

    def judge(self, look: Screened, rivals: int) -> Candidacy:
        """Judge a look at a candidate.

        The p-value is Student's t over the simulated gains, whose spread is partly shared among candidates. ``rivals``:
        number of candidates, for Bonferroni's correction.
        """
        candidate = look.candidate
        gains = np.maximum(self.gains.get(candidate.name, [0.0]), 0.0)
        spreads = [
            float(np.std(np.maximum(g, 0.0), ddof=1)) / self.scale[name] for name, g in self.gains.items() if len(g) > 1
        ]
        # chi-squared variables of K parameters spread by sqrt(2 / K) of their mean, whatever the filter scales them by;
        # in 40 simulated recordings the gains of one parameter spread by no more than the gains of two
        freedom = parameters_added(candidate, len(look.fit.model.rows))
        least = max(_LEAST_SPREAD, float(gains.mean()) * math.sqrt(2.0 / max(freedom, 2)))
        common = max(float(np.median(spreads)) * math.sqrt(0.5 * freedom) if spreads else 0.0, least)
        # a parameter gains half a nat by chance (Wilks); a few simulations know this less well for one parameter alone
        runs = len(gains) if candidate.name in self.gains else 0
        weight = 0 if candidate.individual and runs else _COMMON
        expected = (runs * float(gains.mean()) + weight * 0.5 * freedom) / (runs + weight)
        squares = float(np.sum(np.square(gains - gains.mean())))
        known = len(gains) - 1 + _COMMON
        spread = float(np.sqrt((squares + _COMMON * common**2) / known * (1.0 + 1.0 / len(gains))))
        p_alone = float(student.sf((look.gain - expected) / spread, known))
        return Candidacy(
            look=look,
            fit=look.fit,
            gain=look.gain,
            expected=expected,
            spread=spread,
            p_value=min(1.0, rivals * p_alone),
            p_alone=p_alone,
            refined=False,
        )

    @property
    def needed(self) -> float:
        """A gain [nats] that is usually believed."""
        highest = [
            float(np.mean(np.maximum(g, 0.0)) + 4.0 * max(float(np.std(g)), _LEAST_SPREAD)) for g in self.gains.values()
        ]
        return max(LEAST_GAIN, float(np.median(highest)) if highest else 0.0)


#: Chance before anything was simulated.
UNKNOWN = NullGains({}, {})


def parameters_added(candidate: Candidate, drivers: int) -> int:
    """Number of parameters that a candidate adds."""
    return len(candidate.places) * (drivers if candidate.individual else 1)


def chance_scale(candidate: Candidate, drivers: int) -> float:
    """Std of the gain by chance, after Wilks: of half a chi-squared variable."""
    return math.sqrt(0.5 * parameters_added(candidate, drivers))


def smallest_detectable(looks: Sequence[Screened], null: NullGains) -> dict[str, float]:
    """Strength of each effect from which these data would usually have shown it: value of its first parameter."""
    found = {}
    for look in looks:
        if look.candidate.kind == "constants" or look.loss <= 0.0 or not look.candidate.starts[0]:
            continue
        start = look.loss_at[look.candidate.places[0]]
        scaled = start * float(np.sqrt(null.needed / look.loss))
        # a limit is the stronger the smaller it is
        if effect(look.candidate.name).is_limit:
            scaled = start * start / scaled
        found[look.candidate.name] = scaled
    return found
