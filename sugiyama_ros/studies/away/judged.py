"""What a diagnosis says of one recording of the benchmark, and whether it is right."""

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from sugiyama_ros.diagnosis.adequacy import who
from sugiyama_ros.diagnosis.diagnosis import Diagnosis, diagnose
from sugiyama_ros.fit.cross_validation import gain
from sugiyama_ros.fit.score import evaluate
from sugiyama_ros.fit.stretched import prepared
from sugiyama_ros.studies.away.cases import Case, Pair, cases, recorded

NONE = "none"


@dataclass(frozen=True)
class Judged:
    """What a diagnosis says of one recording.

    Parameters
    ----------
    part, name, strength, seed
        The recording.
    right, covariates, law, vehicles
        Right answers: names, covariates of a form without a name, law, and the vehicles that show it.
    outcome, better_law, reasons
        The verdict on adequacy.
    named, also : tuple of str
        Additions, and what cannot be told apart from the first one.
    who : tuple of int
        Vehicles that show the first addition; empty for all.
    p_value : float
        Smallest p-value of a candidate in the first round.
    oracle : float
        In-sample gain of the right candidate in the first round [nats]; 0 without one.
    heldout, heldout_se, fresh, fresh_se : float
        Gain of all additions [nats]: held out, and on a fresh recording of the same drivers.
    errors : dict of str to float
        Estimate minus truth, in standard errors, by name of the parameter.
    flagged : tuple of str
        Covariates of the bins in which the final model is biased.
    seconds : float
        Time that the diagnosis took.
    """

    part: str
    name: str
    strength: str
    seed: int
    right: tuple[str, ...]
    covariates: tuple[str, ...]
    law: str
    vehicles: tuple[int, ...]
    outcome: str
    better_law: str
    reasons: tuple[str, ...]
    named: tuple[str, ...]
    also: tuple[str, ...]
    who: tuple[int, ...]
    p_value: float
    oracle: float
    heldout: float
    heldout_se: float
    fresh: float
    fresh_se: float
    errors: dict[str, float]
    flagged: tuple[str, ...]
    seconds: float

    @property
    def is_named(self) -> bool:
        """Whether the first name is right; without anything hidden, whether nothing is named."""
        return self.named[0] in self.right if self.named else not self.right

    @property
    def is_in_set(self) -> bool:
        """Whether a right name is the first one or cannot be told apart from it."""
        return self.is_named or any(name in self.right for name in self.also)

    @property
    def is_warned(self) -> bool:
        """Whether the verdict says that the model does not explain the data."""
        return self.outcome == "not_explained"

    @property
    def is_right(self) -> bool:
        """Whether the verdict as a whole is right, by the rules of the part."""
        if self.part == "conditions":
            return not self.named and self.outcome == "adequate"
        if self.law:
            return self.is_warned and self.better_law == self.law
        if self.part == "few":
            return self.is_in_set and bool(self.who) and set(self.vehicles) <= set(self.who)
        if self.part == "forms":
            # whole words: "gap" is not "rear_gap"
            told = any(re.search(rf"\b{c}\b", reason) for c in self.covariates for reason in self.reasons)
            return (bool(self.named) and self.is_in_set) or (self.is_warned and told)
        if self.part == "faults":
            return self.is_in_set or (not self.named and self.is_warned)
        if self.part == "three":
            return set(self.right) <= {*self.named, *self.also}
        return self.is_in_set

    @property
    def is_misleading(self) -> bool:
        """Whether a wrong name stands there without a warning."""
        return bool(self.named) and not self.is_in_set and not self.is_warned


def judge(case: Case, strength: str, seed: int, quick: bool) -> Judged:
    """Record a case and diagnose the recording."""
    pair = recorded(case, strength, seed)
    d = diagnose(pair.first, seed=seed, quick=quick, workers=1)
    heldout = gain(d.data, d.after.samples, d.before.samples)
    fresh = _fresh(d, pair) if d.named else (0.0, 0.0)
    first = who(d.named[0], d.data.vicinity.numbers) if d.named else "all"
    return Judged(
        part=case.part,
        name=case.name,
        strength=strength,
        seed=seed,
        right=case.right,
        covariates=case.covariates,
        law=case.law,
        vehicles=pair.who,
        outcome=d.adequacy.outcome,
        better_law=d.adequacy.better_law or NONE,
        reasons=d.adequacy.reasons,
        named=tuple(n.name for n in d.named),
        also=d.named[0].indistinguishable if d.named else (),
        who=tuple(first) if isinstance(first, list) else (),
        p_value=min(
            [*(one.p_value for one in d.scored), *(one.p_value for one in d.left_out if one.p_value is not None), 1.0]
        ),
        oracle=max((one.gain for one in d.scored if one.candidate.mechanism in case.right), default=0.0),
        heldout=heldout.nats if d.named else 0.0,
        heldout_se=heldout.se if d.named else 0.0,
        fresh=fresh[0],
        fresh_se=fresh[1],
        errors=_errors(d, pair),
        flagged=tuple(sorted({b.covariate for b in d.where_after.flagged})),
        seconds=d.wall_s,
    )


def judge_named(part: str, name: str, strength: str, seed: int, quick: bool) -> Judged:
    """Judge the case of a part that has this name."""
    return judge(next(case for case in cases(part) if case.name == name), strength, seed, quick)


def _fresh(d: Diagnosis, pair: Pair) -> tuple[float, float]:
    """Gain of the additions on a fresh recording of the same drivers, without a new fit, and its standard error."""
    data = prepared(pair.second, d.data.decisions)
    with ThreadPoolExecutor(1) as work:
        after, before = (evaluate(data, one.model, work) for one in (d.final, d.base))
    found = gain(data, after, before)
    return found.nats, found.se


def _errors(d: Diagnosis, pair: Pair) -> dict[str, float]:
    """Errors of the parameters of the right additions, in standard errors."""
    found: dict[str, float] = {}
    if not d.named:
        return found
    stds = d.stds
    for one in d.named:
        for parameter, value in one.parameters.items():
            name, std = f"{one.name}.{parameter}", stds.get(f"{one.form}.{parameter}", 0.0)
            if name in pair.truth and std > 0.0:
                found[name] = (value - pair.truth[name]) / std
    return found
