"""A model of all drivers at once, and its steps within bounds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.scoring import LONGEST, coordinate, is_linear, limited, limits, value


@dataclass(frozen=True, eq=False)
class Model:
    """A model of all drivers.

    rows: (N, WIDTH), parameters of each driver; individual: places in the rows that are fitted for each driver alone;
    shared: places in the rows that are fitted for all drivers together; prior_std: standard deviation of each
    individual parameter over the drivers, in the parameter's coordinate; ahead: (N, WIDTH), parameters of each driver
    as the leader of another driver; shared entries follow ``rows``; few: shared places that only some drivers have,
    with the columns of these drivers; the entry is 0 for the others; held: fitted places that a search leaves as they
    are.
    """

    rows: Array
    individual: tuple[int, ...]
    shared: tuple[int, ...]
    prior_std: tuple[float, ...]
    ahead: Array
    few: tuple[tuple[int, tuple[int, ...]], ...] = ()
    held: tuple[int, ...] = ()

    @property
    def has(self) -> Mask:
        """Whether each driver has each shared parameter, (N, S)."""
        has = np.ones((len(self.rows), len(self.shared)), np.bool_)
        for k, drivers in self.few:
            has[:, self.shared.index(k)] = np.isin(np.arange(len(self.rows)), drivers)
        return has

    @property
    def away(self) -> Array:
        """Distance of each driver from the median driver, in prior stds of each individual coordinate, (N, I)."""
        own = coordinate(self.rows[:, list(self.individual)], self.individual)
        return np.asarray((own - np.median(own, axis=0)) / np.array(self.prior_std))


@dataclass(frozen=True, eq=False)
class NewtonStep:
    """A step of the search: changes of the individual (N, I) and of the shared coordinates (S,).

    predicted_gains: (N,), predicted rise of the log posterior [nats] from each driver's individual changes;
    predicted_gain: predicted rise from the whole step.
    """

    individual: Array
    shared: Array
    predicted_gains: Array
    predicted_gain: float


def leaders(data: Recorded, model: Model, who: Sequence[int]) -> list[Array]:
    """Return the rows (M - 1, WIDTH) of the vehicles ahead of each driver; the median driver's for an unknown one."""
    chosen = np.asarray(who, dtype=np.int64)
    ahead = data.ahead[chosen]
    rows: Array = model.ahead[ahead]
    if (ahead < 0).any():
        rows[ahead < 0] = np.median(model.ahead, axis=0)
    rows[:, :, model.shared] = model.rows[chosen[:, None], model.shared][:, None]
    for k, _ in model.few:
        rows[:, :, k] = np.where(ahead >= 0, model.rows[ahead, k], 0.0)
    return [row[: data.chains[i].position_m.shape[1] - 1] for i, row in zip(chosen, rows, strict=True)]


def moved(data: Recorded, model: Model, step: NewtonStep, share: float = 1.0) -> Model:
    """Return the model after a step, or after a ``share`` of the step, within the bounds of the search."""
    rows = model.rows.copy()
    own, shared = list(model.individual), list(model.shared)
    for places, change in ((own, step.individual), (shared, step.shared * model.has)):
        if not places:
            continue
        now = coordinate(rows[:, places], places)
        longest = np.where(is_linear(places), reach(data, places), LONGEST)
        rows[:, places] = np.clip(
            value(now + limited(share * change, longest), places), *limits(places, data.lower, data.upper)
        )
    for k, drivers in model.few:
        rows[~np.isin(np.arange(len(rows)), drivers), k] = 0.0
    return replace(model, rows=rows)


def reach(data: Recorded, places: Sequence[int]) -> Array:
    """Return the longest step (K,) of linear coordinates: a part of the range, of the recording or of the road."""
    around = data.vicinity
    road = around.road.circumference_m or float(np.nanmax(around.position_m) - np.nanmin(around.position_m))
    first_s, last_s = around.first_last_s
    longest = np.array([0.2 * (ROW.declared[k].upper - ROW.declared[k].lower) for k in places])
    for j, k in enumerate(places):
        if ROW.declared[k].axis == "time":
            longest[j] = 0.05 * (last_s - first_s)
        elif ROW.declared[k].axis == "place":
            longest[j] = 0.1 * road
    return longest
