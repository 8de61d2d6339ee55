"""Is what estimators learn while they drive along as good as a fit of all samples afterwards?"""

from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, index
from sugiyama_ros.effects.registry import switch_on, whole
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.fit.driver import ESTIMATED
from sugiyama_ros.studies.rings import CARS, Ring, alike, jams, run
from sugiyama_ros.studies.study import Answer, Asked, Row, Study
from sugiyama_ros.trajectories.trajectories import Trajectories

_PLACES = [index(name) for name in ESTIMATED]
_DURATION_S, _TIMES_S = 250.0, (60.0, 120.0, 250.0)
# Std of the logarithms over the simulated drivers.
_SPREAD = {SIGMA_NU: 0.08, SIGMA_A: 0.15, V_STAR: 0.08, KAPPA_V: 0.2}
# A desired speed that falls, when, and on which roads; from where on it is told in time.
_FACTOR, _SWITCH_S, _RINGS_M, _SOON_S = 0.85, 100.0, (230.0, 400.0), 25.0


def followed(job: tuple[Trajectories, int]) -> tuple[Array, Array, Array, list[tuple[float, str]]]:
    """Of a driver: parameters (T, 4), std of their logarithms, log-likelihoods (T,), changes told, with time [s]."""
    trajectories, driver = job
    chain = chain_behind(trajectories, driver)
    online = OnlineFilter(trajectories.period_s, trajectories.road)
    values, stds, density, told = [], [], [], []
    for k, sample in enumerate(zip(chain.position_m, chain.identity, chain.length_m, strict=True)):
        estimate = online.step(*sample, trajectories.start_s + k * trajectories.period_s)
        values.append(online.parameters[_PLACES])
        stds.append(np.sqrt(np.diag(online.learnt.covariance)))
        density.append(estimate.log_likelihood if estimate.scored else np.nan)
        if online.change_of_style is not None:
            told.append((k * trajectories.period_s, online.change_of_style[0]))
    return np.array(values), np.array(stds), np.array(density), told


def convergence(asked: Asked) -> Answer:
    """Errors over time beside the batch fit's, of simulated drivers; of measured ones, the predictive likelihood."""
    errors, scaled, batch_errors = [], [], []
    for drivers, t in jams(_SPREAD, asked.runs, asked.seed, _DURATION_S):
        values, stds, _, _ = zip(*asked.work.map(followed, [(t, i) for i in range(CARS)]), strict=True)
        error = np.log(np.array(values) / drivers[:, None, _PLACES])
        errors.append(error)
        scaled.append(error / np.array(stds))
        fits = each_driver(t, Settings(), work=asked.work).rows[:, _PLACES]
        batch_errors.append(np.log(fits / drivers[:, _PLACES]))
    error, z, batch = np.concatenate(errors), np.concatenate(scaled), np.concatenate(batch_errors)
    root = np.sqrt(np.mean(np.square(error), axis=0))
    root_batch = np.sqrt(np.mean(np.square(batch), axis=0))
    period_s = _DURATION_S / (error.shape[1] - 1)
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


def _measured(asked: Asked, t: Trajectories) -> Row:
    """Log-likelihood per sample, predicted online, beside that of the batch fit on the samples it was fitted to."""
    density = [d for _, _, d, _ in asked.work.map(followed, [(t, i) for i in range(len(t.vehicle))])]
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


def changes(asked: Asked) -> Answer:
    """Every third driver's desired speed falls by 15 %: whether and how soon that is told, and what of the others."""
    rows: list[Row] = []
    delays: dict[float, list[float]] = {}
    for ring_m in _RINGS_M:
        slowed, soon, others, hours, delays[ring_m] = 0, 0, 0, 0.0, []
        for k in range(asked.runs):
            who = np.arange(CARS) % 3 == 0
            pairs = []
            for factor in (1.0, _FACTOR):
                change = {"v_star_change": float(np.log(factor)), "kappa_v_change": 1e-9, "time": _SWITCH_S}
                drivers = whole(alike())
                drivers[who] = switch_on(drivers, "preference_switch", change)[who]
                ring = Ring(drivers, asked.seed + k, jammed=ring_m == _RINGS_M[0], duration_s=200.0, ring_m=ring_m)
                pairs.append(run(ring))
            same, switched = pairs
            if same.collisions or switched.collisions:
                continue
            t = switched.measured
            after = slice(round(_SWITCH_S / t.period_s), round((_SWITCH_S + _SOON_S) / t.period_s))
            # with the same random numbers, who could not have driven faster drives as he would have done
            room = np.mean(same.speed[after] - switched.speed[after], axis=0) > 0.5
            for i, (_, _, _, told) in enumerate(asked.work.map(followed, [(t, i) for i in range(CARS)])):
                first = next((s for s, name in told if s >= _SWITCH_S and name == "v_star"), np.inf) - _SWITCH_S
                if who[i] and room[i]:
                    slowed += 1
                    soon += first <= _SOON_S
                    delays[ring_m].append(first)
                others += sum(not who[i] or s < _SWITCH_S for s, _ in told)
                hours += (t.duration_s if not who[i] else _SWITCH_S) / 3600.0
        rows.append(
            {
                "ring [m]": ring_m,
                "slowed": slowed,
                "told within 25 s": soon,
                "share": soon / max(slowed, 1),
                "median delay [s]": float(np.median(delays[ring_m])) if slowed else np.nan,
                "false alarms": others,
                "driver-hours": hours,
            }
        )

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for ring_m, of in delays.items():
            axes.hist(np.minimum(of, 100.0), bins=np.arange(0.0, 101.0, 2.5), alpha=0.6, label=f"{ring_m:g} m")
        axes.set(xlabel="time until the change is told [s]; 100: not at all", ylabel="drivers")
        axes.legend()

    return Answer(tuple(rows), draw)


STUDIES = (
    Study(
        "online",
        "How soon does an estimator know a driver as well as a fit of 250 s does?",
        "Its outlook: inference while people drive is left to later work.",
        convergence,
    ),
    Study(
        "style-change",
        "Is a driver noticed who wants to go slower from now on?",
        "Its outlook: to learn a driver's style in real time is left to later work.",
        changes,
    ),
)
