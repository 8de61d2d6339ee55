"""All effects there are, ours and those that users add, and where their parameters stand in a driver's row.

A user's effect is an ``Effect`` behind an entry point of the group ``sugiyama_ros.effects`` in any installed package.
"""

from collections.abc import Mapping
from importlib.metadata import entry_points

import numpy as np

from sugiyama_ros.compiled_cache import USERS
from sugiyama_ros.driver.parameters import COUNT, PARAMETERS, Parameter
from sugiyama_ros.effects import (
    actuation_lag,
    comfort_limits,
    discovered_force,
    drag,
    external_push,
    gap_offset,
    limited_braking,
    limited_power,
    outlier_noise,
    perception_threshold,
    preference_drift,
    preference_switch,
    reaction_delay,
    rear_pressure,
    road_grade,
    second_leader,
    sensor_eccentricity,
    slow_patch,
    speed_dependent_noise,
    uneven_noise,
)
from sugiyama_ros.effects.effect import STAGES, Effect, Values
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.registry import LAWS
from sugiyama_ros.road import Array

#: Ours; within a stage they act in this order.
BUILT_IN: tuple[Effect, ...] = tuple(
    module.EFFECT
    for module in (
        reaction_delay,
        second_leader,
        gap_offset,
        perception_threshold,
        slow_patch,
        preference_switch,
        preference_drift,
        rear_pressure,
        comfort_limits,
        limited_power,
        limited_braking,
        actuation_lag,
        speed_dependent_noise,
        drag,
        road_grade,
        external_push,
        discovered_force,
        outlier_noise,
        sensor_eccentricity,
        uneven_noise,
    )
)


def _users() -> tuple[Effect, ...]:
    """Effects of other packages. Raises InputError for one that cannot be loaded or is none."""
    found = []
    for point in sorted(entry_points(group=USERS), key=lambda point: point.name):
        try:
            effect = point.load()
        except Exception as error:
            raise InputError(
                f"effect {point.name} ({point.value}): cannot be loaded: {error!r}; mend it or uninstall it"
            ) from None
        if not isinstance(effect, Effect) or effect.stage not in STAGES or effect.function is None:
            raise InputError(
                f"effect {point.name} ({point.value}): is not an Effect with a function and a stage among"
                f" {', '.join(STAGES)}"
            )
        found.append(effect)
    return tuple(found)


EFFECTS: tuple[Effect, ...] = BUILT_IN + _users()

#: The law by which a driver chooses his acceleration: 0 is adaptiveSeek, k the k-th of ``rivals.LAWS``.
LAW = COUNT
_law_places: dict[str, slice] = {}
_at = LAW + 1
for _law in LAWS:
    _law_places[_law.name] = slice(_at, _at + len(_law.parameters))
    _at += len(_law.parameters)
_places: dict[str, slice] = {}
for _effect in EFFECTS:
    if _effect.name in _places:
        raise InputError(f"effect {_effect.name}: there are two of that name; rename or uninstall one")
    _places[_effect.name] = slice(_at, _at + len(_effect.parameters))
    _at += len(_effect.parameters)
#: Where the parameters of a rival law or of an effect stand in a row.
LAW_PLACES: Mapping[str, slice] = _law_places
PLACES: Mapping[str, slice] = _places
#: Length of a row: the driver's parameters, the law and its parameters, those of all effects.
WIDTH = _at

#: Name of every entry of a row; those of effects as in ``reaction_delay.delay``.
ENTRIES: tuple[str, ...] = (
    *(p.name for p in PARAMETERS),
    "law",
    *(f"{law.name}.{p.name}" for law in LAWS for p in law.parameters),
    *(f"{effect.name}.{p.name}" for effect in EFFECTS for p in effect.parameters),
)
#: Declaration of every entry of a row.
DECLARED: tuple[Parameter, ...] = (
    *PARAMETERS,
    Parameter("law", "", "1", 0.0, 0.0, float(len(LAWS)), "0: adaptiveSeek; else a rival's number"),
    *(p for law in LAWS for p in law.parameters),
    *(p for effect in EFFECTS for p in effect.parameters),
)


def effect(name: str) -> Effect:
    """The effect of that name. Raises InputError, which lists the names, for an unknown one."""
    for candidate in EFFECTS:
        if candidate.name == name:
            return candidate
    raise InputError(f"effect {name!r}: not known; the effects are {', '.join(e.name for e in EFFECTS)}")


def place(effect_name: str, parameter: str) -> int:
    """Place in a row of an effect's parameter. Raises InputError for an unknown one."""
    names = [p.name for p in effect(effect_name).parameters]
    if parameter not in names:
        raise InputError(f"effect {effect_name}: has no parameter {parameter!r}; it has {', '.join(names)}")
    return int(PLACES[effect_name].start) + names.index(parameter)


def whole(parameters: Array) -> Array:
    """Rows (..., WIDTH) from rows (..., P) of drivers without effects; a copy."""
    row = np.zeros((*parameters.shape[:-1], WIDTH))
    row[..., : parameters.shape[-1]] = parameters
    return row


def active(rows: Array) -> tuple[str, ...]:
    """Names of the effects that act on any of the drivers in ``rows`` (..., WIDTH)."""
    if rows.shape[-1] < WIDTH:
        return ()
    return tuple(e.name for e in EFFECTS if np.any(rows[..., [place(e.name, s) for s in e.switches]]))


def switch_on(rows: Array, name: str, values: Values) -> Array:
    """A copy of ``rows`` (..., WIDTH) in which the effect has these values.

    Raises InputError for an unknown name or a value out of the declared bounds.
    """
    changed = rows.copy()
    for parameter, value in values.items():
        k = place(name, parameter)
        declared = DECLARED[k]
        # 0 is always allowed: the effect is not there
        if value != 0.0 and not declared.lower <= value <= declared.upper:
            raise InputError(
                f"effect {name}: {parameter} = {value:g} {declared.unit} is out of bounds; give {declared.lower:g} to"
                f" {declared.upper:g}"
            )
        changed[..., k] = value
    return changed
