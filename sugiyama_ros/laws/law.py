"""What a car-following law is: a name, declared parameters, and a pure function of what the driver sees."""

from collections.abc import Callable
from dataclasses import dataclass

from sugiyama_ros.driver.parameters import Parameter, check_declared
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.jit import kernel

_HARDEST, _STRONGEST = float(ACTIONS[0]), float(ACTIONS[-1])


@dataclass(frozen=True, eq=False)
class Law:
    """A car-following law.

    Parameters
    ----------
    name : str
        Name in commands, files and messages.
    title : str
        Name for people.
    summary : str
        What the law says, in one line.
    source : str
        Publication that states the law.
    parameters : tuple of Parameter
        Declared parameters, in the order in which the function takes them.
    function : callable
        Compiled with ``numba.njit``: (gap [m], speed [m/s], leader_speed [m/s], p) -> acceleration [m/s^2]. The gap is
        infinite without a leader, and ``p`` holds the law's parameters, shape (K,). The function must be pure, and
        finite everywhere; ``bounded`` helps.
    """

    name: str
    title: str
    summary: str
    source: str
    parameters: tuple[Parameter, ...]
    function: Callable[..., float]

    def __post_init__(self) -> None:
        check_declared(self.name, self.parameters)


@kernel
def bounded(acceleration: float) -> float:
    """Keep an acceleration [m/s^2] within the range of actions that the paper's drivers choose from."""
    return min(max(acceleration, _HARDEST), _STRONGEST)


@kernel
def hardest_braking() -> float:
    """Return the hardest braking [m/s^2], a negative number, that the paper's drivers choose from."""
    return _HARDEST
