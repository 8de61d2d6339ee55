"""Name what is missing from the model, add it, and look again, until nothing more is supported.

Every candidate is looked at in the same way on the data and on data simulated from the model as it stands
(``bootstrap``), so that a p-value says how often chance, refitting and the filter's approximations give as much.
"""

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.stats import t as student

from sugiyama_ros.criticism.bootstrap import resample, seeds
from sugiyama_ros.criticism.candidates import Candidate, Kind, candidates, recording_of
from sugiyama_ros.criticism.discover import Discovery, discover
from sugiyama_ros.criticism.errors import TOLERANCE, Errors, errors_of
from sugiyama_ros.criticism.fitting import (
    FOLDS,
    Fit,
    Gain,
    Recorded,
    fit,
    fit_base,
    gain,
    held_out_nearly,
    objective,
    prepare,
    without_folds,
)
from sugiyama_ros.criticism.free_run import filtered_states
from sugiyama_ros.criticism.locate import Located, locate
from sugiyama_ros.criticism.rivals import by_gaps, has_parameters, in_filter, laws
from sugiyama_ros.criticism.screening import Glance, carried_over, forecast, glance, refine
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR
from sugiyama_ros.effects.catalogue import DECLARED
from sugiyama_ros.trajectories import Trajectories

#: Each driver's own parameters.
INDIVIDUAL = (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V)
#: Simulated recordings for the p-values, also with ``quick``; level of significance, after Bonferroni's correction.
BOOTSTRAP_RUNS, QUICK_RUNS, LEVEL = 6, 2, 0.05
# Candidates that are fitted in full in each round, and the share of the best gain above which one is.
_SHORTLIST, _SHARE = 4, 0.15
# Candidates that are looked at again after the first round.
_LATER_LOOKS = 8
# A gain is not believed below this [nats], whatever the p-value; and simulated gains spread by at least this.
_LEAST_GAIN, _LEAST_SPREAD = 5.0, 1.5
# Prior weight of the common spread in that of one candidate, as a number of simulated recordings.
_COMMON = 4
# A gain this many times what is needed to be believed is not checked against new simulations.
_CLEAR = 4.0
# What changes no mean motion: a free run, which has no noise, cannot speak against it.
_OF_NOISE = ("noise_constants", "outlier_noise", "speed_dependent_noise")
# Fits that are under way at the same time, all on the same workers.
_AT_ONCE = 3
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
#: Called with what is being done, and the steps done and to do.
OnProgress = Callable[[str, int, int], None]

#: What to record to tell two effects apart.
ADVICE: dict[frozenset[str], str] = {
    frozenset({"actuation_lag", "reaction_delay"}): "record accelerations, or positions at 10 Hz and more",
    frozenset({"rear_pressure", "reaction_delay"}): "record cars without a follower too",
    frozenset({"road_grade", "slow_patch"}): "survey the road, or record standing starts on all of it",
    frozenset({"comfort_limits", "limited_braking"}): "record hard accelerations, as from traffic lights",
    frozenset({"comfort_limits", "limited_power"}): "record hard braking",
    frozenset({"drag", "limited_power"}): "record coasting, or accelerations at several speeds",
    frozenset({"preference_drift", "preference_switch"}): "record for longer",
}


