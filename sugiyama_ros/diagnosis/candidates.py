"""Candidates for what is missing from the model: freed constants, faults of the measurement, and physical effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.effects.effect import MEASUREMENT, UTILITY, Effect, RecordingExtent
from sugiyama_ros.effects.registry import EFFECTS, MECHANISM, ROW, index_of
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.population import LARGEST_STD
from sugiyama_ros.fit.recording import Recorded

Kind = Literal["effect", "measurement", "constants"]
# A recording on which every effect that is searched for at all has a start.
_A_RING = RecordingExtent(0.0, 100.0, 100.0, 0.0, 100.0)


@dataclass(frozen=True)
class Candidate:
    """Something that the search can add to a model.

    Parameters
    ----------
    name : str
        Name of the effect or of the group of constants.
    kind : {"effect", "measurement", "constants"}
        What the candidate changes.
    places : tuple of int
        Entries of the rows that become free.
    starts : tuple of dict of int to float or ndarray
        Starts of the search: values by place, of all drivers or of each, (N,).
    individual : bool
        Whether every driver has individual values.
    summary : str
        Explanation in one line.
    strengths : tuple of int
        Places of parameters to which the change of the samples is proportional, to first order.
    is_noise : bool
        Whether the candidate changes only noises.
    mechanism : str
        Name of the mechanism, of which the candidate may be one form among others; ``name`` if left out.
    is_variant : bool
        Whether no smallest strength is told of it: another form of a mechanism, a part of the utility, a push.
    elsewhere : float
        Gain [nats] that the choice of a place or of a car brings by chance (look-elsewhere effect).
    drivers : tuple of int
        Columns of the drivers who have it; empty for all.
    """

    name: str
    kind: Kind
    places: tuple[int, ...]
    starts: tuple[dict[int, float | Array], ...]
    individual: bool = False
    summary: str = ""
    strengths: tuple[int, ...] = ()
    is_noise: bool = False
    mechanism: str = ""
    is_variant: bool = False
    elsewhere: float = 0.0
    drivers: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "mechanism", self.mechanism or self.name)

    @property
    def happens_once(self) -> bool:
        """Whether the candidate acts in one place of the data only, which cannot be held out."""
        return self.elsewhere > 0.0

    @property
    def entries(self) -> list[int]:
        """Entries of the rows that the candidate sets: those that become free, and those that stay at their start."""
        return sorted({*self.places, *self.starts[0]})

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(ROW.declared[k].name for k in self.places)


@dataclass(frozen=True)
class Constants:
    """Constants that become free together.

    Parameters
    ----------
    name : str
        Name of the group.
    parameters : tuple of str
        Names of the constants.
    title : str
        Name for people.
    summary : str
        Explanation in one line.
    individual : bool
        Whether every driver has individual values.
    is_noise : bool
        Whether the constants change only noises and not the mean motion.
    """

    name: str
    parameters: tuple[str, ...]
    title: str
    summary: str
    individual: bool = False
    is_noise: bool = False


#: Constants that the paper fixes, in groups that act together.
CONSTANTS = (
    Constants(
        "response_constants",
        ("kappa_c", "kappa_d", "kappa_1"),
        "softer or harder response",
        "gap scales and the width of the desired-speed reward are fitted instead of the paper's constants",
    ),
    Constants(
        "noise_constants",
        ("rho", "sigma_x", "sigma_v"),
        "other noise of the motion",
        "noises of position, speed and acceleration are fitted instead of the paper's constants",
        is_noise=True,
    ),
    Constants(
        "rationality",
        ("rationality",),
        "sharper or looser choices",
        "how sharply a driver prefers the best action is fitted for each driver",
        individual=True,
    ),
    Constants(
        "risk_constants",
        ("kappa_c", "kappa_d"),
        "own gap scales of each driver",
        "gap scales at standstill and per closing speed are fitted for each driver",
        individual=True,
    ),
)


def candidates(data: Recorded) -> tuple[Candidate, ...]:
    """Return all candidates that make sense for a recording.

    Parameters
    ----------
    data : Recorded
        The recording.

    Returns
    -------
    tuple of Candidate
        The constants first, then the effects.
    """
    extent = recording_of(data)
    found = [
        Candidate(
            name=c.name,
            kind="constants",
            places=tuple(index(p) for p in c.parameters),
            starts=({},),
            individual=c.individual,
            summary=c.summary,
            is_noise=c.is_noise,
        )
        for c in CONSTANTS
    ]
    for e in EFFECTS.values():
        starts = e.starts(extent)
        if not starts or why_not(e, data):
            continue
        strengths = tuple(index_of(e.name, name) for name in e.switches)
        has_signs = not e.individual and all(ROW.declared[k].lower < 0.0 for k in strengths)
        found.append(
            Candidate(
                name=e.name,
                kind="measurement" if e.stage == MEASUREMENT else "effect",
                places=tuple(index_of(e.name, p.name) for p in e.parameters if p.name not in e.fixed),
                starts=tuple({index_of(e.name, p): v for p, v in values.items()} for values in starts),
                individual=e.individual,
                summary=e.summary,
                strengths=strengths if has_signs else (),
                is_noise=e.is_noise,
                mechanism=MECHANISM[e.name],
                is_variant=e.stage == UTILITY or MECHANISM[e.name] != e.name,
            )
        )
    return tuple(found)


def not_searched(data: Recorded) -> dict[str, str]:
    """Return the effects that this recording cannot show, with the reason, by name."""
    return {name: why for name, e in EFFECTS.items() if e.starts(_A_RING) and (why := why_not(e, data))}


def why_not(e: Effect, data: Recorded) -> str:
    """Return why a search for an effect makes no sense for a recording; empty if it does."""
    around, axes = data.vicinity, {p.axis for p in e.parameters}
    if not e.starts(recording_of(data)):
        return "the road is no ring"
    if around.is_whole_road:
        return "too few vehicles" if data.drivers <= e.reach else ""
    ahead = np.median([chain.position_m.shape[1] - 1 for chain in data.chains])
    reasons = {
        "stretches of different drivers have no time in common": "time" in axes,
        "recordings have no places in common": "place" in axes and not around.has_places,
        "nothing is assumed of the vehicle behind": e.sees_rear,
        "the leader's leader is not known": e.reach > ahead,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def only_those(data: Recorded, possible: Sequence[Candidate], names: Sequence[str]) -> tuple[Candidate, ...]:
    """Return the candidates with these names, or of these mechanisms; all of them if there are no names.

    Raises
    ------
    InputError
        For a name that no candidate has; the message says why where an effect of that name cannot be added.
    """
    for name in names:
        if not any(name in (c.name, c.mechanism) for c in possible):
            raise _cannot_be_added(data, possible, name)
    return tuple(c for c in possible if not names or c.name in names or c.mechanism in names)


def _cannot_be_added(data: Recorded, possible: Sequence[Candidate], name: str) -> InputError:
    """The error for a name that no candidate has."""
    known = sorted({name for c in possible for name in (c.name, c.mechanism)})
    reason = not_searched(data).get(name, "")
    why = f": {reason}" if reason else ""
    return InputError(f"effect {name!r}: cannot be added here{why}; choose among {', '.join(known)}")


def named(data: Recorded, names: Sequence[str]) -> list[Candidate]:
    """Return the candidates with these names.

    Parameters
    ----------
    data : Recorded
        The recording.
    names : sequence of str
        Names of effects or groups of constants.

    Returns
    -------
    list of Candidate
        In the order of the names.

    Raises
    ------
    InputError
        For an unknown name.
    """
    possible = {c.name: c for c in candidates(data)}
    for name in names:
        if name not in possible:
            raise _cannot_be_added(data, tuple(possible.values()), name)
    return [possible[name] for name in names]


def recording_of(data: Recorded) -> RecordingExtent:
    """Return what a search may know about a recording."""
    around = data.vicinity
    first, last = float(np.nanmin(around.position_m)), float(np.nanmax(around.position_m))
    return RecordingExtent(*around.first_last_s, around.road.circumference_m, first, last)


def added(model: Model, candidate: Candidate, start: Mapping[int, float | Array]) -> Model:
    """Return the model with the entries of a candidate freed.

    Parameters
    ----------
    model : Model
        The model.
    candidate : Candidate
        What becomes free.
    start : mapping of int to float or ndarray, shape (N,)
        Start of the search: values by place, of all drivers or of each.

    Returns
    -------
    Model
        The model at the start, with the candidate among its parameters.
    """
    rows = model.rows.copy()
    for k, v in start.items():
        rows[:, k] = v
    if candidate.individual:
        new = tuple(k for k in candidate.places if k not in model.individual)
        std = model.prior_std + (LARGEST_STD,) * len(new)
        shared = tuple(k for k in model.shared if k not in new)
        return replace(model, rows=rows, individual=model.individual + new, shared=shared, prior_std=std)
    new = tuple(k for k in candidate.places if k not in model.shared and k not in model.individual)
    return replace(model, rows=rows, shared=model.shared + new)
