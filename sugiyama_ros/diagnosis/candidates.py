"""What may be missing from a model: freed constants, noises, faults of the measurement, physical effects, forces.

Every candidate declares starts: values of its parameters at which it is scored.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import CONSTANTS, index
from sugiyama_ros.effects.discovered_force import COVARIATES, KNOTS
from sugiyama_ros.effects.effect import ATTENTION, MEASUREMENT, Effect
from sugiyama_ros.effects.needs import check_law
from sugiyama_ros.effects.registry import EFFECTS, MECHANISM, ROW, index_of
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.first_look import SIGMAS
from sugiyama_ros.fit.extent import recording_of, why_not
from sugiyama_ros.fit.joint import LARGEST_STD
from sugiyama_ros.fit.model import Model, PointwiseDensity
from sugiyama_ros.fit.model_file import drivers_of
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.statistics import Tail

#: What a candidate changes. Constants and noises never explain anything.
Kind = Literal["effect", "measurement", "force", "constants", "noise"]
#: Values by place in the rows: of all drivers, or of each driver, (N,).
Start: TypeAlias = Mapping[int, float | Array]
#: Effect that stands for a force along a covariate, and the prefix of such a candidate's name.
FORCE, FORCE_ALONG = "discovered_force", "force_along_"
#: Effect that pushes one car at one moment.
PUSH = "external_push"
# Lengths of a run of innovations [s] that are tried for a push; acceleration [m/s^2] at which its search begins.
_RUNS_S, _PUSH = (1.0, 2.0, 4.0), 0.5
# How long before a run the push has its middle, over the length of the run.
_BEFORE = (0.0, 0.5, 1.0)
# Sizes at which an effect is scored whose only start has one strength, over this strength.
_SIZES = (1.0, 0.25, 4.0)
#: What is added to the name of a candidate that only some drivers have.
OF_SOME = "_of_some"


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something that can be added to a model.

    name: Name of the effect in one of its forms, of the group of constants, or of the force; mechanism: Name of the
    mechanism, of which the candidate may be one form among others; kind: What the candidate changes; places:
    Entries of the rows that become free; starts: Where the candidate is scored. A start without values is the model
    itself, with the entries free; individual: Whether every driver has individual values; switches: Places of the
    strengths of an effect: where all of them are 0, the effect does nothing; drivers: Numbers of the drivers who have
    it; empty for all; is_random: Whether the candidate changes how uncertain a forecast is, and not its mean: noises,
    and what wanders; is_decision: Whether it changes what drivers decide to do, go or wait, whose consequences are
    large however small the change; look_elsewhere_nats: Gain that the best of all places, times and cars has by chance,
    among which the start was chosen (look-elsewhere effect); 0 for what was not chosen so.
    """

    name: str
    mechanism: str
    kind: Kind
    places: tuple[int, ...]
    starts: tuple[Start, ...]
    individual: bool = False
    switches: tuple[int, ...] = ()
    drivers: tuple[int, ...] = ()
    is_random: bool = False
    is_decision: bool = False
    look_elsewhere_nats: float = 0.0

    @property
    def explains(self) -> bool:
        """Whether the candidate can explain what was missing: it has a physical name."""
        return self.kind in ("effect", "measurement")

    @property
    def is_judged_at_starts(self) -> bool:
        """Whether its gain at the starts counts: how the likelihood changes near the model says nothing of it."""
        return self.is_random or self.is_decision

    @property
    def is_somewhere(self) -> bool:
        """Whether it acts at some place or moment on the road, which a search must find."""
        of = EFFECTS[self.effect] if self.effect in EFFECTS and self.kind == "effect" else None
        is_event = self.is_judged_at_starts or self.is_single_event
        return of is not None and not is_event and any(p.axis for p in of.parameters)

    @property
    def is_single_event(self) -> bool:
        """Whether it happens once, to one car: no other block of time shows it."""
        return self.look_elsewhere_nats > 0.0

    @property
    def has_sign(self) -> bool:
        """Whether only positive strengths make sense."""
        return any(ROW.declared[k].lower >= 0.0 for k in self.switches)

    @property
    def judged_by(self) -> str:
        """The column that its gain is read from: one step ahead of what is rare, which few forecasts over seconds show;
        else all horizons together.
        """
        return "one_step" if self.is_decision or self.is_single_event else "all"

    @property
    def rank(self) -> int:
        """What is added first: 0 for what changes how drivers act or what is measured, 1 for forces, freed constants
        and moods, 2 for noises.
        """
        if self.kind == "noise":
            return 2
        return 0 if self.kind == "measurement" or (self.kind == "effect" and not self.is_random) else 1

    @property
    def order(self) -> tuple[int, bool, bool]:
        """What is added first of what cannot be told apart: by rank, then what all drivers share."""
        return self.rank, self.individual, bool(self.drivers)

    @property
    def effect(self) -> str:
        """Name of the effect, whoever has it."""
        return self.name.removesuffix(OF_SOME)

    @property
    def strengths(self) -> tuple[int, ...]:
        """Places of several strengths, which are scored one at a time and fitted together."""
        return self.switches if len(self.switches) > 1 and not self.individual else ()

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(ROW.declared[k].name for k in self.places)


