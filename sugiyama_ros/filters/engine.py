"""What an online filter is made of: the estimate after a sample, and the engine that works it out."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters.chain_model import ChainModel
from sugiyama_ros.filters.noise import Learning

#: Position [m], speed [m/s] and length [m] of the vehicle behind where there is none.
NO_REAR = (math.nan, math.nan, math.nan)


class Estimate(NamedTuple):
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


class KnownNoises(Protocol):
    """What is known of the driver's noises: mean (2,) and covariance (2, 2) of their logarithms."""

    @property
    def mean(self) -> Array:
        """Mean (2,) of the logarithms."""

    @property
    def covariance(self) -> Array:
        """Covariance (2, 2) of the logarithms."""

    @property
    def d_mean(self) -> Array:
        """Derivatives (2, N) of the filter's mean by the logarithms."""

    @property
    def d_covariance(self) -> Array:
        """Derivatives (2, N, N) of the filter's covariance by the logarithms."""

    @property
    def values(self) -> Array:
        """The noises (2,) themselves."""

    def recall(self, mean: Array, covariance: Array) -> None:
        """Go on from a mean (2,) of the logarithms and its covariance (2, 2)."""


class Engine(Protocol):
    """The Kalman filter of a chain and all that learns from its steps.

    model: the chain; learning: how the driver's noises are learnt, None if they are not; x, P: mean (4 M + A,) and
    covariance (4 M + A, 4 M + A) of the state; next_mean: predicted mean at the next sample, (4 M + A,); rows: rows of
    all drivers with what is learnt, (M, WIDTH); change_of_style: name of the parameter that has jumped at the latest
    sample, and its factor; none if none has.
    """

    model: ChainModel
    learning: Learning | None
    x: Array
    P: Array
    next_mean: Array
    rows: Array
    change_of_style: tuple[str, float] | None

    @property
    def noises(self) -> KnownNoises | None:
        """The driver's noises, None if they are not learnt."""

    def change(self, model: ChainModel) -> None:
        """Go on with another model of the same chain; the driver's own parameters stay as they are known."""

    def step(
        self,
        position_m: Sequence[float],
        identity: Sequence[int],
        length_m: Sequence[float],
        rear: tuple[float, float, float],
        time_s: float,
        periods: float = 1.0,
    ) -> Estimate:
        """Go on by some periods and take in a sample.

        position_m, identity, length_m: of the vehicles, (M,), as for ``OnlineFilter.step``; rear: position [m], speed
        [m/s] and length [m] of the vehicle behind; ``NO_REAR`` where it is not known; time_s: time of the recording
        [s]; periods: time since the sample before, in periods of the model: one step of ``any_time.steps_between``.
        """

    def speed_of(self, m: int, vehicle: int) -> float:
        """Return the speed [m/s] of vehicle number m of the chain; 0 if it is another vehicle, or not known."""

    def saved(self) -> Any:
        """Return all that the filter knows now, for ``restore``."""

    def restore(self, saved: Any) -> None:
        """Go back to what ``saved`` has returned, with the same model."""
