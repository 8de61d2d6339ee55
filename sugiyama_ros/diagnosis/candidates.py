"""Candidates for what is missing from the model: freed constants, faults of the measurement, and physical effects."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sugiyama_ros.driver.parameters import index
from sugiyama_ros.effects.effect import MEASUREMENT, RecordingExtent
from sugiyama_ros.effects.registry import EFFECTS, ROW, index_of
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.population import LARGEST_STD
from sugiyama_ros.fit.recording import Recorded

Kind = Literal["effect", "measurement", "constants"]


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
    starts : tuple of dict of int to float
        Starts of the search: values by place.
    individual : bool
        Whether every driver has individual values.
    summary : str
        Explanation in one line.
    strengths : tuple of int
        Places of parameters to which the change of the samples is proportional, to first order.
    is_noise : bool
        Whether the candidate changes only noises.
    drivers : tuple of int
        Columns of the drivers who have it; empty for all.
    """

    name: str
    kind: Kind
    places: tuple[int, ...]
    starts: tuple[dict[int, float], ...]
    individual: bool = False
    summary: str = ""
    strengths: tuple[int, ...] = ()
    is_noise: bool = False
    drivers: tuple[int, ...] = ()

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
    individual : bool
        Whether every driver has individual values.
    is_noise : bool
        Whether the constants change only noises and not the mean motion.
    """

    name: str
    parameters: tuple[str, ...]
    individual: bool = False
    is_noise: bool = False


# Constants that the paper fixes, in groups that act together.
_CONSTANTS = (
    Constants("response_constants", ("kappa_c", "kappa_d", "kappa_1")),
    Constants("noise_constants", ("rho", "sigma_x", "sigma_v"), is_noise=True),
    Constants("rationality", ("rationality",), individual=True),
    Constants("risk_constants", ("kappa_c", "kappa_d"), individual=True),
)


def candidates(recording: RecordingExtent, drivers: int) -> tuple[Candidate, ...]:
    """Return all candidates that make sense for a recording.

    Parameters
    ----------
    recording : RecordingExtent
        What the search may know about the recording.
    drivers : int
        Number of drivers.

    Returns
    -------
    tuple of Candidate
        The constants first, then the effects.
    """
    found = [
        Candidate(
            name=c.name,
            kind="constants",
            places=tuple(index(p) for p in c.parameters),
            starts=({},),
            individual=c.individual,
            summary="a constant of the paper",
            is_noise=c.is_noise,
        )
        for c in _CONSTANTS
    ]
    for e in EFFECTS.values():
        starts = e.starts(recording)
        if not starts or drivers <= e.reach:
            continue
        strengths = tuple(index_of(e.name, name) for name in e.switches)
        has_signs = not e.individual and all(ROW.declared[k].lower < 0.0 for k in strengths)
        found.append(
            Candidate(
                name=e.name,
                kind="measurement" if e.stage == MEASUREMENT else "effect",
                places=tuple(range(ROW.places[e.name].start, ROW.places[e.name].stop)),
                starts=tuple({index_of(e.name, p): v for p, v in values.items()} for values in starts),
                individual=e.individual,
                summary=e.summary,
                strengths=strengths if has_signs else (),
                is_noise=e.is_noise,
            )
        )
    return tuple(found)


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
    possible = {c.name: c for c in candidates(recording_of(data), data.drivers)}
    for name in names:
        if name not in possible:
            raise InputError(f"effect {name!r}: cannot be added here; choose among {', '.join(possible)}")
    return [possible[name] for name in names]


def recording_of(data: Recorded) -> RecordingExtent:
    """Return what a search may know about a recording."""
    t = data.trajectories
    first, last = float(np.nanmin(t.position_m)), float(np.nanmax(t.position_m))
    return RecordingExtent(t.start_s, t.start_s + t.duration_s, t.road.circumference_m, first, last)


def added(model: Model, candidate: Candidate, start: dict[int, float]) -> Model:
    """Return the model with the entries of a candidate freed.

    Parameters
    ----------
    model : Model
        The model.
    candidate : Candidate
        What becomes free.
    start : dict of int to float
        Start of the search: values by place.

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
