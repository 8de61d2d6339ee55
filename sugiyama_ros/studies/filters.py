"""Which filter learns a driver's preferences best while they drive, and what does it cost?"""

import copy
import time
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import (
    KAPPA_V,
    NAMES,
    SIGMA_A,
    SIGMA_NU,
    UTILITY,
    V_STAR,
    at_period,
    defaults,
    population,
)
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.filters.chain import CHAIN, Adaptation, chain_parameters
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import ADAPT, Learnt, OnlineFilter
from sugiyama_ros.filters.predict import linearise_chain
from sugiyama_ros.filters.state import MOVING, STATE, Drivers, State, scene_at, step_for
from sugiyama_ros.filters.update import SETTLING, start_vehicle
from sugiyama_ros.road import Road
from sugiyama_ros.studies.rings import CARS, jams
from sugiyama_ros.studies.study import Answer, Asked, Row, Study
from sugiyama_ros.trajectories.dense import DenseTracks

#: Duration [s] of a simulated run.
DURATION_S = 250.0
_TIMES_S = (60.0, 120.0, 250.0)
# Std of the logarithms over the simulated drivers.
_SPREAD = {V_STAR: 0.08, KAPPA_V: 0.2}
# Places in a driver's row of the parameters that the filters learn.
_PLACES = (V_STAR, KAPPA_V)
#: Number of particles.
PARTICLES = 50
# Share of a particle's parameters that the particle keeps when particles are drawn again (Liu and West).
_OWN = 0.98
# Std of the parameters of a particle, and of the state at a sigma point: both are known, but 0 has no inverse.
_SHARP = 1e-6
# Variance that is added so that the covariance has a Cholesky factor.
_LEAST_VAR = 1e-10


class _LearningFilter(Protocol):
    """A filter that follows one driver, sample by sample.

    It is made of the driver's parameters (P,) at the start, the road, the time [s] between samples, and a generator.
    """

    @property
    def logs(self) -> Array:
        """Logarithms, shape (2,), of v* [m/s] and kappa_v [s] as they are known now."""

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        """Predict one period ahead and take in the next sample.

        position_m: (M,), measured positions [m] of the driver and of the vehicles ahead; identity: (M,), numbers of
        these vehicles; length_m: (M,), lengths [m] of these vehicles.
        """


class _Cubature:
    """The filter of the estimator nodes: preferences in the state, the mean action linearised by cubature."""

    def __init__(self, row: Array, road: Road, period_s: float, _: np.random.Generator) -> None:
        self._filter = OnlineFilter(period_s, road, row, learning=None)

    @property
    def logs(self) -> Array:
        return np.log(self._filter.parameters[list(_PLACES)])

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        return self._filter.step(position_m.tolist(), identity.tolist(), length_m.tolist()).log_likelihood


