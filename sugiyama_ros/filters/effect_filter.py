"""A filter that also learns parameters of effects and laws, with their uncertainty.

A filter cannot hold every such parameter in its state, since many of them act on noises, times or measurements. Their
values follow the likelihood instead, by recursive prediction error. Beside the filter runs a copy for each value, in
which the value is a little larger. The differences of the innovations and of their variances give
the score of the value and its information; the difference of the states says how the state changes with the value.

References
----------
L. Ljung and T. Soderstrom, Theory and Practice of Recursive Identification (1983), section 3.8.
"""

import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import NAMES, population
from sugiyama_ros.effects.registry import EFFECTS, ROW, active, effect
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.chain import Adaptation
from sugiyama_ros.filters.first_look import ChainStep
from sugiyama_ros.filters.kalman import Estimate
from sugiyama_ros.filters.online import ADAPT, Learnt, OnlineFilter
from sugiyama_ros.filters.update import GROSS
from sugiyama_ros.laws.registry import LAWS, PAPERS, name_of
from sugiyama_ros.road import Road

#: The words that stand for the strengths of all effects, and for all parameters of the driver's law.
STRENGTHS, OF_LAW = "effects", "law"
#: Time [s] between two changes of the values.
EVERY_S = 1.0
# How much larger a value is in its copy, and how far a value moves at most in a second, both in prior stds.
_STEP, _FAR = 0.01, 0.5
# A change of the state [m, m/s, logarithms] beyond which it is no small difference.
_LARGEST = 5.0


