"""The verdict above all verdicts: do the data give reason to doubt the final model?

A model that predicts better is not yet an explanation. Drivers of another law can be imitated by several effects
together, and a force of a form that is not in the catalogue takes the name of what resembles it. Such a model leaves
traces: another law predicts held-out samples better, innovations are biased in more bins than in the model's own
simulations, the filter is surer of itself than it should be, or an effect has a sign that makes no physical sense.
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.stats import binom, norm

from sugiyama_ros.diagnosis.addition import Addition
from sugiyama_ros.diagnosis.chance import p_value_of
from sugiyama_ros.diagnosis.coarseness import rounding_says, sampling_says
from sugiyama_ros.diagnosis.discover import FORCE, Discovery
from sugiyama_ros.diagnosis.doubts import doubts, signs_say
from sugiyama_ros.diagnosis.errors import HeldOutErrors
from sugiyama_ros.diagnosis.innovations import correlation_says, spread_says
from sugiyama_ros.diagnosis.law_check import CLEARLY, LEVEL_OF_LAWS, LawCheck, closer_laws, laws_say_as_much, log_ratio
from sugiyama_ros.diagnosis.locate import Located, locate
from sugiyama_ros.fit.cross_validation import Gain, gain, sum_error
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.tables import figure

Outcome = Literal["adequate", "explained", "not_explained"]
# Another law is better by at least this gain [nats].
_LEAST_GAIN = 5.0
#: Probability below which the biases of a model are larger than chance makes them.
LEVEL_OF_BINS = 0.01
# So many names are told.
_TOLD = 3
# Common std of the logarithm of the biases' sum of squares.
_SPREAD = 0.25


@dataclass(frozen=True)
class Adequacy:
    """Whether the final model is adequate.

    Parameters
    ----------
    outcome : {"adequate", "explained", "not_explained"}
        ``"adequate"``: nothing was added, and nothing speaks against the model. ``"explained"``: the additions explain
        what was missing. ``"not_explained"``: something is left that the model does not explain.
    better_law : str or None
        Law that predicts held-out samples better, if there is one.
    bins_flagged : int
        Number of bins in which the final model is biased.
    bins_expected : float or None
        Mean number in recordings that the final model simulates; None without simulations.
    explained_share : float or None
        Held-out gain of the additions, as a share of what could be explained; None if there is nothing to explain.
    reasons : tuple of str
        What speaks against the model, in words.
    bins_p_value : float or None
        Probability that recordings which the final model simulates have biases as large as the data have; None without
        simulations.
    """

    outcome: Outcome
    better_law: str | None
    bins_flagged: int
    bins_expected: float | None
    explained_share: float | None
    reasons: tuple[str, ...]
    bins_p_value: float | None = None


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a verdict on adequacy rests on.

    Parameters
    ----------
    base, final : HeldOutErrors
        Held-out errors of the base model and of the final model.
    named : sequence of Addition
        The additions.
    located : Located
        Where the final model fails.
    laws : mapping of str to HeldOutErrors
        Held-out errors of other laws, fitted in the same filter.
    forces : sequence of Discovery
        Forces without a name that the final model lacks.
    simulated : sequence of Located
        Where the final model fails in recordings that it simulates.
    stds : mapping of str to float
        Standard errors of the shared parameters of the final model, by name.
    checks : mapping of str to LawCheck
        What other laws do in recordings that the final model simulates, by name.
    own : sequence of HeldOutErrors
        Held-out errors of the final model in recordings that it simulates.
    refused : sequence of str
        Names of what predicts better, and was not added because of what the model is for.
    senseless : sequence of (str, tuple of str)
        Names of what predicts better only with values that make no physical sense, and which.
    """

    base: HeldOutErrors
    final: HeldOutErrors
    named: Sequence[Addition]
    located: Located
    laws: Mapping[str, HeldOutErrors]
    forces: Sequence[Discovery]
    simulated: Sequence[Located]
    stds: Mapping[str, float] = field(default_factory=dict)
    checks: Mapping[str, LawCheck] = field(default_factory=dict)
    own: Sequence[HeldOutErrors] = ()
    refused: Sequence[str] = ()
    senseless: Sequence[tuple[str, tuple[str, ...]]] = ()


