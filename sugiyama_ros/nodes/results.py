"""What a recorded run says about its drivers, read back from the finished file."""

import math
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.formats.mcap_reader import Bag


@dataclass(frozen=True)
class DriverResult:
    """One driver at the end of a run: last parameters, and how well each next position was predicted.

    v_star [m/s], kappa_v [s], sigma_nu [m], sigma_a [m/s^2]; one_step_rmse_m [m] and nis_mean over the scored samples,
    NaN if there are none.
    """

    vehicle: int
    v_star: float
    kappa_v: float
    sigma_nu: float
    sigma_a: float
    one_step_rmse_m: float
    nis_mean: float


def read_run(path: Path) -> tuple[dict[str, int], tuple[DriverResult, ...]]:
    """Number of messages on each topic of a run's file, and its drivers by number.

    Raises InputError where the file cannot be read.
    """
    scores: defaultdict[int, list[tuple[float, float]]] = defaultdict(list)
    parameters: dict[int, dict[str, float]] = {}
    with Bag(path) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
        for topic, _, _, message in bag.messages({n for n in counts if n.endswith(("/innovation", "/parameters"))}):
            if topic.endswith("/parameters"):
                parameters[message.vehicle] = dict(zip(message.name, message.value.tolist(), strict=True))
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
