"""What a message about all drivers says of each of them, in the form of the topics of single vehicles."""

from collections.abc import Iterator
from math import isfinite
from typing import NamedTuple

import numpy as np
from sugiyama_msgs.msg import DriverArray

from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.nodes.base.cdr_messages import NS, ReadInnovation

# Entries of the state: position, speed, acceleration.
_STATE, _SPEED = 3, 1
_SHOWN = ("v_star", "kappa_v")


class Told(NamedTuple):
    """One driver after a sample.

    state: stamp [s], vehicle, position [m], speed [m/s] and its variance; innovation: as from the topic of a vehicle;
    adapted: v* [m/s], its std, kappa_v [s], its std, or nothing if the message does not have them.
    """

    state: tuple[float, int, float, float, float]
    innovation: ReadInnovation
    adapted: tuple[float, float, float, float] | None


def each_driver(message: DriverArray) -> Iterator[Told]:
    """Yield what a message says of each driver."""
    stamp = message.header.stamp
    time_s, count, names = stamp.sec + stamp.nanosec / NS, len(message.vehicle), list(message.name)
    speed_var = np.array(message.state_covariance).reshape(count, _STATE, _STATE)[:, _SPEED, _SPEED].tolist()
    value = np.array(message.value).reshape(count, len(names))
    learnt = [name for name, estimated in zip(names, message.estimated, strict=True) if estimated]
    var = np.array(message.parameter_covariance).reshape(count, len(learnt), len(learnt))
    adapted: list[tuple[float, float, float, float] | None] = [None] * count
    if set(_SHOWN) <= set(learnt):
        mean = value[:, [names.index(name) for name in _SHOWN]]
        std = np.sqrt(np.maximum([np.diag(one)[[learnt.index(name) for name in _SHOWN]] for one in var], 0.0))
        adapted = [(m[0], s[0], m[1], s[1]) for m, s in zip(mean.tolist(), std.tolist(), strict=True)]
    for k, vehicle in enumerate(message.vehicle):
        of_innovation = message.innovation_m[k], message.innovation_var[k], message.nis[k], message.scored[k]
        yield Told(
            (time_s, int(vehicle), message.position_m[k], message.speed[k], speed_var[k]),
            ReadInnovation(time_s, int(vehicle), *of_innovation),
            adapted[k],
        )


def effects_of(message: DriverArray) -> list[dict[str, float]]:
    """Return the parameters of the effects that the model of each driver has, N mappings from name to value."""
    value = np.array(message.value).reshape(len(message.vehicle), len(message.name)).tolist()
    named = [k for k, name in enumerate(message.name) if name not in NAMES]
    return [{message.name[k]: row[k] for k in named if isfinite(row[k])} for row in value]