def judge(data: Recorded, evidence: Evidence) -> Adequacy:
    """Judge the final model of a diagnosis.

    Parameters
    ----------
    data : Recorded
        The recording.
    evidence : Evidence
        What is known about the model.

    Returns
    -------
    Adequacy
        The outcome with its reasons.
    """
    signs = signs_say(evidence.named, evidence.stds)
    than = evidence.base if signs else evidence.final
    gains = {law: gain(data, errors.samples, than.samples) for law, errors in evidence.laws.items()}
    better = _better_law(data, evidence, gains)
    others = evidence.laws if evidence.named and not better else {}
    reasons = [
        *_laws_say(data, evidence, gains, bool(signs)),
        *laws_say_as_much(data, evidence.base, evidence.final, others),
        *_free_runs_say(evidence),
        *_bins_say(evidence),
        *spread_says(evidence.final, evidence.own),
        *(correlation_says(evidence.final, evidence.own, data) if evidence.named else ()),
        *signs,
        *_senseless_say(evidence.senseless),
        *doubts(data, evidence.named),
        *((*rounding_says(data, evidence.final), *sampling_says(data)) if evidence.named else ()),
    ]
    reasons += [
        f"a force that depends on {force.shown} is missing, by {figure(force.strength, 2)} m/s²"
        f" ({force.gain_nats:.0f} nats{'' if force.can_be_added else '; the model cannot have a force along it'})"
        for force in evidence.forces[:1]
    ]
    if evidence.refused:
        reasons.append(f"what predicts better makes worse what the model is for: {_first_of(evidence.refused)}")
    outcome: Outcome = "not_explained" if reasons else "explained" if evidence.named else "adequate"
    return Adequacy(
        outcome=outcome,
        better_law=better[0] if better else None,
        bins_flagged=len(evidence.located.flagged),
        bins_expected=_mean_flagged(evidence.simulated) if evidence.simulated else None,
        explained_share=_share(data, evidence, better),
        reasons=tuple(reasons),
        bins_p_value=_bins_p_value(evidence),
    )


def simulated_failures(simulations: Sequence[tuple[Recorded, JointFit]], work: Executor) -> tuple[Located, ...]:
    """Locate where a model fails in recordings that it simulates itself.

    Parameters
    ----------
    simulations : sequence of (Recorded, JointFit)
        Simulated recordings, with the fits to them.
    work : Executor
        Runs the filters.

    Returns
    -------
    tuple of Located
        One for each recording.
    """
    return tuple(locate(simulated, fitted.model, fitted.samples, work) for simulated, fitted in simulations)


def _better_law(data: Recorded, evidence: Evidence, gains: Mapping[str, Gain]) -> tuple[str, Gain] | None:
    """The law that gains most, if one of them predicts better beyond doubt, and its gain.

    gains: what each law gains over the final model. Additions that make no physical sense imitate a law, so they do not
    count against it: the laws are then compared with the base model.

    The right law gains most and may scatter most, so the doubt is whether any law is better. A law that predicts about
    as well as the final model is better, too, if it is far behind the model in recordings that the model simulates.
    """
    is_better = _is_any_clear(data, gains) or any(
        won.nats > 0.0 and _is_unlikely(evidence, law, won) for law, won in gains.items()
    )
    return max(gains.items(), key=lambda one: one[1].nats) if is_better else None


def _as_good_as(data: Recorded, law: str, laws: Mapping[str, HeldOutErrors]) -> list[str]:
    """Laws that do not predict clearly worse than a law."""
    behind = {name: gain(data, laws[law].samples, errors.samples) for name, errors in laws.items() if name != law}
    return [name for name, lost in behind.items() if not _is_clear(lost)]


def _is_clear(won: Gain) -> bool:
    """Whether a gain is beyond doubt, with or without the block of time that gains most, or by its signs.

    One such block, as when all start out of a jam, widens the standard error although it is not against the gain. So
    does one driver who gains most. If nearly all drivers and nearly all blocks gain, that is not by chance (Clarke's
    test, Political Analysis 15 (2007) 347).
    """
    others = sorted(won.blocks)[:-1]
    error = max(sum_error(others), sum_error(won.drivers))
    if any(nats > max(CLEARLY * se, _LEAST_GAIN) for nats, se in ((won.nats, won.se), (sum(others), error))):
        return True
    return won.nats > _LEAST_GAIN and all(_mostly_gain(parts) for parts in (won.drivers, won.blocks))


def _is_any_clear(data: Recorded, gains: Mapping[str, Gain]) -> bool:
    """Whether a law gains beyond doubt without any simulation.

    Where samples are far apart, the filter's forecast goes wrong in between, more so for a model with jumps than for a
    smooth law. Only simulations tell what the right model loses by that.
    """
    return not data.is_sparse and any(_is_clear(won) for won in gains.values())


def _mostly_gain(nats: Sequence[float]) -> bool:
    """Whether so many gains are positive that it is as unlikely by chance as a gain of two standard errors."""
    positive = sum(one > 0.0 for one in nats)
    return bool(binom.sf(positive - 1, len(nats), 0.5) < norm.sf(CLEARLY))


def _is_unlikely(evidence: Evidence, law: str, won: Gain) -> bool:
    """Whether a law gains more than it does in recordings that the final model simulates."""
    return law in evidence.checks and evidence.checks[law].p_of_gain(won) < LEVEL_OF_LAWS


