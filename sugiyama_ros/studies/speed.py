"""How fast the calibration is, compared with other ways to calibrate on the same machine.

    python -m sugiyama_ros.studies.speed [--many 10000]

The paper's recipe is a Kalman filter of filterpy in a Python loop, with the mean action in numpy. The search is scipy's
L-BFGS-B with difference quotients. Basinhopping repeats the search a hundred times; its time is extrapolated. The other
comparison is with the compiled filter and the search of statsmodels, with the same matrices.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.driver.utility import ACTIONS, FORWARD
from sugiyama_ros.filters import causal, paper
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.fit.driver import calibrate
from sugiyama_ros.formats.mcap_writer import BagWriter
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate
from sugiyama_ros.studies.plain_recipes import PLACES, OfStatsmodels, plain_fit, plain_likelihood, start_parameters
from sugiyama_ros.studies.rings import Ring, alike, run
from sugiyama_ros.trajectories.trajectories import Trajectories
from sugiyama_ros.workers import workers

_HOPS = 100
_DURATION_S, _MANY_DURATION_S, _CARS_IN_A_ROW = 250.0, 60.0, 22


def best_of(times: int, function: Callable[[], Any]) -> float:
    """Measure the shortest time [s] of several calls of a function, after a first call that does not count."""
    function()
    spans = []
    for _ in range(times):
        began = time.perf_counter()
        function()
        spans.append(time.perf_counter() - began)
    return min(spans)


def floor(perceived: paper.Perceived) -> float:
    """Measure the time [s] that numpy needs for the exponentials of one likelihood.

    Each action takes three exponentials at each moment: two for the utility and one for the weight. An action that
    ends at a low speed takes a fourth exponential.
    """
    slow = perceived.speed[:, None] + perceived.period_s * ACTIONS < FORWARD
    x = -np.random.default_rng(0).uniform(0.0, 10.0, 3 * slow.size + int(slow.sum()))
    out = np.empty_like(x)
    return best_of(50, lambda: np.exp(x, out=out))


def compared_with_others(t: Trajectories, found: dict[str, float]) -> dict[str, float]:
    """Measure local fits of one driver by filterpy and by statsmodels, and compare them with our fits of all drivers.

    Parameters
    ----------
    t : Trajectories
        Simulated drivers.
    found : dict
        Times of our likelihoods and fits [s].

    Returns
    -------
    dict
        Times [s], differences of log-likelihoods, and ratios.
    """
    perceived = paper.perceive(t, 3)
    began = time.perf_counter()
    local = plain_fit(perceived)
    plain_s = time.perf_counter() - began
    ours = next(fit for fit in calibrate(t, "paper") if fit.vehicle == 3)
    other = OfStatsmodels(perceived)
    difference = other.without_2_pi(other.loglike(other.start_params)) - plain_likelihood(perceived, start_parameters())
    assert abs(difference) < 1e-6, difference
    likelihood_s = best_of(3, lambda: other.loglike(other.start_params))
    began = time.perf_counter()
    searched = other.fit(method="lbfgs", optim_complex_step=False, cov_type="none", disp=False)
    statsmodels_s = time.perf_counter() - began
    cars = len(t.vehicle)
    faster = cars * plain_s / found["fit_22_paper_s"]
    return {
        "plain_fit_s": plain_s,
        "log_likelihood_ours_minus_plain": ours.log_likelihood - local,
        "statsmodels_likelihood_s": likelihood_s,
        "statsmodels_fit_s": statsmodels_s,
        "log_likelihood_ours_minus_statsmodels": ours.log_likelihood - other.without_2_pi(searched.llf),
        "times_faster_than_a_local_fit_of_statsmodels": cars * statsmodels_s / found["fit_22_paper_s"],
        "likelihood_over_floor": found["likelihood_with_gradient_s"] / found["floor_s"],
        "times_faster_than_a_local_plain_fit": faster,
        "times_faster_than_basinhopping": _HOPS * faster,
    }


def main() -> None:
    """Measure all times and print them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--many", type=int, default=0, help="number of drivers of 60 s to calibrate (causal)")
    given = parser.parse_args()
    t = run(Ring(alike(), 4, jammed=True, duration_s=_DURATION_S)).measured
    perceived, p = paper.perceive(t, 3), defaults()
    chain = chain_behind(t, 3)
    found: dict[str, float] = {
        "floor_s": floor(perceived),
        "likelihood_with_gradient_s": best_of(50, lambda: paper.score(perceived, p, PLACES)),
        "causal_likelihood_s": best_of(20, lambda: causal.log_likelihood(chain, p)),
        "plain_likelihood_s": best_of(3, lambda: plain_likelihood(perceived, p)),
    }
    difference = plain_likelihood(perceived, p) - paper.log_likelihood(perceived, p)[0]
    assert abs(difference) < 1e-6, difference
    with ThreadPoolExecutor(4) as work:
        found["fit_22_paper_s"] = best_of(5, lambda: list(calibrate(t, "paper", work=work)))
        found["fit_22_causal_s"] = best_of(1, lambda: each_driver(t, Settings(), work=work))
    found |= compared_with_others(t, found)
    cars = len(t.vehicle)
    simulator = Simulator(
        alike(), np.full(cars, 4.33), platoon(np.full(cars, 4.33), 2.0), Road(230.0), np.random.default_rng(0)
    )
    found["vehicle_steps_per_s"] = cars * 200 / best_of(1, lambda: [simulator.step() for _ in range(200)])
    found["messages_written_per_s"] = messages_written_per_s()
    if given.many:
        found["many"], found["many_s"] = float(given.many), many(given.many)
    print(json.dumps(found, indent=2))


def messages_written_per_s(count: int = 50_000, size_bytes: int = 100) -> float:
    """Measure how many messages a bag takes in a second of processor time; at least 150,000 are required.

    Parameters
    ----------
    count : int
        Number of messages.
    size_bytes : int
        Size of a message [bytes].
    """
    with tempfile.TemporaryDirectory() as directory, BagWriter(Path(directory) / "a.mcap") as bag:
        channel = bag.topic("/header", "std_msgs/msg/Header")
        data = bytes(size_bytes)
        began = time.process_time()
        for k in range(count):
            bag.write(channel, data, k, k)
        return count / (time.process_time() - began)


def many(drivers: int) -> float:
    """Measure the time [s] to calibrate many drivers of 60 s in the causal formulation.

    Parameters
    ----------
    drivers : int
        Number of drivers.
    """
    length = np.full(drivers, 4.33)
    # groups of cars with space between them: each group makes its own wave
    gap = np.where(np.arange(drivers) % _CARS_IN_A_ROW == _CARS_IN_A_ROW - 1, 120.0, 6.0)
    start = np.cumsum(length + gap) - length - gap
    ring = Ring(alike(drivers), 1, duration_s=_MANY_DURATION_S, ring_m=float(start[-1] + length[-1] + gap[-1]))
    simulator = Simulator(ring.drivers, length, start, Road(ring.ring_m), np.random.default_rng(1))
    measured = simulate(simulator, ring.duration_s, stop_at_collision=False).measured
    began = time.perf_counter()
    with workers(drivers) as work:
        each_driver(measured, Settings(), work=work)
    return time.perf_counter() - began


if __name__ == "__main__":
    main()
