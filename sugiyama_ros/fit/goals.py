"""What drivers may intend: to drive through, or to slow down for an exit or the end of a lane that lies ahead.

A goal that is not reached cannot be seen. So a goal is another driver: the same parameters, with the effect
``goal_ahead`` at known values.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import read_numbers, read_pairs
from sugiyama_ros.effects.registry import ROW, effect, switch_on
from sugiyama_ros.errors import InputError

#: The goal of everybody who slows down for nothing.
THROUGH = "through"
_EFFECT = "goal_ahead"
# Comfortable deceleration [m/s^2] of the intelligent driver model, Treiber and Kesting, Traffic Flow Dynamics (2013).
_COMFORTABLE = 1.5
# Parameters of a goal. Who brakes less than this [m/s^2] brakes for nothing.
_PARAMETERS = tuple(replace(p, lower=0.01) if p.name == "deceleration" else p for p in effect(_EFFECT).parameters)


@dataclass(frozen=True)
class Goal:
    """A place ahead for which some drivers slow down.

    Parameters
    ----------
    name : str
        Name, such as "exit".
    place : float
        Position [m] along the road.
    speed : float
        Speed [m/s] that the driver wants at the place; 0 where the lane ends.
    deceleration : float
        Comfortable deceleration [m/s^2] before the place.
    lane : str
        Lane on which drivers come in who may have the goal; empty for all lanes.
    """

    name: str
    place: float
    speed: float = 0.0
    deceleration: float = _COMFORTABLE
    lane: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier() or self.name == THROUGH:
            raise InputError(f"goal {self.name!r}: is no name; use letters, digits and underscores, not {THROUGH}")
        for p in _PARAMETERS:
            if not p.lower <= (value := getattr(self, p.name)) <= p.upper:
                raise InputError(f"goal {self.name}: {p.name} {value:g} is not possible; give {p.bounds}")

    def check_within(self, first_m: float, last_m: float, speed: float) -> None:
        """Raise InputError if nobody who is seen between two positions [m] slows down for it from a speed [m/s]."""
        brakes_m = max(speed**2 - self.speed**2, 0.0) / (2.0 * self.deceleration)
        if not first_m < self.place < last_m + brakes_m:
            raise InputError(
                f"goal {self.name}: place {self.place:g} m is out of reach: vehicles are seen from {first_m:.0f} to"
                f" {last_m:.0f} m; give a place from {first_m + 0.1:.1f} to {last_m + brakes_m - 0.1:.1f} m"
            )

    @property
    def row(self) -> Array:
        """Entries of a driver's row that the goal sets, shape (width,); 0 for all others."""
        return np.asarray(switch_on(np.zeros((1, ROW.width)), _EFFECT, self.values)[0])

    @property
    def values(self) -> dict[str, float]:
        """Parameters of the effect, by name."""
        return {"deceleration": self.deceleration, "place": self.place, "speed": self.speed}


def read_goal(text: str, where: str) -> Goal:
    """Read a goal from ``NAME:place=PLACE[,speed=SPEED][,deceleration=B][,lane=LANE]``. Raises InputError."""
    name, _, pairs = text.partition(":")
    texts, where = read_pairs(pairs, f"{where} {text}"), f"{where} {text}"
    lane = texts.pop("lane", "")
    return goal_from(name, {**read_numbers(texts, _PARAMETERS, where), "lane": lane})


def goals_from(given: Any) -> tuple[Goal, ...]:
    """Make goals of their values by name. Raises InputError."""
    if not isinstance(given, Mapping):
        raise InputError('goals: give values by name, such as {"exit": {"place": 500.0, "speed": 8.0}}')
    return tuple(goal_from(name, values) for name, values in given.items())


def goal_from(name: str, values: Mapping[str, Any]) -> Goal:
    """Make a goal of its values by name. Raises InputError."""
    try:
        given: dict[str, Any] = {key: str(one) if key == "lane" else float(one) for key, one in values.items()}
        return Goal(name, **given)
    except (TypeError, ValueError, AttributeError):
        known = ", ".join(p.name for p in effect(_EFFECT).parameters)
        raise InputError(f"goal {name}: give numbers for place, and no others than {known} and lane") from None


class Goals(NamedTuple):
    """What N drivers may intend, the first of G goals with no effect.

    names: of the goals; row: (G, width), entries of a row that a goal sets, 0 for the others; entry: (N,), number of
    the lane on which each driver comes in; entries: names of these lanes; may: (N, G), whether a driver may have a
    goal.
    """

    names: tuple[str, ...]
    row: Array
    entry: Ints
    entries: tuple[str, ...]
    may: Mask


def goals_of(goals: Sequence[Goal], lane: Sequence[str]) -> Goals:
    """Return what drivers may intend who come in on the lanes ``lane`` (N,). Raises InputError for another lane."""
    entries, entry = np.unique(np.array(lane, dtype=str), return_inverse=True)
    for one in goals:
        if one.lane and one.lane not in entries:
            known = f"the lanes are {', '.join(entries)}" if any(entries) else "the tracks name no lanes"
            raise InputError(f"goal {one.name}: nobody comes in on lane {one.lane}; {known}; give one, or leave it out")
    if len({one.name for one in goals}) < len(goals):
        raise InputError("goals: give each goal a name of its own")
    may = np.array([[True, *(one.lane in ("", here) for one in goals)] for here in lane])
    return Goals(_names(goals), _rows(goals), entry, tuple(entries.tolist()), may)


def _names(goals: Sequence[Goal]) -> tuple[str, ...]:
    """Names (G,) of all goals, driving through first."""
    return (THROUGH, *(one.name for one in goals))


def _rows(goals: Sequence[Goal]) -> Array:
    """Entries (G, width) of a driver's row that each goal sets; none of the first one, driving through."""
    return np.array([np.zeros(ROW.width), *(one.row for one in goals)])


@dataclass(frozen=True)
class KnownGoals:
    """Goals with the share of the drivers who have each, by name; the others drive through."""

    goals: tuple[Goal, ...]
    share: Mapping[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all goals, driving through first."""
        return _names(self.goals)

    @property
    def rows(self) -> Array:
        """Entries of a driver's row that each goal sets, shape (G, width); 0 for all others."""
        return _rows(self.goals)

    @property
    def prior(self) -> Array:
        """Share of the drivers who have each goal, shape (G,)."""
        shares = [self.share[one.name] for one in self.goals]
        return np.array([1.0 - sum(shares), *shares])