class _Unscented:
    """A filter with sigma points of the state and the preferences. The vehicles must stay the same.

    References
    ----------
    Julier and Uhlmann, Proc. IEEE 92 (2004) 401.
    """

    def __init__(self, row: Array, road: Road, period_s: float, _: np.random.Generator) -> None:
        self._road, self._scene = road, scene_at(period_s, road.circumference_m, ADAPT.relaxation_s)
        self._rows = at_period(chain_parameters(row, None, CHAIN), period_s)
        self._places, self._prior_var = ADAPT.arrays
        self._prior_mean = np.log(self._rows[0, [UTILITY[k] for k in self._places]])
        size = STATE * CHAIN + len(self._places)
        points = MerweScaledSigmaPoints(size, alpha=1.0, beta=2.0, kappa=0.0)
        self._filter = UnscentedKalmanFilter(
            size, CHAIN, period_s, hx=lambda x: x[: STATE * CHAIN : STATE], fx=self._move, points=points
        )
        self._filter.residual_z = road.difference
        self._filter.x, self._filter.P = np.zeros(size), np.zeros((size, size))
        self._filter.x[STATE * CHAIN :] = self._prior_mean
        self._filter.P[STATE * CHAIN :, STATE * CHAIN :] = np.diag(self._prior_var)
        self._filter.R = np.diag(self._rows[:, SIGMA_NU] ** 2)
        self._known = np.zeros(CHAIN, np.int64)
        state = State(np.zeros(size), np.zeros((size, size)), self._known)
        drivers = Drivers(self._rows, self._places, self._prior_mean, self._prior_var)
        self._step = step_for(state, drivers, np.zeros(CHAIN), self._scene, ACTIONS)

    @property
    def logs(self) -> Array:
        return np.asarray(self._filter.x[STATE * CHAIN :])

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        kalman, self._length = self._filter, length_m
        if self._known.min() < MOVING:
            state = State(kalman.x, kalman.P, self._known)
            for m, position in enumerate(position_m):
                start_vehicle(m, position, self._scene.period_s, state, self._rows, self._scene)
            return np.nan
        # a state that never changes has the variance 0, and the covariance then has no Cholesky factor
        kalman.P += _LEAST_VAR * np.eye(len(kalman.x))
        kalman.Q = self._linearised(kalman.x)[1] + _LEAST_VAR * np.eye(len(kalman.x))
        kalman.predict()
        kalman.update(position_m)
        y, variance = float(kalman.y[0]), float(kalman.S[0, 0])
        return float(-0.5 * (np.log(variance) + y * y / variance))

    def _move(self, x: Array, _: float) -> Array:
        return self._linearised(x)[0]

    def _linearised(self, x: Array) -> tuple[Array, Array]:
        """Predict a state that is known for certain: its mean after one period, and the process noise."""
        step = self._step
        step.state.mean[:], step.state.covariance[:] = x, _SHARP**2 * np.eye(len(x))
        step.length[:] = self._length
        linearise_chain(step)
        return step.out.next_mean.copy(), step.out.noise.copy()


class _Particles:
    """Particles of the preferences, each with a filter of the state for these preferences (Rao-Blackwell).

    References
    ----------
    Liu and West, in: Sequential Monte Carlo Methods in Practice (2001), chapter 10.
    """

    def __init__(self, row: Array, road: Road, period_s: float, rng: np.random.Generator) -> None:
        self._rng, names = rng, tuple(NAMES[k] for k in _PLACES)
        self._names, self._centre = names, np.log(row[list(_PLACES)])
        sharp = Adaptation(names, (_SHARP,) * len(names))
        self._filters = [OnlineFilter(period_s, road, row, adaptation=sharp, learning=None) for _ in range(PARTICLES)]
        self._at = self._centre + np.sqrt(ADAPT.arrays[1]) * rng.standard_normal((PARTICLES, len(names)))
        self._weight = np.full(PARTICLES, 1.0 / PARTICLES)
        self._put()

    @property
    def logs(self) -> Array:
        return np.asarray(self._weight @ self._at)

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        sample = position_m.tolist(), identity.tolist(), length_m.tolist()
        density = np.array([one.step(*sample).log_likelihood for one in self._filters])
        if np.isnan(density).any():
            return np.nan
        weight = self._weight * np.exp(density - density.max())
        predicted = float(np.log(weight.sum()) + density.max())
        self._weight = weight / weight.sum()
        if 1.0 / np.square(self._weight).sum() < 0.5 * PARTICLES:
            self._draw()
        return predicted

    def _draw(self) -> None:
        """Draw new particles near those that have predicted well; their mean and covariance stay."""
        mean, spread = self.logs, np.cov(self._at.T, aweights=self._weight) + _SHARP**2 * np.eye(len(_PLACES))
        first = (self._rng.random() + np.arange(PARTICLES)) / PARTICLES
        chosen = np.minimum(np.searchsorted(np.cumsum(self._weight), first), PARTICLES - 1)
        noise = self._rng.multivariate_normal(np.zeros(len(mean)), (1.0 - _OWN**2) * spread, PARTICLES)
        self._at = _OWN * self._at[chosen] + (1.0 - _OWN) * mean + noise
        self._filters = [copy.deepcopy(self._filters[k]) for k in chosen]
        self._weight = np.full(PARTICLES, 1.0 / PARTICLES)
        self._put()

    def _put(self) -> None:
        """Give the filter of each particle the preferences of the particle."""
        for one, at in zip(self._filters, self._at, strict=True):
            one.recall(Learnt(self._names, at, _SHARP**2 * np.eye(len(at))))


