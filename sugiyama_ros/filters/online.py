"""One driver's filter, sample by sample, with online updates of his parameters.

The model is that of ``causal``; the Kalman algebra is filterpy's.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import NAMES, SIGMA_NU, UTILITY, check, population
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.contaminated_normal import contaminated_normal
from sugiyama_ros.effects.effect import MEASUREMENT
from sugiyama_ros.effects.registry import WIDTH, active, effect, place, whole
from sugiyama_ros.effects.sensing import is_contaminated
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.alarm import StyleAlarm
from sugiyama_ros.filters.causal import SETTLING
from sugiyama_ros.filters.chain import CHAIN, Adaptation, adaptation_of, chain_parameters
from sugiyama_ros.filters.linearisation import linearise
from sugiyama_ros.filters.measurement import measurement, noise_var_at, robust
from sugiyama_ros.filters.noise import NOISES, Learning, NoiseLearner
from sugiyama_ros.filters.state import MOVING, STATE, Drivers, Linearised, Moment, State, scene_at, workspace_for
from sugiyama_ros.filters.vehicles import forget_vehicle, start_vehicle
from sugiyama_ros.road import Road

#: Adaptation of the estimator nodes: desired speed and risk premium. The prior stds are about those over the drivers of
#: the measured experiment, each fitted for himself.
ADAPT = Adaptation(names=("v_star", "kappa_v"), prior_std=(0.1, 0.4), relaxation_s=6000.0)
#: Learning of the estimator nodes: measurement noise and acceleration noise.
LEARN = Learning()
#: No vehicle behind.
NOBODY = (math.nan, -1, 0.0)
_NO_REAR = np.full(3, np.nan)
# Squared normalised innovation of a gross error, which the filter does not take in; but not more of them in a row.
_GROSS, _MOST_REFUSED = 36.0, 3


@dataclass(frozen=True, slots=True)
class Estimate:
    """What is known of a driver after the update with one sample.

    position_m (wrapped on a ring), speed [m/s], acceleration [m/s^2] and their covariance (3, 3); mean_action [m/s^2];
    gap_m (infinite without a leader) and approach_rate [m/s]; innovation_m, nis and log_likelihood (no 2 pi term) of
    the sample, NaN where it is missing or nothing was predicted; innovation_var [m^2]; scored: whether it counts. Where
    noises are learnt, the density is that of measurements of which some are far off (``Learning.outliers``).
    """

    position_m: float
    speed: float
    acceleration: float
    covariance: Array
    mean_action: float
    gap_m: float
    approach_rate: float
    innovation_m: float
    innovation_var: float
    nis: float
    log_likelihood: float
    scored: bool


@dataclass(frozen=True, eq=False)
class Learnt:
    """Logarithms (A,) of adapted parameters at the reference period, by name, and their covariance (A, A)."""

    names: tuple[str, ...]
    mean: Array
    covariance: Array


class _ChainFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's extended Kalman filter, told the next mean, F and Q of a chain instead of computing them."""

    next_mean: Array

    def predict_x(self, u: Any = 0) -> None:
        self.x = self.next_mean.copy()


