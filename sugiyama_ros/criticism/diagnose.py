"""A diagnosis, top down: score what may be missing, fit the best candidates, compare forecasts, add, and score again.

Everything is a difference between two models on the same recording: of a proper score of held-out forecasts, with its
standard error over blocks of time and drivers, and with what chance gives in the same procedure.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

from scipy.stats import norm

from sugiyama_ros.criticism.candidates import Candidate, candidates, chosen
from sugiyama_ros.criticism.chance import Simulated, p_values
from sugiyama_ros.criticism.check import Check, checks, judged
from sugiyama_ros.criticism.forecast import Surroundings, forecasts, surroundings
from sugiyama_ros.criticism.refine import combined, refined, without, without_folds
from sugiyama_ros.criticism.rivals import laws
from sugiyama_ros.criticism.score import Score, scores
from sugiyama_ros.criticism.table import Difference, Entry, gains
from sugiyama_ros.diagnosis.bootstrap import seeds
from sugiyama_ros.diagnosis.decisions import with_more_decisions
from sugiyama_ros.diagnosis.noises import base_model
from sugiyama_ros.fit.joint import JointFit, maximise
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.stretched import prepared
from sugiyama_ros.progress import OnStage
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories

#: What the diagnosis concludes.
Outcome = Literal["adequate", "explained", "not_explained"]
#: Level of significance: nothing is added that chance shows more often.
ALPHA = 0.05
# Number of candidates that are fitted in a round: the truth has been the fifth by its score, never the sixth.
_FITTED = 5


@dataclass(frozen=True, eq=False)
class Round:
    """One round: what was scored and fitted beside a model, and what was added to it.

    Parameters
    ----------
    current : Entry
        The model at the beginning of the round.
    scores : tuple of Score
        The best score of each mechanism, the largest gain first.
    p_values : dict of str to float
        By mechanism, how probable it is that chance shows as much in any candidate.
    entries : tuple of Entry
        The models that were fitted, the best one first.
    gains : tuple of dict of str to Difference
        Difference of each over the current model, by column.
    added : Entry or None
        The model to go on with; None if no model is clearly better.
    alike : tuple of Entry
        Models that cannot be told apart from the one that was added.
    """

    current: Entry
    scores: tuple[Score, ...]
    p_values: dict[str, float]
    entries: tuple[Entry, ...]
    gains: tuple[dict[str, Difference], ...]
    added: Entry | None
    alike: tuple[Entry, ...]

    @property
    def closest_effect(self) -> tuple[Entry, dict[str, Difference]] | None:
        """The best model with an effect that has a physical name, and its gain over the current model."""
        own = len(self.current.added)
        pairs = zip(self.entries, self.gains, strict=True)
        return next(((e, g) for e, g in pairs if any(c.explains for c in e.added[own:])), None)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The diagnosis of a recording, in numbers.

    Parameters
    ----------
    data : Recorded
        The recording.
    rounds : tuple of Round
        What was scored, fitted and added, in order.
    base, final : Entry
        The model without and with the additions.
    laws : tuple of Entry
        Other car-following laws on the same samples; of a law that is far behind, on some drivers.
    checks : tuple of Check
        Where the final model is compared with what was measured.
    seed : int
        Seed of the simulations and of the draws by chance.
    """

    data: Recorded
    rounds: tuple[Round, ...]
    base: Entry
    final: Entry
    laws: tuple[Entry, ...]
    checks: tuple[Check, ...]
    seed: int

    @property
    def outcome(self) -> Outcome:
        """What the table and the checks say together. Freed constants and noises explain nothing."""
        if any(one.failed for one in self.checks):
            return "not_explained"
        if not self.final.added:
            return "adequate"
        return "explained" if self.final.explains else "not_explained"


