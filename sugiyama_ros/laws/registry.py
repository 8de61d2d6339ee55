"""All car-following laws: the built-in ones, and those of other packages.

A law of another package is a ``Law`` behind an entry point of the group ``sugiyama_ros.laws``.
"""

from collections.abc import Mapping

from sugiyama_ros import plugins
from sugiyama_ros.laws.law import Law

#: Group of the entry points by which other packages add laws.
GROUP = "sugiyama_ros.laws"
#: Laws by name. The place of a law in this order is its number in a driver's row.
LAWS: Mapping[str, Law] = plugins.registered(
    GROUP,
    Law,
    (
        "adaptive_seek",
        "idm",
        "fvdm",
        "constant_speed",
        "gipps",
        "ovm",
        "newell",
        "helly",
    ),
    "LAW",
)
#: Number of the paper's driver model; the other laws are compared with it.
ADAPTIVE_SEEK = 0
#: Names of all laws but adaptiveSeek.
RIVALS: tuple[str, ...] = tuple(LAWS)[1:]


def law(name: str) -> Law:
    """Look up a law. Raises InputError, which lists the names, for an unknown one."""
    return plugins.find(LAWS, GROUP, name, "law")


def number_of(name: str) -> int:
    """Look up the number of a law in a driver's row. Raises InputError for an unknown one."""
    return tuple(LAWS).index(law(name).name)
