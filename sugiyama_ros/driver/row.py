"""A driver's row: all numbers that the compiled code may need for one driver, in one float64 vector.

A row begins with the parameters of ``driver.parameters``. The number of the law follows, by which the driver chooses
their acceleration. Then come the parameters of every law and the parameters of every effect. An effect whose strengths
are 0 does nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import COUNT, PARAMETERS, Parameter
from sugiyama_ros.errors import InputError


@dataclass(frozen=True, eq=False)
class RowLayout:
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
    def of(cls, laws: Mapping[str, Sequence[Parameter]], effects: Mapping[str, Sequence[Parameter]]) -> "RowLayout":
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
