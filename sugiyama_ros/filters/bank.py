"""A bank of models that predict the same drivers side by side, compared by their predictions."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.effects.effect import Values as Given
from sugiyama_ros.effects.registry import EFFECTS, ROW, active, effect, switch_on
from sugiyama_ros.filters.chain import NO_LINES
from sugiyama_ros.filters.effect_filter import EVERY_S, Sensitivity, values_of
from sugiyama_ros.filters.online import NOBODY, OnlineFilter
from sugiyama_ros.road import Road

#: Name of the model without any further effect.
BASE = "base"
# Values at which the effects of the bank begin: those that declare some. Places that they leave out are tried.
_BANK: Mapping[str, Mapping[str, float]] = {name: e.bank for name, e in EFFECTS.items() if e.bank is not None}
#: Time [s] over which weights must be stable to be settled, and by how much they may change then.
SETTLED_S, _STABLE = 60.0, 0.1
# Places all along a ring at which an effect of a place begins; it reaches over the next places.
_PLACES = 4


def variants_of(name: str, road: Road) -> tuple[Given, ...]:
    """Return the values at which an effect begins in the bank; none for an effect of a place on an open road."""
    given = _BANK[name]
    left_out = [p for p in effect(name).parameters if p.axis == "place" and p.name not in given]
    if not left_out:
        return (given,)
    lap = road.circumference_m
    return tuple(
        {**given, left_out[0].name: (k + 0.5) / _PLACES * lap, "width": 2.0 / _PLACES * lap}
        for k in range(_PLACES if road.is_ring else 0)
    )


class _Variant:
    """One model: a filter for each vehicle, and strengths and places that all drivers share, fitted to what comes."""

    def __init__(self, period_s: float, road: Road, row: Array, name: str) -> None:
        self.filters: dict[int, OnlineFilter] = {}
        self.score, self._row, self._name, self._period_s, self._road = 0.0, row, name, period_s, road
        # every filter allows for outliers already, so their share is not fitted
        fitted = name != BASE and effect(name).contamination is None
        names = [f"{name}.{switch}" for switch in effect(name).switches] if fitted else []
        # half the way to the next place
        near_m = 0.5 / _PLACES * road.circumference_m
        places = {f"{name}.{p}": near_m for p in variants_of(name, road)[0] if p not in _BANK[name]} if fitted else {}
        self.values = values_of(row, [*names, *places], places)
        self._beside: dict[int, Sensitivity] = {}

    def meet(self, vehicle: int) -> None:
        """Follow one more vehicle."""
        self.filters[vehicle] = OnlineFilter(self._period_s, self._road, self._row)
        self._beside[vehicle] = Sensitivity(self.filters[vehicle], self.values)

    def leave(self, vehicle: int) -> None:
        """Follow a vehicle no longer."""
        del self.filters[vehicle], self._beside[vehicle]

    def step(self, vehicle: int, sample: tuple[Any, ...]) -> tuple[bool, float]:
        """Take in a sample of one vehicle; returns whether it counts, and its log-likelihood."""
        estimate = self.filters[vehicle].step(*sample)
        self._beside[vehicle].take_in(estimate, sample)
        return estimate.scored, estimate.log_likelihood

    def fit(self, elapsed_s: float) -> None:
        """Go on with the values that fit what came so far."""
        moved = self.values.move(elapsed_s)
        for beside in self._beside.values():
            beside.move(moved)

    @property
    def fitted(self) -> dict[str, float]:
        """Parameters of the effect as fitted so far, by name; none of the base model."""
        if self._name == BASE:
            return {}
        row = self._row.copy()
        row[self.values.places] = self.values.mean
        found = {p: float(row[ROW.index_of(self._name, p.name)]) for p in effect(self._name).parameters}
        lap_m = self._road.circumference_m
        return {p.name: v % lap_m if lap_m > 0.0 and p.axis == "place" else v for p, v in found.items()}

    @property
    def cost(self) -> float:
        """What the fitted values cost [nats]: how much narrower the data have made them than their prior."""
        narrower = np.linalg.slogdet(self.values.covariance)[1] - 2.0 * np.sum(np.log(self.values.prior_std))
        return max(0.0, -0.5 * float(narrower))


class Bank:
    """A filter for each model and vehicle; scores are sums of log-likelihoods that forget.

    The strength of each effect is fitted as the samples come; a sample is predicted before it is fitted. An effect of
    a place begins at places all along a ring, and its place is fitted too. Vehicles may come and go (`meet`, `leave`).

    period_s: time between two samples [s]; road: the road that the vehicles drive on; parameters: of all drivers at the
    reference period, (P,), or (WIDTH,) with the effects that the model has already; forget_s: time [s] after which a
    sample counts a factor e less; row: the base model, (WIDTH,); effects: names of the effects that it has; names:
    names of the models, the base model first; samples: number of scored samples.

    References
    ----------
    Multiple-model estimation for models that do not switch: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with
    Applications to Tracking and Navigation (2001), section 11.6.
    """

    def __init__(self, period_s: float, road: Road, parameters: Array, forget_s: float) -> None:
        base = ROW.with_effects(parameters)
        self.row, self.effects = base, active(base)
        self._models = {BASE: [_Variant(period_s, road, base, BASE)]}
        for name in _BANK:
            given = () if name in self.effects else variants_of(name, road)
            if given:
                rows = [switch_on(base, name, values) for values in given]
                self._models[name] = [_Variant(period_s, road, row, name) for row in rows]
        self.names = tuple(self._models)
        self._period_s = period_s
        self._memory = float(np.exp(-period_s / forget_s))
        self._since_s = self._time_s = 0.0
        self._told: list[tuple[float, Array]] = []
        self.samples = 0

    @property
    def vehicles(self) -> list[int]:
        """Numbers of the vehicles that are followed."""
        return list(self._models[BASE][0].filters)

    def meet(self, vehicle: int) -> None:
        """Follow one more vehicle, with every model."""
        for variant in self._variants:
            variant.meet(vehicle)

    def leave(self, vehicle: int) -> None:
        """Follow a vehicle no longer. The scores keep what it has said."""
        for variant in self._variants:
            variant.leave(vehicle)

    @property
    def _variants(self) -> list[_Variant]:
        return [variant for model in self._models.values() for variant in model]

    def step(
        self,
        vehicle: int,
        position_m: Sequence[float],
        identity: Sequence[int],
        length_m: Sequence[float],
        time_s: float,
        behind: tuple[float, int, float] = NOBODY,
        lines: Sequence[float] = NO_LINES,
    ) -> None:
        """Take in a sample of one vehicle and add up all scores; arguments as ``OnlineFilter.step``."""
        variants = self._variants
        sample = position_m, identity, length_m, time_s, behind, None, lines
        found = [variant.step(vehicle, sample) for variant in variants]
        if all(scored for scored, _ in found):
            for variant, (_, log_likelihood) in zip(variants, found, strict=True):
                variant.score += log_likelihood
            self.samples += 1

    def forget(self) -> None:
        """Let all scores forget one period, and fit all values once a second; call once per sample of time."""
        self._since_s += self._period_s
        self._time_s += self._period_s
        is_due = self._since_s >= EVERY_S
        for variant in self._variants:
            variant.score *= self._memory
            if is_due:
                variant.fit(self._since_s)
        if is_due:
            self._since_s = 0.0
            self._told = [(t, w) for t, w in self._told if t > self._time_s - SETTLED_S - 2.0 * EVERY_S]
            self._told.append((self._time_s, self.weights))

    @property
    def gains(self) -> Array:
        """Scores less what the fitted strengths cost, and less the score of the base model [nats]."""
        scores = []
        for model in self._models.values():
            each = np.array([variant.score - variant.cost for variant in model])
            # which of the places it is, is not known before
            scores.append(each.max() + np.log(np.mean(np.exp(each - each.max()))))
        return np.asarray(np.array(scores) - scores[0])

    @property
    def weights(self) -> Array:
        """Posterior probabilities. Before, the base model is as likely as all others together, which are alike."""
        gains = self.gains
        gains[1:] -= np.log(max(len(gains) - 1, 1))
        likelihood = np.exp(gains - gains.max())
        return np.asarray(likelihood / likelihood.sum())

    @property
    def fitted(self) -> dict[str, dict[str, float]]:
        """Parameters of the effect of each model as fitted so far, where it fits best; none of the base model."""
        best = {name: max(model, key=lambda variant: variant.score) for name, model in self._models.items()}
        return {name: one.fitted for name, one in best.items()}

    @property
    def is_settled(self) -> bool:
        """Whether no weight has changed by more than 0.1 within the last 60 s."""
        if not self._told or self._told[0][0] > self._time_s - SETTLED_S:
            return False
        weights = np.array([w for _, w in self._told])
        return bool(np.all(np.ptp(weights, axis=0) <= _STABLE))
