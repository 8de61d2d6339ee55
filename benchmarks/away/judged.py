"""What a diagnosis says of one recording of the benchmark, whether it is right, and tables of all recordings."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.stats import kstest

from benchmarks.away.cases import Case, Pair, cases, recorded
from sugiyama_ros.diagnosis.diagnose import diagnose
from sugiyama_ros.diagnosis.rounds import Diagnosis
from sugiyama_ros.diagnosis.table import Difference, paired
from sugiyama_ros.fit.model import evaluate
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.page.document import additions


@dataclass(frozen=True)
class Judged:
    """What a diagnosis says of one recording.

    part, name, strength, seed: the recording; right, covariates, law, vehicles: right answers: names, covariates of a
    form without a name, law, and the vehicles that show it; outcome: what the diagnosis concludes; failed: names of the
    checks that fail; laws: other laws that are ahead of the final model, the best one first; the nearest one if none is
    ahead; named, also: additions, and what cannot be told apart from the first one; forces: covariates of the forces
    without a name that were added; who: vehicles that show the first addition; empty for all; p_value: smallest p-value
    of a candidate in the first round; oracle: gain that the score of the right candidate predicts in the first round
    [nats]; 0 without one; heldout, heldout_se, fresh, fresh_se: gain of all additions one step ahead [nats]: held out,
    and on a fresh recording of the same drivers; errors: estimate minus truth, in standard errors, by name of the
    parameter; seconds: time that the diagnosis took.
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
    failed: tuple[str, ...]
    laws: tuple[str, ...]
    named: tuple[str, ...]
    also: tuple[str, ...]
    forces: tuple[str, ...]
    who: tuple[int, ...]
    p_value: float
    oracle: float
    heldout: float
    heldout_se: float
    fresh: float
    fresh_se: float
    errors: dict[str, float]
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
    def is_located(self) -> bool:
        """Whether an added force, or a check that fails, names a covariate along which the form shows."""
        checks = {f"{of}{c}" for of in ("bias_over_", "left_for_force_along_") for c in self.covariates}
        return bool(set(self.forces) & set(self.covariates) or set(self.failed) & checks)

    @property
    def is_right(self) -> bool:
        """Whether the verdict as a whole is right, by the rules of the part."""
        if self.part == "conditions":
            return not self.named and self.outcome == "adequate"
        if self.law:
            return self.is_warned and self.law in self.laws
        if self.part == "few":
            return self.is_in_set and bool(self.who) and set(self.vehicles) <= set(self.who)
        if self.part == "forms":
            return (bool(self.named) and self.is_in_set) or (self.is_warned and self.is_located)
        if self.part == "faults":
            return self.is_in_set or (not self.named and self.is_warned)
        if self.part == "three":
            return set(self.right) <= {*self.named, *self.also}
        return self.is_in_set

    @property
    def is_misleading(self) -> bool:
        """Whether a wrong name stands there without a warning."""
        return bool(self.named) and not self.is_in_set and not self.is_warned


def judge(case: Case, strength: str, seed: int) -> Judged:
    """Record a case and diagnose the recording."""
    pair = recorded(case, strength, seed)
    d = diagnose(pair.first, seed=seed, workers=1)
    found, first = additions(d), d.rounds[0]
    heldout = d.final.over(d.data, d.base)["one_step"]
    fresh = _fresh(d, pair)
    return Judged(
        part=case.part,
        name=case.name,
        strength=strength,
        seed=seed,
        right=case.right,
        covariates=case.covariates,
        law=case.law,
        vehicles=pair.who,
        outcome=d.outcome,
        failed=tuple(one.name for one in d.checks if one.failed),
        laws=_laws(d),
        named=tuple(one.name for one in found),
        also=tuple(found[0].indistinguishable) if found else (),
        forces=tuple(one.covariate for one in found if one.covariate),
        who=tuple(found[0].vehicles) if found else (),
        p_value=min(first.chance.p_values.values(), default=1.0),
        oracle=max((one.gain for one in first.scores if one.candidate.mechanism in case.right), default=0.0),
        heldout=heldout.nats,
        heldout_se=heldout.se,
        fresh=fresh.nats,
        fresh_se=fresh.se,
        errors=_errors(d, pair),
        seconds=d.wall_s,
    )