def _laws_say(data: Recorded, evidence: Evidence, gains: Mapping[str, Gain], is_base: bool) -> list[str]:
    """Which law predicts better, or nearly as well although it would be far behind if the final model were right."""
    if _is_any_clear(data, gains):
        law, won = max(gains.items(), key=lambda one: one[1].nats)
        than = " than the model without the additions" if is_base else ""
        equals = _as_good_as(data, law, evidence.laws)
        also = f" ({' and '.join(equals)} about as well)" if equals else ""
        return [f"{law} predicts held-out samples better{than}, by {won.nats:.0f} ± {won.se:.0f} nats{also}"]
    reasons = []
    for law, check in evidence.checks.items():
        won = gain(data, evidence.laws[law].samples, evidence.final.samples)
        if _is_unlikely(evidence, law, won):
            how = "better" if won.nats > CLEARLY * won.se else "about as well"
            ours = f"predicts held-out samples {how} ({won.nats:+.0f} ± {won.se:.0f} nats)"
            if won.nats < -CLEARLY * won.se:
                ours = f"is {-won.nats:.0f} ± {won.se:.0f} nats behind on held-out samples"
            own = float(np.mean(check.gains))
            simulated = f"is {-own:.0f} nats behind" if own < 0.0 else f"gains {own:.0f} nats"
            reasons.append(f"{law} {ours}, but it {simulated} in recordings that the model simulates")
    return reasons[:1]


def _free_runs_say(evidence: Evidence) -> list[str]:
    """Which law drives on by itself better than the final model by most, if this is unlikely for the right model.

    Free runs of a law that damps waves may end closer than free runs of the right model.
    """
    model = evidence.final
    for law in closer_laws(model, {name: evidence.laws[name] for name in evidence.checks}):
        errors = evidence.laws[law]
        if evidence.checks[law].p_of_ratio(log_ratio(model, errors)) < LEVEL_OF_LAWS:
            theirs, ours = errors.free_run_10s_beside(model)
            return [
                f"free runs of {law} end closer: {figure(theirs, 2)} m off after 10 s instead of {figure(ours, 2)} m"
            ]
    return []


def _first_of(names: Sequence[str]) -> str:
    """The first names, and the number of the others."""
    more = len(names) - _TOLD
    return ", ".join(names[:_TOLD]) + (f" and {more} more" if more > 0 else "")


def _senseless_say(senseless: Sequence[tuple[str, tuple[str, ...]]]) -> list[str]:
    """What would predict better, but makes no physical sense: the form of something else that is missing."""
    return [f"{name} would predict better, but makes no physical sense: {', '.join(why)}" for name, why in senseless]


def _bins_p_value(evidence: Evidence) -> float | None:
    """Probability of biases as large as in the data, by the model's own simulations; None with less than two."""
    if len(evidence.simulated) < 2:
        return None
    return p_value_of(_log_squares(evidence.located), [_log_squares(one) for one in evidence.simulated], _SPREAD)


def _bins_say(evidence: Evidence) -> list[str]:
    """Whether the biases are larger than in the model's own simulations."""
    p_value = _bins_p_value(evidence)
    if p_value is None or p_value >= LEVEL_OF_BINS:
        return []
    if not evidence.located.flagged:
        return ["the biases of all bins together are larger than in its own simulations, although no bin stands out"]
    expected, worst = _mean_flagged(evidence.simulated), evidence.located.flagged[0]
    return [
        f"it is biased in {len(evidence.located.flagged)} of {len(evidence.located.bins)} bins"
        f" ({expected:.1f} in its own simulations), most of all at {worst.shown}"
    ]


def _mean_flagged(simulated: Sequence[Located]) -> float:
    return float(np.mean([len(one.flagged) for one in simulated]))


def _log_squares(located: Located) -> float:
    """Logarithm of the mean square of the normalised biases; 0 on average without any bias."""
    squares = [b.samples * b.bias**2 for b in located.bins]
    return math.log(max(float(np.mean(squares)), 1e-3)) if squares else 0.0


def _share(data: Recorded, evidence: Evidence, better: tuple[str, Gain] | None) -> float | None:
    """Gain of what has a name over this gain and what is left; None if nothing was gained and nothing is left."""
    explained = next((one.before for one in evidence.named if one.name == FORCE), evidence.final).samples
    won = max(gain(data, explained, evidence.base.samples).nats, 0.0)
    by_force = gain(data, evidence.final.samples, explained).nats
    # a law that is fitted to some drivers stands for all
    law = evidence.laws[better[0]] if better else evidence.final
    drivers, all_drivers = len(law.predicted_drivers), len(evidence.final.predicted_drivers)
    by_law = gain(data, law.samples, explained).nats * all_drivers / drivers if better else 0.0
    left = max(0.0, by_law, by_force + sum(force.gain_nats for force in evidence.forces[:1]))
    if not evidence.named and left <= 0.0:
        return None
    return won / max(won + left, 1e-9)


def told(adequacy: Adequacy) -> str:
    """Return the verdict on adequacy as one sentence."""
    if adequacy.outcome == "adequate":
        return "The model is adequate: nothing in these data speaks against it."
    if adequacy.outcome == "explained":
        return "What was missing is explained: nothing in these data speaks against the model with the additions."
    share = ""
    if adequacy.explained_share and adequacy.explained_share < 0.995:
        share = f" The additions bring {100.0 * adequacy.explained_share:.0f} % of what could be explained."
    return f"Not explained: {'; '.join(adequacy.reasons)}.{share}"


def who(addition: Addition, vehicles: Sequence[int]) -> str | list[int]:
    """Return who has an effect: ``"all"``, or numbers out of ``vehicles`` if only some drivers have it."""
    return [int(vehicles[i]) for i in addition.drivers] or "all"
