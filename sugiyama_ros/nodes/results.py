"""Results of a recorded run, read from the finished file."""

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from sugiyama_msgs.msg import DriverArray

from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.laws.registry import LAWS
from sugiyama_ros.nodes.base import cdr_messages, incoming
from sugiyama_ros.nodes.base.incoming import RefusedError

# Parameters of every driver; a message without them is of another node.
_SHOWN = {"v_star", "kappa_v", "sigma_nu", "sigma_a"}


@dataclass(frozen=True)
class DriverResult:
    """One driver at the end of a run: the last parameters, and how well each next position was predicted.

    vehicle: number of the vehicle; v_star, kappa_v, sigma_nu, sigma_a: desired speed [m/s], risk premium [s],
    measurement noise [m] and acceleration noise [m/s^2]; one_step_rmse_m, nis_mean: root mean square of the innovations
    [m] and mean of their nis [1], over the scored samples; naN without any; law: parameters of the driver's law by
    names such as ``idm.T``, in SI units; empty for the paper's driver; identified: parameters that the samples
    determine.
    """

    vehicle: int
    v_star: float
    kappa_v: float
    sigma_nu: float
    sigma_a: float
    one_step_rmse_m: float
    nis_mean: float
    law: dict[str, float]
    identified: tuple[str, ...]


def read_run(path: Path) -> tuple[dict[str, int], tuple[DriverResult, ...]]:
    """Read the file of a run.

    Returns counts: number of messages on each topic; drivers: the drivers, in the order of their numbers. Raises
    InputError.
    """
    read = _Read()
    with Bag(path) as bag:
        topics = bag.info().topics
        for topic, kind, _, raw in bag.raw_messages({topic.name for topic in topics if topic.type in read.kinds}):
            read.kinds[kind](topic, raw)
    counts = {topic.name: topic.count for topic in topics}
    return counts, tuple(sorted(read.drivers(), key=lambda driver: driver.vehicle))


class _Read:
    """What is read of the messages: scores of all samples, and the last message about each driver."""

    def __init__(self) -> None:
        #: What takes in a message, by the type of the message.
        self.kinds = {
            "sugiyama_msgs/msg/Innovation": self._innovation,
            "sugiyama_msgs/msg/DriverParameters": self._parameters,
            "sugiyama_msgs/msg/DriverArray": self._array,
        }
        self._innovations: list[bytes] = []
        self._scores: defaultdict[int, list[tuple[float, float]]] = defaultdict(list)
        self._last: dict[str, bytes] = {}
        self._last_array: dict[int, DriverArray] = {}

    def _innovation(self, _: str, raw: bytes) -> None:
        self._innovations.append(raw)

    def _parameters(self, topic: str, raw: bytes) -> None:
        self._last[topic] = raw

    def _array(self, _: str, raw: bytes) -> None:
        try:
            message = incoming.drivers(raw)
        except RefusedError:
            return
        scores = zip(message.vehicle, message.scored, message.innovation_m, message.nis, strict=True)
        for vehicle, scored, innovation_m, nis in scores:
            self._last_array[vehicle] = message
            if scored:
                self._scores[vehicle].append((innovation_m**2, nis))

    def drivers(self) -> Iterator[DriverResult]:
        """Every driver."""
        innovation = cdr_messages.read_innovations(self._innovations)
        scored = innovation[innovation["scored"]]
        scores = np.column_stack([np.square(scored["innovation_m"]), scored["nis"]])
        for vehicle in np.unique(scored["vehicle"]).tolist():
            self._scores[vehicle] += scores[scored["vehicle"] == vehicle].tolist()
        for raw in self._last.values():
            try:
                one = incoming.parameters(raw)
            except RefusedError:
                continue
            if set(one.name) >= _SHOWN:
                known = tuple(compress(one.name, one.identified))
                yield _driver(one.vehicle, one.name, np.array(one.value), self._scores[one.vehicle], known)
        for vehicle, array in self._last_array.items():
            values = np.reshape(array.value, (len(array.vehicle), len(array.name)))
            row, adapted = list(array.vehicle).index(vehicle), list(compress(array.name, array.estimated))
            known = tuple(compress(adapted, array.identified[row * len(adapted) : (row + 1) * len(adapted)]))
            yield _driver(vehicle, array.name, values[row], self._scores[vehicle], known)


def _driver(
    vehicle: int, names: Sequence[str], values: Any, score: list[tuple[float, float]], identified: tuple[str, ...]
) -> DriverResult:
    parameters = dict(zip(names, values.tolist(), strict=True))
    squared, nis = np.array(score).mean(axis=0).tolist() if score else (math.nan, math.nan)
    return DriverResult(
        vehicle=vehicle,
        v_star=parameters["v_star"],
        kappa_v=parameters["kappa_v"],
        sigma_nu=parameters["sigma_nu"],
        sigma_a=parameters["sigma_a"],
        one_step_rmse_m=math.sqrt(squared),
        nis_mean=nis,
        law={name: value for name, value in parameters.items() if name.partition(".")[0] in LAWS},
        identified=identified,
    )
