"""The paper's model of one driver in statsmodels, for comparison."""

from typing import Any

import numpy as np
from statsmodels.tsa.statespace.mlemodel import MLEModel

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, defaults
from sugiyama_ros.filters import paper
from sugiyama_ros.studies.speed.filterpy_recipe import PLACES, plain_actions, start_parameters


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
