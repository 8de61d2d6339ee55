"""The search for what is missing, round by round: look at every candidate, add the best one that holds, look again.

Every candidate is looked at in the same way on the data and on data simulated from the model as it stands
(``bootstrap``), so that a p-value says how often chance, refitting and the filter's approximations give as much.
"""

import math
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.stats import t as student

from sugiyama_ros.diagnosis.bootstrap import resample, seeds
from sugiyama_ros.diagnosis.candidates import Candidate, Kind, candidates, recording_of
from sugiyama_ros.diagnosis.discover import Discovery
from sugiyama_ros.diagnosis.errors import Errors, errors_of
from sugiyama_ros.diagnosis.screen import FULL, QUICK, Glance, closer, forecast, glance, glance_again, refine
from sugiyama_ros.effects.registry import DECLARED, EFFECTS, effect
from sugiyama_ros.fit.cross_validation import Gain, gain, held_out_nearly, sum_error, without_folds
from sugiyama_ros.fit.joint import Fit, begun, climb, objective, refit
from sugiyama_ros.fit.recording import FOLDS, Recorded
from sugiyama_ros.fit.score import filtered_states
from sugiyama_ros.progress import OnStage

#: Level of significance, after Bonferroni's correction.
LEVEL = 0.05
# Share of the best gain above which a candidate is fitted in full.
_SHARE = 0.3
# Share of the best gain above which a candidate may be a rival that cannot be told apart.
_RIVAL = 0.5
# Candidates that are looked at again after the first round.
_LATER_LOOKS = 8
# A gain is not believed below this [nats], whatever the p-value; and simulated gains spread by at least this.
_LEAST_GAIN, _LEAST_SPREAD = 5.0, 1.5
# Standard errors by which one candidate is clearly worse than another (5 %), and the least difference [nats].
_CLEARLY, _LEAST_DIFFERENCE = 1.645, 3.0
# Prior weight of the common spread in that of one candidate, as a number of simulated recordings.
_COMMON = 4
# A gain of so many nats is not checked against simulations.
_OBVIOUS = 60.0
# Steps of a search that begins at the truth.
_FEW_STEPS = 4
# Fits that are under way at the same time, all on the same workers.
_AT_ONCE = 3
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True, eq=False)
class Looked:
    """What was found about one candidate in one round; gains in nats.

    p_value: corrected for the number of candidates; p_alone: as if there were no other.
    """

    look: Glance
    fit: Fit
    gain: float
    expected: float
    spread: float
    p_value: float
    p_alone: float
    refined: bool

    @property
    def candidate(self) -> Candidate:
        """What was looked at."""
        return self.look.candidate

    @property
    def score(self) -> float:
        """Gain beyond what chance gives."""
        return self.gain - self.expected


@dataclass(frozen=True, eq=False)
class Named:
    """An effect that was added, with everything that a verdict says of it."""

    name: str
    kind: Kind
    parameters: dict[str, float]
    indistinguishable: tuple[str, ...]
    advice: tuple[str, ...]
    p_value: float
    heldout: Gain
    before: Errors
    after: Errors
    fit: Fit


