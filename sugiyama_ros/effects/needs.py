"""Where an effect or a parameter acts: what an effect needs of the road, and what it needs of the law."""

from collections.abc import Collection

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, UTILITY
from sugiyama_ros.effects.effect import CURVES, RING, SIGNALS, YIELDS, Effect
from sugiyama_ros.effects.registry import ROW, effect
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.registry import ADAPTIVE_SEEK, PAPERS, name_of

#: What effects may need of a road, in words.
_IN_WORDS = {
    RING: "a ring",
    YIELDS: "a place where drivers let others pass",
    SIGNALS: "a signal",
    CURVES: "a curve",
}


def check_effect(name: str, rows: Array, road: Collection[str]) -> None:
    """Raise InputError for an effect that could not change what drivers do on a road.

    rows: (N, width), the drivers; road: what the road has, of ``NEEDS``.
    """
    one = effect(name)
    if one.needs and not set(one.needs) & set(road):
        raise InputError(
            f"effect {name}: does nothing on a road without {' or '.join(_IN_WORDS[need] for need in one.needs)}; leave"
            " it out, or take another road"
        )
    check_law(one, rows)


def check_law(one: Effect, rows: Array) -> None:
    """Raise InputError for an effect on preferences of the paper's drivers, if all drivers drive by other laws."""
    if one.acts_on_preferences and (law := _other_law(rows)):
        raise InputError(
            f"effect {one.name}: acts on the preferences of {PAPERS}, and {law} has none; leave out the effect, or the"
            " law"
        )


def check_parameter(name: str, rows: Array, what: str = "") -> None:
    """Raise InputError for a preference of the paper's drivers, if all drivers drive by other laws.

    what: what the user has given, by default the parameter.
    """
    if name in NAMES and NAMES.index(name) in UTILITY and (law := _other_law(rows)):
        raise InputError(
            f"{what or name}: acts on the preferences of {PAPERS}, and {law} has none; leave out {what or name}, or the"
            " law"
        )


def _other_law(rows: Array) -> str:
    """Name of the law by which the first driver drives, if nobody drives as the paper's drivers do; else empty."""
    by = rows[:, ROW.law]
    return "" if np.any(by == ADAPTIVE_SEEK) else name_of(float(by[0]))
