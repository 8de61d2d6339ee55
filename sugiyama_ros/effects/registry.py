"""All physical effects: the built-in ones, and those of other packages; and where they stand in a driver's row.

An effect of another package is an ``Effect`` behind an entry point of the group ``sugiyama_ros.effects``.
"""

from collections.abc import Mapping

import numpy as np

from sugiyama_ros import plugins
from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.row import RowLayout
from sugiyama_ros.effects.effect import STAGES, Effect, Values
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.registry import LAWS

#: Group of the entry points by which other packages add effects.
GROUP = "sugiyama_ros.effects"
#: Effects by name. Within a stage they act in this order.
EFFECTS: Mapping[str, Effect] = {
    name: effect
    for name, effect in plugins.registered(
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
    ).items()
    if effect.stage in STAGES
}
#: Where every parameter stands in a driver's row.
ROW = RowLayout.of(
    {name: law.parameters for name, law in LAWS.items() if name != "adaptive_seek"},
    {name: effect.parameters for name, effect in EFFECTS.items()},
)


def effect(name: str) -> Effect:
    """Look up an effect. Raises InputError, which lists the names, for an unknown one."""
    return plugins.find(EFFECTS, GROUP, name, "effect")


def index_of(effect_name: str, parameter: str) -> int:
    """Find a parameter of an effect in a driver's row. Raises InputError for an unknown one."""
    return ROW.index_of(effect(effect_name).name, parameter)


def active(rows: Array) -> tuple[str, ...]:
    """Names of the effects that act on any of the drivers.

    Parameters
    ----------
    rows : ndarray, shape (..., width)
        Rows of drivers; rows without effects, of shape (..., P), give no names.
    """
    if rows.shape[-1] < ROW.width:
        return ()
    return tuple(
        name for name, e in EFFECTS.items() if np.any(rows[..., [ROW.index_of(name, switch) for switch in e.switches]])
    )


def switch_on(rows: Array, name: str, values: Values) -> Array:
    """Give an effect its values.

    Parameters
    ----------
    rows : ndarray, shape (..., width)
        Rows of drivers, which stay as they are.
    name : str
        Name of the effect.
    values : mapping of str to float
        Values of its parameters.

    Returns
    -------
    ndarray, shape (..., width)
        Changed rows.

    Raises
    ------
    InputError
        For an unknown name, or a value out of the declared bounds.
    """
    changed = rows.copy()
    for parameter, value in values.items():
        k = index_of(name, parameter)
        declared = ROW.declared[k]
        # 0 is always allowed: the effect is not there
        if value != 0.0 and not declared.lower <= value <= declared.upper:
            raise InputError(
                f"effect {name}: {parameter} = {value:g} {declared.unit} is out of bounds; give {declared.lower:g} to"
                f" {declared.upper:g}"
            )
        changed[..., k] = value
    return changed
