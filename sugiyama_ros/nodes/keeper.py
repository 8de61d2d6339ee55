"""What an estimator has learnt, in a file or from a keeper. An estimator that starts later can go on from it.

The node `Keeper` keeps what each estimator last published about its driver: a latched (transient-local) message is gone
when its publisher is gone, so another node has to hold it.
"""

import json
import math
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.publisher import Publisher
from sugiyama_msgs.msg import DriverParameters

from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import read_json, writing
from sugiyama_ros.filters.online import Learnt
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.node import OK, Health, PacedNode
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM

# An estimator may learn a value beyond the declared bounds, but not by more than this factor; smallest logarithm.
_BEYOND, _LEAST = 100.0, -20.0
_LOOK_S = 0.5
_PARAMETERS = re.compile(r"(.*/vehicle_\d+)/parameters")


@dataclass(frozen=True, eq=False)
class Kept:
    """What an estimator has learnt, and the stamp [ns] of the last sample that it used."""

    learnt: Learnt
    until_ns: int


def file_of(directory: Path, vehicle: int) -> Path:
    """File in which the estimator of a vehicle keeps what it has learnt."""
    return directory / f"vehicle_{vehicle:02}.json"


def kept_in(message: DriverParameters) -> Kept:
    """What an estimator had learnt when it published the message. Raises ValueError where nobody can have learnt it."""
    places = np.flatnonzero(message.estimated)
    value = np.array(message.value)[places]
    covariance = np.array(message.covariance).reshape(2 * [len(message.value)])[np.ix_(places, places)]
    names = tuple(message.name[k] for k in places)
    # what is learnt of a driver are logarithms, what is learnt of effects are the values
    of_driver = np.array([name in NAMES for name in names])
    scale = np.where(of_driver, value, 1.0)
    learnt = Learnt(names, np.where(of_driver, np.log(np.abs(value)), value), covariance / np.outer(scale, scale))
    return _checked(Kept(learnt, message.header.stamp.sec * NS + message.header.stamp.nanosec))


def write_learnt(path: Path, kept: Kept) -> None:
    """Write what was learnt into a file. Raises OutputError."""
    learnt = kept.learnt
    document = {
        "names": learnt.names,
        "mean": learnt.mean.tolist(),
        "covariance": learnt.covariance.tolist(),
        "until_ns": kept.until_ns,
    }
    with writing(path) as stream:
        stream.write(json.dumps(document).encode())


def read_learnt(path: Path) -> Kept:
    """Read a file that ``write_learnt`` has written. Raises InputError."""
    document = read_json(path)
    try:
        mean, covariance = (np.array(document[name], dtype=np.float64) for name in ("mean", "covariance"))
        return _checked(Kept(Learnt(tuple(document["names"]), mean, covariance), int(document["until_ns"])))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        why = f" ({error})" if isinstance(error, ValueError) else ""
        raise InputError(
            f"{path}: is no state that an estimator has saved{why}; give a directory of --save-state"
        ) from None


def _checked(kept: Kept) -> Kept:
    """What was learnt, if an estimator can have learnt it; else ValueError."""
    names, mean, covariance = kept.learnt.names, kept.learnt.mean, kept.learnt.covariance
    if unknown := [name for name in names if name not in ROW.entries]:
        raise ValueError(f"{unknown[0]!r} is not the name of a parameter")
    if len(set(names)) != len(names) or mean.shape != (len(names),) or covariance.shape != 2 * mean.shape:
        raise ValueError("its arrays differ in length")
    if not np.isfinite(covariance).all() or not np.allclose(covariance, covariance.T):
        raise ValueError("its covariance is no covariance")
    np.linalg.cholesky(covariance)
    for name, logarithm in zip(names, mean.tolist(), strict=True):
        p = ROW.declared[ROW.entries.index(name)]
        if name not in NAMES:
            if not p.lower <= logarithm <= p.upper:
                raise ValueError(f"{name} is out of bounds")
            continue
        if not _LEAST < logarithm < math.log(_BEYOND * p.upper) or math.exp(logarithm) < p.lower / _BEYOND:
            raise ValueError(f"{name} is far out of bounds")
    if not abs(kept.until_ns) < 1 << 63:
        raise ValueError("its time is out of bounds")
    return kept


class Keeper(PacedNode):
    """Latches the last message of each topic ``.../vehicle_07/parameters`` on ``.../vehicle_07/_kept_parameters``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("keeper", **options)
        self._kept: dict[str, Publisher] = {}
        self.create_timer(_LOOK_S, self._look, clock=self.steady)

    def health(self) -> Health:
        """Always OK, with the number of drivers heard."""
        return Health(OK, "keeping", {"drivers": len(self._kept)})

    def _look(self) -> None:
        """Subscribe to estimators that are new in the graph."""
        for topic, _ in self.get_topic_names_and_types():
            found = _PARAMETERS.fullmatch(topic)
            if found is not None and topic not in self._kept:
                self._kept[topic] = self.create_publisher(DriverParameters, f"{found[1]}/_kept_parameters", LATCHED)
                keep = partial(self.send, self._kept[topic])
                self.create_subscription(DriverParameters, topic, keep, STREAM, raw=True)
