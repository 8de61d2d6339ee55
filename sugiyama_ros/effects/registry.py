"""All physical effects, built-in or from other packages, and where their parameters stand in a driver's row.

A row is all that the compiled code may need for one driver, in one float64 vector. It begins with the parameters of
``driver.parameters``. The number of the law follows, by which the driver chooses their acceleration. Then come the
parameters of every law and the parameters of every effect. An effect whose strengths are 0 does nothing.

Another package adds an effect with an entry point of the group ``sugiyama_ros.effects`` that points to an ``Effect``.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sugiyama_ros import plugins
from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import COUNT, PARAMETERS, Parameter, read_numbers, read_pairs
from sugiyama_ros.effects.effect import STAGES, Effect, Values
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.registry import LAWS, PAPERS


@dataclass(frozen=True, eq=False)
class _RowLayout:
    """Where each parameter of laws and effects stands in a driver's row.

    law: index of the entry that holds the number of the law; law_places: entries of each law's parameters, by the name
    of the law; places: entries of each effect's parameters, by the name of the effect; entries: name of every entry;
    the parameters of laws and effects have names like ``drag.c0``; declared: declaration of every entry.
    """

    law: int
    law_places: Mapping[str, slice]
    places: Mapping[str, slice]
    entries: tuple[str, ...]
    declared: tuple[Parameter, ...]

    @classmethod
    def of(cls, laws: Mapping[str, Sequence[Parameter]], effects: Mapping[str, Sequence[Parameter]]) -> "_RowLayout":
        """Lay out a row for laws and effects."""
        declared = [*PARAMETERS, Parameter("law", "", "1", 0.0, 0.0, float(len(laws)), "number of the law")]
        entries = [p.name for p in declared]

        def lay_out(blocks: Mapping[str, Sequence[Parameter]]) -> dict[str, slice]:
            places = {}
            for name, parameters in blocks.items():
                places[name] = slice(len(declared), len(declared) + len(parameters))
                declared.extend(parameters)
                entries.extend(f"{name}.{p.name}" for p in parameters)
            return places

        law_places, places = lay_out(laws), lay_out(effects)
        return cls(COUNT, law_places, places, tuple(entries), tuple(declared))

    @property
    def width(self) -> int:
        """Number of entries in a row."""
        return len(self.entries)

    def index_of(self, effect: str, parameter: str) -> int:
        """Return the index of an effect's parameter in a row. Raises InputError."""
        places = self.places[effect]
        names = [p.name for p in self.declared[places]]
        if parameter not in names:
            raise InputError(f"effect {effect}: has no parameter {parameter!r}; it has {', '.join(names)}")
        return int(places.start) + names.index(parameter)

    def heading(self, name: str) -> str:
        """Return the heading of an entry's column in a table: its name with its unit."""
        unit = self.declared[self.entries.index(name)].unit
        shown = "v*" if name == "v_star" else name
        return shown if unit == "1" else f"{shown} [{unit}]"

    def with_effects(self, parameters: Array) -> Array:
        """Make rows from parameters, with every effect switched off.

        parameters: (..., P) or (..., width), parameters of drivers, or rows, which keep their effects. Returns (...,
        width), rows; a copy.
        """
        row = np.zeros((*parameters.shape[:-1], self.width))
        row[..., : parameters.shape[-1]] = parameters
        return row


#: Group of the entry points by which other packages add effects.
GROUP = "sugiyama_ros.effects"
#: Effects by name, each followed by its further forms. Effects of one stage act in this order.
EFFECTS: Mapping[str, Effect] = {
    form.name: form
    for effect in plugins.registered(
        GROUP,
        Effect,
        (
            "reaction_delay",
            "second_leader",
            "gap_offset",
            "perception_threshold",
            "accepted_gap",
            "ignored_yield",
            "blind_sector",
            "late_start",
            "slow_patch",
            "curve_speed",
            "goal_ahead",
            "preference_switch",
            "preference_drift",
            "harshness",
            "roughness",
            "averaged_reward",
            "look_ahead",
            "keeping_up",
            "anticipated_leader",
            "rear_pressure",
            "comfort_limits",
            "limited_power",
            "limited_braking",
            "actuation_lag",
            "speed_dependent_noise",
            "drag",
            "road_grade",
            "external_push",
            "discovered_force",
            "outlier_noise",
            "sensor_eccentricity",
            "uneven_noise",
        ),
        "EFFECT",
    ).values()
    for form in (effect, *effect.forms)
    if form.stage in STAGES
}
#: The mechanism of each effect, by the name of the effect: an effect with further forms gives its name to all of them.
MECHANISM: Mapping[str, str] = {name: name for name in EFFECTS} | {
    form.name: effect.name for effect in EFFECTS.values() for form in effect.forms
}
#: Where every parameter stands in a driver's row.
ROW = _RowLayout.of(
    {name: law.parameters for name, law in LAWS.items() if name != PAPERS},
    {name: effect.parameters for name, effect in EFFECTS.items()},
)


