"""The search for what is missing, in rounds: screen every candidate, add the best supported one, and screen again.

Every candidate is screened in the same way on the data and on data simulated from the current model (``bootstrap``). A
p-value therefore says how often chance, the fit and the approximations of the filter give such a gain.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from sugiyama_ros.diagnosis.addition import Addition, advice_for, parameters_of
from sugiyama_ros.diagnosis.bootstrap import resampled_fit, seeds
from sugiyama_ros.diagnosis.candidacy import (
    LEAST_GAIN,
    UNKNOWN,
    Candidacy,
    NullGains,
    chance_scale,
    smallest_detectable,
)
from sugiyama_ros.diagnosis.candidates import Candidate, candidates, recording_of
from sugiyama_ros.diagnosis.discover import Discovery, discover
from sugiyama_ros.diagnosis.errors import HeldOutErrors, held_out_errors
from sugiyama_ros.diagnosis.glance import glance
from sugiyama_ros.diagnosis.push import push_candidate
from sugiyama_ros.diagnosis.screen import FULL, QUICK, Screened, closer, forecast, refine, screen, screen_again
from sugiyama_ros.fit.cross_validation import Gain, gain, held_out_nearly, sum_error
from sugiyama_ros.fit.joint import JointFit, objective, warm_start
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import filtered_states
from sugiyama_ros.progress import OnStage
from sugiyama_ros.workers import at_once

#: Level of significance, after Bonferroni's correction.
LEVEL = 0.05
# A candidate with more than this share of the best gain is fitted in full.
_SHARE = 0.3
# A candidate with more than this share of the best gain may be indistinguishable from the best one.
_RIVAL = 0.5
# Number of candidates that are screened again after the first round.
_LATER_LOOKS = 8
# One candidate is clearly worse than another by this many standard errors (5 %), and at least this difference [nats].
_CLEARLY, _LEAST_DIFFERENCE = 1.645, 3.0
# A gain above this [nats] is not checked against simulations.
_OBVIOUS = 60.0
# A candidate is screened if a glance at it predicts more than this gain [nats].
_PROMISE = 10.0
# Number of steps of a search that starts at the truth.
_FEW_STEPS = 4


class Search:
    """A model that grows from a base model by what the data support.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model without additions.
    quick : bool
        Whether to take shortcuts.
    seed : int
        Seed of the simulated recordings.
    work : ThreadPoolExecutor
        Runs the filters.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.

    Attributes
    ----------
    before : HeldOutErrors
        Held-out errors of ``base``.
    current, errors : JointFit, HeldOutErrors
        The current model and its held-out errors.
    named : list of Addition
        The additions, in order.
    scored : list of Candidacy
        Candidates of the first round, the best one first.
    heldout : dict of str to Gain
        Held-out gains of these candidates, by name.
    smallest : dict of str to float
        Strength from which each effect would usually have shown, by name.
    effort : Effort
        Limits of the search.
    searched : tuple of str
        Names of the candidates.
    """

    def __init__(
        self,
        data: Recorded,
        base: JointFit,
        quick: bool,
        seed: int,
        work: ThreadPoolExecutor,
        *,
        on_progress: OnStage,
    ) -> None:
        self.data, self.base, self.quick, self.seed = data, base, quick, seed
        self._work, self._on_progress = work, on_progress
        push = push_candidate(data, base.samples)
        self._possible = (*candidates(recording_of(data), data.drivers), *((push,) if push else ()))
        self.searched = tuple(dict.fromkeys(c.mechanism for c in self._possible))
        self._seen: dict[str, tuple[JointFit, Screened]] = {}
        self.effort = QUICK if quick else FULL
        self.current = base
        self.before = self.errors = held_out_errors(data, base, work, searched=not quick)
        self.named: list[Addition] = []
        self.scored: list[Candidacy] = []
        self.heldout: dict[str, Gain] = {}
        self.smallest: dict[str, float] = {}

    def add_effect(self) -> bool:
        """Carry out one round: add the best supported candidate, if any is supported.

        If the data cannot tell candidates apart, the round adds the candidate that predicts held-out samples best. A
        quick search does not compare them.

        Returns
        -------
        bool
            Whether a candidate was added.
        """
        scored = self._look_at_all()
        supported = [one for one in scored if one.refined and one.p_value <= LEVEL and one.gain >= one.needed]
        now = self._nearly(self.current) if supported and not self.quick else self.errors
        grown: list[Addition] = []
        predicted = self._gains(supported)
        for one in sorted(supported, key=lambda one: -predicted[one.candidate.name].nats):
            is_rival = not grown or (one.candidate.mechanism in grown[0].indistinguishable and not self.quick)
            if is_rival and self._predicts_more(one, now):
                rivals = self._indistinguishable(one, scored)
                named = self._grow(one.candidate, one.fit, one.p_value, rivals)
                grown += [named] if named is not None else []
        return self._take(max(grown, key=lambda one: one.heldout.nats, default=None))

    def discover(self) -> list[tuple[Discovery, Screened]]:
        """Return forces without a name that the current model lacks, the best supported one first."""
        self._on_progress("forces without a name", 0, 1)
        return discover(self.data, self.current, self._work)

    def add_force(self, forces: Sequence[tuple[Discovery, Screened]]) -> bool:
        """Add the first force that predicts better, and return whether there is one."""
        for force, look in forces:
            one = self._grow(look.candidate, refine(self.data, look, self._work), force.p_value)
            # a curve is flexible where data are few: it may predict one step well and fail in a free run
            if one is not None and one.after.no_worse_than(one.before):
                return self._take(one)
        return False

    def _look_at_all(self) -> list[Candidacy]:
        """Screen the candidates, and fit the most promising ones in full; the best candidate first."""
        is_first = not self._seen
        chosen: Sequence[Candidate] = self._promising() if is_first else self._worth_a_look()
        title = f"round {len(self.named) + 1}"
        looks = _best_forms(at_once(self._look, chosen, f"{title}: candidates", self._on_progress))
        promising = self._shortlist(looks)
        again = at_once(self._look_closer, [looks[k] for k in promising], f"{title}: looking closer", self._on_progress)
        for k, look in zip(promising, again, strict=True):
            looks[k] = look
        self._seen |= {look.candidate.name: (self.current, look) for look in looks}
        # simulate only where the result is open: not for hopeless gains, and not for obvious ones
        doubtful = [k for k in promising if self._judge(looks[k]).p_value <= LEVEL and not _obvious(looks[k])]
        if is_first and not doubtful:
            doubtful = promising[:1]
        null = self._simulate([looks[k].candidate for k in doubtful]) if doubtful else UNKNOWN
        scored = [self._judge(look, null) for look in looks]
        best = max(scored[k].gain for k in promising)
        hopeful = [
            scored[k]
            for k in promising
            if scored[k].p_value <= LEVEL or (scored[k].p_alone <= LEVEL and scored[k].gain > _RIVAL * best)
        ]
        fitted = at_once(self._in_full, hopeful, f"{title}: fitting", self._on_progress)
        scored = sorted([*fitted, *(one for one in scored if one not in hopeful)], key=lambda one: -one.score)
        if is_first:
            self.scored, self.smallest = scored, smallest_detectable(looks, null)
            self.heldout = self._gains(scored)
        return scored

    def _gains(self, scored: Sequence[Candidacy]) -> dict[str, Gain]:
        """Held-out gains of candidates over the current model, without running the filter."""
        now = held_out_nearly(self.data, self.current)
        return {one.candidate.name: gain(self.data, held_out_nearly(self.data, one.fit), now) for one in scored}

    def _predicts_more(self, one: Candidacy, now: HeldOutErrors) -> bool:
        """Whether held-out samples support a candidate, too; ``now``: errors of the current model."""
        if one.candidate.happens_once:
            return True
        predicted = self._nearly(one.fit)
        won = gain(self.data, predicted.samples, now.samples)
        return won.nats > -won.se and (one.candidate.is_noise or predicted.no_worse_than(now))

    def _indistinguishable(self, best: Candidacy, scored: Sequence[Candidacy]) -> tuple[str, ...]:
        """Names of the candidates that do not predict held-out samples clearly worse than the best candidate.

        This is Vuong's test of models that are not nested (Econometrica 57 (1989) 307), one-sided, paired over drivers.
        It is known at this point that something is missing, so the p-value of a rival needs no correction.
        """
        by_best = held_out_nearly(self.data, best.fit)
        names: list[str] = []
        for one in scored:
            if one.refined and one.candidate.mechanism not in (best.candidate.mechanism, *names):
                behind = gain(self.data, by_best, held_out_nearly(self.data, one.fit))
                if behind.nats < max(_CLEARLY * sum_error(behind.drivers), _LEAST_DIFFERENCE):
                    names.append(one.candidate.mechanism)
        return tuple(names)

    def _nearly(self, fitted: JointFit) -> HeldOutErrors:
        """Held-out errors, without a search for each fold."""
        return held_out_errors(self.data, fitted, self._work, searched=False)

    def _grow(
        self, candidate: Candidate, fitted: JointFit, p_value: float, rivals: tuple[str, ...] = ()
    ) -> Addition | None:
        """The model with a candidate, fitted in full; None if its held-out gain is below its standard error over
        drivers.
        """
        data, work, before = self.data, self._work, self.errors
        model = replace(fitted.model, ahead=fitted.model.rows)
        grown = warm_start(data, fitted, model, work, renewals=0 if self.quick else self.effort.renewals)
        after = held_out_errors(data, grown, work, searched=not self.quick)
        won = gain(data, after.samples, before.samples)
        if won.nats < sum_error(won.drivers) and not candidate.happens_once:
            return None
        return Addition(
            name=candidate.mechanism,
            form=candidate.name,
            kind=candidate.kind,
            parameters=parameters_of(grown, candidate),
            indistinguishable=rivals,
            advice=advice_for(candidate.mechanism, rivals),
            p_value=p_value,
            heldout=won,
            before=before,
            after=after,
            fit=grown,
        )

    def _take(self, one: Addition | None) -> bool:
        """Make an extended model the current one; return False if there is none."""
        if one is None:
            return False
        self.current, self.errors = one.fit, one.after
        self.named.append(one)
        self._possible = tuple(c for c in self._possible if c.mechanism != one.name)
        return True

    def _judge(self, look: Screened, null: NullGains | None = None) -> Candidacy:
        return (null or UNKNOWN).judge(look, len(self._possible))

    def _shortlist(self, looks: Sequence[Screened]) -> list[int]:
        """Numbers of the looks to follow: the largest gains, and noises, whose best values may be far from the start.

        In later rounds: the looks with the largest gains above chance.
        """
        if self._seen:
            return sorted(range(len(looks)), key=lambda k: -self._judge(looks[k]).score)[: self.effort.later]
        order = sorted(range(len(looks)), key=lambda k: -looks[k].gain)
        best = max(looks[order[0]].gain, 1.0)
        chosen = [k for k in order[: self.effort.shortlist] if looks[k].gain > _SHARE * best or k in order[:2]]
        if best > 50.0:
            freed = [k for k, look in enumerate(looks) if look.candidate.kind == "constants"]
            chosen += [k for k in freed if looks[k].candidate.is_noise and k not in chosen]
        return chosen

    def _promising(self) -> list[Candidate]:
        """The candidates, but of those that get a glance first only those whose glance promises something."""

        def promises(candidate: Candidate) -> bool:
            gain = glance(self.data, self.current, candidate, self._work)
            return gain > _PROMISE + candidate.elsewhere

        glanced = [c for c in self._possible if c.glanced]
        title = f"round {len(self.named) + 1}: first glances"
        promised = at_once(promises, glanced, title, self._on_progress)
        left = {c.name for c, yes in zip(glanced, promised, strict=True) if not yes}
        return [c for c in self._possible if c.name not in left]

    def _worth_a_look(self) -> list[Candidate]:
        """The candidates with the largest predicted gains over the current model, from earlier looks."""
        seen = [c for c in self._possible if c.name in self._seen]
        order = sorted(seen, key=lambda c: -forecast(self.data, *self._seen[c.name], self.current))
        return order[:_LATER_LOOKS]

    def _look(self, candidate: Candidate) -> Screened:
        """Screen a candidate from the end of an earlier look, or from the start if the earlier look leads nowhere."""
        before = self._seen.get(candidate.name)
        if before and before[1].gain > 0.0:
            again = screen_again(self.data, self.current, *before, self._work, self.effort)
            if again.gain > 0.0 or again.predicted_gain < LEAST_GAIN:
                return again
        return screen(self.data, self.current, candidate, self._work, self.effort)

    def _look_closer(self, look: Screened) -> Screened:
        return closer(self.data, look, self._work)

    def _in_full(self, one: Candidacy) -> Candidacy:
        """Fit a candidate in full; the gain by chance still comes from rough fits."""
        refined = refine(self.data, one.look, self._work, self.effort)
        return replace(one, fit=refined, gain=max(one.gain, _rise(self.current, refined)), refined=True)

    def _simulate(self, chosen: Sequence[Candidate]) -> NullGains:
        """Gains of candidates on recordings that the current model simulates."""
        data, current, work = self.data, self.current, self._work
        states = filtered_states(data, current.model, work)

        def one_run(rng: np.random.Generator) -> list[float]:
            simulated, fitted = resampled_fit(data, current, states, rng, work, _FEW_STEPS)
            looks = (screen(simulated, fitted, candidate, work, self.effort) for candidate in chosen)
            return [closer(simulated, look, work).gain for look in looks]

        gains = at_once(
            one_run,
            seeds(self.seed + len(self.named), self.effort.runs),
            "simulating the current model",
            self._on_progress,
        )
        by_candidate = zip(chosen, zip(*gains, strict=True), strict=True)
        scale = {c.name: chance_scale(c, data.drivers) for c in chosen}
        return NullGains({candidate.name: list(one) for candidate, one in by_candidate}, scale)


def _rise(current: JointFit, fitted: JointFit) -> float:
    everywhere = range(FOLDS)
    return objective(fitted.slopes, fitted.model, everywhere) - objective(current.slopes, current.model, everywhere)


def _best_forms(looks: Sequence[Screened]) -> list[Screened]:
    """The looks at the form of each mechanism that gains most."""
    best: dict[str, Screened] = {}
    for look in looks:
        mechanism = look.candidate.mechanism
        if mechanism not in best or look.gain > best[mechanism].gain:
            best[mechanism] = look
    return list(best.values())


def _obvious(look: Screened) -> bool:
    """Whether no simulation could gain as much; never for individual parameters, which may gain much by chance."""
    return look.gain >= _OBVIOUS and not look.candidate.individual
