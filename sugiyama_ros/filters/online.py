"""One driver's filter, sample by sample, with online updates of the driver's parameters."""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import compress
from typing import Any, Literal

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import NAMES, V_STAR, check, population
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.chain import CHAIN, NO_LINES, NO_REAR, NOT_ADAPTED, NOTHING_AROUND, Adaptation
from sugiyama_ros.filters.first_look import NOBODY as NOBODY
from sugiyama_ros.filters.first_look import SMOOTHED, ChainStep, FirstLook, steps_between
from sugiyama_ros.filters.kalman import ChainModel, FilterpyKalman, OnlineKalman, chain_model
from sugiyama_ros.filters.kalman import Estimate as Estimate
from sugiyama_ros.filters.noise import NOISES, Learning
from sugiyama_ros.road import Road

#: Adaptation of the estimator nodes: desired speed and risk premium. The prior stds are about the stds over the drivers
#: of the measured experiment, each fitted alone.
ADAPT = Adaptation(names=("v_star", "kappa_v"), prior_std=(0.1, 0.4), relaxation_s=6000.0)
#: Learning of the estimator nodes: measurement noise and acceleration noise.
LEARN = Learning()
# What is learnt where positions are smooth: road and instrument are others than those of the measured drivers.
_ADAPT_ELSEWHERE = Adaptation(names=("v_star", "kappa_v"), prior_std=(0.3, 0.4), relaxation_s=6000.0)
_LEARN_ELSEWHERE = Learning(prior_std=(1.0, 0.7))


_ENGINES = {"compiled": OnlineKalman, "filterpy": FilterpyKalman}


