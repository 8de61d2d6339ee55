"""Whatever is asked of drivers changes a simulation, or is refused: nothing is asked in vain."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.simulation.experiment import changed

_Values = Mapping[str, float]
#: Arguments of ``changed``: rows of the drivers, parameters, effects, and what the road has that effects may need.
Asked = tuple[Array, _Values, Mapping[str, _Values], Collection[str]]


class Moving(Protocol):
    """What moves in steps and is measured, such as a ``Simulator``."""

    def step(self) -> Any:
        """Advance by one period, and return the collisions that began."""

    def measure(self) -> Array:
        """Measure the positions [m] of who is there."""


def check_acts(begin: Callable[[Array], Sequence[Moving]], periods: int, asked: Asked) -> None:
    """Raise InputError for the first parameter or effect without which everybody would drive as with it.

    The drivers are simulated beside drivers without it, with the same random numbers, until the two differ.

    begin: puts drivers with rows (N, width) at their start; periods: how long they drive. A parameter may say the value
    that the drivers have already.
    """
    rows, parameters, effects, road = asked
    drivers = changed(rows, parameters, effects, road)
    for name in parameters:
        without = changed(rows, {k: v for k, v in parameters.items() if k != name}, effects, road)
        if not np.array_equal(drivers, without) and _alike(begin(drivers), begin(without), periods):
            raise _idle(f"parameter {name}")
    for name in effects:
        without = changed(rows, parameters, {k: v for k, v in effects.items() if k != name}, road)
        if np.array_equal(drivers, without) or _alike(begin(drivers), begin(without), periods):
            raise _idle(f"effect {name}")


def check_somebody_drives(vehicles: int, controlled: Sequence[int], law: str, spread: float) -> None:
    """Raise InputError for a law or a spread of drivers where a controller drives every vehicle."""
    for name, is_given in (("law", law != PAPERS), ("spread", spread > 0.0)):
        if is_given and set(controlled) >= set(range(vehicles)):
            raise InputError(
                f"{name}: is for drivers, and a controller drives every vehicle; leave out the {name}, or control fewer"
            )


def _idle(what: str) -> InputError:
    return InputError(f"{what}: changes nothing that anybody here does, at any time and place; leave it out")


def _alike(ours: Sequence[Moving], theirs: Sequence[Moving], periods: int) -> bool:
    """Whether two simulations of the same roads are measured alike until their ends."""
    for period in range(periods + 1):
        if period:
            for one in (*ours, *theirs):
                one.step()
        if not all(np.array_equal(own.measure(), other.measure()) for own, other in zip(ours, theirs, strict=True)):
            return False
    return True
