"""A step of the online filter in Python, on filterpy: slow, to be read, and the reference of the compiled step."""

import copy
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sugiyama_ros.effects.sensing import is_contaminated
from sugiyama_ros.filters.causal_kernel import SETTLING
from sugiyama_ros.filters.chain_model import ChainModel
from sugiyama_ros.filters.engine import Estimate
from sugiyama_ros.filters.kalman import ChainKalman
from sugiyama_ros.filters.noise import Learning
from sugiyama_ros.filters.state import MOVING, STATE, Moment, State
from sugiyama_ros.filters.vehicles import gross_in_a_row
from sugiyama_ros.road import Road


class ReadableKalman(ChainKalman):
    """The Kalman filter of a chain, sample by sample; arguments as for ``ChainKalman``.

    change_of_style: name of the parameter that has jumped at the latest sample, and its factor; none if none has.
    """

    def __init__(self, model: ChainModel, road: Road, learning: Learning | None) -> None:
        super().__init__(model, road, learning)
        vehicles = model.vehicles
        self.change_of_style: tuple[str, float] | None = None
        self._identity: list[int] = [-1] * vehicles
        self._waited = [0.0] * vehicles
        self._gross = [0] * vehicles
        self._settled = 0
        self._started = False
        self._reads = np.eye(3, model.adapted_entries.stop)

    def step(
        self,
        position_m: Sequence[float],
        identity: Sequence[int],
        length_m: Sequence[float],
        rear: tuple[float, float, float],
        time_s: float,
        periods: float = 1.0,
    ) -> Estimate:
        """Go on by some periods and take in a sample; see ``Engine.step``."""
        self.change_of_style = None
        if self._started:
            self.go_on(periods)
        self._started = True
        self._settled = 1 if identity[0] != self._identity[0] else self._settled + 1
        for m in range(self.model.vehicles):
            self._waited[m] += periods
            if identity[m] < 0 or identity[m] != self._identity[m]:
                self.forget(m)
                self._identity[m], self._gross[m] = int(identity[m]), 0
        scores = self._take_in(position_m)
        lengths = np.array(length_m)
        mean_action = self.linearise(Moment(lengths, np.array(rear), time_s))
        return self._estimate(*scores, mean_action, 0.5 * float(lengths[:2].sum()))

    def speed_of(self, m: int, vehicle: int) -> float:
        """Return the speed [m/s] of vehicle number m of the chain; 0 if it is another vehicle, or not known."""
        return float(self.x[STATE * m + 1]) if self._identity[m] == vehicle else 0.0

    def saved(self) -> dict[str, Any]:
        """Return all that the filter knows now, for ``restore``."""
        return copy.deepcopy(self.__dict__)

    def restore(self, saved: dict[str, Any]) -> None:
        """Go back to what ``saved`` has returned, with the same model."""
        self.__dict__.update(copy.deepcopy(saved))

    def _take_in(self, position_m: Sequence[float]) -> tuple[float, float, float]:
        """Update with a sample; returns the own innovation [m], its variance [m^2] and its log-likelihood."""
        known = self.known.tolist()
        sampled = [m for m in range(len(known)) if self._identity[m] >= 0 and not math.isnan(position_m[m])]
        moving = [m for m in sampled if known[m] == MOVING]
        innovations = {m: self.innovation(m, position_m[m]) for m in moving}
        innovation, variance, density = math.nan, math.nan, math.nan
        if 0 in innovations:
            innovation, variance = innovations[0]
            density = self.learn(innovation, variance)
        elif known[0] == MOVING:
            variance = self.innovation(0, math.nan)[1]
        accepted = [m for m in moving if self._is_accepted(m, *innovations[m])]
        self.take_in(np.array([position_m[m] for m in accepted]), np.array(accepted))
        if 0 in innovations:
            self.change_of_style = self.check_style()
        for m in sampled:
            if known[m] != MOVING:
                self.start(m, position_m[m], self._waited[m] * self.model.scene.period_s)
                self._waited[m] = 0.0
        return innovation, variance, density

    def _is_accepted(self, m: int, innovation: float, variance: float) -> bool:
        """Whether the filter takes in a sample: not a gross error, unless so many come that the filter is wrong."""
        contaminated = is_contaminated(self.rows[m])
        state, scene = State(self.x, self.P, self.known), self.model.scene
        self._gross[m] = gross_in_a_row(m, self._gross[m], innovation, variance, contaminated, state, scene)
        return self._gross[m] == 0 or contaminated

    def _estimate(
        self, innovation: float, variance: float, density: float, mean_action: float, half_lengths_m: float
    ) -> Estimate:
        x, next_speed, period = self.x, self.next_mean[1], self.model.scene.period_s
        # the next speed is v + dt a, so the acceleration is (v' - v) / dt, and so is its row of derivatives
        reads = self._reads
        reads[2] = self.F[1] / period
        reads[2, 1] -= 1.0 / period
        led = len(self.known) > 1 and self.known[1] == MOVING
        nis = innovation * innovation / variance
        return Estimate(
            position_m=float(x[0]) % self.road.circumference_m if self.road.is_ring else float(x[0]),
            speed=float(x[1]),
            acceleration=float(next_speed - x[1]) / period,
            covariance=reads @ self.P @ reads.T,
            mean_action=mean_action,
            gap_m=float(x[STATE] - x[0]) - half_lengths_m if led else math.inf,
            approach_rate=float(x[1] - x[STATE + 1]) if led else 0.0,
            innovation_m=innovation,
            innovation_var=variance,
            nis=nis,
            log_likelihood=density,
            scored=not math.isnan(innovation) and self._settled > SETTLING,
        )
