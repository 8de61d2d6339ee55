"""Entry points of the installed packages, by which other packages add extensions."""

from functools import cache
from importlib import metadata
from typing import Any


def entry_points(group: str) -> tuple[metadata.EntryPoint, ...]:
    """Return the entry points of a group, sorted by name.

    The installed packages are searched once, because a search takes longer than loading all built-in extensions.

    group: name of the group, for example ``sugiyama_ros.effects``.
    """
    return tuple(sorted(_installed().select(group=group), key=lambda point: point.name))


@cache
def _installed() -> Any:  # of another class in Python 3.10
    return metadata.entry_points()


def search_again() -> None:
    """Forget the packages that were found, for packages that were installed since."""
    _installed.cache_clear()