# The filters that are compared, by their names in the table.
_FILTERS: dict[str, Callable[..., _LearningFilter]] = {
    "cubature (the nodes')": _Cubature,
    "unscented": _Unscented,
    f"{PARTICLES} particles": _Particles,
}


def _row() -> Array:
    """Parameters (P,) of a driver whose noises are known and whose preferences are not."""
    row = population()
    row[[SIGMA_NU, SIGMA_A]] = defaults(CARS)[0, [SIGMA_NU, SIGMA_A]]
    return row


class _LearningCurve(NamedTuple):
    """What one filter makes of one driver over T samples.

    ``logs`` (T, 2) are logarithms of v* and kappa_v, ``log_likelihood`` has shape (T,), ``step_s`` is the time [s]
    that the computer takes for a sample.
    """

    logs: Array
    log_likelihood: Array
    step_s: float


def _follow(job: tuple[DenseTracks, int, str, int]) -> _LearningCurve:
    """Follow one driver: trajectories, column of the driver, name of the filter, seed."""
    trajectories, driver, name, seed = job
    chain = chain_behind(trajectories, driver)
    follower = _FILTERS[name](_row(), trajectories.road, trajectories.period_s, np.random.default_rng([seed, driver]))
    logs, density, begun = [], [], time.perf_counter()
    for sample in zip(chain.position_m, chain.identity, chain.length_m, strict=True):
        density.append(follower.step(*sample))
        logs.append(follower.logs)
    return _LearningCurve(np.array(logs), np.array(density), (time.perf_counter() - begun) / len(logs))


def _answer(asked: Asked) -> Answer:
    """Compare errors of v* and kappa_v over time, log-likelihoods and cost of the filters on the same drivers.

    A fit of all samples, of the same simulated drivers, says what can be known at the end.
    """
    curves: dict[str, list[_LearningCurve]] = {name: [] for name in _FILTERS}
    truths, fits = [], []
    for simulated in jams(_SPREAD, asked.runs, asked.seed, DURATION_S):
        drivers, t = simulated.parameters, simulated.dense
        truths.append(np.log(drivers[:, list(_PLACES)]))
        for name, several in curves.items():
            several += asked.work.map(_follow, [(t, i, name, asked.seed) for i in range(CARS)])
        fits.append(np.log(each_driver(t, Settings(), work=asked.work).rows[:, list(_PLACES)]))
    truth = np.concatenate(truths)

    def root_mean_square(errors: Array) -> Array:
        return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))

    root = {name: root_mean_square(np.array([one.logs for one in of]) - truth[:, None]) for name, of in curves.items()}
    ends = root_mean_square(np.concatenate(fits) - truth)
    last = len(next(iter(root.values()))) - 1
    at = [(time_s, min(round(time_s / DURATION_S * last), last)) for time_s in _TIMES_S]
    rows: list[Row] = [
        {
            "filter": name,
            **{f"v* {s:g} s [%]": 100.0 * root[name][k, 0] for s, k in at},
            **{f"kappa_v {s:g} s [%]": 100.0 * root[name][k, 1] for s, k in at},
            "nats per sample": float(np.nanmean([one.log_likelihood[SETTLING + 2 :] for one in of])),
            "ms per step": 1e3 * float(np.median([one.step_s for one in of])),
            "drivers": len(of),
        }
        for name, of in curves.items()
    ]
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
    takes=("runs", "seed"),
)
