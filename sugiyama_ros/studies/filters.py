"""Which filter learns a driver's preferences best while they drive, and what does it cost?"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, population
from sugiyama_ros.filters.causal import SETTLING
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.studies.followers import PARTICLES, PLACES, Cubature, LearningFilter, Particles, Unscented
from sugiyama_ros.studies.rings import CARS, alike, jams
from sugiyama_ros.studies.study import Answer, Asked, Row, Study
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Duration [s] of a simulated run.
DURATION_S = 250.0
_TIMES_S = (60.0, 120.0, 250.0)
# Std of the logarithms over the simulated drivers.
_SPREAD = {V_STAR: 0.08, KAPPA_V: 0.2}
# The filters that are compared, by their names in the table.
_FILTERS: dict[str, Callable[..., LearningFilter]] = {
    "cubature (the nodes')": Cubature,
    "unscented": Unscented,
    f"{PARTICLES} particles": Particles,
}


def _row() -> Array:
    """Parameters (P,) of a driver whose noises are known and whose preferences are not."""
    row = population()
    row[[SIGMA_NU, SIGMA_A]] = alike()[0, [SIGMA_NU, SIGMA_A]]
    return row


class _LearningCurve(NamedTuple):
    """What one filter makes of one driver over T samples.

    ``logs`` (T, 2) are logarithms of v* and kappa_v, ``log_likelihood`` has shape (T,), ``step_s`` is the time [s]
    that the computer takes for a sample.
    """

    logs: Array
    log_likelihood: Array
    step_s: float


def _follow(job: tuple[Trajectories, int, str, int]) -> _LearningCurve:
    """Follow one driver: trajectories, column of the driver, name of the filter, seed."""
    trajectories, driver, name, seed = job
    chain = chain_behind(trajectories, driver)
    follower = _FILTERS[name](_row(), trajectories.road, trajectories.period_s, np.random.default_rng([seed, driver]))
    logs, density, begun = [], [], time.perf_counter()
    for sample in zip(chain.position_m, chain.identity, chain.length_m, strict=True):
        density.append(follower.step(*sample))
        logs.append(follower.logs)
    return _LearningCurve(np.array(logs), np.array(density), (time.perf_counter() - begun) / len(logs))


class _Errors(NamedTuple):
    """Errors of the filters on all simulated drivers.

    For each filter: errors of the logarithms (T, 2), log-likelihoods (T,) and time of a step [s] of each driver. Of the
    batch fit: errors (N, 2) of the logarithms.
    """

    error: dict[str, list[Array]]
    density: dict[str, list[Array]]
    cost: dict[str, list[float]]
    batch: Array


def _errors(asked: Asked) -> _Errors:
    """Follow the same simulated drivers with every filter, and fit them all afterwards."""
    error: dict[str, list[Array]] = {name: [] for name in _FILTERS}
    density: dict[str, list[Array]] = {name: [] for name in _FILTERS}
    cost: dict[str, list[float]] = {name: [] for name in _FILTERS}
    batch = []
    for drivers, t in jams(_SPREAD, asked.runs, asked.seed, DURATION_S):
        truth = np.log(drivers[:, list(PLACES)])
        for name in _FILTERS:
            jobs = [(t, i, name, asked.seed) for i in range(CARS)]
            for i, found in enumerate(asked.work.map(_follow, jobs)):
                error[name].append(found.logs - truth[i])
                density[name].append(found.log_likelihood[SETTLING + 2 :])
                cost[name].append(found.step_s)
        fits = each_driver(t, Settings(), work=asked.work)
        batch.append(np.log(fits.rows[:, list(PLACES)]) - truth)
    return _Errors(error, density, cost, np.concatenate(batch))


def _answer(asked: Asked) -> Answer:
    """Compare errors of v* and kappa_v over time, log-likelihoods and cost of the filters on the same drivers."""
    found = _errors(asked)
    root = {name: np.sqrt(np.mean(np.square(e), axis=0)) for name, e in found.error.items()}
    last = len(next(iter(root.values()))) - 1
    at = [(time_s, min(round(time_s / DURATION_S * last), last)) for time_s in _TIMES_S]
    rows: list[Row] = [
        {
            "filter": name,
            **{f"v* {s:g} s [%]": 100.0 * root[name][k, 0] for s, k in at},
            **{f"kappa_v {s:g} s [%]": 100.0 * root[name][k, 1] for s, k in at},
            "nats per sample": float(np.nanmean(found.density[name])),
            "ms per step": 1e3 * float(np.median(found.cost[name])),
            "drivers": len(found.error[name]),
        }
        for name in _FILTERS
    ]
    ends = np.sqrt(np.mean(np.square(found.batch), axis=0))
    rows.append({"filter": "batch fit of 250 s", "v* 250 s [%]": 100.0 * ends[0], "kappa_v 250 s [%]": 100.0 * ends[1]})

    def draw(figure: Any) -> None:
        for j, (axes, parameter) in enumerate(zip(figure.subplots(1, 2), ("v*", "kappa_v"), strict=True)):
            for name, of in root.items():
                axes.plot(DURATION_S * np.arange(len(of)) / (len(of) - 1), 100.0 * of[:, j], label=name)
            axes.axhline(100.0 * ends[j], color="black", linestyle="--", label="batch fit of 250 s")
            axes.set(xlabel="time [s]", ylabel="error [%]", title=parameter, ylim=(0.0, None))
        axes.legend()

    return Answer(tuple(rows), draw)


STUDY = Study(
    name="filters",
    question="Which filter learns a driver's preferences best while they drive?",
    paper="Inference while people drive is left to later work (outlook).",
    answer=_answer,
)
