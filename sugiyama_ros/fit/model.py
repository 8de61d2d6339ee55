"""A model of all drivers at once, and its steps within bounds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.scoring import LONGEST, coordinate, is_linear, limits, value


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


def moved(data: Recorded, model: Model, individual: Array, shared: Array) -> Model:
    """Return the model after changes of the individual (N, I) and of the shared coordinates (S,), within the bounds of
    the search.
    """
    rows = model.rows.copy()
    for own, change in ((model.individual, individual), (model.shared, shared * model.has)):
        if not own:
            continue
        places = list(own)
        longest = np.where(is_linear(places), reach(data, places), LONGEST)
        there = value(coordinate(rows[:, places], places) + np.clip(change, -longest, longest), places)
        rows[:, places] = np.clip(there, *limits(places, data.lower, data.upper))
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
