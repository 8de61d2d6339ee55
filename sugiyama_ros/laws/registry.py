"""All car-following laws: the built-in laws and the laws of other packages.

Another package adds a law with an entry point of the group ``sugiyama_ros.laws`` that points to a ``Law``.
"""

from collections.abc import Mapping

from sugiyama_ros import plugins
from sugiyama_ros.laws import PAPERS as PAPERS
from sugiyama_ros.laws.law import Law

#: Group of the entry points by which other packages add laws.
GROUP = "sugiyama_ros.laws"
#: Laws by name. The number of a law in a driver's row is its index in this order.
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
#: Number of the paper's driver model.
ADAPTIVE_SEEK = 0
#: Names of all laws except adaptiveSeek.
RIVALS: tuple[str, ...] = tuple(LAWS)[1:]


def law(name: str) -> Law:
    """Look up a law. Raises InputError."""
    return plugins.find(LAWS, GROUP, name, "law")


def name_of(number: float) -> str:
    """Name of the law with a number in a driver's row."""
    return tuple(LAWS)[round(number)]


def number_of(name: str) -> int:
    """Look up the number of a law in a driver's row. Raises InputError."""
    return tuple(LAWS).index(law(name).name)