def candidates(data: Recorded) -> tuple[Candidate, ...]:
    """Return all candidates that make sense for a recording, without forces."""
    constants = [
        Candidate(
            c.name, c.name, "noise" if c.is_noise else "constants", tuple(map(index, c.parameters)), ({},), c.individual
        )
        for c in CONSTANTS
    ]
    return (
        *constants,
        *(_of_effect(e, data) for e in EFFECTS.values() if e.starts(recording_of(data)) and not why_not(e, data)),
    )


def _of_effect(e: Effect, data: Recorded) -> Candidate:
    kind: Kind = "measurement" if e.stage == MEASUREMENT else "constants" if e.is_constant else "effect"
    switches = tuple(index_of(e.name, name) for name in e.switches)
    starts = tuple({index_of(e.name, p): v for p, v in values.items()} for values in e.starts(recording_of(data)))
    if len(starts) == len(switches) == 1 and switches[0] in starts[0]:
        # one size says nothing of another one where an effect is no straight line: a threshold, a limit
        (start,), (strength,) = starts, switches
        sizes = [(strength, times * start[strength]) for times in _SIZES]
        starts = tuple({**start, k: v} for k, v in sizes if ROW.declared[k].lower <= v <= ROW.declared[k].upper)
    return Candidate(
        name=e.name,
        mechanism=MECHANISM[e.name],
        kind="noise" if e.is_noise and kind == "effect" else kind,
        places=tuple(index_of(e.name, p.name) for p in e.parameters if p.name not in e.fixed),
        starts=starts,
        individual=e.individual,
        switches=switches,
        is_random=e.is_noise or bool(e.wanders),
        is_decision=e.stage == ATTENTION,
    )


def force_along(covariate: str, first: float, last: float) -> Candidate:
    """Return a force along a covariate, as a curve between knots from ``first`` to ``last``."""
    places = [index_of(FORCE, name) for name in ("covariate", "first", "last")]
    values = (COVARIATES.index(covariate) + 1.0, first, last)
    knots = tuple(range(places[-1] + 1, places[-1] + 1 + KNOTS))
    return Candidate(FORCE_ALONG + covariate, FORCE, "force", knots, (dict(zip(places, values, strict=True)),))


def check_names(names: Sequence[str], law: str) -> None:
    """Check that names are those of effects, of their forms, of groups of constants, or of forces without a name.

    law: name of the law by which the drivers drive. Raises InputError, also for what acts on nothing of this law.
    """
    constants, rows = [one.name for one in CONSTANTS], drivers_of(None, law).rows
    for name in names:
        effect, _, covariate = name.partition(":")
        if effect == FORCE:
            if covariate and covariate not in COVARIATES:
                known = ", ".join(COVARIATES)
                raise InputError(f"{name}: nobody measures {covariate!r}; give {FORCE}: and one of {known}")
        elif name not in (*EFFECTS, *MECHANISM.values(), *constants):
            raise InputError(
                f"effect {name!r}: is not known; give names that `sugiyama effects` lists, {', '.join(constants)}, or"
                f" {FORCE}:COVARIATE"
            )
        elif name in EFFECTS:
            check_law(EFFECTS[name], rows)


