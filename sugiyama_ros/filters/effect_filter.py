"""One driver's filter that also learns parameters of effects and of a law, with their uncertainty."""

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import NAMES, population
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.chain import Adaptation
from sugiyama_ros.filters.effect_values import EVERY_S, Sensitivity, check_names, values_of
from sugiyama_ros.filters.engine import Estimate
from sugiyama_ros.filters.first_look import ChainStep
from sugiyama_ros.filters.learnt import Learnt
from sugiyama_ros.filters.online import ADAPT, OnlineFilter
from sugiyama_ros.road import Road


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
        self._values = values_of(self._given, self._wanted)
        self._beside: Sensitivity | None = None
        self._since_s = 0.0
        super().__init__(period_s, road, parameters, adaptation=adaptation)

    def reset(self) -> None:
        """Forget all samples and everything learnt."""
        row = self._model.row.copy()
        row[len(NAMES) :] = self._given[len(NAMES) :]
        self._model, self._since_s = self._model_of(row), 0.0
        self._values, self._beside = values_of(self._given, self._wanted), None
        super().reset()
        self._look_beside()

    def _look_beside(self) -> None:
        """Make the copies in which the values are larger."""
        self._beside = None if self._values is None else Sensitivity(self, self._values)

    def change(self, parameters: Array) -> None:
        """Go on with other effects and keep all that was learnt, except for values that are given anew.

        Parameters and errors as for `OnlineFilter.change`.
        """
        super().change(parameters)
        known = self._values
        self._given[len(NAMES) :] = parameters[len(NAMES) :]
        self._values = values_of(self._given, self._wanted)
        if self._values is not None:
            self._values.continued(known)
        self._look_beside()

    @property
    def parameter_covariance(self) -> Array:
        """Covariance (WIDTH, WIDTH) of ``parameters``; zero for parameters that are not adapted."""
        covariance = super().parameter_covariance
        if self._values is not None and self._beside is not None:
            own, places = self.kalman.model.adapted, self._values.places
            by_value = self._beside.slopes * self.kalman.rows[0, own][:, None]
            shared = by_value @ self._values.covariance
            covariance[np.ix_(own, own)] += shared @ by_value.T
            covariance[np.ix_(own, places)], covariance[np.ix_(places, own)] = shared, shared.T
            covariance[np.ix_(places, places)] = self._values.covariance
        return covariance

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the adapted parameters whose standard deviation is less than half of the prior's."""
        return super().identified + (self._values.identified if self._values is not None else ())

    @property
    def adapted(self) -> tuple[str, ...]:
        """Names of the parameters that are adapted."""
        return super().adapted + (self._values.names if self._values is not None else ())

    @property
    def learnt(self) -> Learnt:
        """All that is known of the driver's parameters, to go on from. Parameters of effects are no logarithms."""
        own, values = super().learnt, self._values
        if values is None:
            return own
        size, k = len(own.names), len(values.names)
        covariance = np.zeros((size + k, size + k))
        covariance[:size, :size], covariance[size:, size:] = own.covariance, values.covariance
        if self._beside is not None:
            # the driver's own logarithms come last
            first, slopes = size - len(self._beside.slopes), self._beside.slopes
            covariance[first:size, first:size] += slopes @ values.covariance @ slopes.T
            covariance[first:size, size:] = slopes @ values.covariance
            covariance[size:, first:size] = covariance[first:size, size:].T
        return Learnt(own.names + values.names, np.concatenate([own.mean, values.mean]), covariance)

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
        if values is None or self._beside is None or not set(values.names) <= set(learnt.names):
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
        own = None if beside is None else (deepcopy(values.__dict__), beside.saved())
        return super().saved(), values, beside, own, self._since_s

    def restore(self, saved: Any) -> None:
        """Go back to what ``saved`` has returned. ``change`` must not have been called since."""
        plain, self._values, self._beside, own, self._since_s = saved
        super().restore(plain)
        if self._values is not None and self._beside is not None:
            self._values.__dict__.update(deepcopy(own[0]))
            self._beside.restore(own[1])

    def _step(self, sample: ChainStep) -> Estimate:
        estimate = super()._step(sample)
        if self._values is not None and self._beside is not None:
            self._beside.take_in(estimate, sample)
            self._since_s += self.period_s if sample.elapsed_s is None else sample.elapsed_s
            if self._since_s >= EVERY_S:
                self._beside.move(self._values.move(self._since_s))
                self._since_s = 0.0
        return estimate
