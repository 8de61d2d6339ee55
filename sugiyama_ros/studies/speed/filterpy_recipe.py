"""The paper's recipe in plain Python, for comparison: filterpy, numpy, and the search of scipy."""

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.optimize import minimize

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, SIGMA_A, defaults
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.filters import paper
from sugiyama_ros.fit.smooth_positions import ESTIMATED

#: Places of the estimated parameters in a driver's row.
PLACES = [NAMES.index(name) for name in ESTIMATED]


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
