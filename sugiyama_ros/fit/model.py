"""A model of all drivers at once, the coordinates in which its parameters are searched, and steps within bounds.

Parameters are searched in logarithms where they have a sign.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import OMEGA_2
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.scoring import LONGEST, limited

# Coordinates: +1 log p, -1 log -p, 0 p itself.
_SIGN = np.array([1.0 if p.lower >= 0.0 else 0.0 for p in ROW.declared])
_SIGN[OMEGA_2] = -1.0


@dataclass(frozen=True, eq=False)
class Model:
    """A model of all drivers.

    rows: (N, WIDTH) parameters; individual, shared: places in the rows that are fitted, for each driver alone and for
    all drivers together; prior_std: spread of the individual parameters over the drivers, in their coordinates; ahead:
    (N, WIDTH) parameters that drivers are taken to have as leaders of others (shared entries follow ``rows``).
    """

    rows: Array
    individual: tuple[int, ...]
    shared: tuple[int, ...]
    prior_std: tuple[float, ...]
    ahead: Array

    @property
    def away(self) -> Array:
        """How far each driver is from the median driver, in prior stds of each individual coordinate, (N, I)."""
        own = coordinate(self.rows[:, list(self.individual)], self.individual)
        return np.asarray((own - np.median(own, axis=0)) / np.array(self.prior_std))


@dataclass(frozen=True, eq=False)
class Step:
    """A step of the search: changes of the individual coordinates (N, I) and of the shared ones (S,).

    predicted_gains: (N,) rise of the log posterior [nats] predicted for the individual changes; predicted_gain: for the
    whole step.
    """

    individual: Array
    shared: Array
    predicted_gains: Array
    predicted_gain: float


def leaders(data: Recorded, model: Model, driver: int) -> Array:
    """Parameters (M - 1, WIDTH) of the vehicles ahead of a driver; the median driver's if nobody is known there."""
    ahead = data.ahead[driver]
    rows: Array = model.ahead[ahead]
    if ahead.min() < 0:
        rows[ahead < 0] = np.median(model.ahead, axis=0)
    rows[:, model.shared] = model.rows[driver, model.shared]
    return rows


def coordinate(values: Array, places: Sequence[int]) -> Array:
    """Coordinates of parameters (..., K) at ``places``: logarithms where they have a sign."""
    sign = _SIGN[list(places)]
    logarithm = np.log(np.maximum(np.where(sign == 0.0, 1.0, sign * values), 1e-12))
    return np.where(sign == 0.0, values, logarithm)


def value(coordinates: Array, places: Sequence[int]) -> Array:
    """Parameters (..., K) at ``places`` from their coordinates."""
    sign = _SIGN[list(places)]
    return np.where(sign == 0.0, coordinates, sign * np.exp(np.where(sign == 0.0, 0.0, coordinates)))


def is_linear(places: Sequence[int]) -> NDArray[np.bool_]:
    """Whether the coordinate of each parameter at ``places`` is the parameter itself, not a logarithm; (K,)."""
    return np.asarray(_SIGN[list(places)] == 0.0)


def moved(data: Recorded, model: Model, step: Step, share: float = 1.0) -> Model:
    """The model after a step, or a ``share`` of it, within the bounds of the search."""
    rows = model.rows.copy()
    own, shared = list(model.individual), list(model.shared)
    for places, change in ((own, step.individual), (shared, np.tile(step.shared, (len(rows), 1)))):
        if not places:
            continue
        now = coordinate(rows[:, places], places)
        longest = np.where(is_linear(places), reach(data, places), LONGEST)
        rows[:, places] = _within(value(now + limited(share * change, longest), places), places, data.upper)
    return replace(model, rows=rows)


def reach(data: Recorded, places: Sequence[int]) -> Array:
    """Longest step (K,) of linear coordinates: a part of the declared range, of the recording or of the road."""
    t = data.trajectories
    road = t.road.circumference_m or float(np.nanmax(t.position_m) - np.nanmin(t.position_m))
    longest = np.array([0.2 * (ROW.declared[k].upper - ROW.declared[k].lower) for k in places])
    for j, k in enumerate(places):
        if ROW.declared[k].axis == "time":
            longest[j] = 0.05 * t.duration_s
        elif ROW.declared[k].axis == "place":
            longest[j] = 0.1 * road
    return longest


def _within(values: Array, places: Sequence[int], upper: Array) -> Array:
    """Parameters (..., K) clipped to their bounds; those searched in logarithms keep away from zero."""
    lower = np.array([max(ROW.declared[k].lower, 1e-3) if _SIGN[k] > 0.0 else ROW.declared[k].lower for k in places])
    highest = np.array([min(upper[k], -1e-3) if _SIGN[k] < 0.0 else upper[k] for k in places])
    return np.clip(values, lower, highest)