def diagnose(
    recording: Trajectories | Tracks,
    *,
    add: Sequence[str] = (),
    seed: int = 0,
    simulations: int = 2,
    workers: int = 2,
    on_progress: OnStage = lambda what, done, total: None,
) -> Diagnosis:
    """Find what is missing from the model.

    Parameters
    ----------
    recording : Trajectories or Tracks
        The recording.
    add : sequence of str
        Names of what is added, whatever the data say; by default, what the data ask for.
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
    with ThreadPoolExecutor(workers) as work:
        on_progress("fitting the base model", 0, 1)
        data, base = base_model(prepared(recording), work)
        bench = _bench(data, base, seed, simulations, work, on_progress)
        found = _found(bench, base)
        if found.is_open and (finer := with_more_decisions(recording, data, base, work, on_progress)) is not None:
            base = finer[1]
            bench = _bench(*finer, seed, simulations, work, on_progress)
            found = _found(bench, base)
        first = bench.entry("base", (), base)
        rounds = _told(bench, first, found, add) if add else _searched(bench, first, found)
        return _concluded(bench, rounds, simulations)


@dataclass(frozen=True, eq=False)
class _Bench:
    """What all rounds of a diagnosis share."""

    data: Recorded
    possible: tuple[Candidate, ...]
    around: Surroundings
    simulated: Simulated
    seed: int
    work: ThreadPoolExecutor
    on_progress: OnStage

    def entry(self, name: str, added: tuple[Candidate, ...], fit: JointFit) -> Entry:
        """A fitted model with its held-out forecasts."""
        models = without_folds(self.data, fit, self.work)
        return Entry(name, added, fit, models, forecasts(self.data, self.around, models, self.work))


def _bench(
    data: Recorded, base: JointFit, seed: int, simulations: int, work: ThreadPoolExecutor, on_progress: OnStage
) -> _Bench:
    simulated = Simulated(data, base, seed, simulations, work, on_progress)
    around = surroundings(data, base.model, work)
    return _Bench(data, candidates(data), around, simulated, seed, work, on_progress)


@dataclass(frozen=True, eq=False)
class _Found:
    """Scores beside a model: of all candidates by name, best starts first; and what chance gives, by mechanism."""

    by_name: dict[str, list[Score]]
    p_values: dict[str, float]

    @property
    def best(self) -> tuple[Score, ...]:
        """The best score of each mechanism, the largest gain first."""
        best: dict[str, Score] = {}
        for own in self.by_name.values():
            best.setdefault(own[0].candidate.mechanism, own[0])
        return tuple(best.values())

    @property
    def is_open(self) -> bool:
        """Whether anything gains more than by chance."""
        return min(self.p_values.values(), default=1.0) < ALPHA


def _searched(bench: _Bench, first: Entry, found: _Found) -> list[Round]:
    """Add what the data support, one round after the other; the last round adds nothing."""
    rounds = [_round(bench, first, found)]
    while (added := rounds[-1].added) is not None:
        rounds.append(_round(bench, added, _found(bench, added.fit, added.added)))
    return rounds


def _told(bench: _Bench, first: Entry, found: _Found, names: Sequence[str]) -> list[Round]:
    """Add what was asked for, one after the other."""
    rounds: list[Round] = []
    current = first
    for candidate in chosen([own[0].candidate for own in found.by_name.values()], names):
        if rounds:
            found = _found(bench, current.fit, current.added)
        entry = _fitted(bench, current, found.by_name[candidate.name])
        won = gains(bench.data, entry.forecasts, current.forecasts)
        rounds.append(Round(current, found.best, found.p_values, (entry,), (won,), entry, ()))
        current = entry
    return rounds


def _found(bench: _Bench, fit: JointFit, added: tuple[Candidate, ...] = ()) -> _Found:
    bench.on_progress(f"round {len(added) + 1}: scoring", 0, 1)
    known = {one.mechanism for one in added}
    left = [c for c in bench.possible if c.mechanism not in known]
    by_name: dict[str, list[Score]] = {}
    for one in sorted(scores(bench.data, fit, left, bench.work), key=lambda one: -one.gain):
        if one.candidate.mechanism not in known:
            by_name.setdefault(one.candidate.name, []).append(one)
    every = [one for own in by_name.values() for one in own]
    found = _Found(by_name, p_values(every, [], bench.seed))
    if not found.is_open:
        return found
    # what the filter's approximations do must be known only where there is something to explain
    promising = [c for c in left if found.p_values.get(c.mechanism, 1.0) < ALPHA]
    return _Found(by_name, p_values(every, bench.simulated.scores(promising), bench.seed))


def _fitted(bench: _Bench, current: Entry, own: Sequence[Score]) -> Entry:
    candidate = own[0].candidate
    return bench.entry(candidate.name, (*current.added, candidate), refined(bench.data, current.fit, own, bench.work))


def _round(bench: _Bench, current: Entry, found: _Found) -> Round:
    """Fit the candidates with the best scores beside a model, and choose."""
    open_ = [found.by_name[s.candidate.name] for s in found.best if found.p_values[s.candidate.mechanism] < ALPHA]
    # the score of constants says little: they respond to whatever is missing, far from where they start
    worth = [*open_[:_FITTED], *(own for own in open_[_FITTED:] if own[0].candidate.kind == "constants")]
    entries = []
    for number, own in enumerate(worth):
        bench.on_progress(f"round {len(current.added) + 1}: fitting", number, len(worth))
        entries.append(_fitted(bench, current, own))
    # of the best mechanism with a name, all forms
    named = [e for e in entries if e.added[-1].explains]
    if named:
        first = max(named, key=lambda e: gains(bench.data, e.forecasts, current.forecasts)["all"].nats).added[-1]
        forms = [own for own in found.by_name.values() if own[0].candidate.mechanism == first.mechanism]
        entries += [_fitted(bench, current, own) for own in forms if own[0].candidate.name != first.name]
    added, alike = _best(bench, current, entries)
    if added is not None and alike:
        gaining = [e for e in alike if gains(bench.data, e.forecasts, current.forecasts)["all"].is_worth_it]
        entries += _together(bench, current, [added, *gaining][:3])
        added, alike = _best(bench, current, entries)
    won = [gains(bench.data, one.forecasts, current.forecasts) for one in entries]
    order = sorted(range(len(entries)), key=lambda k: -won[k]["all"].nats)
    return Round(
        current,
        found.best,
        found.p_values,
        tuple(entries[k] for k in order),
        tuple(won[k] for k in order),
        None if added is None else _without_needless(bench, added),
        tuple(alike),
    )


def _without_needless(bench: _Bench, entry: Entry) -> Entry:
    """A model without the additions that it does not need any more beside the last one."""
    for candidate in entry.added[:-1]:
        fit = maximise(bench.data, without(bench.data, entry.fit, candidate, bench.work), bench.work)
        less = bench.entry(entry.name, tuple(c for c in entry.added if c is not candidate), fit)
        if not gains(bench.data, entry.forecasts, less.forecasts)["all"].is_worth_it:
            entry = less
    return entry


def _together(bench: _Bench, current: Entry, entries: Sequence[Entry]) -> list[Entry]:
    """Pairs of additions that cannot be told apart: each may be one half of what is missing."""
    found, own = [], len(current.added)
    for pair in combinations(entries, 2):
        new = tuple(c for one in pair for c in one.added[own:])
        fit = combined(bench.data, current.fit, [(one.added[-1], one.fit) for one in pair], bench.work)
        found.append(bench.entry(" + ".join(c.name for c in new), (*current.added, *new), fit))
    return found


def _best(bench: _Bench, current: Entry, entries: Sequence[Entry]) -> tuple[Entry | None, list[Entry]]:
    """The model that gains most, more than its error, and is nowhere clearly worse; and what cannot be told apart.

    Among models that cannot be told apart from it, one that can explain goes before one that cannot, and one addition
    before two.
    """

    def leads(one: Entry, other: Entry) -> bool:
        return gains(bench.data, one.forecasts, other.forecasts)["all"].is_clear

    won = {id(one): gains(bench.data, one.forecasts, current.forecasts) for one in entries}
    allowed = [
        e
        for e in entries
        if (g := won[id(e)])["all"].is_worth_it and not any(v.is_loss for v in g.values()) and e.makes_sense
    ]
    if not allowed:
        return None, []
    first = max(allowed, key=lambda e: won[id(e)]["all"].nats)
    alike = [e for e in entries if e is first or not leads(first, e)]
    own = len(current.added)
    best = min(
        (e for e in alike if e in allowed),
        key=lambda e: (not any(c.explains for c in e.added[own:]), len(e.added), -won[id(e)]["all"].nats),
    )
    return best, [e for e in alike if e is not best]


def _concluded(bench: _Bench, rounds: list[Round], simulations: int) -> Diagnosis:
    """The final model, other laws, and the checks."""
    data, work = bench.data, bench.work
    final = rounds[-1].added or rounds[-1].current
    bench.on_progress("checking", 0, 1)
    simulated = bench.simulated
    if final.added:
        simulated = Simulated(data, final.fit, bench.seed + 1, simulations, work, bench.on_progress)
    found = list(checks(data, final, simulated.recordings, seeds(bench.seed + 2, 12), work))
    rivals = laws(data, bench.around, final, work)
    found += _left(rounds, data, final, rivals)
    return Diagnosis(data, tuple(rounds), rounds[0].current, final, rivals, judged(found), bench.seed)


def _left(rounds: Sequence[Round], data: Recorded, final: Entry, rivals: Sequence[Entry]) -> list[Check]:
    """Checks of what is left: the best candidate of the last round, and the best other law."""
    last = rounds[-1]
    left = []
    if last.added is None and last.p_values:
        name = min(last.p_values, key=lambda one: last.p_values[one])
        score = max((one for one in last.scores if one.candidate.mechanism == name), key=lambda one: one.gain)
        left.append(Check(f"left_for_{score.candidate.name}", score.gain, 0.0, "nats", last.p_values[name]))
    for one in rivals:
        won = gains(data, one.forecasts, final.forecasts)["all"]
        left.append(Check(f"gain_of_{one.name}", won.nats, 0.0, "nats", float(norm.sf(won.nats / max(won.se, 1e-9)))))
    return left
