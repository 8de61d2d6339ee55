"""The paper's calibration by other means: filterpy with numpy, and statsmodels.

The recipe with filterpy is a Kalman filter in a Python loop, with the mean action in numpy and scipy's L-BFGS-B with
difference quotients. statsmodels has a compiled filter and its own search, and gets the same matrices.
"""

from itertools import islice
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.optimize import minimize
from statsmodels.tsa.statespace.mlemodel import MLEModel

from benchmarks.speed.parts import DRIVER
from benchmarks.speed.timing import SpeedFigure, cpu_of_functions, jam
from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, SIGMA_A, defaults
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.filters import paper
from sugiyama_ros.fit.driver import carry_out, jobs
from sugiyama_ros.fit.smooth_positions import ESTIMATED

#: Places of the estimated parameters in a driver's row.
PLACES = [NAMES.index(name) for name in ESTIMATED]
_HOPS = 100
# Largest difference of two log-likelihoods that are the same function [nats].
_ALIKE = 1e-6


def start_parameters() -> Array:
    """Make the parameters, shape (P,), at which the searches begin."""
    start = defaults()
    start[SIGMA_A] = 1.0
    return start


def plain_actions(perceived: paper.Perceived, p: Array) -> Array:
    """Compute mean actions in numpy, straight from the paper's formulas.

    p: (P,), parameters of the driver. Returns (T',), mean actions [m/s^2].
    """
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
    """Compute the log-likelihood (Eq. SSM_Likelihood) with filterpy.

    p: (P,), parameters of the driver.
    """
    action = plain_actions(perceived, p)
    q = dict(zip(NAMES, p.tolist(), strict=True))
    kalman = KalmanFilter(dim_x=3, dim_z=1, dim_u=1)
    kalman.x = np.array([[perceived.measured_m[0]], [perceived.speed[0]], [0.0]])
    kalman.P = np.eye(3)
    kalman.F, kalman.H = paper.phi(q["rho"], perceived.period_s), paper.A
    kalman.B, kalman.Q, kalman.R = (
        np.array([[0.0], [0.0], [1.0]]),
        paper.omega(p),
        np.array([[q["sigma_nu"] ** 2]]),
    )
    total = 0.0
    for t, z in enumerate(perceived.measured_m):
        if t:
            kalman.predict(u=np.array([[action[t] - q["rho"] * action[t - 1]]]))
        kalman.update(z)
        if t >= paper.UNSCORED:
            total -= 0.5 * (np.log(kalman.S[0, 0]) + kalman.y[0, 0] ** 2 / kalman.S[0, 0])
    return float(total)


def plain_fit(perceived: paper.Perceived) -> float:
    """Run one local search of the paper's recipe; the largest log-likelihood is returned."""
    start = start_parameters()

    def negative(logarithms: Array) -> float:
        p = start.copy()
        p[PLACES] = np.exp(logarithms)
        return -plain_likelihood(perceived, p)

    return -float(minimize(negative, np.log(start[PLACES]), method="L-BFGS-B").fun)


class StatsmodelsDriver(MLEModel):  # type: ignore[misc]
    """The paper's model of one driver in statsmodels, with logarithms of the estimated parameters.

    perceived: what the driver perceives.
    """

    def __init__(self, perceived: paper.Perceived) -> None:
        start = np.array([perceived.measured_m[0], perceived.speed[0], 0.0])
        super().__init__(perceived.measured_m, k_states=3, loglikelihood_burn=paper.UNSCORED)
        self._perceived = perceived
        self.ssm.initialize_known(start, np.eye(3))
        self["design"], self["selection"] = paper.A, np.eye(3)
        self["state_intercept"] = np.zeros((3, len(perceived.measured_m)))

    @property
    def start_params(self) -> Array:
        """Logarithms of the parameters at which the search begins."""
        return np.asarray(np.log(start_parameters()[PLACES]))

    def update(self, params: Array, **kwargs: Any) -> None:
        """Set the matrices of the model for these logarithms of the parameters."""
        params = super().update(params, **kwargs)
        p = defaults()
        p[PLACES] = np.exp(params)
        q = dict(zip(NAMES, p, strict=True))
        self["transition"] = paper.phi(q["rho"], self._perceived.period_s)
        self["state_cov"], self["obs_cov"] = paper.omega(p), np.array([[q["sigma_nu"] ** 2]])
        action = plain_actions(self._perceived, p)
        self["state_intercept", 2, :-1] = action[1:] - q["rho"] * action[:-1]

    def without_2_pi(self, log_likelihood: float) -> float:
        """Convert the log-likelihood of statsmodels to the paper's (Eq. SSM_Likelihood), which has no 2 pi term."""
        return log_likelihood + 0.5 * (len(self._perceived.measured_m) - paper.UNSCORED) * float(np.log(2.0 * np.pi))


def peers() -> tuple[SpeedFigure, ...]:
    """The paper's calibration by other means: filterpy with numpy, and statsmodels.

    The recipe with filterpy is a Kalman filter in a Python loop, with the mean action in numpy and scipy's L-BFGS-B
    with difference quotients. statsmodels has a compiled filter and its own search, and gets the same matrices.
    """
    t = jam()
    perceived, p = paper.perceive(t, DRIVER), defaults()
    other = StatsmodelsDriver(perceived)
    start = start_parameters()
    check("filterpy", plain_likelihood(perceived, p), paper.log_likelihood(perceived, p)[0])
    check(
        "statsmodels",
        other.without_2_pi(other.loglike(other.start_params)),
        paper.log_likelihood(perceived, start)[0],
    )
    search = next(islice(jobs(t, "paper", ESTIMATED), DRIVER, None))
    one = cpu_of_functions(
        {
            "ours": lambda: paper.score(perceived, p, PLACES),
            "filterpy": lambda: plain_likelihood(perceived, p),
            "statsmodels": lambda: other.loglike(other.start_params),
        },
        rounds=5,
    )
    fit = cpu_of_functions(
        {
            "ours": lambda: carry_out(search),
            "filterpy": lambda: plain_fit(perceived),
            "statsmodels": lambda: other.fit(method="lbfgs", optim_complex_step=False, cov_type="none", disp=False),
        },
        rounds=2,
    )
    ours = "over ours with gradient and information"
    by_filterpy, by_statsmodels = fit["filterpy"] / fit["ours"], fit["statsmodels"] / fit["ours"]
    return (
        SpeedFigure("filterpy_likelihood", f"likelihood by filterpy and numpy {ours}", one["filterpy"] / one["ours"]),
        SpeedFigure("statsmodels_likelihood", f"likelihood by statsmodels {ours}", one["statsmodels"] / one["ours"]),
        SpeedFigure("filterpy_fit", "search of one driver by filterpy, numpy and L-BFGS-B over ours", by_filterpy),
        SpeedFigure("statsmodels_fit", "search of one driver by statsmodels and its L-BFGS over ours", by_statsmodels),
        SpeedFigure(
            "basinhopping_fit",
            f"basinhopping with {_HOPS} such searches by filterpy, extrapolated",
            _HOPS * by_filterpy,
        ),
    )


def check(who: str, theirs: float, ours: float) -> None:
    """Raise RuntimeError if two log-likelihoods [nats] differ.

    who: whose log-likelihood ``theirs`` is; theirs, ours: log-likelihoods [nats].
    """
    if not abs(theirs - ours) < _ALIKE:
        raise RuntimeError(f"the log-likelihood of {who} is {theirs - ours:g} nats above ours")
