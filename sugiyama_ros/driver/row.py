"""A driver's row: all numbers that the compiled code may need of one driver, in one float64 vector.

A row holds the parameters of ``driver.parameters``, then the number of the law by which the driver chooses their
acceleration, then the parameters of every law, then the parameters of every effect. An effect whose strengths are 0
does nothing.
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

    Parameters
    ----------
    laws, effects : mapping of str to sequence of Parameter
        Declared parameters by the name of the law or effect, in the order of the row.

    Attributes
    ----------
    law : int
        Index of the number of the law.
    law_places, places : mapping of str to slice
        Where the parameters of a law, or of an effect, stand.
    entries : tuple of str
        Name of every entry; those of laws and effects as in ``drag.c0``.
    declared : tuple of Parameter
        Declaration of every entry.
    """

    law: int
    law_places: Mapping[str, slice]
    places: Mapping[str, slice]
    entries: tuple[str, ...]
    declared: tuple[Parameter, ...]

    @classmethod
    def of(cls, laws: Mapping[str, Sequence[Parameter]], effects: Mapping[str, Sequence[Parameter]]) -> "RowLayout":
        """Lay out a row for these laws and effects."""
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
        """Number of entries of a row."""
        return len(self.entries)

    def index_of(self, effect: str, parameter: str) -> int:
        """Find a parameter of an effect. Raises InputError, which lists the parameters, for an unknown one."""
        places = self.places[effect]
        names = [p.name for p in self.declared[places]]
        if parameter not in names:
            raise InputError(f"effect {effect}: has no parameter {parameter!r}; it has {', '.join(names)}")
        return int(places.start) + names.index(parameter)

    def with_effects(self, parameters: Array) -> Array:
        """Rows of shape (..., width) from parameters of shape (..., P) or whole rows; a copy."""
        row = np.zeros((*parameters.shape[:-1], self.width))
        row[..., : parameters.shape[-1]] = parameters
        return row