class OnlineFilter:
    """Causal filter of one driver behind a chain of vehicles.

    parameters: (P,) of the driver at the start, at the reference period, those of ``population()`` if left out, or a
    whole row (WIDTH,) with effects; ``ahead``: the same of the drivers ahead; period_s: time [s] between two samples.
    prior: what was known of the driver before the first sample; change_of_style: name of the parameter that has jumped
    at the last one, and its factor.
    adaptation: what of his preferences is learnt; learning: how his noises are, None if they are not.
    Raises InputError for parameters out of bounds.
    """

    def __init__(
        self,
        period_s: float,
        road: Road,
        parameters: Array | None = None,
        ahead: Array | None = None,
        adaptation: Adaptation = ADAPT,
        learning: Learning | None = LEARN,
        vehicles: int = CHAIN,
    ) -> None:
        parameters = population() if parameters is None else parameters
        check(parameters)
        self.road = road
        self.period_s = period_s
        self.vehicles = vehicles
        self._ahead = ahead
        self._adaptation = adaptation
        self._places, _ = adaptation_of(parameters, adaptation).arrays
        self._workspace = workspace_for(ACTIONS, vehicles, len(self._places))
        self._adapted = slice(STATE * vehicles, STATE * vehicles + len(self._places))
        self._learning = learning
        self._take(whole(parameters))
        self._measures = np.zeros((vehicles, STATE * vehicles + len(self._places)))
        self._measures[np.arange(vehicles), STATE * np.arange(vehicles)] = 1.0
        self._reads = np.eye(3, self._measures.shape[1])
        self.reset()

    def reset(self) -> None:
        """Forget all samples and everything learnt."""
        size = self._measures.shape[1]
        adapted = self._adapted
        self._rows = self._rows_at_start.copy()
        self._behind = self._follower() if self._aft else None
        self._known = np.zeros(self.vehicles, np.int64)
        self._identity: list[int] = [-1] * self.vehicles
        self._waited = [0] * self.vehicles
        self._refused = [0] * self.vehicles
        self._settled = 0
        self._filter = _ChainFilter(dim_x=size, dim_z=self.vehicles)
        self._filter.x = np.zeros(size)
        self._filter.P = np.zeros((size, size))
        self._noise = np.zeros((size, size))
        self._filter.next_mean = np.zeros(size)
        self._filter.F = np.zeros((size, size))
        self._filter.x[adapted] = self._prior_mean
        self._filter.P[adapted, adapted] = np.diag(self._prior_var)
        self._started = False
        self._noises: NoiseLearner | None = None
        if self._learning is not None:
            prior_mean = np.log(self._rows_at_start[0, NOISES])
            self._noises = NoiseLearner(self._learning, prior_mean, self.period_s, size)

        places = range(adapted.start, adapted.stop)
        self._alarm = StyleAlarm(places, size, self.period_s) if places else None
        self.change_of_style: tuple[str, float] | None = None
        self.prior = self.learnt

    def change(self, parameters: Array) -> None:
        """Go on with other effects, from a whole row (WIDTH,), and keep all that was learnt.

        The driver's own parameters stay as they are. Raises InputError if that needs a parameter adapted which is not.
        """
        row = whole(self._start_parameters[: len(NAMES)])
        row[len(NAMES) :] = parameters[len(NAMES) :]
        if not np.array_equal(adaptation_of(row, self._adaptation).arrays[0], self._places):
            raise InputError("effect preference_drift: this filter does not adapt v_star and kappa_v; start it anew")
        learnt = self._rows[0, : len(NAMES)]
        self._take(row)
        self._rows = self._rows_at_start.copy()
        self._rows[0, : len(NAMES)] = learnt
        if self._aft and self._behind is None:
            self._behind = self._follower()

    def _follower(self) -> "OnlineFilter":
        """A filter of the vehicle behind, of whom nothing is learnt."""
        return OnlineFilter(self.period_s, self.road, adaptation=Adaptation(), learning=None, vehicles=1)

    def _take(self, row: Array) -> None:
        adaptation = adaptation_of(row, self._adaptation)
        _, self._prior_var = adaptation.arrays
        self._start_parameters = row
        # drivers ahead share what is the same for all
        ahead = whole(population() if self._ahead is None else self._ahead)
        ahead[len(NAMES) :] = row[len(NAMES) :]
        for name in active(row):
            if effect(name).individual:
                ahead[[place(name, p.name) for p in effect(name).parameters]] = 0.0
        self._rows_at_start = chain_parameters(row, ahead, self.vehicles, self.period_s)
        self._prior_mean = np.log(self._rows_at_start[0, [UTILITY[k] for k in self._places]])
        self._scene = scene_at(self.period_s, self.road.circumference_m, adaptation.relaxation_s)
        self._noise_shift = np.log(self._rows_at_start[0, NOISES] / row[NOISES])
        names = active(row)
        self._aft = bool(names) and self.vehicles > 1
        self._measured_otherwise = any(effect(name).stage == MEASUREMENT for name in names)

    @property
    def parameters(self) -> Array:
        """The driver's whole row (WIDTH,) as known now, at the reference period."""
        known = self._start_parameters.copy()
        for k in self._places:
            known[UTILITY[k]] = self._rows[0, UTILITY[k]]
        if self._noises is not None:
            known[NOISES] *= self._rows[0, NOISES] / self._rows_at_start[0, NOISES]
        return known

    @property
    def parameter_covariance(self) -> Array:
        """Covariance (WIDTH, WIDTH) of ``parameters``; zero for those that are not adapted."""
        covariance, parameters = np.zeros((WIDTH, WIDTH)), self.parameters
        places = [UTILITY[k] for k in self._places]
        covariance[np.ix_(places, places)] = self._filter.P[self._adapted, self._adapted]
        if self._noises is not None:
            covariance[np.ix_(NOISES, NOISES)] = self._noises.covariance
        return covariance * np.outer(parameters, parameters)

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the adapted parameters that the samples tell: twice as well, at least, as the prior does."""
        now = np.sqrt(np.diag(self.learnt.covariance))
        before = np.concatenate([self._learning.prior_std if self._learning else (), np.sqrt(self._prior_var)])
        return tuple(name for name, a, b in zip(self.adapted, now, before, strict=True) if a < 0.5 * b)

    @property
    def learnt(self) -> Learnt:
        """All that is known of the driver's parameters, to go on from."""
        parts = [(self._filter.x[self._adapted], self._filter.P[self._adapted, self._adapted])]
        if self._noises is not None:
            parts.insert(0, (self._noises.mean - self._noise_shift, self._noises.covariance))
        means, covariances = zip(*parts, strict=True)
        return Learnt(self.adapted, np.concatenate(means), block_diag(*covariances))

    def recall(self, learnt: Learnt) -> None:
        """Go on from what was learnt before, of those parameters that are adapted here."""
        places = {name: k for k, name in enumerate(learnt.names)}
        noises = [places[NAMES[k]] for k in NOISES if NAMES[k] in places]
        if self._noises is not None and len(noises) == len(NOISES):
            self._noises.recall(learnt.mean[noises] + self._noise_shift, learnt.covariance[np.ix_(noises, noises)])
            self._rows[0, NOISES] = self._noises.values
        own = [places[NAMES[UTILITY[k]]] for k in self._places if NAMES[UTILITY[k]] in places]
        if len(own) == len(self._places):
            self._filter.x[self._adapted] = self._filter.next_mean[self._adapted] = learnt.mean[own]
            self._filter.P[self._adapted, :], self._filter.P[:, self._adapted] = 0.0, 0.0
            self._filter.P[self._adapted, self._adapted] = learnt.covariance[np.ix_(own, own)]
            self._rows[0, [UTILITY[k] for k in self._places]] = np.exp(learnt.mean[own])

    @property
    def adapted(self) -> tuple[str, ...]:
        """Names of the parameters that are adapted."""
        noises = NOISES if self._learning is not None else ()
        return tuple(NAMES[k] for k in (*noises, *(UTILITY[k] for k in self._places)))

    @property
    def looks_back(self) -> bool:
        """Whether it has effects, which may depend on the vehicle behind."""
        return self._aft

    def step(
        self,
        position_m: Sequence[float],
        identity: Sequence[int],
        length_m: Sequence[float],
        time_s: float = 0.0,
        behind: tuple[float, int, float] = NOBODY,
    ) -> Estimate:
        """Go on by one period and take in its sample.

        position_m: M measured positions [m], own first, then those ahead, NaN where missing; identity: M numbers of
        these vehicles, -1 for none; length_m: their M lengths [m]; time_s: time of the recording, for effects that
        depend on it; behind: position, number and length of the vehicle behind, where ``looks_back``.
        """
        kalman = self._filter
        self.change_of_style = None
        if self._started:
            kalman.Q = self._noise
            kalman.predict()
            if self._noises is not None:
                self._noises.predict(kalman.F, self._noise)
            if self._alarm is not None:
                self._alarm.predict(kalman.F)
        self._started = True
        self._settled = 1 if identity[0] != self._identity[0] else self._settled + 1
        chain = range(self.vehicles)
        for m in chain:
            self._waited[m] += 1
            if identity[m] < 0 or identity[m] != self._identity[m]:
                forget_vehicle(m, State(kalman.x, kalman.P, self._known))
                if self._noises is not None:
                    self._noises.forget(m)
                self._identity[m] = int(identity[m])

        known = self._known.tolist()
        sampled = [m for m in chain if identity[m] >= 0 and not math.isnan(position_m[m])]
        moving = [m for m in sampled if known[m] == MOVING]
        innovations = {m: self._innovation(m, position_m[m]) for m in moving}
        innovation, variance, density = math.nan, math.nan, math.nan
        if 0 in innovations:
            innovation, variance = innovations[0]
            density = self._learn(innovation, variance)
            if self._alarm is not None:
                self._alarm.observe(innovation, variance)
        elif known[0] == MOVING:
            variance = self._innovation(0, math.nan)[1]
        believed = [m for m in moving if self._is_believed(m, *innovations[m])]
        if self._measured_otherwise:
            for m in believed:
                self._update_with_effects(position_m[m], m)
        elif believed:
            self._update(np.array([position_m[m] for m in believed]), np.array(believed))
        if 0 in innovations:
            self.change_of_style = self._check_style()
        for m in sampled:
            if known[m] != MOVING:
                elapsed = self._waited[m] * self._scene.period_s
                start_vehicle(
                    m, position_m[m], elapsed, State(kalman.x, kalman.P, self._known), self._rows, self._scene
                )
                self._waited[m] = 0
                if m == 0 and self._noises is not None:
                    self._noises.start(kalman.P)
                if m == 0 and self._alarm is not None:
                    self._alarm.reset()
        if self._noises is not None:
            self._rows[0, NOISES] = self._noises.values
        for j, k in enumerate(self._places):
            self._rows[0, UTILITY[k]] = math.exp(kalman.x[STATE * self.vehicles + j])
        lengths = np.array(length_m)
        mean_action = linearise(
            State(kalman.x, kalman.P, self._known),
            Drivers(self._rows, self._places, self._prior_mean, self._prior_var),
            Moment(lengths, self._rear(behind, time_s), time_s),
            self._scene,
            self._workspace,
            Linearised(kalman.next_mean, kalman.F, self._noise),
        )
        return self._estimate(innovation, variance, density, mean_action, 0.5 * float(lengths[:2].sum()))

    def _rear(self, behind: tuple[float, int, float], time_s: float) -> Array:
        """Position [m], speed and length of the vehicle behind, NaN where it is not known."""
        if self._behind is None:
            return _NO_REAR
        position, number, length = behind
        estimate = self._behind.step([position], [number], [length], time_s)
        if math.isnan(estimate.innovation_var):
            return _NO_REAR
        return np.array([estimate.position_m, estimate.speed, length])

    def _innovation(self, m: int, position_m: float) -> tuple[float, float]:
        """Of vehicle m of the chain [m], NaN where its position is missing, and its variance [m^2]."""
        mean, noise_var = float(self._filter.x[STATE * m]), self._noise_var(m)
        variance = float(self._filter.P[STATE * m, STATE * m])
        if self._measured_otherwise:
            off, factor = measurement(mean, self._rows[m], self._scene.circumference_m)
            mean, variance = mean + off, factor * factor * variance
        way, lap = position_m - mean, self.road.circumference_m
        return way - lap * round(way / lap) if lap > 0.0 and way == way else way, variance + noise_var

    def _noise_var(self, m: int) -> float:
        """Of the measurement of vehicle m of the chain [m^2], where it is."""
        if not self._measured_otherwise:
            return float(self._rows[m, SIGMA_NU]) ** 2
        return float(noise_var_at(float(self._filter.x[STATE * m]), self._rows[m], self._scene.circumference_m))

    def _learn(self, innovation: float, variance: float) -> float:
        """Log-likelihood of the driver's own sample, and what it says of his noises."""
        if self._noises is not None:
            noise_var = self._noise_var(0)
            factor = (
                math.sqrt((variance - noise_var) / float(self._filter.P[0, 0])) if self._measured_otherwise else 1.0
            )
            self._noises.learn(innovation, variance, noise_var, factor)
        if self._noises is None or is_contaminated(self._rows[0]):
            return float(robust(innovation, variance, self._rows[0])[2])
        return float(
            contaminated_normal(innovation, variance, float(self._rows[0, SIGMA_NU]) ** 2, *self._noises.outliers)[2]
        )

    def _check_style(self) -> tuple[str, float] | None:
        """Name of the parameter that has jumped, and by what factor, if the alarm is given; the filter is corrected."""
        if self._alarm is None:
            return None
        change = self._alarm.check(self._filter.x, self._filter.P)
        return None if change is None else (NAMES[UTILITY[self._places[change.number]]], math.exp(change.jump))

    def _is_believed(self, m: int, innovation: float, variance: float) -> bool:
        """Whether the filter takes in a sample: not a gross error, unless so many come that the filter is wrong."""
        gross = innovation * innovation > _GROSS * variance and not is_contaminated(self._rows[m])
        self._refused[m] = self._refused[m] + 1 if gross else 0
        return not 0 < self._refused[m] <= _MOST_REFUSED

    def _update_with_effects(self, position_m: float, m: int) -> None:
        """Kalman update with the position of one vehicle."""
        kalman, row = self._filter, self._rows[m]
        x = STATE * m
        off, factor = measurement(kalman.x[x], row, self._scene.circumference_m)
        gain = factor * kalman.P[:, x]
        y, variance = self._innovation(m, position_m)
        step, shrink, _ = robust(y, variance, row)
        measures, noise_var = factor * self._measures[[m]], self._noise_var(m) if m == 0 else 0.0
        kalman.update(
            np.array([position_m]),
            HJacobian=lambda _: measures,
            Hx=lambda state: state[[x]] + off,
            R=np.array([[1.0 / step - factor * gain[x]]]),
            residual=self.road.difference,
        )
        if self._noises is not None:
            self._noises.update(kalman, measures, noise_var)
        if self._alarm is not None:
            self._alarm.update(factor * kalman.K, np.array([x]))
        kalman.P = kalman.P - np.outer(gain, gain) * (shrink - step)

    def _update(self, position_m: Array, moving: Ints) -> None:
        """Kalman update with the positions of the vehicles ``moving`` of the chain."""
        measures, noise_var = self._measures[moving], self._rows[moving, SIGMA_NU] ** 2
        self._filter.update(
            position_m,
            HJacobian=lambda _: measures,
            Hx=lambda x: x[STATE * moving],
            R=np.diag(noise_var),
            residual=self.road.difference,
        )
        if self._noises is not None:
            self._noises.update(self._filter, measures, float(noise_var[0]) if moving[0] == 0 else 0.0)
        if self._alarm is not None:
            self._alarm.update(self._filter.K, STATE * moving)

    def _estimate(
        self, innovation: float, variance: float, density: float, mean_action: float, half_lengths_m: float
    ) -> Estimate:
        x, covariance = self._filter.x, self._filter.P
        period = self._scene.period_s
        # the next speed is v + dt a, so the acceleration is (v' - v) / dt, and so is its row of derivatives
        reads = self._reads
        reads[2] = self._filter.F[1] / period
        reads[2, 1] -= 1.0 / period
        led = self.vehicles > 1 and self._known[1] == MOVING
        nis = innovation * innovation / variance
        return Estimate(
            position_m=float(x[0]) % self.road.circumference_m if self.road.is_ring else float(x[0]),
            speed=float(x[1]),
            acceleration=float(self._filter.next_mean[1] - x[1]) / period,
            covariance=reads @ covariance @ reads.T,
            mean_action=mean_action,
            gap_m=float(x[STATE] - x[0]) - half_lengths_m if led else math.inf,
            approach_rate=float(x[1] - x[STATE + 1]) if led else 0.0,
            innovation_m=innovation,
            innovation_var=variance,
            nis=nis,
            log_likelihood=density,
            scored=not math.isnan(innovation) and self._settled > SETTLING,
        )


@cache
def warm_up() -> None:
    """Load, or compile, the code of a step now, so that no later step has to wait for it."""
    filter_ = OnlineFilter(1.0, Road())
    chain = range(filter_.vehicles)
    for t in range(4):
        filter_.step([50.0 * m + 5.0 * t for m in chain], [m if t < 3 else -1 for m in chain], [4.0 for _ in chain])