class Search:
    """A model that grows from ``base`` by what the data support.

    current, errors: the model as it stands, and its held-out errors; named: what was added. Of the first round: looked,
    best first; heldout: the candidates' held-out gains; smallest: strengths from which on they would have shown.
    """

    def __init__(
        self, data: Recorded, base: Fit, quick: bool, seed: int, work: ThreadPoolExecutor, on_progress: OnStage
    ) -> None:
        self._data, self._quick, self._seed, self._work, self._on_progress = data, quick, seed, work, on_progress
        self._possible = candidates(recording_of(data), data.drivers)
        self._seen: dict[str, tuple[Fit, Glance]] = {}
        self.effort = QUICK if quick else FULL
        self.current = base
        self.errors = errors_of(data, without_folds(data, base, work, searched=not quick), work)
        self.named: list[Named] = []
        self.looked: list[Looked] = []
        self.heldout: dict[str, Gain] = {}
        self.smallest: dict[str, float] = {}

    def add_effect(self) -> bool:
        """One round: add the candidate that is supported best, if any is.

        Of those that cannot be told apart from it, the one that predicts best what it was not fitted to; with
        ``quick``, the best supported one.
        """
        looked = self._look_at_all()
        supported = [one for one in looked if one.refined and one.p_value <= LEVEL and one.gain >= _LEAST_GAIN]
        now = self._nearly(self.current) if supported and not self._quick else self.errors
        grown: list[Named] = []
        predicted = self._gains(supported)
        for one in sorted(supported, key=lambda one: -predicted[one.candidate.name].nats):
            is_rival = not grown or (one.candidate.name in grown[0].indistinguishable and not self._quick)
            if is_rival and self._predicts_more(one, now):
                rivals = self._indistinguishable(one, looked)
                about = {one.candidate.name, *rivals}
                advice = advice_on(one.candidate.name, about)
                named = self._grow(one.candidate, one.fit, one.p_value, rivals, advice)
                grown += [named] if named is not None else []
        return self._take(max(grown, key=lambda one: one.heldout.nats, default=None))

    def add_force(self, forces: Sequence[tuple[Discovery, Glance]]) -> bool:
        """Add the first of these that holds, if any does."""
        for force, look in forces:
            one = self._grow(look.candidate, refine(self._data, look, self._work), force.p_value)
            # a curve that is flexible where there are few data may predict a step well, and go astray in a free run
            if one is not None and one.after.no_worse_than(one.before):
                return self._take(one)
        return False

    def _look_at_all(self) -> list[Looked]:
        """All candidates that are worth it, best first; those that promise most are fitted in full."""
        is_first = not self._seen
        chosen: Sequence[Candidate] = self._possible if is_first else self._worth_a_look()
        title = f"round {len(self.named) + 1}"
        looks = at_once(self._look, chosen, f"{title}: candidates", self._on_progress)
        promising = self._shortlist(looks)
        again = at_once(self._look_closer, [looks[k] for k in promising], f"{title}: looking closer", self._on_progress)
        for k, look in zip(promising, again, strict=True):
            looks[k] = look
        self._seen |= {look.candidate.name: (self.current, look) for look in looks}
        # neither what nobody would believe nor what nobody would doubt
        doubtful = [k for k in promising if self._judge(looks[k]).p_value <= LEVEL and not _obvious(looks[k])]
        if is_first and not doubtful:
            doubtful = promising[:1]
        null = self._simulate([looks[k].candidate for k in doubtful]) if doubtful else _UNKNOWN
        looked = [self._judge(look, null) for look in looks]
        best = max(looked[k].gain for k in promising)
        hopeful = [
            looked[k]
            for k in promising
            if looked[k].p_value <= LEVEL or (looked[k].p_alone <= LEVEL and looked[k].gain > _RIVAL * best)
        ]
        fitted = at_once(self._in_full, hopeful, f"{title}: fitting", self._on_progress)
        looked = sorted([*fitted, *(one for one in looked if one not in hopeful)], key=lambda one: -one.score)
        if is_first:
            self.looked, self.smallest = looked, _smallest(looks, null)
            self.heldout = self._gains(looked)
        return looked

    def _gains(self, looked: Sequence[Looked]) -> dict[str, Gain]:
        """Held-out gains of candidates over the model as it stands, without the filter."""
        now = held_out_nearly(self._data, self.current)
        return {one.candidate.name: gain(self._data, held_out_nearly(self._data, one.fit), now) for one in looked}

    def _predicts_more(self, one: Looked, now: Errors) -> bool:
        """Whether a candidate is supported held out, too; now: errors of the model as it stands."""
        predicted = self._nearly(one.fit)
        won = gain(self._data, predicted.samples, now.samples)
        return won.nats > -won.se and (one.candidate.is_noise or predicted.no_worse_than(now))

    def _indistinguishable(self, best: Looked, looked: Sequence[Looked]) -> tuple[str, ...]:
        """Candidates that do not predict clearly less than the best one, held out.

        Vuong's test of models that are not nested (Econometrica 57 (1989) 307), one-sided, paired over drivers. That
        something is missing is established then, so that a rival's own p-value needs no correction.
        """
        by_best = held_out_nearly(self._data, best.fit)
        names = []
        for one in looked:
            if one.refined and one.candidate.name != best.candidate.name:
                behind = gain(self._data, by_best, held_out_nearly(self._data, one.fit))
                if behind.nats < max(_CLEARLY * sum_error(behind.drivers), _LEAST_DIFFERENCE):
                    names.append(one.candidate.name)
        return tuple(names)

    def _nearly(self, fitted: Fit) -> Errors:
        """Held-out errors, without a search for each fold."""
        return errors_of(self._data, without_folds(self._data, fitted, self._work, searched=False), self._work)

    def _grow(
        self,
        candidate: Candidate,
        fitted: Fit,
        p_value: float,
        rivals: tuple[str, ...] = (),
        advice: tuple[str, ...] = (),
    ) -> Named | None:
        """The model with a candidate added, fitted in full, if its held-out gain is above its error over drivers."""
        data, work, before = self._data, self._work, self.errors
        model = replace(fitted.model, ahead=fitted.model.rows)
        grown = refit(data, fitted, model, work, renewals=0 if self._quick else self.effort.renewals)
        after = errors_of(data, without_folds(data, grown, work, searched=not self._quick), work)
        won = gain(data, after.samples, before.samples)
        if won.nats < sum_error(won.drivers):
            return None
        values = parameters_of(grown, candidate)
        return Named(candidate.name, candidate.kind, values, rivals, advice, p_value, won, before, after, grown)

    def _take(self, one: Named | None) -> bool:
        """Go on with a grown model."""
        if one is None:
            return False
        self.current, self.errors = one.fit, one.after
        self.named.append(one)
        self._possible = tuple(c for c in self._possible if c.name != one.name)
        return True

    def _judge(self, look: Glance, null: "_Null | None" = None) -> Looked:
        return (null or _UNKNOWN).judge(look, len(self._possible))

    def _shortlist(self, looks: Sequence[Glance]) -> list[int]:
        """Those fitted in full: the largest gains, and the noises, whose best values may lie far from a glance.

        Once something is named, those that gain most beyond what chance gives.
        """
        if self._seen:
            return sorted(range(len(looks)), key=lambda k: -self._judge(looks[k]).score)[: self.effort.later]
        order = sorted(range(len(looks)), key=lambda k: -looks[k].gain)
        best = max(looks[order[0]].gain, 1.0)
        chosen = [k for k in order[: self.effort.shortlist] if looks[k].gain > _SHARE * best or k in order[:2]]
        if best > 50.0:
            chosen += [
                k
                for k, look in enumerate(looks)
                if look.candidate.kind == "constants" and look.candidate.is_noise and k not in chosen
            ]
        return chosen

    def _worth_a_look(self) -> list[Candidate]:
        """Candidates that promise most over the current model, by what was seen of them before."""
        order = sorted(self._possible, key=lambda c: -forecast(self._data, *self._seen[c.name], self.current))
        return order[:_LATER_LOOKS]

    def _look(self, candidate: Candidate) -> Glance:
        """Look at a candidate from where an earlier look at it has ended; anew where that leads nowhere."""
        before = self._seen.get(candidate.name)
        if before and before[1].gain > 0.0:
            again = glance_again(self._data, self.current, *before, self._work, self.effort)
            if again.gain > 0.0 or again.promise < _LEAST_GAIN:
                return again
        return glance(self._data, self.current, candidate, self._work, self.effort)

    def _look_closer(self, look: Glance) -> Glance:
        return closer(self._data, look, self._work)

    def _in_full(self, one: Looked) -> Looked:
        """The same, fitted in full; what chance gives is still that of a glance."""
        refined = refine(self._data, one.look, self._work, self.effort)
        return replace(one, fit=refined, gain=max(one.gain, _rise(self.current, refined)), refined=True)

    def _simulate(self, chosen: Sequence[Candidate]) -> "_Null":
        """Gains of candidates on recordings that the current model has simulated."""
        data, current, work = self._data, self.current, self._work
        states = filtered_states(data, current.model, work)

        def one_run(rng: np.random.Generator) -> list[float]:
            simulated = resample(data, current.model, states, rng)
            start = begun(simulated, current.model, work)
            fitted = climb(simulated, start, work, iterations=_FEW_STEPS, renewals=0)
            looks = (glance(simulated, fitted, candidate, work, self.effort) for candidate in chosen)
            return [closer(simulated, look, work).gain for look in looks]

        gains = at_once(
            one_run,
            seeds(self._seed + len(self.named), self.effort.runs),
            "simulating the model without it",
            self._on_progress,
        )
        by_candidate = zip(chosen, zip(*gains, strict=True), strict=True)
        scale = {c.name: math.sqrt(0.5 * _freedom(c, data.drivers)) for c in chosen}
        return _Null({candidate.name: list(one) for candidate, one in by_candidate}, scale)


