"""What the user says about a file that the file does not say itself."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import number, read_yaml
from sugiyama_ros.road import Road
from sugiyama_ros.roads.network import Network
from sugiyama_ros.trajectories.about import Reference, View
from sugiyama_ros.trajectories.selection import EVERYTHING, Selection
from sugiyama_ros.trajectories.tracks import FLAGS, NUMBERS, TEXTS, Tracks

#: Columns of a table of tracks.
COLUMNS = (*TEXTS, *NUMBERS, "leader", *FLAGS)
#: Columns of the leader, in a table whose rows have a follower and the leader; and their gap.
PAIRED = ("leader_vehicle", "leader_s_m", "leader_length_m", "leader_speed", "gap_m")
# Columns that a map may name.
_MAPPED = (*COLUMNS, "position_m", "speed", *PAIRED)
# Factors to metres or seconds, without their signs: from picoseconds to the largest units.
_FACTORS = 1e-12, 1e12
_REFERENCES: tuple[Reference, ...] = ("centre", "front", "rear")
_VIEWS: tuple[View, ...] = ("end", "whole")


@dataclass(frozen=True)
class Choices:
    """What the user says about a file.

    Parameters
    ----------
    columns : mapping of str to (str, float)
        Column of the file, and factor to metres or seconds, for columns of tracks.
    reference : {"centre", "front", "rear"}, optional
        Which point of a vehicle the positions are of; by default as the format says.
    ring_m : float, optional
        Circumference [m] of the ring.
    view : {"end", "whole"}, optional
        Whether vehicles may be ahead of the first one.
    network : Network, optional
        The road, for files of vehicles in the plane.
    selection : Selection
        Which rows to keep; everything by default.

    Raises
    ------
    InputError
        If the circumference is negative or not finite, or stands beside a road that says itself what it is.
    """

    columns: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    reference: Reference | None = None
    ring_m: float | None = None
    view: View | None = None
    network: Network | None = None
    selection: Selection = EVERYTHING

    def __post_init__(self) -> None:
        Road(self.ring_m or 0.0)
        if self.ring_m is not None and self.network is not None:
            raise InputError(f"ring: {self.ring_m:g} m is given beside a road; leave out the ring, or the road file")

    def check_ring(self, tracks: Tracks) -> None:
        """Raise InputError for a ring that changes nothing: who leads stands in the file, and nobody passes its seam.

        tracks: as they were read, on the ring.
        """
        if not self.ring_m:
            return
        same = np.diff(tracks.run) == 0
        steps_m, led = np.diff(tracks.s_m)[same], tracks.leader_row >= 0
        ways_m = tracks.s_m[tracks.leader_row[led]] - tracks.s_m[led]
        if np.all(np.abs(steps_m) <= 0.5 * self.ring_m) and np.all(ways_m >= 0.0):
            raise InputError(
                f"{tracks.about.source or 'tracks'}: nobody drives once around a ring of {self.ring_m:g} m, or follows"
                " somebody around it; leave out --ring"
            )


def agreed_ring(path: Path, said_m: float | None, choices: Choices) -> float:
    """Circumference [m] of the ring, from the file or from the user. Raises InputError if the two differ."""
    ring_m = choices.ring_m
    if said_m is not None and ring_m is not None and not math.isclose(said_m, ring_m, rel_tol=1e-9):
        raise InputError(f"{path}: says a ring of {said_m:g} m, but {ring_m:g} m was given; leave out --ring")
    return Road(said_m if said_m is not None else ring_m or 0.0).circumference_m


def read_choices(path: Path) -> Choices:
    """Read a map of columns: YAML such as ``s_m: {column: Local_Y, factor: 0.3048}`` or ``lane: Lane_ID``.

    Beside columns it may hold ``reference``, ``ring_m`` and ``view``. Raises InputError.
    """
    return choices_of(read_yaml(path), path)


def choices_of(said: Any, path: object) -> Choices:
    """What the content of a map says; ``path`` is its name in a message. Raises InputError."""
    if not isinstance(said, Mapping):
        raise InputError(f"{path}: not a map of columns; give lines like 'lane: Lane_ID'")
    known = (*_MAPPED, "reference", "ring_m", "view")
    unknown = [name for name in said if name not in known]
    if unknown:
        raise InputError(f"{path}: {str(unknown[0])[:40]!r} is no column of tracks; choose among {', '.join(known)}")
    if {"s_m", "position_m"} <= set(said):
        raise InputError(f"{path}: s_m and position_m are both the position; give one of them")
    choices = Choices(
        columns={name: _column(path, name, said[name]) for name in _MAPPED if name in said},
        reference=_one_of(path, "reference", said.get("reference"), _REFERENCES),
        view=_one_of(path, "view", said.get("view"), _VIEWS),
    )
    if "ring_m" not in said:
        return choices
    ring_m = number(said["ring_m"], f"{path}: ring_m")
    try:
        return replace(choices, ring_m=ring_m)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def reference_of(text: str | None, option: str = "--reference") -> Reference | None:
    """The reference that an option names. Raises InputError."""
    found: Reference | None = _one_of(option, "reference", text, _REFERENCES)
    return found


def _one_of(where: object, name: str, value: Any, known: tuple[Any, ...]) -> Any:
    if value is not None and value not in known:
        raise InputError(f"{where}: {name} {str(value)[:40]!r} is not known; choose among {', '.join(known)}")
    return value


def _column(path: object, name: str, said: Any) -> tuple[str, float]:
    if isinstance(said, Mapping) and set(said) <= {"column", "factor"} and "column" in said:
        factor = number(said.get("factor", 1.0), f"{path}: factor of {name}")
        if not _FACTORS[0] <= abs(factor) <= _FACTORS[1]:
            raise InputError(f"{path}: factor of {name}: {factor:g} is no unit's factor; 0.3048 makes metres of feet")
        return str(said["column"]), factor
    if isinstance(said, dict | list):
        raise InputError(f"{path}: {name}: give the name of a column, or {{column: NAME, factor: NUMBER}}")
    return str(said), 1.0
