"""Extensions: the built-in ones, and those that other installed packages add through entry points.

An extension is one object with a name (an effect, a law, a controller, a file format or a study) in one module. A
package of your own offers it through an entry point, for example ``[project.entry-points."sugiyama_ros.effects"]``
with ``syrup = "my_package.syrup:EFFECT"``.
"""

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from importlib import import_module, metadata
from types import ModuleType
from typing import Any, Protocol, TypeVar

from sugiyama_ros.errors import InputError

#: Why an extension could not be loaded, by group and name of its entry point.
FAILED: dict[tuple[str, str], str] = {}


def entry_points(group: str) -> tuple[metadata.EntryPoint, ...]:
    """Return the entry points of a group, sorted by name.

    The installed packages are searched once, because a search takes longer than loading all built-in extensions.

    group: name of the group, for example ``sugiyama_ros.effects``.
    """
    return tuple(sorted(_installed().select(group=group), key=lambda point: point.name))


@cache
def _installed() -> Any:  # of another class in Python 3.10
    return metadata.entry_points()


class Named(Protocol):
    """Anything with a name."""

    @property
    def name(self) -> str:
        """Name in commands, files and messages."""


_Kind = TypeVar("_Kind", bound=Named)


def registered(group: str, kind: type[_Kind], modules: Sequence[str], attribute: str) -> dict[str, _Kind]:
    """Collect all extensions of a kind by name: first the built-in ones, then those of other packages.

    group: of the entry points, and name of the package of the built-in modules; kind: class of the extensions; modules:
    built-in modules, ``module:NAME`` where one holds several extensions; attribute: its name where it holds one.
    """
    found: dict[str, _Kind] = {}
    for place in modules:
        module, _, name = place.partition(":")
        one = getattr(import_module(f"{group}.{module}"), name or attribute)
        found[one.name] = one
    for point, one in load(group, kind).items():
        if one.name in found:
            FAILED[group, point] = f"there is another extension of the name {one.name!r}; rename one of them"
        else:
            found[one.name] = one
    return found


def load(group: str, kind: type[_Kind]) -> dict[str, _Kind]:
    """Load the extensions of other packages, by the name of their entry point.

    An extension that cannot be loaded, or that is not of the right class, is left out. The reason is kept in
    ``FAILED``, for an error message if somebody asks for this extension.
    """
    found: dict[str, _Kind] = {}
    for point in entry_points(group):
        try:
            one = point.load()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a package may raise anything, and may call sys.exit
            FAILED[group, point.name] = f"{point.value} cannot be loaded: {error!r}; correct it or uninstall it"
            continue
        if isinstance(one, kind):
            found[point.name] = one
        else:
            FAILED[group, point.name] = f"{point.value} is not of the class {kind.__name__}"
    return found


def find(extensions: Mapping[str, _Kind], group: str, name: str, what: str) -> _Kind:
    """Look up an extension; ``what``: its kind in words. Raises InputError, which lists the names."""
    if name in extensions:
        return extensions[name]
    if (group, name) in FAILED:
        raise InputError(f"{what} {name}: {FAILED[group, name]}")
    near = get_close_matches(name.lower(), extensions, 1)
    meant = f"did you mean {near[0]}? " if near else ""
    raise InputError(f"{what} {name!r}: not known; {meant}choose among {', '.join(extensions)}")


class ExtensionModule(ModuleType, Mapping[str, Any]):
    """A package of extensions that is also a mapping of their names to them, read from its module ``registry``."""

    @property
    def _extensions(self) -> Mapping[str, Any]:
        """The registry's mapping has the name of the package in capitals."""
        registry = import_module(f"{self.__name__}.registry")
        extensions: Mapping[str, Any] = getattr(registry, self.__name__.rpartition(".")[2].upper())
        return extensions

    def __getitem__(self, name: str) -> Any:
        return self._extensions[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._extensions)

    def __len__(self) -> int:
        return len(self._extensions)

    def __hash__(self) -> int:
        return id(self)

    def __eq__(self, other: object) -> bool:
        return self is other

    def _repr_html_(self) -> str:
        """Show titles and summaries in a notebook."""
        rows = (f"<tr><td>{name}</td><td>{e.title}</td><td>{e.summary}</td></tr>" for name, e in self.items())
        return "<table>" + "".join(rows) + "</table>"
