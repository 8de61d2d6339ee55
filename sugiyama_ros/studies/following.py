"""What an estimator learns of one driver, sample by sample."""

from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.trajectories.trajectories import Trajectories

_PLACES = [index(name) for name in ESTIMATED]


class Followed(NamedTuple):
    """What an estimator learns of one driver over T samples.

    parameters: (T, 4), the driver's parameters after each sample, in the order of ``ESTIMATED``; log_std: (T, 4), std
    of the logarithms of the parameters; log_likelihood: (T,), log-likelihood of each sample; naN where the sample does
    not count; changes: reported changes of style: time [s] since the first sample, and name of the parameter.
    """

    parameters: Array
    log_std: Array
    log_likelihood: Array
    changes: list[tuple[float, str]]


def followed(job: tuple[Trajectories, int]) -> Followed:
    """Run the filter of the estimator nodes on all samples of one driver."""
    trajectories, driver = job
    chain = chain_behind(trajectories, driver)
    online = OnlineFilter(trajectories.period_s, trajectories.road)
    parameters, log_std, log_likelihood, reported = [], [], [], []
    for k, sample in enumerate(zip(chain.position_m, chain.identity, chain.length_m, strict=True)):
        estimate = online.step(*sample, trajectories.start_s + k * trajectories.period_s)
        parameters.append(online.parameters[_PLACES])
        log_std.append(np.sqrt(np.diag(online.learnt.covariance)))
        log_likelihood.append(estimate.log_likelihood if estimate.scored else np.nan)
        if online.change_of_style is not None:
            reported.append((k * trajectories.period_s, online.change_of_style[0]))
    return Followed(np.array(parameters), np.array(log_std), np.array(log_likelihood), reported)
