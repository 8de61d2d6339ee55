"""Three filters that learn the desired speed and the risk premium of a driver while they drive."""

import copy
from typing import Protocol

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import KAPPA_V, NAMES, SIGMA_NU, UTILITY, V_STAR, at_period
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.filters.chain import CHAIN, Adaptation, chain_parameters
from sugiyama_ros.filters.online import ADAPT, Learnt, OnlineFilter
from sugiyama_ros.filters.sample import start_vehicle
from sugiyama_ros.filters.state import MOVING, STATE, Drivers, Moment, State, scene_at, step_for
from sugiyama_ros.filters.step import linearise
from sugiyama_ros.road import Road

#: Places in a driver's row of the parameters that the filters learn.
PLACES = (V_STAR, KAPPA_V)
#: Number of particles.
PARTICLES = 50
# Share of a particle's parameters that the particle keeps when particles are drawn again (Liu and West).
_OWN = 0.98
# Std of the parameters of a particle, and of the state at a sigma point: both are known, but 0 has no inverse.
_SHARP = 1e-6
# Variance that is added so that the covariance has a Cholesky factor.
_LEAST_VAR = 1e-10


class LearningFilter(Protocol):
    """A filter that follows one driver, sample by sample."""

    @property
    def logs(self) -> Array:
        """Logarithms, shape (2,), of v* [m/s] and kappa_v [s] as they are known now."""

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        """Predict one period ahead and take in the next sample.

        position_m: (M,), measured positions [m] of the driver and of the vehicles ahead; identity: (M,), numbers of
        these vehicles; length_m: (M,), lengths [m] of these vehicles.
        """


class Cubature:
    """The filter of the estimator nodes: preferences in the state, the mean action linearised by cubature.

    row: (P,), parameters of the driver at the start; road: the road; period_s: time [s] between two samples.
    """

    def __init__(self, row: Array, road: Road, period_s: float, _: np.random.Generator) -> None:
        self._filter = OnlineFilter(period_s, road, row, learning=None)

    @property
    def logs(self) -> Array:
        """Logarithms, shape (2,), of v* [m/s] and kappa_v [s] as they are known now."""
        return np.log(self._filter.parameters[list(PLACES)])

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        """Predict and take in the next sample; see ``LearningFilter.step``."""
        return self._filter.step(position_m.tolist(), identity.tolist(), length_m.tolist()).log_likelihood


class Unscented:
    """A filter with sigma points of the state and the preferences. The vehicles must stay the same.

    row: (P,), parameters of the driver at the start; road: the road; period_s: time [s] between two samples.

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
        self._step = step_for(state, drivers, Moment(np.zeros(CHAIN), np.full(3, np.nan), 0.0), self._scene, ACTIONS)

    @property
    def logs(self) -> Array:
        """Logarithms, shape (2,), of v* [m/s] and kappa_v [s] as they are known now."""
        return np.asarray(self._filter.x[STATE * CHAIN :])

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        """Predict and take in the next sample; see ``LearningFilter.step``."""
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
        step.moment.length[:] = self._length
        linearise(step)
        return step.out.next_mean.copy(), step.out.noise.copy()


class Particles:
    """Particles of the preferences, each with a filter of the state for these preferences (Rao-Blackwell).

    row: (P,), parameters of the driver at the start; road: the road; period_s: time [s] between two samples; rng: draws
    the particles.

    References
    ----------
    Liu and West, in: Sequential Monte Carlo Methods in Practice (2001), chapter 10.
    """

    def __init__(self, row: Array, road: Road, period_s: float, rng: np.random.Generator) -> None:
        self._rng, names = rng, tuple(NAMES[k] for k in PLACES)
        self._names, self._centre = names, np.log(row[list(PLACES)])
        sharp = Adaptation(names, (_SHARP,) * len(names))
        self._filters = [OnlineFilter(period_s, road, row, adaptation=sharp, learning=None) for _ in range(PARTICLES)]
        self._at = self._centre + np.sqrt(ADAPT.arrays[1]) * rng.standard_normal((PARTICLES, len(names)))
        self._weight = np.full(PARTICLES, 1.0 / PARTICLES)
        self._put()

    @property
    def logs(self) -> Array:
        """Logarithms, shape (2,), of v* [m/s] and kappa_v [s] as they are known now."""
        return np.asarray(self._weight @ self._at)

    def step(self, position_m: Array, identity: Ints, length_m: Array) -> float:
        """Predict and take in the next sample; see ``LearningFilter.step``."""
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
        mean, spread = self.logs, np.cov(self._at.T, aweights=self._weight) + _SHARP**2 * np.eye(len(PLACES))
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
