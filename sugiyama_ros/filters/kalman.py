"""The Kalman filter of a chain, sample by sample, with what learns from each of its steps.

The model is stated in ``linearisation``; the Kalman algebra is filterpy's.
"""

import math
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import NAMES, SIGMA_NU
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.contaminated_normal import contaminated_normal
from sugiyama_ros.effects.sensing import is_contaminated
from sugiyama_ros.filters.alarm import StyleAlarm
from sugiyama_ros.filters.any_time import conclude_for
from sugiyama_ros.filters.chain_model import ChainModel
from sugiyama_ros.filters.linearisation import linearise
from sugiyama_ros.filters.measurement import log_density, measurement, noise_var_at, weights
from sugiyama_ros.filters.noise import NOISES, Learning, NoiseLearner
from sugiyama_ros.filters.state import STATE, Drivers, Moment, Scene, State, arrays_for
from sugiyama_ros.filters.vehicles import forget_vehicle, start_vehicle
from sugiyama_ros.road import Road


class ChainKalman(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's extended Kalman filter of a chain, which is told the next mean, F and Q by ``linearise``.

    model: the chain; ``change`` sets another one; road: the road that the vehicles drive on; learning: how the driver's
    noises are learnt, None if they are not; x, P: mean (4 M + A,) and covariance (4 M + A, 4 M + A) of the state;
    known: what is known of each vehicle, (M,); rows: rows of all drivers with what is learnt, (M, WIDTH); noises: what
    learns the driver's noises, None if nothing does; alarm: what watches for a change of style, None where no parameter
    is adapted.
    """

    def __init__(self, model: ChainModel, road: Road, learning: Learning | None) -> None:
        vehicles, adapted = model.vehicles, model.adapted_entries
        size = adapted.stop
        super().__init__(dim_x=size, dim_z=vehicles)
        self.model, self.road, self.learning = model, road, learning
        self.rows: Array = model.rows.copy()
        self.known: Ints = np.zeros(vehicles, np.int64)
        self.x, self.P = np.zeros(size), np.zeros((size, size))
        self.x[adapted] = model.prior_mean
        self.P[adapted, adapted] = np.diag(model.prior_var)
        self._moment = Moment(np.zeros(vehicles), np.full(3, math.nan), 0.0)
        self._arrays = arrays_for(vehicles, len(model.places), ACTIONS, model.scene.period_s)
        linearised = self._arrays[-1]
        self.next_mean, self.F, self.next_noise = linearised.next_mean, linearised.jacobian, linearised.noise
        self._measures = np.zeros((vehicles, size))
        self._measures[np.arange(vehicles), STATE * np.arange(vehicles)] = 1.0
        self.noises: NoiseLearner | None = None
        if learning is not None:
            self.noises = NoiseLearner(learning, np.log(self.rows[0, NOISES]), model.scene.period_s, size)
        places = range(adapted.start, adapted.stop)
        self.alarm = StyleAlarm(places, size, model.scene.period_s) if places else None

    def change(self, model: ChainModel) -> None:
        """Go on with another model of the same chain; the driver's own parameters stay as they are known."""
        learnt = self.rows[0, : len(NAMES)]
        self.model, self.rows = model, model.rows.copy()
        self.rows[0, : len(NAMES)] = learnt
        self.linearise(self._moment)

    def predict_x(self, u: Any = 0) -> None:
        """Take the next mean that ``linearise`` has found."""
        self.x = self.next_mean.copy()

    def go_on(self, periods: float) -> None:
        """Go on by some periods."""
        if periods != 1.0:
            conclude_for(periods, *self._linearised_from, *self._arrays)
        self.Q = self.next_noise
        self.predict()
        if self.noises is not None:
            self.noises.predict(self.F, self.next_noise, periods)
        if self.alarm is not None:
            self.alarm.predict(self.F, periods)

    def linearise(self, moment: Moment) -> float:
        """Put what is learnt into the rows and linearise the next period; returns the own mean action [m/s^2]."""
        model, self._moment = self.model, moment
        if self.noises is not None:
            self.rows[0, NOISES] = self.noises.values
        first = model.adapted_entries.start
        for j, k in enumerate(model.adapted):
            self.rows[0, k] = math.exp(self.x[first + j])
        return linearise(*self._linearised_from, *self._arrays)

    @property
    def _linearised_from(self) -> tuple[State, Drivers, Moment, Scene]:
        """What the next period is linearised from."""
        model = self.model
        drivers = Drivers(self.rows, model.places, model.prior_mean, model.prior_var)
        return State(self.x, self.P, self.known), drivers, self._moment, model.scene

    def forget(self, m: int) -> None:
        """Forget vehicle m of the chain, which is another one now."""
        forget_vehicle(m, State(self.x, self.P, self.known))
        if self.noises is not None:
            self.noises.forget(m)

    def start(self, m: int, position_m: float, elapsed_s: float) -> None:
        """Take in a position of vehicle m, which is not MOVING yet, ``elapsed_s`` after its first position."""
        start_vehicle(m, position_m, elapsed_s, State(self.x, self.P, self.known), self.rows, self.model.scene)
        if m == 0 and self.noises is not None:
            self.noises.start(self.P)
        if m == 0 and self.alarm is not None:
            self.alarm.reset()

    def innovation(self, m: int, position_m: float) -> tuple[float, float]:
        """Return the innovation [m] of vehicle m, NaN where its position is missing, and its variance [m^2]."""
        mean, noise_var = float(self.x[STATE * m]), self._noise_var(m)
        variance = float(self.P[STATE * m, STATE * m])
        if self.model.measured_otherwise:
            off, factor = measurement(mean, self.rows[m], self.model.scene.circumference_m)
            mean, variance = mean + off, factor * factor * variance
        way, lap = position_m - mean, self.road.circumference_m
        return way - lap * round(way / lap) if lap > 0.0 and way == way else way, variance + noise_var

    def _noise_var(self, m: int) -> float:
        """Return the variance [m^2] of the measurement noise of vehicle m, where it is now."""
        if not self.model.measured_otherwise:
            return float(self.rows[m, SIGMA_NU]) ** 2
        return float(noise_var_at(float(self.x[STATE * m]), self.rows[m], self.model.scene.circumference_m))

    def learn(self, innovation: float, variance: float) -> float:
        """Learn from the driver's own innovation, before the update with it; returns its log-likelihood."""
        density = self._learn_noises(innovation, variance)
        if self.alarm is not None:
            self.alarm.observe(innovation, variance)
        return density

    def _learn_noises(self, innovation: float, variance: float) -> float:
        if self.noises is not None:
            noise_var = self._noise_var(0)
            changed = self.model.measured_otherwise
            factor = math.sqrt((variance - noise_var) / float(self.P[0, 0])) if changed else 1.0
            self.noises.learn(innovation, variance, noise_var, factor)
        if self.noises is None or is_contaminated(self.rows[0]):
            return float(log_density(innovation, variance, self.rows[0]))
        return float(
            contaminated_normal(innovation, variance, float(self.rows[0, SIGMA_NU]) ** 2, *self.noises.outliers)[2]
        )

    def check_style(self) -> tuple[str, float] | None:
        """Return the parameter that has jumped and its factor, if the alarm is given; the state is corrected then."""
        if self.alarm is None:
            return None
        change = self.alarm.check(self.x, self.P)
        return None if change is None else (NAMES[self.model.adapted[change.number]], math.exp(change.jump))

    def take_in(self, position_m: Array, vehicles: Ints) -> None:
        """Update the state with measured positions [m] of some vehicles of the chain, (m,) each."""
        if self.model.measured_otherwise:
            for position, m in zip(position_m.tolist(), vehicles.tolist(), strict=True):
                self._update_with_effects(position, m)
        elif len(vehicles):
            self._update(position_m, vehicles)

    def _update_with_effects(self, position_m: float, m: int) -> None:
        row, x = self.rows[m], STATE * m
        off, factor = measurement(self.x[x], row, self.model.scene.circumference_m)
        gain = factor * self.P[:, x]
        y, variance = self.innovation(m, position_m)
        step, shrink = weights(y, variance, row)
        measures, noise_var = factor * self._measures[[m]], self._noise_var(m) if m == 0 else 0.0
        self.update(
            np.array([position_m]),
            HJacobian=lambda _: measures,
            Hx=lambda state: state[[x]] + off,
            R=np.array([[1.0 / step - factor * gain[x]]]),
            residual=self.road.difference,
        )
        if self.noises is not None:
            self.noises.update(self, measures, noise_var)
        if self.alarm is not None:
            self.alarm.update(factor * self.K, np.array([x]))
        self.P = self.P - np.outer(gain, gain) * (shrink - step)

    def _update(self, position_m: Array, vehicles: Ints) -> None:
        measures, noise_var = self._measures[vehicles], self.rows[vehicles, SIGMA_NU] ** 2
        self.update(
            position_m,
            HJacobian=lambda _: measures,
            Hx=lambda x: x[STATE * vehicles],
            R=np.diag(noise_var),
            residual=self.road.difference,
        )
        if self.noises is not None:
            self.noises.update(self, measures, float(noise_var[0]) if vehicles[0] == 0 else 0.0)
        if self.alarm is not None:
            self.alarm.update(self.K, STATE * vehicles)