def judge_named(part: str, name: str, strength: str, seed: int) -> Judged:
    """Judge the case of a part that has this name."""
    return judge(next(case for case in cases(part) if case.name == name), strength, seed)


def _laws(d: Diagnosis) -> tuple[str, ...]:
    """Other laws that are ahead of the final model, the best one first; the nearest one if none is ahead."""
    won = {law.name: law.over(d.data, d.final)["all"].nats for law in d.laws}
    ordered = sorted(won, key=lambda name: -won[name])
    return tuple(name for k, name in enumerate(ordered) if k == 0 or won[name] > 0.0)


def _fresh(d: Diagnosis, pair: Pair) -> Difference:
    """Gain of the additions one step ahead on a fresh recording of the same drivers, without a new fit."""
    data = prepare(pair.second, d.data.decisions)
    with ThreadPoolExecutor(1) as work:
        after, before = (evaluate(data, one.fit.model, work) for one in (d.final, d.base))
    return paired(data, after, before)


def _errors(d: Diagnosis, pair: Pair) -> dict[str, float]:
    """Errors of the parameters of the right additions, in standard errors."""
    found: dict[str, float] = {}
    for one in additions(d):
        for parameter, std in one.parameters_std.items():
            name = f"{one.name}.{parameter}"
            if name in pair.truth and std > 0.0:
                found[name] = (one.parameters[parameter] - pair.truth[name]) / std
    return found


_HEAD = "| part | recordings | right | first name right | in the set | named | not explained | misleading |"


def _share(known: Sequence[bool]) -> str:
    return f"{sum(known)} of {len(known)}" if known else "-"


def _row(label: str, rows: Sequence[Judged]) -> str:
    cells = (
        label,
        str(len(rows)),
        _share([r.is_right for r in rows]),
        _share([r.is_named for r in rows]) if any(r.right for r in rows) else "-",
        _share([r.is_in_set for r in rows]) if any(r.right for r in rows) else "-",
        _share([bool(r.named) for r in rows]),
        _share([r.is_warned for r in rows]),
        _share([r.is_misleading for r in rows]),
    )
    return f"| {' | '.join(cells)} |"


def _told(r: Judged) -> str:
    laws = f", near {' and '.join(r.laws)}" if r.laws and r.is_warned else ""
    who = f" of {', '.join(map(str, r.who))}" if r.who else ""
    return f"{', '.join(r.named) or 'nothing'}{who}: {r.outcome.replace('_', ' ')}{laws}"


def _calibration(rows: Sequence[Judged]) -> list[str]:
    """How gains and errors hold, and how p-values spread where nothing is hidden."""
    lines = []
    gains = [r for r in rows if r.named]
    if gains:
        off = [abs(r.fresh - r.heldout) <= 2.0 * np.hypot(r.fresh_se, r.heldout_se) for r in gains]
        lines.append(f"Held-out gains that reproduce on fresh data within two standard errors: {_share(off)}.")
    errors = [abs(e) for r in rows for e in r.errors.values()]
    if errors:
        lines.append(
            f"Parameters within 1.96 standard errors of the truth: {_share([e < 1.96 for e in errors])};"
            f" the largest error is {max(errors):.1f} standard errors."
        )
    p = [r.p_value for r in rows if r.part == "conditions"]
    if p:
        lines.append(
            f"Smallest p-value of the first round where nothing is hidden:"
            f" {_share([x <= 0.05 for x in p])} below 0.05; Kolmogorov-Smirnov against uniform"
            f" p = {kstest(p, 'uniform').pvalue:.2g}."
        )
    return lines


def report(rows: Sequence[Judged]) -> str:
    """Return the tables as Markdown: one row for each part, and one for each kind of recording."""
    head = [_HEAD, "|" + "---|" * (_HEAD.count("|") - 1)]
    by_part = [_row(part, [r for r in rows if r.part == part]) for part in dict.fromkeys(r.part for r in rows)]
    cases = ["| part | recording | right | verdict |", "|---|---|---|---|"]
    for r in rows:
        cases.append(f"| {r.part} | {r.name}, {r.strength} ({r.seed}) | {'yes' if r.is_right else 'no'} | {_told(r)} |")
    return "\n".join([*head, *by_part, "", *_calibration(rows), "", *cases, ""])
