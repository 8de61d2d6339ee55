"""One driver's filter, sample by sample, with online updates of the driver's parameters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, check, population
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.effects.sensing import is_contaminated
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.causal import SETTLING
from sugiyama_ros.filters.chain import CHAIN, NOT_ADAPTED, Adaptation
from sugiyama_ros.filters.chain_model import ChainModel, chain_model
from sugiyama_ros.filters.kalman import ChainKalman
from sugiyama_ros.filters.learnt import (
    Learnt,
    adapted_names,
    identified_names,
    known_parameters,
    learnt_of,
    parameter_covariance,
    recall,
)
from sugiyama_ros.filters.noise import Learning
from sugiyama_ros.filters.state import MOVING, STATE, Moment
from sugiyama_ros.road import Road

#: Adaptation of the estimator nodes: desired speed and risk premium. The prior stds are about the stds over the drivers
#: of the measured experiment, each fitted alone.
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
    noises are learnt, the log-likelihood allows for outliers (``Learning.outliers``).
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


class OnlineFilter:
    """Causal filter of one driver behind a chain of vehicles.

    Parameters
    ----------
    period_s
        Time between two samples [s].
    road
        The road that the vehicles drive on.
    parameters
        Of the driver at the start, at the reference period: (P,), or a row with effects (WIDTH,). The mean of the
        population if left out.
    ahead
        The same of the drivers ahead.
    adaptation
        Which preferences of the driver are learnt.
    learning
        How the driver's noises are learnt, None if they are not.
    vehicles
        Number M of vehicles in the chain.

    Attributes
    ----------
    prior
        What was known of the driver before the first sample.
    change_of_style
        Name of the parameter that has jumped at the latest sample, and its factor; None if none has.
    kalman
        The Kalman filter itself.

    Raises
    ------
    InputError
        For parameters out of bounds.
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
        self._ahead, self._adaptation, self._learning = ahead, adaptation, learning
        self._model = self._model_of(ROW.with_effects(parameters))
        self._reads = np.eye(3, self._model.adapted_entries.stop)
        self.reset()

    def _model_of(self, row: Array) -> ChainModel:
        lap = self.road.circumference_m
        return chain_model(row, self._ahead, self._adaptation, self.vehicles, self.period_s, lap)

    def reset(self) -> None:
        """Forget all samples and everything learnt."""
        self.kalman = ChainKalman(self._model, self.road, self._learning)
        self._behind = self._follower() if self._model.has_effects else None
        self._identity: list[int] = [-1] * self.vehicles
        self._waited = [0] * self.vehicles
        self._refused = [0] * self.vehicles
        self._settled = 0
        self._started = False
        self.change_of_style: tuple[str, float] | None = None
        self.prior = self.learnt

    def change(self, parameters: Array) -> None:
        """Go on with other effects and keep all that was learnt.

        Parameters
        ----------
        parameters
            Row (WIDTH,) with the effects. The driver's own parameters stay as they are.

        Raises
        ------
        InputError
            If an effect needs a parameter adapted that is not.
        """
        row = ROW.with_effects(self._model.row[: len(NAMES)])
        row[len(NAMES) :] = parameters[len(NAMES) :]
        model = self._model_of(row)
        if not np.array_equal(model.places, self._model.places):
            raise InputError(
                "effect: this filter does not adapt the preferences that wander with it; start the filter anew"
            )
        self._model = model
        self.kalman.change(model)
        if model.has_effects and self._behind is None:
            self._behind = self._follower()

    def _follower(self) -> "OnlineFilter":
        """Return a filter of the vehicle behind, of which nothing is learnt."""
        return OnlineFilter(self.period_s, self.road, adaptation=NOT_ADAPTED, learning=None, vehicles=1)

    @property
    def parameters(self) -> Array:
        """The driver's row (WIDTH,) as known now, at the reference period."""
        return known_parameters(self.kalman)

    @property
    def parameter_covariance(self) -> Array:
        """Covariance (WIDTH, WIDTH) of ``parameters``; zero for parameters that are not adapted."""
        return parameter_covariance(self.kalman)

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the adapted parameters whose standard deviation is less than half of the prior's."""
        return identified_names(self.kalman)

    @property
    def learnt(self) -> Learnt:
        """All that is known of the driver's parameters, to go on from."""
        return learnt_of(self.kalman)

    def recall(self, learnt: Learnt) -> None:
        """Go on from what was learnt before, of the parameters that are adapted here."""
        recall(self.kalman, learnt)

    @property
    def adapted(self) -> tuple[str, ...]:
        """Names of the parameters that are adapted."""
        return adapted_names(self.kalman)

    @property
    def looks_back(self) -> bool:
        """Whether the driver has effects, which may depend on the vehicle behind."""
        return self._model.has_effects

    def step(
        self,
        position_m: Sequence[float],
        identity: Sequence[int],
        length_m: Sequence[float],
        time_s: float = 0.0,
        behind: tuple[float, int, float] = NOBODY,
    ) -> Estimate:
        """Go on by one period and take in its sample.

        Parameters
        ----------
        position_m
            Measured positions [m], own first, then the vehicles ahead, (M,); NaN where missing.
        identity
            Numbers of these vehicles, (M,); -1 for none.
        length_m
            Their lengths [m], (M,).
        time_s
            Time of the recording [s], for effects that depend on it.
        behind
            Position [m], number and length [m] of the vehicle behind, where ``looks_back``.

        Returns
        -------
        Estimate
            After the update.
        """
        self.change_of_style = None
        if self._started:
            self.kalman.go_on()
        self._started = True
        self._settled = 1 if identity[0] != self._identity[0] else self._settled + 1
        for m in range(self.vehicles):
            self._waited[m] += 1
            if identity[m] < 0 or identity[m] != self._identity[m]:
                self.kalman.forget(m)
                self._identity[m] = int(identity[m])
        scores = self._take_in(position_m)
        lengths = np.array(length_m)
        mean_action = self.kalman.linearise(Moment(lengths, self._rear(behind, time_s), time_s))
        return self._estimate(*scores, mean_action, 0.5 * float(lengths[:2].sum()))

    def _take_in(self, position_m: Sequence[float]) -> tuple[float, float, float]:
        """Update with a sample; returns the own innovation [m], its variance [m^2] and its log-likelihood."""
        kalman, known = self.kalman, self.kalman.known.tolist()
        sampled = [m for m in range(self.vehicles) if self._identity[m] >= 0 and not math.isnan(position_m[m])]
        moving = [m for m in sampled if known[m] == MOVING]
        innovations = {m: kalman.innovation(m, position_m[m]) for m in moving}
        innovation, variance, density = math.nan, math.nan, math.nan
        if 0 in innovations:
            innovation, variance = innovations[0]
            density = kalman.learn(innovation, variance)
        elif known[0] == MOVING:
            variance = kalman.innovation(0, math.nan)[1]
        accepted = [m for m in moving if self._is_accepted(m, *innovations[m])]
        kalman.take_in(np.array([position_m[m] for m in accepted]), np.array(accepted))
        if 0 in innovations:
            self.change_of_style = kalman.check_style()
        for m in sampled:
            if known[m] != MOVING:
                kalman.start(m, position_m[m], self._waited[m] * self.period_s)
                self._waited[m] = 0
        return innovation, variance, density

    def _rear(self, behind: tuple[float, int, float], time_s: float) -> Array:
        """Return position [m], speed [m/s] and length [m] of the vehicle behind, NaN where it is not known."""
        if self._behind is None:
            return _NO_REAR
        position, number, length = behind
        estimate = self._behind.step([position], [number], [length], time_s)
        if math.isnan(estimate.innovation_var):
            return _NO_REAR
        return np.array([estimate.position_m, estimate.speed, length])

    def _is_accepted(self, m: int, innovation: float, variance: float) -> bool:
        """Whether the filter takes in a sample: not a gross error, unless so many come that the filter is wrong."""
        gross = innovation * innovation > _GROSS * variance and not is_contaminated(self.kalman.rows[m])
        self._refused[m] = self._refused[m] + 1 if gross else 0
        return not 0 < self._refused[m] <= _MOST_REFUSED

    def _estimate(
        self, innovation: float, variance: float, density: float, mean_action: float, half_lengths_m: float
    ) -> Estimate:
        kalman = self.kalman
        x, next_speed = kalman.x, kalman.next_mean[1]
        # the next speed is v + dt a, so the acceleration is (v' - v) / dt, and so is its row of derivatives
        reads = self._reads
        reads[2] = kalman.F[1] / self.period_s
        reads[2, 1] -= 1.0 / self.period_s
        led = self.vehicles > 1 and kalman.known[1] == MOVING
        nis = innovation * innovation / variance
        return Estimate(
            position_m=float(x[0]) % self.road.circumference_m if self.road.is_ring else float(x[0]),
            speed=float(x[1]),
            acceleration=float(next_speed - x[1]) / self.period_s,
            covariance=reads @ kalman.P @ reads.T,
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