@dataclass(frozen=True, eq=False)
class Learnt:
    """Logarithms (A,) of adapted parameters at the reference period, by name, and their covariance (A, A).

    Parameters of effects, such as ``drag.c0``, stand with their values, not with logarithms.
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class _Outset:
    """With what a filter starts: parameters of the drivers ahead, and what is learnt, as in ``OnlineFilter``."""

    ahead: Array | None
    adaptation: Adaptation
    learning: Learning | None


class OnlineFilter:
    """Causal filter of one driver behind a chain of vehicles.

    period_s: time between two samples [s]; road: the road that the vehicles drive on; parameters: of the driver at the
    start, at the reference period: (P,), or a row with effects (WIDTH,); the mean of the population if left out; ahead:
    the same of the drivers ahead; adaptation: which preferences of the driver are learnt; learning: how the driver's
    noises are learnt, None if they are not; while they are, the filter starts anew with other noises as soon as the
    first positions show that they are smoother than the noises allow (``first_look``); vehicles: number M of vehicles
    in the chain; engine: "compiled", or "filterpy" for the same estimates by code that is slower, and meant to be read;
    prior: what was known of the driver before the first sample; kalman: the engine: the Kalman filter itself and what
    learns from its steps. Raises InputError.
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
        engine: Literal["compiled", "filterpy"] = "compiled",
    ) -> None:
        parameters = population() if parameters is None else parameters
        check(parameters)
        self.road = road
        self.period_s = period_s
        self.vehicles = vehicles
        self.engine = engine
        self._start = _Outset(ahead, adaptation, learning)
        self._model = self._model_of(ROW.with_effects(parameters))
        self._look = FirstLook(road, period_s) if learning is not None else None
        self._recalled: Learnt | None = None
        self.reset()

    def _model_of(self, row: Array) -> ChainModel:
        lap = self.road.circumference_m
        return chain_model(row, self._start.ahead, self._start.adaptation, self.vehicles, self.period_s, lap)

    def reset(self) -> None:
        """Forget all samples and everything learnt."""
        self.kalman = _ENGINES[self.engine](self._model, self._start.learning)
        self._behind = self._follower() if self._model.sees_rear else None
        self.prior = self.learnt
        if self._look is not None:
            self._look, self._recalled = FirstLook(self.road, self.period_s), None

    def change(self, parameters: Array) -> None:
        """Go on with other effects and keep all that was learnt. Raises InputError."""
        row = ROW.with_effects(self._model.row[: len(NAMES)])
        row[len(NAMES) :] = parameters[len(NAMES) :]
        model = self._model_of(row)
        if not np.array_equal(model.places, self._model.places):
            raise InputError(
                "effect: this filter does not adapt the preferences that wander with it; start the filter anew"
            )
        self._model = model
        self.kalman.change(model)
        if model.sees_rear and self._behind is None:
            self._behind = self._follower()

    def _follower(self) -> "OnlineFilter":
        """Return a filter of the vehicle behind, of which nothing is learnt."""
        return OnlineFilter(
            self.period_s, self.road, self._start.ahead, None, NOT_ADAPTED, None, vehicles=1, engine=self.engine
        )

    @property
    def change_of_style(self) -> tuple[str, float] | None:
        """Name of the parameter that has jumped at the latest sample, and its factor; None if none has."""
        return self.kalman.change_of_style

    @property
    def adapted(self) -> tuple[str, ...]:
        """Names of the parameters that are adapted, noises first."""
        return self.kalman.names

    @property
    def parameters(self) -> Array:
        """The driver's row (WIDTH,) as known now, at the reference period."""
        known: Array = self.kalman.model.row.copy()
        known[self.kalman.places] = self.kalman.values
        return known

    @property
    def learnt(self) -> Learnt:
        """All that is known of the driver's parameters, to go on from."""
        return Learnt(self.kalman.names, *self.kalman.learnt)

    @property
    def adapted_covariance(self) -> Array:
        """Covariance (A, A) of the adapted parameters, in the order of ``adapted``."""
        values = self.kalman.values
        return np.asarray(self.kalman.learnt[1] * values * values[:, None])

    @property
    def parameter_covariance(self) -> Array:
        """Covariance (WIDTH, WIDTH) of ``parameters``; zero for parameters that are not adapted."""
        covariance, at = np.zeros((ROW.width, ROW.width)), [ROW.entries.index(name) for name in self.adapted]
        covariance[np.ix_(at, at)] = self.adapted_covariance
        return covariance

    @property
    def is_identified(self) -> Mask:
        """Whether the standard deviation of each adapted parameter is less than half of the prior's, (A,)."""
        return np.asarray(self.kalman.learnt[1].diagonal() < 0.25 * self.kalman.prior_var)

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the adapted parameters whose standard deviation is less than half of the prior's."""
        return tuple(compress(self.adapted, self.is_identified.tolist()))

    def plain_copy(self) -> "OnlineFilter":
        """Return a filter that knows the same, without a first look and without what a subclass adds."""
        copied = OnlineFilter.__new__(OnlineFilter)
        copied.__dict__.update({name: self.__dict__[name] for name in ("road", "period_s", "vehicles", "engine")})
        copied.kalman, copied._behind = copy.deepcopy((self.kalman, self._behind))
        copied._model, copied._start, copied._look = copied.kalman.model, self._start, None
        copied.prior, copied._recalled = self.prior, self._recalled
        return copied

    @property
    def is_smooth(self) -> bool:
        """Whether the filter has started anew, because positions are smoother than its noises were."""
        return self._start.learning is _LEARN_ELSEWHERE

    def saved(self) -> Any:
        """Return all that the filter knows now, for ``restore``."""
        parts = self.kalman, self._behind, self._model, self._start, self.prior, self._recalled
        behind = None if self._behind is None else self._behind.saved()
        return parts, self.kalman.saved(), behind, None if self._look is None else self._look.copied()

    def restore(self, saved: Any) -> None:
        """Go back to what ``saved`` has returned. ``change`` must not have been called since."""
        parts, own, behind, look = saved
        self.kalman, self._behind, self._model, self._start, self.prior, self._recalled = parts
        self._look = None if look is None else look.copied()
        self.kalman.restore(own)
        if self._behind is not None:
            self._behind.restore(behind)

    def restart(self) -> None:
        """Forget where the vehicles are, and keep what was learnt of the driver."""
        learnt, prior, recalled = self.learnt, self.prior, self._recalled
        self.reset()
        self._recall(learnt)
        self.prior, self._recalled = prior, recalled

    def recall(self, learnt: Learnt) -> None:
        """Go on from what was learnt before, of the parameters that are adapted here."""
        if self._look is not None and not self._look.samples:
            self._recalled = learnt
        self._recall(learnt)

    def _recall(self, learnt: Learnt) -> None:
        """Go on from what was learnt before of the parameters that the Kalman filter knows."""
        kalman, model, noises = self.kalman, self.kalman.model, self.kalman.noises
        at = {name: k for k, name in enumerate(learnt.names)}
        of_noises = [at[NAMES[k]] for k in NOISES if NAMES[k] in at]
        if noises is not None and len(of_noises) == len(NOISES):
            noises.recall(learnt.mean[of_noises] + model.noise_shift, learnt.covariance[np.ix_(of_noises, of_noises)])
            kalman.rows[0, NOISES] = np.exp(noises.mean)
        own, entries = [at[NAMES[k]] for k in model.adapted if NAMES[k] in at], model.adapted_entries
        if len(own) == len(model.adapted):
            kalman.x[entries] = kalman.next_mean[entries] = learnt.mean[own]
            kalman.P[entries, :], kalman.P[:, entries] = 0.0, 0.0
            kalman.P[entries, entries] = learnt.covariance[np.ix_(own, own)]
            kalman.rows[0, model.adapted] = np.exp(learnt.mean[own])

    def speed_of(self, m: int, vehicle: int) -> float:
        """Return the speed [m/s] of vehicle number m of the chain as known now; 0 if it is not this vehicle yet."""
        return self.kalman.speed_of(m, vehicle)

    @property
    def looks_back(self) -> bool:
        """Whether an effect of the driver depends on the vehicle behind."""
        return self._model.sees_rear

    def step(
        self,
        position_m: Sequence[float],
        identity: Sequence[int],
        length_m: Sequence[float],
        time_s: float = 0.0,
        behind: tuple[float, int, float] = NOBODY,
        elapsed_s: float | None = None,
        lines: Sequence[float] = NO_LINES,
    ) -> Estimate:
        """Go on in time and take in a sample.

        Over more than a period and a half, the filter predicts in several steps.

        position_m: measured positions [m], own first, then the vehicles ahead, (M,); naN where missing; length_m: their
        lengths [m], (M,); time_s: time of the recording [s], for effects that depend on it; behind: position [m],
        number and length [m] of the vehicle behind, where ``looks_back``; elapsed_s: time [s] since the sample before,
        above 0; a period if left out; lines: (8,) position [m] of the line ahead, times [s] until who goes first
        reaches the place behind it and has left it, and curvature [1/m] of the road; the same of the leader.
        """
        sample = ChainStep(position_m, identity, length_m, time_s, behind, elapsed_s, lines)
        estimate = self._step(sample)
        if self._look is not None:
            self._look.take_in(sample)
            if self._look.is_over:
                return self._conclude(self._look) or estimate
        return estimate

    def _step(self, sample: ChainStep) -> Estimate:
        position_m, identity, length_m, time_s, behind, elapsed_s, lines = sample
        steps, periods = (1, 1.0) if elapsed_s is None else steps_between(elapsed_s, self.period_s)
        for left in range(steps - 1, 0, -1):
            before_s, nowhere = time_s - left * periods * self.period_s, [math.nan] * len(position_m)
            rear = self._rear((math.nan, behind[1], behind[2]), before_s, periods)
            self.kalman.step(nowhere, identity, length_m, (*rear, *lines), before_s, periods)
        around = *self._rear(behind, time_s, periods), *lines
        return self.kalman.step(position_m, identity, length_m, around, time_s, periods)

    def _conclude(self, look: FirstLook) -> Estimate | None:
        """End the first look. If positions are smooth, start anew and take in the samples again."""
        self._look, estimate = None, None
        row = look.start(self._model.row)
        if row is None:
            return None
        ahead = ROW.with_effects(population() if self._start.ahead is None else self._start.ahead)
        ahead[[*SMOOTHED, V_STAR]] = row[[*SMOOTHED, V_STAR]]
        wanted = _ADAPT_ELSEWHERE if self._start.adaptation == ADAPT else self._start.adaptation
        self._start = _Outset(ahead, wanted, _LEARN_ELSEWHERE)
        self._model = self._model_of(row)
        self.reset()
        if self._recalled is not None:
            self.recall(self._recalled)
        for sample in look.samples:
            estimate = self._step(sample)
        return estimate

    def _rear(self, behind: tuple[float, int, float], time_s: float, periods: float) -> tuple[float, float, float]:
        """Return position [m], speed [m/s] and length [m] of the vehicle behind; ``NO_REAR`` while it is not known."""
        if self._behind is None:
            return NO_REAR
        position, number, length = behind
        estimate = self._behind.kalman.step([position], [number], [length], NOTHING_AROUND, time_s, periods)
        if math.isnan(estimate.innovation_var):
            return NO_REAR
        return estimate.position_m, estimate.speed, length


@cache
def warm_up() -> None:
    """Load, or compile, the code of a step now, so that no later step has to wait for it."""
    filter_ = OnlineFilter(1.0, Road())
    chain = range(filter_.vehicles)
    for t in range(4):
        filter_.step([50.0 * m + 5.0 * t for m in chain], [m if t < 3 else -1 for m in chain], [4.0 for _ in chain])