@dataclass(frozen=True, eq=False)
class Looked:
    """What was found about one candidate in one round; gains in nats."""

    look: Glance
    fit: Fit
    gain: float
    expected: float
    spread: float
    p_value: float
    refined: bool

    @property
    def candidate(self) -> Candidate:
        """What was looked at."""
        return self.look.candidate

    @property
    def score(self) -> float:
        """Gain beyond what chance gives."""
        return self.gain - self.expected

    @property
    def predictive(self) -> float:
        """Gain that new data may be expected to show: what chance gives in sample is missing there (after Akaike)."""
        return self.gain - 2.0 * self.expected


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


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Verdict on a recording; fits: the base model's and the last one's; looked: first round, best first."""

    data: Recorded
    base: Fit
    final: Fit
    named: tuple[Named, ...]
    looked: tuple[Looked, ...]
    heldout: dict[str, Gain]
    discovered: tuple[Discovery, ...]
    before: Errors
    after: Errors
    where_before: Located
    where_after: Located
    smallest: dict[str, float]
    rivals: dict[str, dict[str, float]]
    bootstrap_runs: int
    quick: bool
    seed: int
    wall_s: float


def diagnose(
    trajectories: Trajectories,
    *,
    seed: int = 0,
    quick: bool = False,
    most: int = 3,
    verdict_only: bool = False,
    add_forces: bool = False,
    workers: int = 4,
    on_progress: OnProgress = lambda what, done, total: None,
) -> Diagnosis:
    """Find what is missing: at most ``most`` effects, one after the other.

    verdict_only: leave out the rivals and the forces without a name; add_forces: add the best of these at the end.

    Raises InputError for a recording that is too short.
    """
    began = time.monotonic()
    with ThreadPoolExecutor(workers) as work:
        on_progress("fitting the base model", 0, 1)
        data = prepare(trajectories)
        base = fit_base(data, INDIVIDUAL, work)
        possible = candidates(recording_of(data), data.drivers)
        runs = QUICK_RUNS if quick else BOOTSTRAP_RUNS
        current, named, first, null = base, [], [], _Null({}, {})
        before = errors = errors_of(data, without_folds(data, base, work, refit=not quick), work)
        heldout: dict[str, Gain] = {}
        smallest: dict[str, float] = {}
        seen: dict[str, tuple[Fit, Glance]] = {}
        for number in range(most):
            chosen = _worth_a_look(data, possible, seen, current) if seen else possible
            look_at = partial(_look, data, current, seen, work)
            looks = _at_once(look_at, chosen, f"round {number + 1}: candidates", on_progress)
            seen |= {look.candidate.name: (current, look) for look in looks}
            shortlist = _shortlist(looks)
            if number == 0:
                # what nobody would believe need not be disproved
                doubtful = [k for k in shortlist if null.judge(looks[k], len(possible)).p_value <= LEVEL]
                chosen = [looks[k].candidate for k in doubtful or shortlist[:1]]
                null = _simulate(data, current, chosen, runs, seed, work, on_progress)
            looked = [null.judge(look, len(possible)) for look in looks]
            hopeful = [looked[k] for k in shortlist if looked[k].p_value <= LEVEL]
            in_full = partial(_in_full, data, current, work)
            fitted = _at_once(in_full, hopeful, f"round {number + 1}: fitting", on_progress)
            looked = sorted([*fitted, *(one for one in looked if one not in hopeful)], key=lambda one: -one.score)
            if number == 0:
                first = looked
                smallest = _smallest(looks, null)
                nearly = held_out_nearly(data, base)
                for one in looked:
                    heldout[one.candidate.name] = gain(data, held_out_nearly(data, one.fit), nearly)
            supported = [one for one in looked if one.refined and one.p_value <= LEVEL and one.gain >= _LEAST_GAIN]
            best = None
            now = errors
            if supported and not quick:
                now = errors_of(data, without_folds(data, current, work, refit=False), work)
            for one in sorted(supported, key=lambda one: -one.predictive):
                predicted = errors_of(data, without_folds(data, one.fit, work, refit=False), work)
                won = gain(data, predicted.samples, now.samples)
                holds = one.candidate.name in _OF_NOISE or predicted.no_worse_than(now)
                if won.nats > -won.se and holds:
                    best = one
                    break
            if best is None:
                break
            if number and not quick and best.score < _CLEAR * max(_LEAST_GAIN, 3.0 * best.spread):
                again = _simulate(data, current, [best.candidate], runs, seed + number, work, on_progress)
                best = replace(best, p_value=again.judge(best.look, len(possible)).p_value)
                if best.p_value > LEVEL:
                    break
            step = _grow(data, best.fit, errors, work, quick)
            if step is None:
                break
            current, after, won = step
            rivals = _indistinguishable(best, looked)
            advice = tuple(text for pair, text in ADVICE.items() if best.candidate.name in pair and pair & set(rivals))
            named.append(_named(best.candidate, rivals, advice, best.p_value, won, errors, after, current))
            errors = after
            possible = tuple(c for c in possible if c.name != best.candidate.name)
        on_progress("forces without a name", 0, 1)
        forces = [] if quick or verdict_only else discover(data, current, work)
        forces = [(force, look) for force, look in forces if force.p_value < LEVEL]
        for force, look in forces if add_forces else []:
            step = _grow(data, refine(data, look, work), errors, work, quick)
            # a curve that is flexible where there are few data may predict a step well, and go astray in a free run
            if step is not None and step[2].nats > step[2].se and step[1].no_worse_than(errors):
                current, after, won = step
                named.append(_named(look.candidate, (), (), force.p_value, won, errors, after, current))
                errors = after
                break
        others: dict[str, dict[str, float]] = {}
        rival = partial(_rival, data, work, quick)
        for found in _at_once(rival, [] if verdict_only else laws(), "rival models", on_progress):
            others |= found
        on_progress("where it fails", 0, 1)
        where = [locate(data, one.model, e.samples, work) for one, e in ((base, before), (current, errors))]
    return Diagnosis(
        data,
        base,
        current,
        tuple(named),
        tuple(first),
        heldout,
        tuple(force for force, _ in forces),
        before,
        errors,
        where[0],
        where[1],
        smallest,
        others,
        runs,
        quick,
        seed,
        time.monotonic() - began,
    )


def _grow(
    data: Recorded, fitted: Fit, errors: Errors, work: ThreadPoolExecutor, quick: bool
) -> tuple[Fit, Errors, Gain] | None:
    """A model with something added, its errors and its gain over the one with ``errors``; None if it does not hold."""
    grown = fit(data, replace(fitted.model, ahead=fitted.model.rows), work)
    after = errors_of(data, without_folds(data, grown, work, refit=not quick), work)
    won = gain(data, after.samples, errors.samples)
    if won.nats <= 0.0 or (won.nats < won.se and after.worst_change(errors) > TOLERANCE):
        return None
    return grown, after, won


def _named(
    candidate: Candidate,
    rivals: tuple[str, ...],
    advice: tuple[str, ...],
    p_value: float,
    won: Gain,
    before: Errors,
    after: Errors,
    grown: Fit,
) -> Named:
    values = parameters_of(grown, candidate)
    return Named(candidate.name, candidate.kind, values, rivals, advice, p_value, won, before, after, grown)


def _rival(data: Recorded, work: ThreadPoolExecutor, quick: bool, law: str) -> dict[str, dict[str, float]]:
    """Errors of a rival calibrated in the filter, and, but for ``quick``, of the same by least squares on gaps."""
    fitted = in_filter(data, law, work)
    found = {law: errors_of(data, without_folds(data, fitted, work, refit=not quick), work).summary()}
    if not quick and has_parameters(law):
        found[f"{law}_least_squares"] = errors_of(data, by_gaps(data, law, fitted, work), work).summary()
    return found


def parameters_of(fitted: Fit, candidate: Candidate) -> dict[str, float]:
    """Values of a candidate's parameters, the median driver's where they are individual."""
    places = sorted({*candidate.places, *candidate.starts[0]})
    rows = np.median(fitted.model.rows[:, places], axis=0)
    return {DECLARED[k].name: float(v) for k, v in zip(places, rows, strict=True)}


def _in_full(data: Recorded, current: Fit, work: ThreadPoolExecutor, one: Looked) -> Looked:
    """The same, fitted in full; what chance gives is still that of a glance."""
    refined = refine(data, one.look, work)
    return replace(one, fit=refined, gain=max(one.gain, _rise(current, refined)), refined=True)


def _at_once(
    function: Callable[[_Item], _Result], items: Sequence[_Item], what: str, on_progress: OnProgress
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


def _worth_a_look(
    data: Recorded, possible: Sequence[Candidate], seen: dict[str, tuple[Fit, Glance]], current: Fit
) -> list[Candidate]:
    """Candidates that promise most over the current model, by what was seen of them before."""
    order = sorted(possible, key=lambda c: -forecast(data, *seen[c.name], current))
    return order[:_LATER_LOOKS]


def _look(
    data: Recorded,
    current: Fit,
    seen: dict[str, tuple[Fit, Glance]],
    work: ThreadPoolExecutor,
    candidate: Candidate,
) -> Glance:
    """Look at a candidate, also from where an earlier look at it has ended."""
    before = seen.get(candidate.name)
    also = carried_over(*before, current) if before and before[1].gain > 0.0 else None
    return glance(data, current, candidate, work, also)


def _shortlist(looks: Sequence[Glance]) -> list[int]:
    """Those fitted in full: the largest gains, and the noises, whose best values may lie far from a glance."""
    order = sorted(range(len(looks)), key=lambda k: -looks[k].gain)
    best = max(looks[order[0]].gain, 1.0)
    chosen = [k for k in order[:_SHORTLIST] if looks[k].gain > _SHARE * best or k in order[:2]]
    if best > 50.0:
        chosen += [k for k, look in enumerate(looks) if look.candidate.name == "noise_constants" and k not in chosen]
    return chosen


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
        # chi-squared variables of K parameters spread by sqrt(2 / K) of their mean, whatever the filter scales them by
        freedom = _freedom(candidate, len(look.fit.model.rows))
        least = max(_LEAST_SPREAD, float(gains.mean()) * math.sqrt(2.0 / freedom))
        common = max(float(np.median(spreads)) * math.sqrt(0.5 * freedom) if spreads else 0.0, least)
        # a parameter gains half a nat by chance (Wilks), which a few simulations know less well if it is but one
        runs = len(gains) if candidate.name in self.gains else 0
        weight = 0 if candidate.individual and runs else _COMMON
        expected = (runs * float(gains.mean()) + weight * 0.5 * freedom) / (runs + weight)
        squares = float(np.sum(np.square(gains - gains.mean())))
        known = len(gains) - 1 + _COMMON
        spread = float(np.sqrt((squares + _COMMON * common**2) / known * (1.0 + 1.0 / len(gains))))
        p_value = min(1.0, rivals * float(student.sf((look.gain - expected) / spread, known)))
        return Looked(look, look.fit, look.gain, expected, spread, p_value, refined=False)

    @property
    def needed(self) -> float:
        """A gain [nats] that is usually believed."""
        highest = [
            float(np.mean(np.maximum(g, 0.0)) + 4.0 * max(float(np.std(g)), _LEAST_SPREAD)) for g in self.gains.values()
        ]
        return max(_LEAST_GAIN, float(np.median(highest)) if highest else 0.0)


def _freedom(candidate: Candidate, drivers: int) -> int:
    """Number of parameters that a candidate adds."""
    return len(candidate.places) * (drivers if candidate.individual else 1)


def _simulate(
    data: Recorded,
    current: Fit,
    chosen: Sequence[Candidate],
    runs: int,
    seed: int,
    work: ThreadPoolExecutor,
    on_progress: OnProgress,
) -> _Null:
    states = filtered_states(data, current.model, work)

    def one_run(rng: np.random.Generator) -> list[float]:
        simulated = resample(data, current.model, states, rng)
        fitted = fit(simulated, current.model, work)
        return [glance(simulated, fitted, candidate, work).gain for candidate in chosen]

    gains = _at_once(one_run, seeds(seed, runs), "simulating the model without it", on_progress)
    by_candidate = zip(chosen, zip(*gains, strict=True), strict=True)
    scale = {c.name: math.sqrt(0.5 * _freedom(c, data.drivers)) for c in chosen}
    return _Null({candidate.name: list(one) for candidate, one in by_candidate}, scale)


def _indistinguishable(best: Looked, looked: Sequence[Looked]) -> tuple[str, ...]:
    """Candidates whose gain differs from the best one's by less than two paired standard errors over drivers."""
    names = []
    for one in looked:
        if one is best or one.p_value > LEVEL or one.candidate.name == best.candidate.name:
            continue
        difference = np.nansum(best.fit.samples.log_likelihood - one.fit.samples.log_likelihood, axis=1)
        se = float(np.sqrt(len(difference) * np.var(difference, ddof=1))) if len(difference) > 1 else 0.0
        if best.score - one.score < max(2.0 * se, 3.0) and one.refined:
            names.append(one.candidate.name)
    return tuple(names)


def _smallest(looks: Sequence[Glance], null: _Null) -> dict[str, float]:
    """Strength of each effect from which on these data would usually have shown it; of the first parameter."""
    found = {}
    for look in looks:
        if look.candidate.kind == "constants" or look.loss <= 0.0 or not look.candidate.starts[0]:
            continue
        start = look.loss_at[look.candidate.places[0]]
        scaled = start * float(np.sqrt(null.needed / look.loss))
        # a limit is the stronger the smaller it is
        if DECLARED[look.candidate.places[0]].name in ("limit", "power"):
            scaled = start * start / scaled
        found[look.candidate.name] = scaled
    return found
