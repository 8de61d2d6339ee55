"""A bank of models that predict the same driver side by side, compared by their predictions."""

from collections.abc import Mapping, Sequence

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects.registry import EFFECTS, ROW, effect, switch_on
from sugiyama_ros.filters.online import NOBODY, Estimate, OnlineFilter
from sugiyama_ros.road import Road

#: Name of the model without any effect.
BASE = "base"
#: Values of the effects that the bank follows: those that declare some.
BANK: Mapping[str, Mapping[str, float]] = {name: e.bank for name, e in EFFECTS.items() if e.bank is not None}


def strengths(names: Sequence[str]) -> Array:
    """Return the first parameter of each model of the bank, 0 for the base model."""
    return np.array([0.0 if n == BASE else BANK[n][effect(n).parameters[0].name] for n in names])


class Bank:
    """One filter per model and vehicle; scores are sums of log-likelihoods that forget.

    Parameters
    ----------
    vehicles
        Numbers of the vehicles.
    period_s
        Time between two samples [s].
    road
        The road that the vehicles drive on.
    parameters
        Of all drivers at the reference period, (P,) or (WIDTH,).
    forget_s
        Time [s] after which a sample counts a factor e less.

    References
    ----------
    Multiple-model estimation for models that do not switch: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with
    Applications to Tracking and Navigation (2001), section 11.6.
    """

    def __init__(
        self, vehicles: Sequence[int], period_s: float, road: Road, parameters: Array, forget_s: float
    ) -> None:
        self.names = (BASE, *BANK)
        base = ROW.with_effects(parameters)
        rows = [base] + [switch_on(base, name, values) for name, values in BANK.items()]
        self._filters = {v: [OnlineFilter(period_s, road, row) for row in rows] for v in vehicles}
        self._memory = float(np.exp(-period_s / forget_s))
        self.scores = np.zeros(len(self.names))
        self.samples = 0

    def step(
        self,
        vehicle: int,
        position_m: Sequence[float],
        identity: Sequence[int],
        length_m: Sequence[float],
        time_s: float,
        behind: tuple[float, int, float] = NOBODY,
    ) -> list[Estimate]:
        """Return all models' estimates of one vehicle and add up their scores; arguments as ``OnlineFilter.step``."""
        estimates = [f.step(position_m, identity, length_m, time_s, behind) for f in self._filters[vehicle]]
        if all(e.scored for e in estimates):
            self.scores += [e.log_likelihood for e in estimates]
            self.samples += 1
        return estimates

    def forget(self) -> None:
        """Let all scores forget one period; call once per sample of time."""
        self.scores *= self._memory

    @property
    def gains(self) -> Array:
        """Scores less the score of the base model [nats]."""
        return np.asarray(self.scores - self.scores[0])

    @property
    def weights(self) -> Array:
        """Posterior probabilities of the models, all equally likely before."""
        likelihood = np.exp(self.scores - self.scores.max())
        return np.asarray(likelihood / likelihood.sum())
