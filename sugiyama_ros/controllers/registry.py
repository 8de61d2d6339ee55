"""All controllers of vehicles: the built-in controllers and the controllers of other packages.

Another package adds a controller with an entry point of the group ``sugiyama_ros.controllers`` that points to a
``Controller``.
"""

from collections.abc import Callable, Mapping, Sequence
from operator import index

import numpy as np

from sugiyama_ros import plugins
from sugiyama_ros.controllers.controller import Controlled, Controller
from sugiyama_ros.driver.parameters import read_numbers, read_pairs
from sugiyama_ros.errors import InputError

#: Group of the entry points by which other packages add controllers.
GROUP = "sugiyama_ros.controllers"
#: Controllers by name.
CONTROLLERS: Mapping[str, Controller] = plugins.registered(
    GROUP,
    Controller,
    (
        "constant_speed",
        "mean_speed",
        "follower_stopper",
        "pi_saturation",
    ),
    "CONTROLLER",
)


def controller(name: str) -> Controller:
    """Look up a controller. Raises InputError."""
    return plugins.find(CONTROLLERS, GROUP, name, "controller")


def controlled_by(
    vehicles: str | Sequence[int] | None, text: str | None, shown: Callable[[str], str] = str
) -> Controlled | None:
    """Vehicles, such as ``0,7``, that the controller ``NAME[:KEY=VALUE[,KEY=VALUE]]`` drives; None if there are none.

    shown: how messages show the names ``controlled`` and ``controller``. Raises InputError.
    """
    if vehicles is None and text is None:
        return None
    if vehicles is None or text is None:
        given, missing = ("controller", "controlled")[:: 1 if vehicles is None else -1]
        raise InputError(f"{shown(given)}: needs {shown(missing)}, too")
    name, _, pairs = text.partition(":")
    chosen, where = controller(name), f"{shown('controller')} {text}"
    values = {p.name: p.default for p in chosen.parameters} | read_numbers(
        read_pairs(pairs, where), chosen.parameters, where
    )
    return Controlled(_numbers(vehicles, shown("controlled")), chosen, np.array(list(values.values())))


def _numbers(vehicles: str | Sequence[int], where: str) -> tuple[int, ...]:
    """Numbers of vehicles, each once. Raises InputError."""
    try:
        given = [int(part) for part in vehicles.split(",")] if isinstance(vehicles, str) else [*map(index, vehicles)]
    except (TypeError, ValueError):
        raise InputError(f"{where} {vehicles}: gives no numbers of vehicles; give them such as 0,7") from None
    return tuple(dict.fromkeys(given))
