"""A diagnosis, top down: score what may be missing, fit the best candidates, compare forecasts, add, and score again.

Everything is a difference between two models on the same recording: of a proper score of held-out forecasts, with its
standard error over blocks of time and drivers, and with what chance gives in the same procedure.
"""

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import norm

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.base import base_model, laws, with_more_decisions
from sugiyama_ros.diagnosis.candidates import FORCE, Candidate, candidates, chosen, push_of_one
from sugiyama_ros.diagnosis.chance import Chance, chance_of
from sugiyama_ros.diagnosis.check import Check, checks, judged
from sugiyama_ros.diagnosis.forecast import driven, forecasts
from sugiyama_ros.diagnosis.refine import begun, finished, with_named, with_one, without, without_folds
from sugiyama_ros.diagnosis.rounds import Diagnosis, Round
from sugiyama_ros.diagnosis.score import Direction, Score, directions, scores
from sugiyama_ros.diagnosis.table import Difference, Entry, errors, gains
from sugiyama_ros.diagnosis.where import locate
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.fit.joint import JointFit, maximise
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.profile import profiled
from sugiyama_ros.fit.recording import MOST_SAMPLES, SEARCHED_DRIVERS, SEARCHED_SAMPLES, Recorded
from sugiyama_ros.fit.simulated import resampled_fits, seeds
from sugiyama_ros.fit.standard_errors import away_from_0, shared_stds
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.progress import OnStage
from sugiyama_ros.results import CLEARLY
from sugiyama_ros.statistics import ALPHA
from sugiyama_ros.trajectories.tracks import Tracks

# Number of forces, moods and noises that are fitted in a round.
_FITTED = 5


