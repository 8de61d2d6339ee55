"""What a controller of a vehicle is: a name, declared parameters, and a function of what the vehicle measures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import Parameter, check_declared
from sugiyama_ros.driver.utility import ACTIONS

# Hardest braking [m/s^2]: that of the paper's drivers.
_HARDEST = float(ACTIONS[0])
#: Largest acceleration [m/s^2], as of the controlled vehicle of Wu et al., IEEE Trans. Robot. 38 (2022) 1270.
STRONGEST = 1.0


def _no_memory(p: Array, period: float) -> int:
    return 0


@dataclass(frozen=True, eq=False)
class Controller:
    """A controller, which drives a vehicle in place of a driver.

    Parameters
    ----------
    name : str
        Name in commands, files and messages.
    title : str
        Name for people.
    summary : str
        What the controller does, in one line.
    source : str
        Publication that states the controller.
    parameters : tuple of Parameter
        Declared parameters, in the order in which the function takes them.
    function : callable
        (gap [m], speed [m/s], leader_speed [m/s], memory, period [s], p) -> acceleration [m/s^2] of the coming period.
        The gap is infinite and the leader's speed 0 without a leader; ``p`` holds the parameters, shape (K,). The
        function is called once in each period, and may change ``memory`` in place.
    memory : callable
        (p, period [s]) -> number of entries of the memory, all of which are 0 at the start. By default there is none.
    """

    name: str
    title: str
    summary: str
    source: str
    parameters: tuple[Parameter, ...]
    function: Callable[[float, float, float, Array, float, Array], float]
    memory: Callable[[Array, float], int] = _no_memory

    def __post_init__(self) -> None:
        check_declared(self.name, self.parameters)


@dataclass(frozen=True, eq=False)
class Controlled:
    """Vehicles that a controller drives, each with a memory of its own.

    vehicles: numbers of the vehicles; controller: the controller; values: (K,), its parameters.
    """

    vehicles: tuple[int, ...]
    controller: Controller
    values: Array

    def memories(self, period_s: float) -> tuple[Array, ...]:
        """Memory of each vehicle at the start, for a period [s]."""
        return tuple(np.zeros(self.controller.memory(self.values, period_s)) for _ in self.vehicles)


def acceleration_to(wanted: float, speed: float, period: float) -> float:
    """Acceleration [m/s^2] that takes a vehicle to a commanded speed [m/s] within a period [s], as far as it can."""
    return min(max((wanted - speed) / period, _HARDEST), STRONGEST)
