"""Judgement of candidates: their gains, compared with the gains that chance gives where nothing is missing."""

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.chance import COMMON, of_best, spread_of_next
from sugiyama_ros.diagnosis.prescreen import PROMISE, Prescreen, beyond_chance, prescreen
from sugiyama_ros.diagnosis.screen import Effort, Screened, closer, screen
from sugiyama_ros.effects.registry import effect
from sugiyama_ros.fit.cross_validation import Gain, gain, held_out_nearly
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.progress import OnStage
from sugiyama_ros.workers import at_once

#: A smaller gain [nats] does not count as support, whatever its p-value.
LEAST_GAIN = 5.0
#: A candidate with more than this share of the best gain is fitted in full.
FULL_SHARE = 0.3
# A gain above this [nats] is not checked against simulations.
_OBVIOUS = 60.0
# Smallest spread of simulated gains [nats]: of the gains of two parameters (Wilks).
_LEAST_SPREAD = 1.0
# Candidates resemble one another: the largest gain of 35 of them by chance is the largest of 19 to 25 independent ones
# (normal scores with the correlations of all starts, in 36 recordings of 18 conditions).
_INDEPENDENT = 0.65


@dataclass(frozen=True, eq=False)
class Candidacy:
    """Result for one candidate in one round of the search.

    Parameters
    ----------
    look : Screened
        The rough fit.
    fit : JointFit
        The model with the candidate.
    gain : float
        Gain over the model without the candidate [nats].
    expected, spread : float
        Mean and standard deviation of the gain by chance [nats].
    p_value : float
        Probability of such a gain by chance, corrected for the number of candidates.
    p_alone : float
        The probability without the correction.
    refined : bool
        Whether ``fit`` is a full fit.
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

    def without_fits(self, instead: JointFit) -> "Candidacy":
        """Return the result with another fit ``instead`` of its own fits, which take memory."""
        return replace(self, look=replace(self.look, fit=instead), fit=instead)

    @property
    def needed(self) -> float:
        """Smallest gain that counts as support [nats]."""
        return LEAST_GAIN + self.candidate.elsewhere

    @property
    def score(self) -> float:
        """Gain minus the mean gain by chance [nats]."""
        return self.gain - self.expected - self.candidate.elsewhere


@dataclass(frozen=True, eq=False)
class NullGains:
    """Gains of candidates on simulated recordings in which nothing is missing.

    Parameters
    ----------
    gains : dict of str to list of float
        Gains of each candidate [nats], one for each simulated recording.
    scale : dict of str to float
        Standard deviation of half a chi-squared variable with as many degrees of freedom as the candidate has
        parameters.
    """

    gains: dict[str, list[float]]
    scale: dict[str, float]

    def judge(self, look: Screened, rivals: int) -> Candidacy:
        """Compare the gain of a candidate with gains by chance.

        The p-value comes from Student's t distribution over the simulated gains. The candidates partly share the spread
        of the gains.

        Parameters
        ----------
        look : Screened
            The rough fit of the candidate.
        rivals : int
            Number of candidates, for the correction of the p-value.

        Returns
        -------
        Candidacy
            The candidate with its p-values, not fitted in full yet.
        """
        candidate = look.candidate
        gains = np.maximum(self.gains.get(candidate.name, [0.0]), 0.0)
        spreads = [
            float(np.std(np.maximum(g, 0.0), ddof=1)) / self.scale[name] for name, g in self.gains.items() if len(g) > 1
        ]
        # the std of a chi-squared variable of K parameters is sqrt(2 / K) of its mean, however the filter scales it;
        # in 40 simulated recordings the gains of one parameter spread no more than the gains of two parameters
        freedom = parameters_added(candidate, len(look.fit.model.rows))
        least = max(_LEAST_SPREAD, float(gains.mean()) * math.sqrt(2.0 / max(freedom, 2)))
        common = max(float(np.median(spreads)) * math.sqrt(0.5 * freedom) if spreads else 0.0, least)
        # a parameter gains half a nat by chance (Wilks); a few simulations know this less well for one parameter alone
        runs = len(gains) if candidate.name in self.gains else 0
        weight = 0 if candidate.individual and runs else COMMON
        expected = (runs * float(gains.mean()) + weight * 0.5 * freedom) / (runs + weight)
        spread, known = spread_of_next(gains, common)
        p_alone = float(student.sf((look.gain - candidate.elsewhere - expected) / spread, known))
        return Candidacy(
            look=look,
            fit=look.fit,
            gain=look.gain,
            expected=expected,
            spread=spread,
            p_value=of_best(p_alone, _INDEPENDENT * rivals),
            p_alone=p_alone,
            refined=False,
        )

    def joined(self, further: "NullGains") -> "NullGains":
        """Return these gains with those of some of the candidates on further recordings."""
        return replace(self, gains={name: g + further.gains.get(name, []) for name, g in self.gains.items()})

    @property
    def needed(self) -> float:
        """A gain [nats] that usually counts as support."""
        highest = [
            float(np.mean(np.maximum(g, 0.0)) + 4.0 * max(float(np.std(g)), _LEAST_SPREAD)) for g in self.gains.values()
        ]
        return max(LEAST_GAIN, float(np.median(highest)) if highest else 0.0)


def null_gains(
    simulations: Sequence[tuple[Recorded, JointFit]],
    chosen: Sequence[Candidate],
    effort: Effort,
    work: ThreadPoolExecutor,
    on_progress: OnStage,
) -> NullGains:
    """Return the gains of candidates on recordings that a model simulates.

    Parameters
    ----------
    simulations : sequence of (Recorded, JointFit)
        Simulated recordings, with the fits to them.
    chosen : sequence of Candidate
        The candidates.
    effort : Effort
        Limits of the search.
    work : ThreadPoolExecutor
        Runs the filters.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.

    Returns
    -------
    NullGains
        The gains of each candidate.
    """

    def one_run(pair: tuple[Recorded, JointFit]) -> list[float]:
        simulated, fitted = pair
        return [_gain_there(simulated, fitted, candidate, effort, work) for candidate in chosen]

    gains = at_once(one_run, simulations, "comparing with simulations", on_progress)
    drivers = len(simulations[0][1].model.rows)
    by_candidate = {c.name: list(one) for c, one in zip(chosen, zip(*gains, strict=True), strict=True)}
    return NullGains(by_candidate, {c.name: chance_scale(c, drivers) for c in chosen})


def _gain_there(simulated: Recorded, fitted: JointFit, candidate: Candidate, effort: Effort, work: Executor) -> float:
    """Gain of a candidate on a simulated recording [nats]; what the prescreen predicts where it promises little."""
    seen = prescreen(simulated, fitted, candidate, work)
    predicted = beyond_chance(simulated, fitted, seen)
    if predicted <= PROMISE:
        return max(predicted, 0.0)
    return closer(simulated, screen(simulated, fitted, candidate, work, effort, seen), work).gain


def heldout_gains(data: Recorded, current: JointFit, scored: Sequence[Candidacy]) -> dict[str, Gain]:
    """Return the held-out gains of candidates over the current model, by name, without running the filter."""
    now = held_out_nearly(data, current)
    return {one.candidate.name: gain(data, held_out_nearly(data, one.fit), now) for one in scored}


#: Gains by chance before any simulation.
UNKNOWN = NullGains({}, {})


def parameters_added(candidate: Candidate, drivers: int) -> int:
    """Return the number of parameters that a candidate adds."""
    return len(candidate.places) * (drivers if candidate.individual else 1)


def chance_scale(candidate: Candidate, drivers: int) -> float:
    """Return the std of the gain by chance [nats], half a chi-squared variable (Wilks)."""
    return math.sqrt(0.5 * parameters_added(candidate, drivers))


def smallest_detectable(prescreens: Iterable[Prescreen], base: JointFit, null: NullGains) -> dict[str, float]:
    """Return the strength from which each effect would usually have shown in these data.

    Parameters
    ----------
    prescreens : iterable of Prescreen
        Prescreens of the candidates.
    base : JointFit
        The model without them.
    null : NullGains
        Gains by chance.

    Returns
    -------
    dict of str to float
        Value of the first parameter of each effect, by the name of the effect.
    """
    found = {}
    for seen in prescreens:
        candidate, (start, loss) = seen.candidate, seen.lost(base)
        if candidate.kind == "constants" or candidate.is_variant or loss <= 0.0:
            continue
        scaled = start * float(np.sqrt(null.needed / loss))
        # a smaller limit is a stronger effect
        if effect(candidate.name).is_limit:
            scaled = start * start / scaled
        found[candidate.name] = scaled
    return found


def shortlist(looks: Sequence[Screened], effort: Effort) -> list[int]:
    """Return the numbers of the looks to follow: the largest gains, and noises, whose best values may be far away."""
    order = sorted(range(len(looks)), key=lambda k: -looks[k].gain)
    best = max(looks[order[0]].gain, 1.0)
    chosen = [k for k in order[: effort.shortlist] if looks[k].gain > FULL_SHARE * best or k in order[:2]]
    if best > 50.0:
        freed = [k for k, look in enumerate(looks) if look.candidate.kind == "constants"]
        chosen += [k for k in freed if looks[k].candidate.is_noise and k not in chosen]
    return chosen


def is_obvious(data: Recorded, look: Screened) -> bool:
    """Whether no simulation could gain as much.

    Never for individual parameters, which may gain much by chance, and never where samples are far apart: there, a
    shared parameter may make up for what the filter cannot know in between.
    """
    return look.gain >= _OBVIOUS and not look.candidate.individual and not data.is_sparse
