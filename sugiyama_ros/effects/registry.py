"""All physical effects, built-in or from other packages, and where their parameters stand in a driver's row.

Another package adds an effect with an entry point of the group ``sugiyama_ros.effects`` that points to an ``Effect``.
"""

from collections.abc import Mapping

import numpy as np

from sugiyama_ros import plugins
from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.row import RowLayout
from sugiyama_ros.effects.effect import STAGES, Effect, Values
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.registry import LAWS, PAPERS

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
            "slow_patch",
            "preference_switch",
            "preference_drift",
            "harshness",
            "roughness",
            "averaged_reward",
            "look_ahead",
            "keeping_up",
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
ROW = RowLayout.of(
    {name: law.parameters for name, law in LAWS.items() if name != PAPERS},
    {name: effect.parameters for name, effect in EFFECTS.items()},
)


def effect(name: str) -> Effect:
    """Look up an effect. Raises InputError."""
    return plugins.find(EFFECTS, GROUP, name, "effect")


def index_of(effect_name: str, parameter: str) -> int:
    """Return the index of an effect's parameter in a driver's row. Raises InputError."""
    return ROW.index_of(effect(effect_name).name, parameter)


def active(rows: Array) -> tuple[str, ...]:
    """Find the effects that act on at least one driver.

    rows: (..., width) or (..., P), rows of drivers, or parameters without effects.
    """
    if rows.shape[-1] < ROW.width:
        return ()
    return tuple(
        name for name, e in EFFECTS.items() if np.any(rows[..., [ROW.index_of(name, switch) for switch in e.switches]])
    )


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
                f"effect {name}: {parameter} = {value:g} {declared.unit} is out of bounds; give {declared.lower:g} to"
                f" {declared.upper:g}"
            )
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
            raise InputError(f"effect {name}: {p.name} is missing; give {p.lower:g} to {p.upper:g} {p.unit}")
    for smaller, larger in one.ascending:
        if not (acting[..., ROW.index_of(name, smaller)] < acting[..., ROW.index_of(name, larger)]).all():
            raise InputError(f"effect {name}: {larger} must be larger than {smaller}")
