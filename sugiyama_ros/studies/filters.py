"""Which filter learns a driver's preferences best while he drives, and what does it cost?"""

import copy
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.calibration import each_for_himself
from sugiyama_ros.driver.parameters import KAPPA_V, NAMES, SIGMA_A, SIGMA_NU, UTILITY, V_STAR, population
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.filters.causal import SETTLING
from sugiyama_ros.filters.chain import CHAIN, Adaptation, chain_parameters
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.linearisation import linearise
from sugiyama_ros.filters.online import ADAPT, Learnt, OnlineFilter
from sugiyama_ros.filters.state import MOVING, STATE, Drivers, Linearised, Moment, State, scene_at, workspace_for
from sugiyama_ros.filters.vehicles import start_vehicle
from sugiyama_ros.road import Road
from sugiyama_ros.studies.rings import CARS, alike, jams
from sugiyama_ros.studies.study import Answer, Asked, Row, Study
from sugiyama_ros.trajectories.trajectories import Trajectories

_PLACES = (V_STAR, KAPPA_V)
_DURATION_S, _TIMES_S = 250.0, (60.0, 120.0, 250.0)
# Std of the logarithms over the simulated drivers.
_SPREAD = {V_STAR: 0.08, KAPPA_V: 0.2}
_PARTICLES = 50
# Share of a particle's parameters that stays its own when particles are drawn anew (Liu and West).
_OWN = 0.98
# What stands for no uncertainty at all: of a particle's parameters, and of a point's state.
_SHARP = 1e-6
_LEAST_VAR = 1e-10


class Follower(Protocol):
    """Follows one driver, sample by sample."""

    @property
    def logs(self) -> Array:
        """Logarithms (2,) of v* and kappa_v as known now."""

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        """Go on by one period and take in its sample; its log-likelihood, NaN while nothing is predicted."""


class Cubature:
    """The filter of the estimator nodes: preferences in the state, the mean action linearised by cubature."""

    def __init__(self, row: Array, road: Road, period_s: float, _: np.random.Generator) -> None:
        self._filter = OnlineFilter(period_s, road, row, learning=None)

    @property
    def logs(self) -> Array:
        """Of v* and kappa_v."""
        return np.log(self._filter.parameters[list(_PLACES)])

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        """As in ``Follower``."""
        return self._filter.step(position_m.tolist(), identity.tolist(), length_m.tolist()).log_likelihood


class Unscented:
    """The whole state by sigma points (Julier and Uhlmann, Proc. IEEE 92 (2004) 401); nobody comes or goes."""

    def __init__(self, row: Array, road: Road, period_s: float, _: np.random.Generator) -> None:
        self._road, self._scene = road, scene_at(period_s, road.circumference_m, ADAPT.relaxation_s)
        self._rows = chain_parameters(row, None, CHAIN, period_s)
        self._places, self._prior_var = ADAPT.arrays
        self._prior_mean = np.log(self._rows[0, [UTILITY[k] for k in self._places]])
        self._workspace = workspace_for(ACTIONS, CHAIN, len(self._places))
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
        self._known, self._steps = np.zeros(CHAIN, np.int64), 0

    @property
    def logs(self) -> Array:
        """Of v* and kappa_v."""
        return np.asarray(self._filter.x[STATE * CHAIN :])

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        """As in ``Follower``."""
        kalman, self._length = self._filter, length_m
        self._steps += 1
        if self._known.min() < MOVING:
            state = State(kalman.x, kalman.P, self._known)
            for m, position in enumerate(position_m):
                start_vehicle(m, position, self._scene.period_s, state, self._rows, self._scene)
            return np.nan
        # what never changes has no uncertainty, of which there is no Cholesky factor
        kalman.P += _LEAST_VAR * np.eye(len(kalman.x))
        kalman.Q = self._linearised(kalman.x)[1] + _LEAST_VAR * np.eye(len(kalman.x))
        kalman.predict()
        kalman.update(position_m)
        y, variance = float(kalman.y[0]), float(kalman.S[0, 0])
        return float(-0.5 * (np.log(variance) + y * y / variance))

    def _move(self, x: Array, _: float) -> Array:
        return self._linearised(x)[0]

    def _linearised(self, x: Array) -> tuple[Array, Array]:
        """Where a state that is known for certain goes in one period, and with what noise."""
        size = len(x)
        moved, noise = np.empty(size), np.empty((size, size))
        linearise(
            State(x, _SHARP**2 * np.eye(size), self._known),
            Drivers(self._rows, self._places, self._prior_mean, self._prior_var),
            Moment(self._length, np.full(3, np.nan), 0.0),
            self._scene,
            self._workspace,
            Linearised(moved, np.empty((size, size)), noise),
        )
        return moved, noise


