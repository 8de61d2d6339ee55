"""Results of a recorded run, read from the finished file."""

import math
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.formats.mcap_reader import Bag

_TYPES = {"innovation": "Innovation", "parameters": "DriverParameters"}
_SHOWN = {"v_star", "kappa_v", "sigma_nu", "sigma_a"}


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
    scores: defaultdict[int, list[tuple[float, float]]] = defaultdict(list)
    parameters: dict[int, dict[str, float]] = {}
    with Bag(path) as bag:
        topics = bag.info().topics
        counts = {topic.name: topic.count for topic in topics}
        # other nodes may publish on topics that end alike, or bytes that are no message
        wanted = {t.name for t in topics if t.type == f"sugiyama_msgs/msg/{_TYPES.get(t.name.rpartition('/')[2])}"}
        for topic, _, _, message in bag.messages(wanted, skip_misfits=True):
            if topic.endswith("/parameters"):
                found = dict(zip(message.name, message.value.tolist(), strict=False))
                if found.keys() >= _SHOWN:  # else another node has published it
                    parameters[message.vehicle] = found
            elif message.scored:
                scores[message.vehicle].append((message.innovation_m**2, message.nis))
    return counts, tuple(_driver(v, parameters[v], np.array(scores[v])) for v in sorted(parameters))


def _driver(vehicle: int, parameters: dict[str, float], score: Any) -> DriverResult:
    squared, nis = score.mean(axis=0).tolist() if len(score) else (math.nan, math.nan)
    return DriverResult(
        vehicle=vehicle,
        v_star=parameters["v_star"],
        kappa_v=parameters["kappa_v"],
        sigma_nu=parameters["sigma_nu"],
        sigma_a=parameters["sigma_a"],
        one_step_rmse_m=math.sqrt(squared),
        nis_mean=nis,
    )