def advice_on(name: str, others: Collection[str]) -> tuple[str, ...]:
    """What to record to tell an effect from others that it cannot be told apart from."""
    found = []
    for first in EFFECTS.values():
        for second, text in first.advice.items():
            if name in (first.name, second) and {first.name, second} - {name} <= set(others):
                found.append(text)
    return tuple(found)


def parameters_of(fitted: Fit, candidate: Candidate) -> dict[str, float]:
    """Values of a candidate's parameters, the median driver's where they are individual."""
    places = sorted({*candidate.places, *candidate.starts[0]})
    rows = np.median(fitted.model.rows[:, places], axis=0)
    return {DECLARED[k].name: float(v) for k, v in zip(places, rows, strict=True)}


def at_once(
    function: Callable[[_Item], _Result], items: Sequence[_Item], what: str, on_progress: OnStage
) -> list[_Result]:
    """Results for all items; while one waits for the last of its filters, another uses the processors."""
    results = []
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        for k, result in enumerate(pool.map(function, items)):
            on_progress(what, k + 1, len(items))
            results.append(result)
    return results


def _rise(current: Fit, fitted: Fit) -> float:
    everywhere = range(FOLDS)
    return objective(fitted.slopes, fitted.model, everywhere) - objective(current.slopes, current.model, everywhere)