class Particles:
    """Preferences by particles, each with a filter of the state given them (Rao-Blackwell; Liu and West 2001)."""

    def __init__(self, row: Array, road: Road, period_s: float, rng: np.random.Generator) -> None:
        self._rng, names = rng, tuple(NAMES[k] for k in _PLACES)
        self._names, self._centre = names, np.log(row[list(_PLACES)])
        sharp = Adaptation(names, (_SHARP,) * len(names))
        self._filters = [OnlineFilter(period_s, road, row, adaptation=sharp, learning=None) for _ in range(_PARTICLES)]
        self._at = self._centre + np.sqrt(ADAPT.arrays[1]) * rng.standard_normal((_PARTICLES, len(names)))
        self._weight = np.full(_PARTICLES, 1.0 / _PARTICLES)
        self._put()

    @property
    def logs(self) -> Array:
        """Of v* and kappa_v."""
        return np.asarray(self._weight @ self._at)

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        """As in ``Follower``."""
        sample = position_m.tolist(), identity.tolist(), length_m.tolist()
        density = np.array([one.step(*sample).log_likelihood for one in self._filters])
        if np.isnan(density).any():
            return np.nan
        weight = self._weight * np.exp(density - density.max())
        predicted = float(np.log(weight.sum()) + density.max())
        self._weight = weight / weight.sum()
        if 1.0 / np.square(self._weight).sum() < 0.5 * _PARTICLES:
            self._draw()
        return predicted

    def _draw(self) -> None:
        """Particles anew, near those that have predicted well, with the mean and covariance that they have now."""
        mean, spread = self.logs, np.cov(self._at.T, aweights=self._weight) + _SHARP**2 * np.eye(len(_PLACES))
        first = (self._rng.random() + np.arange(_PARTICLES)) / _PARTICLES
        chosen = np.minimum(np.searchsorted(np.cumsum(self._weight), first), _PARTICLES - 1)
        noise = self._rng.multivariate_normal(np.zeros(len(mean)), (1.0 - _OWN**2) * spread, _PARTICLES)
        self._at = _OWN * self._at[chosen] + (1.0 - _OWN) * mean + noise
        self._filters = [copy.deepcopy(self._filters[k]) for k in chosen]
        self._weight = np.full(_PARTICLES, 1.0 / _PARTICLES)
        self._put()

    def _put(self) -> None:
        for one, at in zip(self._filters, self._at, strict=True):
            one.recall(Learnt(self._names, at, _SHARP**2 * np.eye(len(at))))


_FILTERS: dict[str, Callable[..., Follower]] = {
    "cubature (the nodes')": Cubature,
    "unscented": Unscented,
    f"{_PARTICLES} particles": Particles,
}


def _row() -> Array:
    """A driver whose noises are known, and nothing else."""
    row = population()
    row[[SIGMA_NU, SIGMA_A]] = alike()[0, [SIGMA_NU, SIGMA_A]]
    return row


def followed(job: tuple[Trajectories, int, str, int]) -> tuple[Array, Array, float]:
    """Of a driver: logarithms (T, 2), log-likelihoods (T,), time of a step [s]."""
    trajectories, driver, name, seed = job
    chain = chain_behind(trajectories, driver)
    follower = _FILTERS[name](_row(), trajectories.road, trajectories.period_s, np.random.default_rng([seed, driver]))
    logs, density, begun = [], [], time.perf_counter()
    for sample in zip(chain.position_m, chain.identity, chain.length_m, strict=True):
        density.append(follower.step(*sample))
        logs.append(follower.logs)
    return np.array(logs), np.array(density), (time.perf_counter() - begun) / len(logs)


def answer(asked: Asked) -> Answer:
    """Errors of v* and kappa_v over time, mean log-likelihood, and cost, of each filter on the same drivers."""
    error: dict[str, list[Array]] = {name: [] for name in _FILTERS}
    density: dict[str, list[Array]] = {name: [] for name in _FILTERS}
    cost: dict[str, list[float]] = {name: [] for name in _FILTERS}
    batch = []
    for drivers, t in jams(_SPREAD, asked.runs, asked.seed, _DURATION_S):
        truth = np.log(drivers[:, list(_PLACES)])
        for name in _FILTERS:
            for i, found in enumerate(asked.work.map(followed, [(t, i, name, asked.seed) for i in range(CARS)])):
                error[name].append(found[0] - truth[i])
                density[name].append(found[1][SETTLING + 2 :])
                cost[name].append(found[2])
        fits = each_for_himself(t, "causal", ("sigma_nu", "sigma_a", "v_star", "kappa_v"), work=asked.work)
        batch.append(np.log(fits.rows[:, list(_PLACES)]) - truth)
    root = {name: np.sqrt(np.mean(np.square(e), axis=0)) for name, e in error.items()}
    last = len(next(iter(root.values()))) - 1
    at = [(time_s, min(round(time_s / _DURATION_S * last), last)) for time_s in _TIMES_S]
    rows: list[Row] = [
        {
            "filter": name,
            **{f"v* {s:g} s [%]": 100.0 * root[name][k, 0] for s, k in at},
            **{f"kappa_v {s:g} s [%]": 100.0 * root[name][k, 1] for s, k in at},
            "nats per sample": float(np.nanmean(density[name])),
            "ms per step": 1e3 * float(np.median(cost[name])),
            "drivers": len(error[name]),
        }
        for name in _FILTERS
    ]
    ends = np.sqrt(np.mean(np.square(np.concatenate(batch)), axis=0))
    rows.append({"filter": "batch fit of 250 s", "v* 250 s [%]": 100.0 * ends[0], "kappa_v 250 s [%]": 100.0 * ends[1]})

    def draw(figure: Any) -> None:
        for j, (axes, parameter) in enumerate(zip(figure.subplots(1, 2), ("v*", "kappa_v"), strict=True)):
            for name, of in root.items():
                axes.plot(_DURATION_S * np.arange(len(of)) / (len(of) - 1), 100.0 * of[:, j], label=name)
            axes.axhline(100.0 * ends[j], color="black", linestyle="--", label="batch fit of 250 s")
            axes.set(xlabel="time [s]", ylabel="error [%]", title=parameter, ylim=(0.0, None))
        axes.legend()

    return Answer(tuple(rows), draw)


STUDY = Study(
    "filters",
    "Which filter learns a driver's preferences best while he drives?",
    "Its outlook: inference while people drive is left to later work.",
    answer,
)
