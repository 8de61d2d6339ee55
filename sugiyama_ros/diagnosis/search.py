"""The search for what is missing, in rounds: screen every candidate, add the best supported one, and screen again.

Every candidate is screened in the same way on the data and on data simulated from the current model (``bootstrap``). A
p-value therefore says how often chance, the fit and the approximations of the filter give such a gain.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from functools import partial

from sugiyama_ros.diagnosis.addition import FEIGNED, FLEXIBLE, Addition, addition_of, feigning, least_gain
from sugiyama_ros.diagnosis.bootstrap import resampled_fits, seeds
from sugiyama_ros.diagnosis.candidacy import (
    FULL_SHARE,
    LEAST_GAIN,
    UNKNOWN,
    Candidacy,
    NullGains,
    heldout_gains,
    is_obvious,
    null_gains,
    shortlist,
    smallest_detectable,
)
from sugiyama_ros.diagnosis.candidates import Candidate, candidates, only_those
from sugiyama_ros.diagnosis.discover import Discovery, against_simulations, best_force, discover, is_force
from sugiyama_ros.diagnosis.doubts import wrong_signs
from sugiyama_ros.diagnosis.errors import HeldOutErrors, held_out_errors, searched_errors
from sugiyama_ros.diagnosis.few import who_shows
from sugiyama_ros.diagnosis.few_screen import ShownByFew, fits_of_few, shown_by_few
from sugiyama_ros.diagnosis.forms import best_forms
from sugiyama_ros.diagnosis.largest import p_values, with_p_values
from sugiyama_ros.diagnosis.looks import Looks
from sugiyama_ros.diagnosis.placing import converged
from sugiyama_ros.diagnosis.prescreen import Promise
from sugiyama_ros.diagnosis.push import push_candidate
from sugiyama_ros.diagnosis.scan import forces_left
from sugiyama_ros.diagnosis.screen import FULL, QUICK, Screened, closer, refine, screen
from sugiyama_ros.diagnosis.telling_apart import indistinguishable
from sugiyama_ros.diagnosis.use import ANYTHING, Goal, Use
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.fit.cross_validation import Gain, gain
from sugiyama_ros.fit.joint import JointFit, rise
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.sandwich import shared_stds
from sugiyama_ros.progress import OnStage
from sugiyama_ros.workers import at_once

#: Level of significance, after the correction for the number of candidates.
LEVEL = 0.05
# Level at which a candidate is added: a wrong name is worse than none.
_ADDED = 0.02
# A candidate with more than this share of the best gain may be indistinguishable from the best one.
_RIVAL = 0.5
# Number of forces without a name that a quick search fits.
_TRIED = 3
# A fit to a few drivers often gains twice its forecast, so that half this share of the best gain is enough to try it.
_FORECAST = 0.25


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
    goal : Goal
        What may be added, and what the model is for.
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
        Candidates of the first round, the best one first, without their fits.
    heldout : dict of str to Gain
        Held-out gains of these candidates, by name.
    left_out : list of Promise
        Mechanisms that were not screened in the first round, in the form that promises most.
    smallest : dict of str to float
        Strength from which each effect would usually have shown, by name.
    refused : list of (str, tuple of str)
        Candidates that were not added because of what the model is for, and why.
    senseless : dict of str to tuple of str
        Candidates of the last round that predict better only with values that make no physical sense, and which.
    effort : Effort
        Limits of the search.
    asked : tuple of str
        Names of the only candidates, if somebody has asked for them.
    searched : tuple of str
        Names of the candidates.
    runs : int
        Largest number of simulated recordings on which a p-value rests; 0 if no gain was in doubt.
    other_order : Search or None
        The search that begins with freed constants where this one began with an effect that cannot be told apart from
        them, or the other way around; None for a quick search.
    """

    def __init__(
        self,
        data: Recorded,
        base: JointFit,
        quick: bool,
        seed: int,
        work: ThreadPoolExecutor,
        *,
        goal: Goal = ANYTHING,
        on_progress: OnStage,
    ) -> None:
        self.data, self.base, self.quick, self.seed = data, base, quick, seed
        self._work, self._on_progress = work, on_progress
        push = push_candidate(data, base.samples)
        every = (*candidates(data), *((push,) if push else ()))
        self.asked = tuple(dict.fromkeys(goal.only))
        effects = [name for name in self.asked if not is_force(name)]
        self._possible = only_those(data, every, effects) if effects or not self.asked else ()
        self.searched = tuple(dict.fromkeys((*(c.mechanism for c in self._possible), *filter(is_force, self.asked))))
        self.effort = QUICK if quick else FULL
        self._looks = Looks(data, base, work, self.effort)
        self.current = base
        self.before = self.errors = held_out_errors(data, base, work, searched=not quick)
        self.named: list[Addition] = []
        self.scored: list[Candidacy] = []
        self.heldout: dict[str, Gain] = {}
        self.left_out: list[Promise] = []
        self.smallest: dict[str, float] = {}
        self.refused: list[tuple[str, tuple[str, ...]]] = []
        self.senseless: dict[str, tuple[str, ...]] = {}
        self._few_gained: dict[str, float] = {}
        self.other_order: Search | None = None
        self.runs = 0
        self._simulated: list[tuple[Recorded, JointFit]] = []
        self._use = Use(data, base, goal.purpose, work)

    def add_effect(self) -> bool:
        """Carry out one round: add the best supported candidate, if any is supported.

        If the data cannot tell candidates apart, the round adds the candidate that predicts held-out samples best. A
        quick search does not compare them.

        Returns
        -------
        bool
            Whether a candidate was added.
        """
        self.senseless = {}
        scored = self._look_at_all()
        supported = [one for one in scored if one.refined and one.p_value <= _ADDED and one.gain >= one.needed]
        now = self._nearly(self.current) if supported and not self.quick else self.errors
        grown: list[Addition] = []
        predicted = heldout_gains(self.data, self.current, supported)
        rivals = [(one.candidate.mechanism, one.fit) for one in scored if one.refined]
        for one in sorted(supported, key=lambda one: -predicted[one.candidate.name].nats):
            is_rival = not grown or (one.candidate.mechanism in grown[0].indistinguishable and not self.quick)
            if is_rival and self._predicts_more(one, now):
                named = self._grow(one.candidate, one.fit, one.p_value, rivals)
                grown += [named] if named is not None else []
        if grown:
            best = max(grown, key=lambda one: one.heldout.nats)
            self.other_order = self.other_order or self._with_constants_elsewhere(best, grown)
            few = who_shows(self.current, best.fit)
            grown = [best if few is None else replace(best, drivers=few.drivers)]
        # what is supported but does not predict better must not hide what a few drivers show
        gained = next((one.gain for one in supported if grown and one.candidate.name == grown[0].form), 0.0)
        grown += self._of_few(self._shown_by_few(gained), _RIVAL * gained)
        return self._take(max(grown, key=lambda one: one.heldout.nats, default=None))

    def _with_constants_elsewhere(self, best: Addition, grown: Sequence[Addition]) -> "Search | None":
        """A search that has begun with constants where this one begins with an effect, or the other way around."""
        others = [one for one in grown if (one.kind == "constants") != (best.kind == "constants")]
        if self.named or not others:
            return None
        other = copy(self)
        other.named, other.refused, other.senseless, other._few_gained = [], [], {}, {}
        other._looks = self._looks.copy()
        other._take(max(others, key=lambda one: one.heldout.nats))
        return other if other.named else None

    def _shown_by_few(self, gained: float) -> list[ShownByFew]:
        """Effects by which a few drivers may gain more than all drivers by what was found (gained) [nats]."""
        known = {*self.current.model.individual, *self.current.model.shared}
        possible = [c for c in self._possible if known.isdisjoint(c.places) and self._few_gained.get(c.name, 1.0) > 0.0]
        seen = self._looks.beside(self.current)
        shown = shown_by_few(self.data, self.current, possible, self._work, self._on_progress, seen)
        self._few_gained |= {one.candidate.name: one.gain for one in shown}
        least = max(_FORECAST * gained, LEAST_GAIN)
        return [one for one in shown if one.gain > max(least, FULL_SHARE * shown[0].gain)]

    def _of_few(self, shown: Sequence[ShownByFew], least: float) -> list[Addition]:
        """Effects that only a few drivers have, and that predict better; ``least``: gain less costs to begin with."""
        fits = fits_of_few(self.data, self.current, shown, len(self._possible), self._work, self._on_progress)
        rivals, grown = [(f.candidate.mechanism, f.fit) for f in fits], []
        for f in fits:
            if f.gain - f.few.cost > least:
                one = self._grow(replace(f.candidate, drivers=f.few.drivers), f.fit, f.p_value, rivals)
                grown += [one] if one and one.after.no_worse_than(one.before) else []
        return grown

    def forces(self, level: float) -> list[tuple[Discovery, Screened]]:
        """Forces without a name that the current model lacks, at a level of significance; the largest gain first.

        A quick search fits only those along covariates that the scan finds.
        """
        self._on_progress("forces without a name", 0, 1)
        only: Sequence[str] = COVARIATES
        if self.quick:
            left = forces_left(self.data, self.current, self.simulations(), level, self._work)
            only = [one.covariate for one in left if one.covariate in COVARIATES][:_TRIED]
        forces = discover(self.data, self.current, self._work, self.effort, only)
        if found := [one for one in forces if one[0].p_value < level]:
            found = against_simulations(found, self.simulations(), self._work, self.effort)
        return sorted((one for one in found if one[0].p_value < level), key=lambda one: -one[0].gain_nats)

    def forget(self) -> None:
        """Give up the looks at candidates, which take memory; no round can follow."""
        self._looks.forget()

    def compare_all(self) -> None:
        """Give candidates of the first round, of which none was named, p-values from one test of all of them."""
        self.runs = max(self.runs, 1)
        found = p_values(self.data, self.base, self._looks.prescreens, self.simulations(), self.seed, self._work)
        self.scored, self.left_out = with_p_values(found, self.scored, self.heldout, self.left_out)

    def add_force(self, forces: Sequence[tuple[Discovery, Screened]]) -> bool:
        """Add the first force that predicts better, and return whether there is one."""
        for force, look in forces:
            one = self._grow(look.candidate, refine(self.data, look, self._work), force.p_value)
            # a curve is flexible where data are few: it may predict one step well and fail in free runs, or in a jam
            if one is None or one.heldout.nats < FLEXIBLE * one.heldout.se:
                continue
            if one.after.no_worse_than(one.before) and not self._use.is_worse(one.fit, self.current):
                return self._take(one)
        return False

    def _look_at_all(self) -> list[Candidacy]:
        """Screen the candidates, and fit the most promising ones in full; the best candidate first."""
        is_first = self._looks.is_first_round
        title = f"round {len(self.named) + 1}"
        chosen = self._looks.worth_a_look(self._possible, self.current, self._on_progress)
        look_at = partial(self._looks.look, current=self.current)
        found = at_once(look_at, chosen, f"{title}: candidates", self._on_progress)
        looks = best_forms(found)
        promising = self._shortlist(looks)
        step = partial(closer, self.data, work=self._work)
        again = at_once(step, [looks[k] for k in promising], f"{title}: looking closer", self._on_progress)
        for k, look in zip(promising, again, strict=True):
            looks[k] = look
        self._looks.keep([*found, *looks], self.current)
        # simulate only where the result is open: not for hopeless gains, and not for obvious ones
        open_ = [k for k in promising if not is_obvious(self.data, looks[k])]
        doubtful = [k for k in open_ if self._judge(looks[k]).p_value <= LEVEL]
        null = UNKNOWN
        if doubtful:
            self.runs = max(self.runs, self.effort.runs)
            chosen = [looks[k].candidate for k in doubtful]
            null = null_gains(self.simulations(), chosen, self.effort, self._work, self._on_progress)
            # two simulations may gain little by chance: six before anything is named
            if self.quick and (named := [k for k in doubtful if self._judge(looks[k], null).p_value <= LEVEL]):
                self.runs = FULL.runs
                further = self.simulations(self.runs)[self.effort.runs :]
                chosen = [looks[k].candidate for k in named]
                null = null.joined(null_gains(further, chosen, self.effort, self._work, self._on_progress))
        scored = [self._judge(look, null) for look in looks]
        judged = [scored[k] for k in promising]
        best = max(one.gain for one in judged)
        hopeful = [o for o in judged if o.p_value <= LEVEL or (o.p_alone <= LEVEL and o.gain > _RIVAL * best)]
        fitted = at_once(self._in_full, hopeful, f"{title}: fitting", self._on_progress)
        scored = sorted([*fitted, *(one for one in scored if one not in hopeful)], key=lambda one: -one.score)
        if is_first:
            self.heldout = heldout_gains(self.data, self.current, scored)
            self.smallest = smallest_detectable(self._looks.prescreens.values(), self.current, null)
            self.scored = [one.without_fits(self.base) for one in scored]
            shown = {one.candidate.mechanism for one in scored}
            self.left_out = [one for one in best_forms(self._looks.left_out) if one.candidate.mechanism not in shown]
        return scored

    def _predicts_more(self, one: Candidacy, now: HeldOutErrors) -> bool:
        """Whether held-out samples support a candidate, too; ``now``: errors of the current model."""
        if one.candidate.happens_once:
            return True
        predicted = self._nearly(one.fit)
        won = gain(self.data, predicted.samples, now.samples)
        return won.nats > 0.0 and (one.candidate.is_noise or predicted.no_worse_than(now))

    def _nearly(self, fitted: JointFit) -> HeldOutErrors:
        """Held-out errors, without a search for each fold."""
        return held_out_errors(self.data, fitted, self._work, searched=False)

    def _grow(
        self, candidate: Candidate, fitted: JointFit, p_value: float, rivals: Sequence[tuple[str, JointFit]] = ()
    ) -> Addition | None:
        """The model with a candidate, fitted in full; None if it gains too little held out, or makes no sense."""
        one = self._extended(candidate, fitted, p_value, rivals)
        if not self._holds(one, candidate):
            return None
        if wrong := self._wrong_signs(one):
            self.senseless[one.name] = wrong
            return None
        return one

    def _extended(
        self, candidate: Candidate, fitted: JointFit, p_value: float, rivals: Sequence[tuple[str, JointFit]] = ()
    ) -> Addition:
        """The model with a candidate, fitted in full, and what it gains held out."""
        data, work = self.data, self._work
        # what is named has converged, also in a quick search
        grown = converged(data, fitted, candidate, work)
        after = held_out_errors(data, grown, work, searched=not self.quick)
        won = gain(data, after.samples, self.errors.samples)
        if won.nats > self._most(grown):
            who = feigning((self.current, self.errors), (grown, after)) or None
            self.errors = searched_errors(data, self.current, self.errors, work, who)
            self.before = self.before if self.named else self.errors
            after = searched_errors(data, grown, after, work, who)
            won = gain(data, after.samples, self.errors.samples)
        best = candidate.mechanism, after.samples
        alike = indistinguishable(data, self.errors.samples, best, rivals)
        return addition_of(candidate, grown, (self.errors, after), won, p_value, alike)

    def _most(self, grown: JointFit) -> float:
        """Largest held-out gain [nats] of an extended model to believe: nothing predicts more than it fits."""
        return FEIGNED * rise(self.current, grown) + LEAST_GAIN

    def _holds(self, one: Addition, candidate: Candidate) -> bool:
        """Whether held-out samples support an extended model."""
        won = one.heldout
        # what happens once cannot be held out, but it must not seem to change what has nothing to do with it
        return not (
            won.nats < least_gain(won, candidate) or (candidate.happens_once and won.nats > self._most(one.fit))
        )

    def _wrong_signs(self, one: Addition) -> tuple[str, ...]:
        """Parameters of an extended model that make no physical sense, in words."""
        return wrong_signs(one, partial(shared_stds, self.data, one.fit, self._work))

    def add_asked(self, name: str) -> None:
        """Add what somebody asks for, in the form that fits best, and note whether the data ask for it, too.

        Parameters
        ----------
        name : str
            Name of an effect, of one of its forms, of a group of constants, or of a force without a name.

        Raises
        ------
        InputError
            For a name that cannot be added here.
        """
        title = f"adding {name}"
        if is_force(name):
            force, look = best_force(self.data, self.current, self._work, self.effort, name)
            shown = [(force, look)]
            if force.p_value < LEVEL:
                shown = against_simulations(shown, self._enough_simulations(), self._work, self.effort)
            scored = replace(UNKNOWN.judge(look, 1), p_value=shown[0][0].p_value)
        else:
            forms = [c for c in self._possible if name in (c.name, c.mechanism)]
            looks = at_once(self._closely, forms, title, self._on_progress)
            look = max(looks, key=lambda one: one.gain - one.candidate.elsewhere)
            null, chosen = UNKNOWN, [look.candidate]
            if not is_obvious(self.data, look):
                null = null_gains(self._enough_simulations(), chosen, self.effort, self._work, self._on_progress)
            scored = null.judge(look, len(forms))
        scored = at_once(self._in_full, [scored], f"{title}: fitting", self._on_progress)[0]
        one = self._extended(scored.candidate, scored.fit, scored.p_value)
        few = None if scored.candidate.individual else who_shows(self.current, one.fit)
        is_likely = scored.p_value <= _ADDED and scored.gain >= scored.needed
        is_supported = is_likely and self._holds(one, scored.candidate) and not self._wrong_signs(one)
        one = replace(one, is_supported=is_supported, drivers=few.drivers if few is not None and is_supported else ())
        worse = self._use.worse([*self.named, one], one.fit, self.current)
        self.heldout[scored.candidate.name] = one.heldout
        self.scored.append(scored.without_fits(one.fit))
        self._accept(one, worse)

    def _enough_simulations(self) -> list[tuple[Recorded, JointFit]]:
        """As many simulated recordings as a p-value needs on which a name rests."""
        self.runs = FULL.runs
        return self.simulations(self.runs)

    def _closely(self, candidate: Candidate) -> Screened:
        """A rough fit of a candidate beside the current model, with a closer look."""
        return closer(self.data, screen(self.data, self.current, candidate, self._work, self.effort), self._work)

    def _take(self, one: Addition | None) -> bool:
        """Make an extended model the current one; return False if there is none."""
        if one is None:
            return False
        worse = self._use.worse([*self.named, one], one.fit, self.current)
        self._possible = tuple(c for c in self._possible if c.mechanism != one.name)
        if worse and self._use.refuses:
            self.refused.append((one.name, worse))
            return bool(self._possible)
        self._accept(one, worse)
        return True

    def _accept(self, one: Addition, worse: tuple[str, ...]) -> None:
        """Make an extended model the current one."""
        self.current, self.errors, self._simulated = one.fit, one.after, []
        self.named.append(replace(one, worse=worse))

    def _judge(self, look: Screened, null: NullGains | None = None) -> Candidacy:
        return (null or UNKNOWN).judge(look, len(self._possible))

    def _shortlist(self, looks: Sequence[Screened]) -> list[int]:
        """Numbers of the looks to follow; in later rounds: those with the largest gains above chance."""
        if not self._looks.is_first_round:
            return sorted(range(len(looks)), key=lambda k: -self._judge(looks[k]).score)[: self.effort.later]
        return shortlist(looks, self.effort)

    def _in_full(self, one: Candidacy) -> Candidacy:
        """Fit a candidate in full; the gain by chance still comes from rough fits."""
        refined = refine(self.data, one.look, self._work, self.effort)
        return replace(one, fit=refined, gain=max(one.gain, rise(self.current, refined)), refined=True)

    def simulations(self, runs: int = 0) -> list[tuple[Recorded, JointFit]]:
        """Recordings that the current model simulates, with the fits to them; ``runs``: number, if more than usual."""
        wanted = max(runs, self.effort.runs)
        if len(self._simulated) < wanted:
            rngs = seeds(self.seed + len(self.named), wanted)[len(self._simulated) :]
            self._simulated += resampled_fits(self.data, self.current, rngs, self._work, self._on_progress)
        return self._simulated
