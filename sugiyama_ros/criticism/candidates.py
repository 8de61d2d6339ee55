"""What may be missing from a model: freed constants, noises, faults of the measurement, physical effects, forces.

Every candidate declares starts: values of its parameters at which it is scored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import recording_of, why_not
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.effects.discovered_force import COVARIATES, KNOTS
from sugiyama_ros.effects.effect import MEASUREMENT, Effect
from sugiyama_ros.effects.registry import EFFECTS, MECHANISM, ROW, index_of
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.population import LARGEST_STD
from sugiyama_ros.fit.recording import Recorded

#: What a candidate changes. Constants and noises never explain anything.
Kind = Literal["effect", "measurement", "force", "constants", "noise"]
#: Values by place in the rows: of all drivers, or of each driver, (N,).
Start: TypeAlias = Mapping[int, float | Array]
#: Effect that stands for a force along a covariate, and the prefix of such a candidate's name.
FORCE, FORCE_ALONG = "discovered_force", "force_along_"
#: What is added to the name of a candidate that only some drivers have.
OF_SOME = "_of_some"
# Constants that the paper fixes, in groups that act together: names, kind, whether each driver has individual values.
_CONSTANTS: tuple[tuple[str, tuple[str, ...], Kind, bool], ...] = (
    ("response_constants", ("kappa_c", "kappa_d", "kappa_1"), "constants", False),
    ("noise_constants", ("rho", "sigma_x", "sigma_v"), "noise", False),
    ("rationality", ("rationality",), "constants", True),
    ("risk_constants", ("kappa_c", "kappa_d"), "constants", True),
)


@dataclass(frozen=True, eq=False)
class Candidate:
    """Something that can be added to a model.

    Parameters
    ----------
    name : str
        Name of the effect in one of its forms, of the group of constants, or of the force.
    mechanism : str
        Name of the mechanism, of which the candidate may be one form among others.
    kind : {"effect", "measurement", "force", "constants", "noise"}
        What the candidate changes.
    places : tuple of int
        Entries of the rows that become free.
    starts : tuple of Start
        Where the candidate is scored. A start without values is the model itself, with the entries free.
    individual : bool
        Whether every driver has individual values.
    switches : tuple of int
        Places of the strengths of an effect: where all of them are 0, the effect does nothing.
    has_sign : bool
        Whether only positive strengths make sense.
    drivers : tuple of int
        Numbers of the drivers who have it; empty for all.
    is_random : bool
        Whether the candidate changes how uncertain a forecast is, and not its mean: noises, and what wanders.
    """

    name: str
    mechanism: str
    kind: Kind
    places: tuple[int, ...]
    starts: tuple[Start, ...]
    individual: bool = False
    switches: tuple[int, ...] = ()
    has_sign: bool = False
    drivers: tuple[int, ...] = ()
    is_random: bool = False

    @property
    def explains(self) -> bool:
        """Whether the candidate can explain what was missing: it has a physical name."""
        return self.kind in ("effect", "measurement")

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
    """Return all candidates that make sense for a recording, without forces.

    Parameters
    ----------
    data : Recorded
        The recording.

    Returns
    -------
    tuple of Candidate
        Constants first, then effects.
    """
    constants = [
        Candidate(name, name, kind, tuple(map(index, parameters)), ({},), individual)
        for name, parameters, kind, individual in _CONSTANTS
    ]
    return (
        *constants,
        *(_of_effect(e, data) for e in EFFECTS.values() if e.starts(recording_of(data)) and not why_not(e, data)),
    )


def _of_effect(e: Effect, data: Recorded) -> Candidate:
    kind: Kind = "measurement" if e.stage == MEASUREMENT else "effect"
    switches = tuple(index_of(e.name, name) for name in e.switches)
    return Candidate(
        name=e.name,
        mechanism=MECHANISM[e.name],
        kind="noise" if e.is_noise and kind == "effect" else kind,
        places=tuple(index_of(e.name, p.name) for p in e.parameters if p.name not in e.fixed),
        starts=tuple({index_of(e.name, p): v for p, v in values.items()} for values in e.starts(recording_of(data))),
        individual=e.individual,
        switches=switches,
        has_sign=any(ROW.declared[k].lower >= 0.0 for k in switches),
        is_random=e.is_noise or bool(e.wanders),
    )


def force_along(covariate: str, first: float, last: float) -> Candidate:
    """Return a force along a covariate, as a curve between knots from ``first`` to ``last``."""
    places = [index_of(FORCE, name) for name in ("covariate", "first", "last")]
    values = (COVARIATES.index(covariate) + 1.0, first, last)
    knots = tuple(range(places[-1] + 1, places[-1] + 1 + KNOTS))
    return Candidate(FORCE_ALONG + covariate, FORCE, "force", knots, (dict(zip(places, values, strict=True)),))


def chosen(possible: Sequence[Candidate], names: Sequence[str]) -> list[Candidate]:
    """Return the candidates with these names, or of these mechanisms, in the order of the names.

    Raises
    ------
    InputError
        For a name that no candidate has.
    """
    found: list[Candidate] = []
    for name in names:
        mine = [c for c in possible if c.name == name] or [c for c in possible if c.mechanism == name]
        if not mine:
            known = ", ".join(dict.fromkeys(c.name for c in possible))
            raise InputError(f"effect {name!r}: cannot be added here; choose among {known}")
        found += mine[:1]
    return found


def with_candidate(model: Model, candidate: Candidate, start: Start) -> Model:
    """Return a model at a start of a candidate, with the entries of the candidate free."""
    rows, ahead = model.rows.copy(), model.ahead.copy()
    for k, v in start.items():
        rows[:, k] = ahead[:, k] = v
    if candidate.drivers:
        others = np.ix_(np.setdiff1d(np.arange(len(rows)), candidate.drivers), np.array(candidate.switches))
        rows[others] = ahead[others] = 0.0
    model = replace(model, rows=rows, ahead=ahead)
    new = tuple(k for k in candidate.places if k not in (*model.individual, *model.shared))
    if not candidate.individual:
        few = tuple((k, candidate.drivers) for k in candidate.switches) if candidate.drivers else ()
        return replace(model, shared=model.shared + new, few=model.few + few)
    new = tuple(k for k in candidate.places if k not in model.individual)
    shared = tuple(k for k in model.shared if k not in new)
    std = model.prior_std + (LARGEST_STD,) * len(new)
    return replace(model, individual=model.individual + new, shared=shared, prior_std=std)
