"""Is what estimators learn while people drive as good as a fit of all samples afterwards?"""

from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, index
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.studies.rings import CARS, jams
from sugiyama_ros.studies.study import Answer, Asked, Row, Study
from sugiyama_ros.trajectories.dense import DenseTracks

#: Duration [s] of a simulated run.
DURATION_S = 250.0
_TIMES_S = (60.0, 120.0, 250.0)
_PLACES = [index(name) for name in ESTIMATED]
# Std of the logarithms over the simulated drivers.
_SPREAD = {SIGMA_NU: 0.08, SIGMA_A: 0.15, V_STAR: 0.08, KAPPA_V: 0.2}


class _FollowedDriver(NamedTuple):
    """What an estimator learns of one driver over T samples.

    parameters: (T, 4), the driver's parameters after each sample, in the order of ``ESTIMATED``; log_std: (T, 4), std
    of the logarithms of the parameters; log_likelihood: (T,), log-likelihood of each sample; NaN where the sample does
    not count; changes: reported changes of style: time [s] since the first sample, and name of the parameter.
    """

    parameters: Array
    log_std: Array
    log_likelihood: Array
    changes: list[tuple[float, str]]


def followed(job: tuple[DenseTracks, int]) -> _FollowedDriver:
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
    return _FollowedDriver(np.array(parameters), np.array(log_std), np.array(log_likelihood), reported)


def _answer(asked: Asked) -> Answer:
    """Compare the errors of the estimators over time with the errors of a batch fit, on simulated drivers.

    The true parameters of measured drivers are unknown, so for them the study compares predictive likelihoods.
    """
    errors, scaled, batch_errors = [], [], []
    for simulated in jams(_SPREAD, asked.runs, asked.seed, DURATION_S):
        drivers, t = simulated.parameters, simulated.dense
        values, stds, _, _ = zip(*asked.work.map(followed, [(t, i) for i in range(CARS)]), strict=True)
        error = np.log(np.array(values) / drivers[:, None, _PLACES])
        errors.append(error)
        scaled.append(error / np.array(stds))
        fits = each_driver(t, Settings(), work=asked.work).rows[:, _PLACES]
        batch_errors.append(np.log(fits / drivers[:, _PLACES]))
    error, z, batch = np.concatenate(errors), np.concatenate(scaled), np.concatenate(batch_errors)
    root = np.sqrt(np.mean(np.square(error), axis=0))
    root_batch = np.sqrt(np.mean(np.square(batch), axis=0))
    period_s = DURATION_S / (error.shape[1] - 1)
    rows: list[Row] = [
        {
            "parameter": name,
            "after [s]": time_s,
            "error [%]": 100.0 * root[k, j],
            "batch, 250 s [%]": 100.0 * root_batch[j],
            "ratio": root[k, j] / root_batch[j],
            "coverage of 95 %": float(np.mean(np.abs(z[:, k, j]) < 1.96)),
            "drivers": len(error),
        }
        for j, name in enumerate(ESTIMATED)
        for time_s in _TIMES_S
        for k in [min(round(time_s / period_s), error.shape[1] - 1)]
    ]
    if asked.trajectories is not None:
        rows.append(_measured(asked, asked.trajectories))

    def draw(figure: Any) -> None:
        time_s = period_s * np.arange(error.shape[1])
        for j, (axes, name) in enumerate(zip(figure.subplots(2, 2).ravel(), ESTIMATED, strict=True)):
            axes.plot(time_s, 100.0 * root[:, j], label="online")
            axes.axhline(100.0 * root_batch[j], color="black", linestyle="--", label="batch fit of 250 s")
            axes.set(xlabel="time [s]", ylabel="error [%]", title=name, ylim=(0.0, None))
        axes.legend()

    return Answer(tuple(rows), draw)


def _measured(asked: Asked, t: DenseTracks) -> Row:
    """Compare log-likelihoods per sample: predicted online, and of a batch fit of the same samples."""
    density = [one.log_likelihood for one in asked.work.map(followed, [(t, i) for i in range(len(t.vehicle))])]
    scored = int(sum(np.isfinite(d).sum() for d in density))
    fitted = float(each_driver(t, Settings(), work=asked.work).log_likelihood.sum()) / scored
    predicted = float(sum(np.nansum(d) for d in density)) / scored
    return {
        "parameter": "measured: nats per sample",
        "after [s]": t.duration_s,
        "online": predicted,
        "batch, in sample": fitted,
        "below it [%]": 100.0 * (1.0 - predicted / fitted),
        "drivers": len(density),
    }


STUDY = Study(
    name="online",
    question="How soon does an estimator know a driver as well as a fit of 250 s does?",
    paper="Inference while people drive is left to later work (outlook).",
    answer=_answer,
)
