"""How fast the calibration is: everything timed in one run on one machine, and told as ratios.

    python -m sugiyama_ros.studies.speed [--many 10000]

The paper's recipe is a Kalman filter of filterpy in a Python loop, with the mean action by numpy, under scipy's
L-BFGS-B with difference quotients; basinhopping repeats that a hundred times, which is extrapolated. Another user would
take statsmodels' compiled filter and its own search, with the same matrices.
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
from filterpy.kalman import KalmanFilter
from scipy.optimize import minimize
from statsmodels.tsa.statespace.mlemodel import MLEModel

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import NAMES, SIGMA_A, defaults
from sugiyama_ros.driver.utility import ACTIONS, FORWARD
from sugiyama_ros.filters import causal, paper, paper_kalman
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.fit.driver import ESTIMATED, calibrate
from sugiyama_ros.formats.mcap_writer import BagWriter
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate
from sugiyama_ros.studies.rings import Ring, alike, run
from sugiyama_ros.workers import workers

_HOPS = 100
_DURATION_S, _MANY_DURATION_S, _CARS_IN_A_ROW = 250.0, 60.0, 22
_PLACES = [NAMES.index(name) for name in ESTIMATED]


def _start() -> Array:
    """Parameters (P,) from which the searches begin."""
    start = defaults()
    start[SIGMA_A] = 1.0
    return start


def best_of(times: int, function: Callable[[], Any]) -> float:
    """Shortest time [s] of several, after one that does not count."""
    function()
    spans = []
    for _ in range(times):
        began = time.perf_counter()
        function()
        spans.append(time.perf_counter() - began)
    return min(spans)


def plain_actions(perceived: paper.Perceived, p: Array) -> Array:
    """Mean actions (T',) by numpy, straight from the paper's formulas."""
    q = dict(zip(NAMES, p.tolist(), strict=True))
    dt, a = perceived.period_s, ACTIONS[None, :]
    gap, v, ahead = perceived.gap_m[:, None], perceived.speed[:, None], perceived.leader_speed[:, None]
    speed = v + dt * a
    reward = np.exp(-(((speed - q["v_star"]) / (q["kappa_1"] * q["v_star"])) ** 2))
    reward -= np.exp(np.minimum(-10.0 * (speed + 0.25), 600.0))
    risk = np.zeros_like(reward)
    for tau in range(1, 5):
        later = v + tau * dt * a
        distance = gap + dt * tau * (ahead - v) - dt * dt * a * (0.5 * tau * (tau - 1))
        scale = q["kappa_c"] + q["kappa_v"] * np.abs(later) + q["kappa_d"] * np.maximum(later - ahead, 0.0)
        ratio = np.maximum(distance / scale, 0.0)
        risk = np.maximum(risk, np.exp(-ratio * (ratio + 2.0)))
    utility = reward + q["omega_2"] * risk
    weight = np.exp(q["rationality"] * (utility - utility.max(axis=1, keepdims=True)))
    return np.asarray((weight @ ACTIONS) / weight.sum(axis=1))


def plain_likelihood(perceived: paper.Perceived, p: Array) -> float:
    """Eq. SSM_Likelihood by filterpy."""
    action = plain_actions(perceived, p)
    q = dict(zip(NAMES, p.tolist(), strict=True))
    kalman = KalmanFilter(dim_x=3, dim_z=1, dim_u=1)
    kalman.x = np.array([[perceived.measured_m[0]], [perceived.speed[0]], [0.0]])
    kalman.P = np.eye(3)
    kalman.F, kalman.H = paper_kalman.phi(q["rho"], perceived.period_s), paper_kalman.A
    kalman.B, kalman.Q, kalman.R = (
        np.array([[0.0], [0.0], [1.0]]),
        paper_kalman.omega(p),
        np.array([[q["sigma_nu"] ** 2]]),
    )
    total = 0.0
    for t, z in enumerate(perceived.measured_m):
        if t:
            kalman.predict(u=np.array([[action[t] - q["rho"] * action[t - 1]]]))
        kalman.update(z)
        if t >= paper_kalman.UNSCORED:
            total -= 0.5 * (np.log(kalman.S[0, 0]) + kalman.y[0, 0] ** 2 / kalman.S[0, 0])
    return float(total)


def plain_fit(perceived: paper.Perceived) -> float:
    """One local search of the paper's recipe; its log-likelihood."""
    start = _start()

    def negative(logarithms: Array) -> float:
        p = start.copy()
        p[_PLACES] = np.exp(logarithms)
        return -plain_likelihood(perceived, p)

    return -float(minimize(negative, np.log(start[_PLACES]), method="L-BFGS-B").fun)


class OfStatsmodels(MLEModel):  # type: ignore[misc]
    """The same model by statsmodels, with the logarithms of the estimated parameters."""

    def __init__(self, perceived: paper.Perceived) -> None:
        start = np.array([perceived.measured_m[0], perceived.speed[0], 0.0])
        super().__init__(perceived.measured_m, k_states=3, loglikelihood_burn=paper_kalman.UNSCORED)
        self._perceived = perceived
        self.ssm.initialize_known(start, np.eye(3))
        self["design"], self["selection"] = paper_kalman.A, np.eye(3)
        self["state_intercept"] = np.zeros((3, len(perceived.measured_m)))

    @property
    def start_params(self) -> Array:
        return np.asarray(np.log(_start()[_PLACES]))

    def update(self, params: Array, **kwargs: Any) -> None:
        params = super().update(params, **kwargs)
        p = defaults()
        p[_PLACES] = np.exp(params)
        q = dict(zip(NAMES, p, strict=True))
        self["transition"] = paper_kalman.phi(q["rho"], self._perceived.period_s)
        self["state_cov"], self["obs_cov"] = paper_kalman.omega(p), np.array([[q["sigma_nu"] ** 2]])
        action = plain_actions(self._perceived, p)
        self["state_intercept", 2, :-1] = action[1:] - q["rho"] * action[:-1]

    def without_2_pi(self, log_likelihood: float) -> float:
        """Eq. SSM_Likelihood, from what statsmodels calls the log-likelihood."""
        return log_likelihood + 0.5 * (len(self._perceived.measured_m) - paper_kalman.UNSCORED) * float(
            np.log(2.0 * np.pi)
        )


def floor(perceived: paper.Perceived) -> float:
    """Time [s] of the exponentials of one likelihood in one call of numpy.

    At each moment each action takes three (both terms of the utility, the weight), and where it ends slow a fourth.
    """
    slow = perceived.speed[:, None] + perceived.period_s * ACTIONS < FORWARD
    x = -np.random.default_rng(0).uniform(0.0, 10.0, 3 * slow.size + int(slow.sum()))
    out = np.empty_like(x)
    return best_of(50, lambda: np.exp(x, out=out))


def main() -> None:
    """Measure, and print one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--many", type=int, default=0, help="drivers of 60 s to calibrate, causal")
    given = parser.parse_args()
    t = run(Ring(alike(), 4, jammed=True, duration_s=_DURATION_S)).measured
    perceived, p = paper.perceive(t, 3), defaults()
    chain = chain_behind(t, 3)
    found: dict[str, float] = {
        "floor_s": floor(perceived),
        "likelihood_with_gradient_s": best_of(50, lambda: paper.score(perceived, p, _PLACES)),
        "causal_likelihood_s": best_of(20, lambda: causal.log_likelihood(chain, p)),
        "plain_likelihood_s": best_of(3, lambda: plain_likelihood(perceived, p)),
    }
    difference = plain_likelihood(perceived, p) - paper.log_likelihood(perceived, p)[0]
    assert abs(difference) < 1e-6, difference
    with ThreadPoolExecutor(4) as work:
        found["fit_22_paper_s"] = best_of(5, lambda: list(calibrate(t, "paper", work=work)))
        found["fit_22_causal_s"] = best_of(1, lambda: each_driver(t, Settings(), work=work))
    began = time.perf_counter()
    local = plain_fit(perceived)
    found["plain_fit_s"] = time.perf_counter() - began
    ours = next(fit for fit in calibrate(t, "paper") if fit.vehicle == 3)
    found["log_likelihood_ours_minus_plain"] = ours.log_likelihood - local
    other = OfStatsmodels(perceived)
    difference = other.without_2_pi(other.loglike(other.start_params)) - plain_likelihood(perceived, _start())
    assert abs(difference) < 1e-6, difference
    found["statsmodels_likelihood_s"] = best_of(3, lambda: other.loglike(other.start_params))
    began = time.perf_counter()
    searched = other.fit(method="lbfgs", optim_complex_step=False, cov_type="none", disp=False)
    found["statsmodels_fit_s"] = time.perf_counter() - began
    found["log_likelihood_ours_minus_statsmodels"] = ours.log_likelihood - other.without_2_pi(searched.llf)
    cars = len(t.vehicle)
    found["times_faster_than_a_local_fit_of_statsmodels"] = cars * found["statsmodels_fit_s"] / found["fit_22_paper_s"]
    found["likelihood_over_floor"] = found["likelihood_with_gradient_s"] / found["floor_s"]
    found["times_faster_than_a_local_plain_fit"] = cars * found["plain_fit_s"] / found["fit_22_paper_s"]
    found["times_faster_than_basinhopping"] = _HOPS * found["times_faster_than_a_local_plain_fit"]
    simulator = Simulator(
        alike(), np.full(cars, 4.33), platoon(np.full(cars, 4.33), 2.0), Road(230.0), np.random.default_rng(0)
    )
    found["vehicle_steps_per_s"] = cars * 200 / best_of(1, lambda: [simulator.step() for _ in range(200)])
    found["messages_written_per_s"] = messages_written_per_s()
    if given.many:
        found["many"], found["many_s"] = float(given.many), many(given.many)
    print(json.dumps(found, indent=2))


def messages_written_per_s(count: int = 50_000, size_bytes: int = 100) -> float:
    """Messages that a bag takes in a second of processor time; 150,000 are asked for."""
    with tempfile.TemporaryDirectory() as directory, BagWriter(Path(directory) / "a.mcap") as bag:
        channel = bag.topic("/header", "std_msgs/msg/Header")
        data = bytes(size_bytes)
        began = time.process_time()
        for k in range(count):
            bag.write(channel, data, k, k)
        return count / (time.process_time() - began)


def many(drivers: int) -> float:
    """Time [s] to calibrate so many drivers of 60 s, in the causal formulation."""
    length = np.full(drivers, 4.33)
    # rows of cars with room between them: each makes a wave of its own
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