def chosen(data: Recorded, possible: Sequence[Candidate], name: str) -> Candidate:
    """Return the candidate with a name, or the first one of a mechanism with this name."""
    wanted = FORCE_ALONG + name.partition(":")[2] if name.startswith(f"{FORCE}:") else name
    mine = [c for c in possible if c.name == wanted] or [c for c in possible if c.mechanism == wanted]
    if mine:
        return mine[0]
    known = sorted({one.replace(FORCE_ALONG, f"{FORCE}:") for c in possible for one in (c.name, c.mechanism)})
    why = "too few samples know it, or have it in common" * (wanted != name)
    why = why_not(EFFECTS[name], data) if name in EFFECTS and EFFECTS[name].is_searched else why
    raise InputError(
        f"effect {name!r}: cannot be added here{f': {why}' if why else ''}; choose among {', '.join(known)}"
    )


def with_candidate(model: Model, candidate: Candidate, start: Start) -> Model:
    """Return a model at a start of a candidate, with the entries of the candidate free.

    Noises are fitted to what the mean action leaves, which keeps its parameters: noise with a long memory would
    otherwise take over what drivers do.
    """
    rows, ahead = model.rows.copy(), model.ahead.copy()
    for k, v in start.items():
        rows[:, k] = ahead[:, k] = v
    if candidate.drivers:
        others = np.ix_(np.setdiff1d(np.arange(len(rows)), candidate.drivers), np.array(candidate.switches))
        rows[others] = ahead[others] = 0.0
    fitted = (*model.individual, *model.shared) if candidate.kind == "noise" else ()
    held = tuple(k for k in fitted if k not in (*SIGMAS, *candidate.places))
    model = replace(model, rows=rows, ahead=ahead, held=held)
    new = tuple(k for k in candidate.places if k not in (*model.individual, *model.shared))
    if not candidate.individual:
        few = tuple((k, candidate.drivers) for k in candidate.switches) if candidate.drivers else ()
        return replace(model, shared=model.shared + new, few=model.few + few)
    new = tuple(k for k in candidate.places if k not in model.individual)
    shared = tuple(k for k in model.shared if k not in new)
    std = model.prior_std + (LARGEST_STD,) * len(new)
    return replace(model, individual=model.individual + new, shared=shared, prior_std=std)


def push_of_one(data: Recorded, samples: PointwiseDensity) -> Candidate | None:
    """Return a push of the car and at the moment with the largest run of standardised innovations.

    None where nothing is predicted, and on tracks, where a push would need a time that all stretches share.
    """
    around = data.vicinity
    if not around.is_whole_road:
        return None
    scored = np.isfinite(samples.log_likelihood)
    z = np.where(scored, samples.innovation_m / np.sqrt(samples.innovation_var), 0.0)
    places, best, there = 1.0, (0.0, 0, 0, 0.0), list[Array]()
    for run_s in _RUNS_S:
        length = max(1, round(run_s / around.period_s))
        if length >= z.shape[1]:
            continue
        total = np.cumsum(np.pad(z, ((0, 0), (1, 0))), axis=1)
        sums = (total[:, length:] - total[:, :-length]) / math.sqrt(length)
        car, at = divmod(int(np.argmax(np.abs(sums))), sums.shape[1])
        # runs that overlap by half count as one place, and each is tried with several starts
        places += 2.0 * len(_BEFORE) * scored.sum() / length
        there.append(0.5 * np.square(sums).ravel())
        if abs(sums[car, at]) > abs(best[0]):
            best = (float(sums[car, at]), car, at, run_s)
    value, car, at, run_s = best
    if not run_s:
        return None
    own = tuple(index_of(PUSH, name) for name in ("strength", "time", "duration"))
    # the innovations of a pushed car are of one sign from the push on, until the filter has understood
    strength, at_s = math.copysign(_PUSH, value), float(around.time_s[at, car])
    starts = tuple(dict(zip(own, (strength, at_s - b * run_s, 0.5 * run_s), strict=True)) for b in _BEFORE)
    by_chance = Tail.of(np.concatenate(there)).gain_at(math.log(places))
    return Candidate(PUSH, PUSH, "effect", own, starts, switches=own[:1], drivers=(car,), look_elsewhere_nats=by_chance)