@dataclass(eq=False)
class Values:
    """What is known of K parameters of effects or a law: a normal distribution within the declared bounds.

    names: of the parameters, such as ``drag.c0``; places: (K,) in a driver's row; prior_mean, prior_std: (K,); mean,
    covariance: (K,) and (K, K); score, information: (K,) and (K, K), collected since the last ``move``.
    """

    names: tuple[str, ...]
    places: list[int]
    prior_mean: Array
    prior_std: Array
    mean: Array
    covariance: Array
    score: Array
    information: Array

    @property
    def steps(self) -> Array:
        """How much larger each value is in its copy, (K,)."""
        return _STEP * self.prior_std

    @property
    def is_identified(self) -> Mask:
        """Whether the standard deviation of each value is less than half of the prior's, (K,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)) < 0.5 * self.prior_std)

    def go_on_from(self, known: "Values") -> None:
        """Go on from what was known before, except for values that were given anew."""
        before = dict(zip(known.names, known.prior_mean, strict=True))
        same = [name for name, given in zip(self.names, self.prior_mean, strict=True) if before.get(name) == given]
        here, there = [self.names.index(n) for n in same], [known.names.index(n) for n in same]
        self.mean[here] = known.mean[there]
        self.covariance[np.ix_(here, here)] = known.covariance[np.ix_(there, there)]

    def move(self, elapsed_s: float) -> Array:
        """Take in what was collected, and return by how much each value changes, (K,)."""
        keep = math.exp(-elapsed_s / ADAPT.relaxation_s)
        predicted = keep * keep * self.covariance + (1.0 - keep * keep) * np.diag(self.prior_std**2)
        self.covariance[:] = np.linalg.inv(np.linalg.inv(predicted) + self.information)
        far = _FAR * self.prior_std
        towards = np.clip(self.covariance @ self.score, -far, far) + (1.0 - keep) * (self.prior_mean - self.mean)
        declared = [ROW.declared[k] for k in self.places]
        # a value of 0 would switch its effect off, and the copy needs room above
        lower = np.array([p.lower for p in declared]) + self.steps
        upper = np.array([p.upper for p in declared]) - self.steps
        moved = np.clip(self.mean + towards, lower, upper) - self.mean
        self.mean = self.mean + moved
        self.score, self.information = np.zeros_like(self.score), np.zeros_like(self.information)
        return moved


def check_names(names: Sequence[str]) -> None:
    """Check names of parameters of effects and laws that are to be learnt. Raises InputError for an unknown one."""
    known = {name for name in ROW.entries if "." in name}
    for name in names:
        if name not in {STRENGTHS, OF_LAW} | known:
            raise InputError(
                f"adapt: {name!r} cannot be learnt online; give parameters of effects or laws such as drag.c0 and"
                f" idm.T, or {STRENGTHS}, or {OF_LAW}"
            )


def values_of(row: Array, names: Sequence[str], std: Mapping[str, float] = MappingProxyType({})) -> Values:
    """Return the priors of the parameters to be learnt, of the law and the effects that act.

    names: of the parameters; ``effects`` stands for the strengths of all effects, ``law`` for the law's parameters.
    Raises InputError.
    """
    check_names(names)
    effects, own_law = active(row), LAWS[name_of(row[ROW.law])]
    of_law = [f"{own_law.name}.{p.name}" for p in own_law.parameters if own_law.name != PAPERS]
    chosen = of_law if OF_LAW in names else []
    chosen += [f"{one}.{switch}" for one in effects for switch in effect(one).switches if STRENGTHS in names]
    acting = (*effects, own_law.name)
    chosen += [name for name in names if "." in name and name.split(".")[0] in acting and name not in chosen]
    places = [ROW.entries.index(name) for name in chosen]
    mean = row[places]
    size = np.array([std.get(name) or _size(name, value) for name, value in zip(chosen, mean.tolist(), strict=True)])
    k = len(chosen)
    square = np.zeros((k, k))
    return Values(tuple(chosen), places, mean, size, mean.copy(), square + np.diag(size**2), np.zeros(k), square)


def _size(name: str, value: float) -> float:
    """Prior std of a value: the largest value that the effect declares as typical, or the value itself.

    A driver's parameter of a law is known up to a third.
    """
    of, parameter = name.split(".")
    if of in LAWS:
        return abs(value) / 3.0 or 0.1
    declared = EFFECTS[of]
    sizes = [abs(known[parameter]) for known in (*declared.benchmark, declared.bank or {}) if parameter in known]
    p = ROW.declared[ROW.index_of(of, parameter)]
    return max([abs(value), *sizes]) or 0.1 * (p.upper - p.lower)


class Sensitivity:
    """A filter, and its copies with one value larger each.

    filter_: the filter, with the values of ``values``; values: the values; several drivers may share them.
    """

    def __init__(self, filter_: OnlineFilter, values: Values) -> None:
        self._filter, self._values = filter_, values
        #: Derivatives (A, K) of the adapted logarithms of the driver by the values.
        self.slopes = np.zeros((len(filter_.kalman.model.places), len(values.names)))
        self.begin()

    def begin(self) -> None:
        """Put the values into the filter, and let the copies begin from what the filter knows now."""
        self._kalman = self._filter.kalman
        _put_values(self._filter, self._values.places, self._values.mean)
        entries, self._copies = self._kalman.model.adapted_entries, []
        for k, step in enumerate(self._values.steps):
            copy = self._filter.plain_copy()
            copy.kalman.x[entries] += step * self.slopes[:, k]
            _put_values(copy, self._values.places, self._shifted(k))
            self._copies.append(copy)

    def _shifted(self, k: int) -> Array:
        """Values (K,) of copy k."""
        shifted = self._values.mean.copy()
        shifted[k] += self._values.steps[k]
        return shifted

    def take_in(self, estimate: Estimate, sample: Sequence[Any]) -> None:
        """Let the copies take in a sample, and collect what it says of the values."""
        values, kalman = self._values, self._filter.kalman
        if kalman is not self._kalman:
            # the filter has started anew
            self.begin()
            return
        found = [copy.step(*sample) for copy in self._copies]
        # who takes in what another one refuses, or changes style, differs by more than the value
        if estimate.nis > GROSS or any(one.kalman.change_of_style is not None for one in (self._filter, *self._copies)):
            self.begin()
            return
        entries = kalman.model.adapted_entries
        for k, copy in enumerate(self._copies):
            self.slopes[:, k] = (copy.kalman.x[entries] - kalman.x[entries]) / values.steps[k]
        if not (estimate.scored and all(one.scored for one in found)):
            return
        score = np.array([one.log_likelihood - estimate.log_likelihood for one in found]) / values.steps
        of_mean = self._filter.road.difference(
            np.array([one.innovation_m for one in found]), np.array(estimate.innovation_m)
        )
        of_var = np.array([one.innovation_var - estimate.innovation_var for one in found])
        of_mean, of_var = of_mean / values.steps, of_var / (values.steps * estimate.innovation_var)
        values.score += score
        values.information += np.outer(of_mean, of_mean) / estimate.innovation_var + 0.5 * np.outer(of_var, of_var)

    def move(self, moved: Array) -> None:
        """Go on with other values: the states of all filters change with them, by the slopes; moved: (K,)."""
        kalman, values = self._filter.kalman, self._values
        if not self._copies:
            return
        by_value = np.column_stack([copy.kalman.x - kalman.x for copy in self._copies]) / values.steps
        change = by_value @ moved
        if not np.all(np.isfinite(change)) or np.abs(change).max() > _LARGEST:
            self.begin()
            return
        kalman.x += change
        _put_values(self._filter, values.places, values.mean)
        for k, copy in enumerate(self._copies):
            copy.kalman.x += change
            _put_values(copy, values.places, self._shifted(k))

    def saved(self) -> Any:
        """Return what the copies know now, for ``restore``."""
        return self._kalman, self._copies, [copy.saved() for copy in self._copies], self.slopes.copy()

    def restore(self, saved: Any) -> None:
        """Go back to what ``saved`` has returned; the filter and the values must be those of then."""
        self._kalman, self._copies, before, slopes = saved
        self.slopes = slopes.copy()
        for copy, one in zip(self._copies, before, strict=True):
            copy.restore(one)


def _put_values(filter_: OnlineFilter, places: list[int], values: Array) -> None:
    """Let a filter go on with other values (K,) of parameters of effects, at places (K,) of a driver's row.

    The drivers ahead keep theirs: a leader who is slower than the model's must not become a value of the driver.
    """
    kalman, model = filter_.kalman, filter_.kalman.model
    row, rows = model.row.copy(), model.rows.copy()
    row[places] = rows[0, places] = values
    kalman.rows[0, model.adapted] = np.exp(kalman.x[model.adapted_entries])
    kalman.change(replace(model, row=row, rows=rows))


class EffectFilter(OnlineFilter):
    """An `OnlineFilter` that learns parameters of the effects in its model and of its law too.

    period_s, road, parameters, adaptation: as for `OnlineFilter`; the values of the effects in ``parameters`` are the
    means of their priors; names: parameters to be learnt while their effect is in the model, such as ``drag.c0``;
    ``effects`` stands for the strengths of all effects, and ``law`` for all parameters of the driver's law. Raises
    InputError.
    """

    def __init__(
        self,
        period_s: float,
        road: Road,
        parameters: Array | None = None,
        names: Sequence[str] = (),
        adaptation: Adaptation = ADAPT,
    ) -> None:
        check_names(names)
        self._wanted = tuple(names)
        self._given = ROW.with_effects(population() if parameters is None else parameters)
        super().__init__(period_s, road, parameters, adaptation=adaptation)

    def reset(self) -> None:
        """Forget all samples and everything learnt."""
        row = self._model.row.copy()
        row[len(NAMES) :] = self._given[len(NAMES) :]
        self._model, self._since_s = self._model_of(row), 0.0
        self._values = values_of(self._given, ())
        super().reset()
        self._values = values_of(self._given, self._wanted)
        self._beside = Sensitivity(self, self._values)
        self.prior = self.learnt

    def change(self, parameters: Array) -> None:
        """Go on with other effects and keep all that was learnt, except for values that are given anew.

        Parameters and errors as for `OnlineFilter.change`.
        """
        super().change(parameters)
        known = self._values
        self._given[len(NAMES) :] = parameters[len(NAMES) :]
        self._values = values_of(self._given, self._wanted)
        self._values.go_on_from(known)
        self._beside = Sensitivity(self, self._values)

    @property
    def adapted(self) -> tuple[str, ...]:
        """Names of the parameters that are adapted."""
        return super().adapted + self._values.names

    @property
    def is_identified(self) -> Mask:
        """Whether the standard deviation of each adapted parameter is less than half of the prior's, (A,)."""
        return np.concatenate([super().is_identified, self._values.is_identified])

    @property
    def learnt(self) -> Learnt:
        """All that is known of the driver's parameters, to go on from. Parameters of effects are no logarithms."""
        own, values = super().learnt, self._values
        covariance = self._joined(own.covariance, np.ones(len(own.names)))
        return Learnt(own.names + values.names, np.concatenate([own.mean, values.mean]), covariance)

    @property
    def adapted_covariance(self) -> Array:
        """Covariance (A, A) of the adapted parameters, in the order of ``adapted``."""
        return self._joined(super().adapted_covariance, self.kalman.values)

    def _joined(self, own: Array, scale: Array) -> Array:
        """Join a covariance of the driver's own parameters, in units of ``scale``, and the covariance of the values."""
        size, values = len(own), self._values
        if not values.names:
            return own
        covariance = np.asarray(block_diag(own, values.covariance))
        # the driver's own preferences come last
        first = size - len(self._beside.slopes)
        slopes = self._beside.slopes * scale[first:, None]
        covariance[first:size, first:size] += slopes @ values.covariance @ slopes.T
        covariance[first:size, size:] = slopes @ values.covariance
        covariance[size:, first:size] = covariance[first:size, size:].T
        return covariance

    def recall(self, learnt: Learnt) -> None:
        """Go on from what was learnt before, of the parameters that are adapted here."""
        super().recall(learnt)
        self._recall_values(learnt)

    def restart(self) -> None:
        """Forget where the vehicles are, and keep what was learnt of the driver."""
        learnt = self.learnt
        super().restart()
        self._recall_values(learnt)

    def _recall_values(self, learnt: Learnt) -> None:
        values = self._values
        if not set(values.names) <= set(learnt.names):
            return
        at = [learnt.names.index(name) for name in values.names]
        values.mean[:], values.covariance[:] = learnt.mean[at], learnt.covariance[np.ix_(at, at)]
        own = [learnt.names.index(NAMES[k]) for k in self.kalman.model.adapted if NAMES[k] in learnt.names]
        entries = self.kalman.model.adapted_entries
        if len(own) == len(self._beside.slopes):
            shared = learnt.covariance[np.ix_(own, at)]
            self._beside.slopes[:] = np.linalg.solve(values.covariance, shared.T).T
            # what is left where the values are known
            self.kalman.P[entries, entries] -= self._beside.slopes @ shared.T
        self._beside.begin()

    def saved(self) -> Any:
        """Return all that the filter knows now, for ``restore``."""
        values, beside = self._values, self._beside
        return super().saved(), values, beside, deepcopy(values.__dict__), beside.saved(), self._since_s

    def restore(self, saved: Any) -> None:
        """Go back to what ``saved`` has returned. ``change`` must not have been called since."""
        plain, self._values, self._beside, values, copies, self._since_s = saved
        super().restore(plain)
        self._values.__dict__.update(deepcopy(values))
        self._beside.restore(copies)

    def _step(self, sample: ChainStep) -> Estimate:
        estimate = super()._step(sample)
        self._beside.take_in(estimate, sample)
        self._since_s += self.period_s if sample.elapsed_s is None else sample.elapsed_s
        if self._since_s >= EVERY_S:
            self._beside.move(self._values.move(self._since_s))
            self._since_s = 0.0
        return estimate