def effect(name: str) -> Effect:
    """Look up an effect. Raises InputError."""
    return plugins.find(EFFECTS, GROUP, name, "effect")


def index_of(effect_name: str, parameter: str) -> int:
    """Return the index of an effect's parameter in a driver's row. Raises InputError."""
    return ROW.index_of(effect(effect_name).name, parameter)


def strengths(effect_name: str) -> list[int]:
    """Return the indices of an effect's strengths in a driver's row; the effect acts if one is not 0."""
    return [ROW.index_of(effect_name, name) for name in EFFECTS[effect_name].switches]


def active(rows: Array) -> tuple[str, ...]:
    """Find the effects that act on at least one driver.

    rows: (..., width) or (..., P), rows of drivers, or parameters without effects.
    """
    if rows.shape[-1] < ROW.width:
        return ()
    return tuple(name for name in EFFECTS if np.any(rows[..., strengths(name)]))


def switch_on(rows: Array, name: str, values: Values) -> Array:
    """Switch an effect on for all drivers.

    rows: (..., width), rows of the drivers; they stay as they are. Returns (..., width), rows with the effect. Raises
    InputError.
    """
    changed = rows.copy()
    for parameter, value in values.items():
        k = index_of(name, parameter)
        declared = ROW.declared[k]
        # 0 is always allowed, because it switches the effect off
        if value != 0.0 and not declared.lower <= value <= declared.upper:
            raise InputError(
                f"effect {name}: {parameter} = {value:g}{declared.of_unit} is out of bounds; give"
                f" {declared.bounds_of_effect}"
            )
        if declared.is_whole and value != round(value):
            raise InputError(f"effect {name}: {parameter} = {value:g} is no whole number; give {round(value)}")
        changed[..., k] = value
    _check_companions(changed, name)
    return changed


def switched_on(rows: Array, name: str, values: Values) -> Array:
    """Switch an effect on, as ``switch_on``, and check that it acts then. Raises InputError."""
    changed, switches = switch_on(rows, name, values), effect(name).switches
    if not any(values.get(switch) for switch in switches):
        raise InputError(f"effect {name}: give {' or '.join(switches)}")
    return changed


def _check_companions(rows: Array, name: str) -> None:
    """Check that an effect that acts has the parameters by which it divides, such as the distance of a force."""
    one = effect(name)
    acting = rows[np.any(rows[..., [ROW.index_of(name, switch) for switch in one.switches]], axis=-1)]
    for p in one.parameters:
        if p.lower > 0.0 and not acting[..., ROW.index_of(name, p.name)].all():
            raise InputError(f"effect {name}: {p.name} is missing; give {p.bounds}")
    for smaller, larger in one.ascending:
        if not (acting[..., ROW.index_of(name, smaller)] < acting[..., ROW.index_of(name, larger)]).all():
            raise InputError(f"effect {name}: {larger} must be larger than {smaller}")


def read_effects(texts: Iterable[str], where: str) -> dict[str, dict[str, float]]:
    """Values of effects by name, from texts ``NAME:PARAMETER=VALUE[,PARAMETER=VALUE]``. Raises InputError."""
    found: dict[str, dict[str, float]] = {}
    for text in texts:
        name, _, pairs = text.partition(":")
        if name in found:
            raise InputError(
                f"{where} {text}: {name} is given twice; give all its values together, with commas between"
            )
        declared = effect(name).parameters
        found[name] = read_numbers(read_pairs(pairs, f"{where} {text}"), declared, f"{where} {text}", may_be_zero=True)
        if not found[name]:
            raise InputError(f"{where} {text}: is not NAME:PARAMETER=VALUE[,PARAMETER=VALUE]{_parameters(name)}")
    return found


def _parameters(name: str) -> str:
    """The parameters that an effect has, for the error of one without values."""
    if name not in EFFECTS:
        return ""
    known = (f"{p.name} ({p.bounds})" for p in EFFECTS[name].parameters)
    return f"; {name} has {', '.join(known)}"