def _obvious(look: Glance) -> bool:
    """Whether no simulation could give as much; a parameter for each driver may gain much by chance."""
    return look.gain >= _OBVIOUS and not look.candidate.individual


@dataclass(frozen=True, eq=False)
class _Null:
    """Gains of candidates on simulated recordings in which nothing is missing.

    scale: std of half a chi-squared variable with the candidate's number of parameters.
    """

    gains: dict[str, list[float]]
    scale: dict[str, float]

    def judge(self, look: Glance, rivals: int) -> Looked:
        """p-value by Student's t over the simulated gains, whose spread is shared among candidates in part."""
        candidate = look.candidate
        gains = np.maximum(self.gains.get(candidate.name, [0.0]), 0.0)
        spreads = [
            float(np.std(np.maximum(g, 0.0), ddof=1)) / self.scale[name] for name, g in self.gains.items() if len(g) > 1
        ]
        # chi-squared variables of K parameters spread by sqrt(2 / K) of their mean, whatever the filter scales them by;
        # in 40 simulated recordings the gains of one parameter did so by no more than those of two
        freedom = _freedom(candidate, len(look.fit.model.rows))
        least = max(_LEAST_SPREAD, float(gains.mean()) * math.sqrt(2.0 / max(freedom, 2)))
        common = max(float(np.median(spreads)) * math.sqrt(0.5 * freedom) if spreads else 0.0, least)
        # a parameter gains half a nat by chance (Wilks), which a few simulations know less well if it is but one
        runs = len(gains) if candidate.name in self.gains else 0
        weight = 0 if candidate.individual and runs else _COMMON
        expected = (runs * float(gains.mean()) + weight * 0.5 * freedom) / (runs + weight)
        squares = float(np.sum(np.square(gains - gains.mean())))
        known = len(gains) - 1 + _COMMON
        spread = float(np.sqrt((squares + _COMMON * common**2) / known * (1.0 + 1.0 / len(gains))))
        p_alone = float(student.sf((look.gain - expected) / spread, known))
        return Looked(look, look.fit, look.gain, expected, spread, min(1.0, rivals * p_alone), p_alone, refined=False)

    @property
    def needed(self) -> float:
        """A gain [nats] that is usually believed."""
        highest = [
            float(np.mean(np.maximum(g, 0.0)) + 4.0 * max(float(np.std(g)), _LEAST_SPREAD)) for g in self.gains.values()
        ]
        return max(_LEAST_GAIN, float(np.median(highest)) if highest else 0.0)


_UNKNOWN = _Null({}, {})


def _freedom(candidate: Candidate, drivers: int) -> int:
    """Number of parameters that a candidate adds."""
    return len(candidate.places) * (drivers if candidate.individual else 1)


def _smallest(looks: Sequence[Glance], null: _Null) -> dict[str, float]:
    """Strength of each effect from which on these data would usually have shown it; of the first parameter."""
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
