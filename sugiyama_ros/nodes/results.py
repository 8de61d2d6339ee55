"""Results of a recorded run, read from the finished file."""

import math
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message
from sugiyama_msgs.msg import DriverParameters

from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.nodes.base import cdr_messages


@dataclass(frozen=True)
class DriverResult:
    """One driver at the end of a run: the last parameters, and how well each next position was predicted.

    Attributes
    ----------
    vehicle : int
        Number of the vehicle.
    v_star, kappa_v, sigma_nu, sigma_a : float
        Desired speed [m/s], risk premium [s], measurement noise [m] and acceleration noise [m/s^2].
    one_step_rmse_m, nis_mean : float
        Root mean square of the innovations [m] and mean of their nis [1], over the scored samples; NaN without any.
    """

    vehicle: int
    v_star: float
    kappa_v: float
    sigma_nu: float
    sigma_a: float
    one_step_rmse_m: float
    nis_mean: float


def read_run(path: Path) -> tuple[dict[str, int], tuple[DriverResult, ...]]:
    """Read the file of a run.

    Returns
    -------
    counts : dict
        Number of messages on each topic.
    drivers : tuple of DriverResult
        The drivers, in the order of their numbers.

    Raises
    ------
    InputError
        Where the file cannot be read.
    """
    scores: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
    parameters: dict[str, bytes] = {}
    with Bag(path) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
        for topic, _, _, raw in bag.raw_messages({n for n in counts if n.endswith(("/innovation", "/parameters"))}):
            vehicle, _, name = topic.rpartition("/")
            if name == "parameters":
                parameters[vehicle] = raw
                continue
            innovation = cdr_messages.read_innovation(raw)
            if innovation.scored:
                scores[vehicle].append((innovation.innovation_m**2, innovation.nis))
    drivers = [_driver(deserialize_message(raw, DriverParameters), scores[v]) for v, raw in parameters.items()]
    return counts, tuple(sorted(drivers, key=lambda driver: driver.vehicle))


def _driver(message: DriverParameters, score: list[tuple[float, float]]) -> DriverResult:
    parameters = dict(zip(message.name, message.value.tolist(), strict=True))
    squared, nis = np.array(score).mean(axis=0).tolist() if score else (math.nan, math.nan)
    return DriverResult(
        vehicle=message.vehicle,
        v_star=parameters["v_star"],
        kappa_v=parameters["kappa_v"],
        sigma_nu=parameters["sigma_nu"],
        sigma_a=parameters["sigma_a"],
        one_step_rmse_m=math.sqrt(squared),
        nis_mean=nis,
    )