def diagnose(
    recording: Tracks,
    *,
    add: Sequence[str] = (),
    most: int | None = None,
    law: str = PAPERS,
    seed: int = 0,
    simulations: int = 2,
    workers: int = 2,
    on_progress: OnStage = lambda what, done, total: None,
) -> Diagnosis:
    """Find what is missing from the model.

    Parameters
    ----------
    recording : Tracks
        The recording.
    add : sequence of str
        Names of what is added, whatever the data say; by default, what the data ask for.
    most : int, optional
        Largest number of steps that add what the data ask for; as many as they ask for if left out.
    law : str
        Name of the law by which the drivers of the base model drive.
    seed : int
        Seed of the simulations and of the draws by chance.
    simulations : int
        Number of simulated recordings that say what the filter's approximations do.
    workers : int
        Number of threads.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.

    Returns
    -------
    Diagnosis
        The diagnosis.

    Raises
    ------
    InputError
        If the recording is too short, or for a name that cannot be added.
    """
    began = time.monotonic()
    with ThreadPoolExecutor(workers) as work:
        whole = prepare(recording)
        of_some = max(SEARCHED_SAMPLES, SEARCHED_DRIVERS * whole.samples // whole.decisions)
        searched = MOST_SAMPLES if whole.vicinity.is_whole_road else min(of_some, MOST_SAMPLES)
        on_progress("fitting the base model", 0, 1)
        some = whole if searched == MOST_SAMPLES else prepare(recording, most=searched)
        bench = _Bench(some, simulations, seed, work, on_progress)
        bench, first, found = _begun(recording, bench, law, searched)
        rounds = _told(bench, first, found, add) if add else _searched(bench, first, found, most)
        search = _Search(bench, rounds)
        final = search if bench.data.drivers == whole.drivers else _confirmed(recording, search, law, tuple(add))
        return _concluded(search, final, tuple(add), began)


@dataclass(frozen=True, eq=False)
class _Bench:
    """What all rounds of a diagnosis share; directions: of all candidates but noises, beside the base model."""

    data: Recorded
    simulations: int
    seed: int
    work: ThreadPoolExecutor
    on_progress: OnStage
    known: dict[JointFit, list[tuple[Recorded, JointFit]]] = field(default_factory=dict)
    directions: list[Direction] = field(default_factory=list)

    def on(self, data: Recorded) -> "_Bench":
        """The same for another recording."""
        return replace(self, data=data, known={}, directions=[])

    @cached_property
    def possible(self) -> tuple[Candidate, ...]:
        """All candidates, without forces."""
        return candidates(self.data)

    def entry(self, name: str, added: tuple[Candidate, ...], fit: JointFit, beside: Sequence[Model] = ()) -> Entry:
        """A fitted model with its held-out forecasts; ``beside``: models without folds of the fit that it extends."""
        models = without_folds(self.data, fit, self.work, beside)
        return Entry(name, added, fit, models, forecasts(self.data, models, self.work))

    def simulated(self, fit: JointFit) -> list[tuple[Recorded, JointFit]]:
        """Recordings that a model simulates, with the fits to them, made once."""
        if fit not in self.known:
            rngs = seeds(self.seed, self.simulations)
            self.known[fit] = resampled_fits(self.data, fit, rngs, self.work, self.on_progress)
        return self.known[fit]


class _Search(NamedTuple):
    """Rounds, and what they share."""

    bench: _Bench
    rounds: Sequence[Round]


@dataclass(frozen=True, eq=False)
class _Scored:
    """Scores beside a model, of all candidates by name, best starts first; and what chance gives."""

    by_name: dict[str, list[Score]]
    chance: Chance

    @cached_property
    def best(self) -> tuple[Score, ...]:
        """The score of each mechanism in the form that gains most beyond chance; the most improbable one first."""
        forms: dict[str, list[Score]] = {}
        for name in sorted(self.by_name, key=lambda name: -self.chance.improbable[name]):
            forms.setdefault(self.by_name[name][0].candidate.mechanism, []).append(self.by_name[name][0])
        return tuple(
            max(own, key=lambda one: one.gain - self.chance.needed[one.candidate.name]) for own in forms.values()
        )

    @cached_property
    def worth(self) -> list[Candidate]:
        """What is worth a fit: the best of what chance rarely shows."""
        open_ = [one.candidate for one in self.best if self.chance.p_values[one.candidate.mechanism] < ALPHA]
        # the score of freed constants says little: they respond to whatever is missing, far from where they start
        is_free = [c.kind == "constants" and not c.switches for c in open_]
        return [c for k, c in enumerate(open_) if c.rank == 0 or k < _FITTED or is_free[k]]


def _begun(recording: Tracks, bench: _Bench, law: str, searched: int) -> tuple[_Bench, Entry, _Scored]:
    """The base model, at the period from which it predicts best, and what is scored beside it."""
    data, base = base_model(bench.data, bench.work, law)
    bench = bench.on(data)
    found, told = _scored(bench, base), (bench.on_progress, law, searched)
    if found.chance.shows_something and (finer := with_more_decisions(recording, data, base, bench.work, *told)):
        data, base = finer
        bench = bench.on(data)
        found = _scored(bench, base)
    return bench, bench.entry("base", (), base), found


def _scored(bench: _Bench, fit: JointFit, rounds: Sequence[Round] = ()) -> _Scored:
    """Score everything that no round has added. What was dropped again does not come back, so a search ends."""
    bench.on_progress(f"round {len(rounds) + 1}: scoring", 0, 1)
    known = {c.mechanism for one in rounds if one.added is not None for c in one.added.added}
    known |= {c.mechanism for one in rounds for c in one.current.added}
    left = [c for c in bench.possible if c.mechanism not in known]
    if not bench.directions:
        derived = [c for c in left if not c.is_judged_at_starts]
        bench.directions.extend(directions(bench.data, fit, derived, bench.work, with_forces=True))
    push = push_of_one(bench.data, fit.samples)
    further = [c for c in (*left, *((push,) if push else ())) if c.is_judged_at_starts or c is push]
    along = [*bench.directions, *directions(bench.data, fit, further, bench.work)]
    along = [one for one in along if one.candidate.mechanism not in known]
    by_name: dict[str, list[Score]] = {}
    for one in sorted(scores(bench.data, fit, along, bench.work), key=lambda one: -one.gain):
        by_name.setdefault(one.candidate.name, []).append(one)
    every = [one for own in by_name.values() for one in own]
    drawn: dict[Score, tuple[float, Array]] = {}
    found = _Scored(by_name, chance_of(every, [], bench.seed, drawn))
    # what the filter's approximations do must be known only of what would be fitted
    there: list[list[Score]] = [[] for _ in range(bench.simulations)]
    known = set()
    while new := {c.mechanism for c in found.worth} - known:
        asked = [c for c in left if c.mechanism in new]
        for own, (data, again) in zip(there, bench.simulated(fit), strict=True):
            there_too = directions(data, again, asked, bench.work, with_forces=FORCE in new)
            own += scores(data, again, there_too, bench.work)
        found, known = _Scored(by_name, chance_of(every, there, bench.seed, drawn)), known | new
    return found


def _searched(bench: _Bench, first: Entry, found: _Scored, most: int | None) -> list[Round]:
    """Add what the data support, one round after the other, until nothing is added."""
    rounds = [_round(bench, first, found)]
    while (added := rounds[-1].added) is not None and (most is None or len(rounds) < most):
        rounds.append(_round(bench, added, _scored(bench, added.fit, rounds)))
    return rounds


def _told(bench: _Bench, first: Entry, found: _Scored, names: Sequence[str]) -> list[Round]:
    """Add what was asked for, one after the other; and score what is left, which nobody asked for."""
    rounds: list[Round] = []
    current = first
    for name in names:
        scored = [own[0].candidate for own in found.by_name.values()]
        candidate = chosen(bench.data, [*bench.possible, *scored], name)
        entry = _profiled(bench, current, _fitted(bench, current, candidate, found))
        won = {e: e.over(bench.data, current) for e in (entry, *_other_forms(bench, current, found, [entry]))}
        is_better = entry.is_better(bench.data, current)
        closest = _closest_effect(bench, won, entry)
        step = Round(current, found.best, found.chance, won, entry, won[entry], is_better, closest_effect=closest)
        rounds.append(step)
        current = entry
        found = _scored(bench, current.fit, rounds)
    return [*rounds, Round(current, found.best, found.chance, {}, None, {})]


def _fitted(bench: _Bench, current: Entry, candidate: Candidate, found: _Scored) -> Entry:
    """The model with a candidate."""
    first = begun(bench.data, current.fit, candidate, found.by_name.get(candidate.name, ()), bench.work)
    return _finished(bench, current, candidate, first)


def _finished(bench: _Bench, current: Entry, candidate: Candidate, first: JointFit) -> Entry:
    """The model with a candidate, after the first steps of its fit; the current one where nothing was found."""
    fit = finished(bench.data, current.fit, candidate, first, bench.work)
    found = replace(current, name=candidate.name, added=(*current.added, candidate))
    return found if fit is current.fit else bench.entry(found.name, found.added, fit, current.models)


def _other_forms(bench: _Bench, current: Entry, found: _Scored, fitted: Sequence[Entry]) -> list[Entry]:
    """The models with those forms of the first one's mechanism that are not among those fitted, and may win."""
    mechanism, tried = fitted[0].added[-1].mechanism, {e.added[-1].name for e in fitted}
    forms = [own[0] for own in found.by_name.values() if own[0].candidate.mechanism == mechanism]
    most = max((one.gain for one in forms), default=0.0)
    open_ = [one.candidate for one in forms if 2.0 * one.gain >= most and one.candidate.name not in tried]
    return [_fitted(bench, current, c, found) for c in open_]


def _round(bench: _Bench, current: Entry, found: _Scored) -> Round:
    """Fit the candidates with the best scores beside a model, and choose."""
    won: dict[Entry, dict[str, Difference]] = {}
    first_steps = {}
    for number, candidate in enumerate(found.worth):
        bench.on_progress(f"round {len(current.added) + 1}: fitting", number, len(found.worth))
        near = found.by_name.get(candidate.name, ())
        first_steps[candidate] = begun(bench.data, current.fit, candidate, near, bench.work)
    for candidate in _promising(bench, current, first_steps):
        entry = _finished(bench, current, candidate, first_steps[candidate])
        won[entry] = entry.over(bench.data, current)
    # of the best mechanism, all forms: what only some drivers seem to have, all of them may have as well
    if won:
        first = (_allowed(bench, current, won) or sorted(won, key=lambda e: -won[e]["all"].nats))[0]
        fitted = [first, *(e for e in won if e is not first)]
        won |= {e: e.over(bench.data, current) for e in _other_forms(bench, current, found, fitted)}
    added, alike = _best(bench, current, won)
    if added is not None:
        gain = won.pop(added)
        added = _profiled(bench, current, added)
        won[added] = added.over(bench.data, current) if added.fit.stds else gain
        added = _without_needless(bench, current, added)
    gains_ = dict(sorted(won.items(), key=lambda one: -one[1]["all"].nats))
    return Round(
        current=current,
        scores=found.best,
        chance=found.chance,
        gains=gains_,
        added=added,
        gain={} if added is None else added.over(bench.data, current),
        is_better=added is not None and added.is_better(bench.data, current),
        alike=tuple(alike),
        closest_effect=_closest_effect(bench, gains_, added),
    )


def _closest_effect(bench: _Bench, tried: Iterable[Entry], added: Entry | None) -> tuple[str, Difference] | None:
    """The first of the models with an effect that has a physical name, and how far it is behind what was added."""
    closest = next((e for e in tried if e.added[-1].explains), None)
    if added is None or closest is None:
        return None
    return closest.added[-1].mechanism, added.over(bench.data, closest)["all"]


def _promising(bench: _Bench, current: Entry, first_steps: dict[Candidate, JointFit]) -> list[Candidate]:
    """What may still win: of each kind, what gains at least half of the most on the samples that it was fitted to."""
    now, *there = (forecasts(bench.data, [fit.model], bench.work) for fit in (current.fit, *first_steps.values()))
    won = {c: gains(bench.data, one, now)[c.judged_by].nats for c, one in zip(first_steps, there, strict=True)}
    most = {c: max(won[o] for o in won if (o.rank, o.judged_by) == (c.rank, c.judged_by)) for c in won}
    return [c for c in won if most[c] - won[c] <= 0.5 * abs(most[c])]


def _profiled(bench: _Bench, current: Entry, entry: Entry) -> Entry:
    """The model with what drivers decide by at the vertex of its profile, where derivatives say nothing of it."""
    places = [k for c in entry.added if c.is_decision for k in c.places]
    fit = entry.fit
    for place in places:
        bench.on_progress("profile of what drivers decide by", 0, 1)
        fit = profiled(bench.data, fit, place, bench.work)
    return entry if fit is entry.fit else bench.entry(entry.name, entry.added, fit, current.models)


def _without_needless(bench: _Bench, current: Entry, entry: Entry) -> Entry:
    """A model without the additions that it does not need any more beside the last one; better than ``current``."""
    for candidate in entry.added[:-1]:
        less = _without(bench, entry, candidate)
        needs = entry.is_better(bench.data, less) and _is_away(bench, entry, candidate)
        if not needs and less.is_better(bench.data, current):
            entry = less
    return entry


def _without(bench: _Bench, entry: Entry, candidate: Candidate) -> Entry:
    """A model without one of its additions, fitted again; what holds the other parameters is fitted after them."""
    added = tuple(c for c in entry.added if c is not candidate)
    whole = entry.fit.beside or entry.fit
    fit = maximise(bench.data, without(bench.data, whole, candidate, bench.work), bench.work)
    if entry.fit.beside is not None:
        fit = with_named(bench.data, fit, [added[-1].name], bench.work)
    return bench.entry(entry.name, added, fit)


def _is_away(bench: _Bench, entry: Entry, candidate: Candidate) -> bool:
    """Whether a strength of an addition is away from 0 by two standard errors, as far as these are known."""
    places = [k for k in candidate.switches if k in entry.fit.model.shared]
    return not places or max(away_from_0(bench.data, entry.fit, places, bench.work)) > CLEARLY


def _allowed(bench: _Bench, current: Entry, won: dict[Entry, dict[str, Difference]]) -> list[Entry]:
    """The models that may be added, the best one first: they are better, and make sense."""
    allowed = [e for e in won if e.makes_sense and e.is_better(bench.data, current)]
    return sorted(allowed, key=lambda e: -won[e]["all"].nats)


def _best(bench: _Bench, current: Entry, won: dict[Entry, dict[str, Difference]]) -> tuple[Entry | None, list[Entry]]:
    """The model that gains most, of those that are better; and what cannot be told apart from it; won: gain of each.

    Among models that cannot be told apart, what changes how drivers act goes before freed constants, forces and moods,
    and these before noises: whatever else is missing shows in them, too. Then, what all drivers share goes before what
    some have or each has in their own way, and what gains most before the rest; of decisions, one step ahead.
    """
    allowed = _allowed(bench, current, won)
    if not allowed:
        return None, []
    first = allowed[0]
    alike = [e for e in won if e is first or not first.over(bench.data, e)["all"].is_clear]
    won_by = {e: won[e][e.added[-1].judged_by].nats for e in alike}
    order = sorted(alike, key=lambda e: (*e.added[-1].order, -won_by[e]))
    best = next((e for e in order if e in allowed and _is_away(bench, e, e.added[-1])), None)
    return best, [e for e in alike if e is not best]


def _confirmed(recording: Tracks, search: _Search, law: str, asked: Sequence[str]) -> _Search:
    """Fit to all drivers what a search on some of them has found, until something is not better by all of them."""
    some = search.bench
    some.on_progress("fitting what was found to all drivers", 0, 1)
    data, base = base_model(prepare(recording, some.data.decisions), some.work, law)
    bench = some.on(data)
    current, rounds = bench.entry("base", (), base), list[Round]()
    for one in search.rounds:
        entry = None if one.added is None else _again(bench, current, one.added)
        is_better = entry is not None and entry.is_better(data, current)
        if entry is None or not (is_better or asked):
            rounds.append(replace(one, current=current, added=None, gain={}, is_better=False, alike=()))
            break
        gain = entry.over(data, current)
        rounds.append(replace(one, current=current, added=entry, gain=gain, is_better=is_better))
        current = entry
    return _Search(bench, rounds)


def _again(bench: _Bench, current: Entry, found: Entry) -> Entry:
    """What was found for some drivers, beside a model of all drivers."""
    bench.on_progress(f"fitting {found.name} to all drivers", 0, 1)
    candidate, fit = with_one(bench.data, current.fit, found.added[-1].name, bench.work)
    entry = bench.entry(found.name, (*current.added, candidate), fit, current.models)
    entry = _profiled(bench, current, entry)
    for needless in (c for c in current.added if c.name not in {kept.name for kept in found.added}):
        entry = _without(bench, entry, needless)
    return entry


def _concluded(search: _Search, found: _Search, asked: tuple[str, ...], began: float) -> Diagnosis:
    """The final model, other laws, and the checks; ``found``: what was found, fitted to all drivers."""
    bench, rounds = found
    data, work = bench.data, bench.work
    base, final = rounds[0].current, rounds[-1].after
    bench.on_progress("checking the final model", 0, 1)
    simulated = bench.simulated(final.fit)
    own = [forecasts(one, without_folds(one, fitted, work), work) for one, fitted in simulated]
    ends, rivals = [errors(one) for one in own], laws(data, final, work)
    left = [*_left(search, len(rounds)), *(_gain_of(one, final, data) for one in rivals)]
    return Diagnosis(
        data=data,
        searched=search.bench.data,
        rounds=tuple(rounds),
        base=base,
        final=final,
        laws=rivals,
        floor={name: float(np.mean([one[name] for one in ends])) for name in ends[0]},
        checks=judged([*checks(data, final, simulated, own, bench.seed, work), *left]),
        where_before=locate(data, base.fit.model, base.forecasts.samples, work),
        where_after=locate(data, final.fit.model, final.forecasts.samples, work),
        driven_before=driven(data, base.models, work),
        driven_after=driven(data, final.models, work),
        stds=shared_stds(data, final.fit, work),
        smallest=() if any(one.added for one in rounds) else tuple(_smallest(rounds[0])),
        asked=asked,
        simulations=bench.simulations,
        seed=bench.seed,
        wall_s=time.monotonic() - began,
    )


def _smallest(first: Round) -> Iterator[dict[str, Any]]:
    """Yield from which strength on each effect would have shown: where its score would gain more than chance does."""
    for one in first.scores:
        c, needed = one.candidate, first.chance.needed.get(one.candidate.name)
        if c.kind not in ("effect", "measurement") or c.individual or c.drivers or one.information is None:
            continue
        place = next((k for k in (*c.switches, *c.places) if np.any(one.starts[0].get(k, 0.0))), None)
        known = float(np.diagonal(one.total, axis1=-2, axis2=-1).ravel()[0])
        if needed is None or place is None or known <= 0.0 or EFFECTS[c.name].is_limit:
            continue
        value = math.sqrt(2.0 * needed / known) * float(np.max(np.asarray(one.starts[0][place])))
        declared = ROW.declared[place]
        if declared.lower <= value <= declared.upper:
            yield {"name": c.mechanism, "parameter": declared.name, "value": value}


def _left(search: _Search, kept: int) -> list[Check]:
    """Checks of what a search has left after some rounds: the best candidate of the last one, and other forms of what
    was added.
    """
    data, rounds = search.bench.data, search.rounds[:kept]
    last, p_values = rounds[-1], rounds[-1].chance.p_values
    left = []
    if last.added is None and last.gains:
        # of those that were fitted: the one that most probably gains, of so many
        best = min((_gain_of(e, last.current, data) for e in last.gains), key=lambda check: check.p_value)
        name = best.name.replace("gain_of_", "left_for_")
        left.append(replace(best, name=name, p_value=min(1.0, len(last.gains) * best.p_value)))
    elif last.added is None and last.scores:
        # nothing was fitted: what the scores promise
        most = min(last.scores, key=lambda score: (p_values[score.candidate.mechanism], -score.gain))
        c = most.candidate
        left.append(Check(f"left_for_{c.name}", most.gain, 0.0, "nats", p_values[c.mechanism]))
    for one in rounds[: -1 if last.added is None else None]:
        # the best other form of what was added: unseen data may prefer it
        new = one.after.added[-1]
        forms = [e for e in one.gains if e.added[-1].mechanism == new.mechanism and e.added[-1] is not new]
        left += sorted((_gain_of(e, one.after, data) for e in forms), key=lambda check: check.value)[-1:]
    return left


def _gain_of(entry: Entry, final: Entry, data: Recorded) -> Check:
    """A check of what another model gains on unseen data."""
    won = entry.over(data, final)["all"]
    return Check(f"gain_of_{entry.name}", won.nats, 0.0, "nats", float(norm.sf(won.nats / max(won.se, 1e-9))))
