"""What an online filter knows of the parameters that are shown, in arrays that are made once."""

from collections.abc import Sequence

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.effect_filter import EffectFilter
from sugiyama_ros.filters.noise import NOISES
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.jit import kernel

_NO_NOISES = np.empty((0, 0))


@kernel
def _read(
    known: tuple[Array, Array, Array],
    where: tuple[Ints, Ints, Array, Array],
    value: Array,
    covariance: Array,
    identified: Mask,
) -> None:
    """Fill in what is shown of A adapted parameters, of which the noises come first.

    known: the driver's row (P,), and the covariances of the logarithms of the noises and of the other parameters.
    where: places in the row and in ``value``, factors, and bounds of the variances, (A,) each. To be filled: value
    (S,), covariance (A, A), identified (A,).
    """
    row, noises, others = known
    places, at, scale, bound = where
    first = len(noises)
    for i in range(len(places)):
        value[at[i]] = row[places[i]] * scale[i]
    for i in range(len(places)):
        for j in range(len(places)):
            log = 0.0
            if i < first and j < first:
                log = noises[i, j]
            elif i >= first and j >= first:
                log = others[i - first, j - first]
            covariance[i, j] = log * value[at[j]] * value[at[i]]
            if i == j:
                identified[i] = log < bound[i]


class ShownParameters:
    """Some of a driver's parameters, as an online filter knows them.

    The values are those of ``OnlineFilter.parameters``, ``parameter_covariance`` and ``identified``, for less work.

    filter_: the driver's filter; after its ``change``, the parameters have to be chosen anew; shown: places (S,) in the
    driver's row; all adapted parameters are among them; value: parameters at the reference period, (S,) [SI];
    adapted_covariance: covariance (A, A) of the adapted parameters, in the order of ``OnlineFilter.adapted``;
    adapted_identified: whether the standard deviation of the adapted parameters is less than half of the prior's, (A,).
    """

    def __init__(self, filter_: OnlineFilter, shown: Sequence[int]) -> None:
        self._filter, kalman = filter_, filter_.kalman
        model, shown = kalman.model, list(shown)
        noises = NOISES if kalman.learning is not None else []
        places = [*noises, *model.adapted]
        at = [shown.index(k) for k in places]
        scale = np.ones(len(places))
        scale[: len(noises)] = model.row[noises] / model.rows[0, noises]
        noise_std = kalman.learning.prior_std if kalman.learning is not None else ()
        bound = 0.25 * np.concatenate([np.square(noise_std), model.prior_var])
        self._names, self._at, self._block = [NAMES[k] for k in places], at, np.ix_(at, at)
        self._where = np.array(places, np.int64), np.array(at, np.int64), scale, bound
        self._entries = model.adapted_entries
        self.value: Array = model.row[shown]
        self.read()

    def read(self) -> None:
        """Fill the arrays with what the filter knows now."""
        kalman, count = self._filter.kalman, len(self._at)
        noises = _NO_NOISES if kalman.noises is None else kalman.noises.covariance
        self.adapted_covariance: Array = np.empty((count, count))
        self.adapted_identified: Mask = np.empty(count, np.bool_)
        known = kalman.rows[0], noises, kalman.P[self._entries, self._entries]
        _read(known, self._where, self.value, self.adapted_covariance, self.adapted_identified)

    @property
    def covariance(self) -> Array:
        """Covariance (S, S) of ``value``; zero for parameters that are not adapted."""
        covariance = np.zeros((len(self.value), len(self.value)))
        covariance[self._block] = self.adapted_covariance
        return covariance

    @property
    def identified(self) -> Mask:
        """Whether the standard deviation is less than half of the prior's, (S,); False for what is not adapted."""
        identified = np.zeros(len(self.value), np.bool_)
        identified[self._at] = self.adapted_identified
        return identified

    @property
    def not_identified(self) -> list[str]:
        """Names of the adapted parameters that the samples so far do not tell."""
        told = zip(self._names, self.adapted_identified.tolist(), strict=True)
        return [name for name, is_identified in told if not is_identified]


class ShownWithEffects(ShownParameters):
    """As `ShownParameters`, for a filter that learns parameters of effects; arguments as there."""

    def __init__(self, filter_: EffectFilter, shown: Sequence[int]) -> None:
        self._filter, self._shown, self._names = filter_, list(shown), list(filter_.adapted)
        self._of = np.array([ROW.entries.index(name) for name in self._names])
        at = [self._shown.index(k) for k in self._of]
        self._at, self._block = at, np.ix_(at, at)
        self.value: Array = filter_.parameters[self._shown]
        self.read()

    def read(self) -> None:
        """Fill the arrays with what the filter knows now."""
        identified = self._filter.identified
        self.value[:] = self._filter.parameters[self._shown]
        self.adapted_covariance = self._filter.parameter_covariance[np.ix_(self._of, self._of)]
        self.adapted_identified = np.array([name in identified for name in self._names])


def shown_of(filter_: OnlineFilter, shown: Sequence[int]) -> ShownParameters:
    """Return what a filter knows of the parameters at some places (S,) of a driver's row."""
    return ShownWithEffects(filter_, shown) if isinstance(filter_, EffectFilter) else ShownParameters(filter_, shown)
