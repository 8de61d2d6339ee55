"""A model of all drivers at once: its steps within bounds, and what it predicts for every sample."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.abreast import ABREAST
from sugiyama_ros.filters.causal import ChainJob, Predicted, predict_samples, predict_states
from sugiyama_ros.filters.chain import Chain
from sugiyama_ros.filters.state import STATE
from sugiyama_ros.fit.coordinates import LONGEST, coordinate, is_linear, limits, value
from sugiyama_ros.fit.recording import Recorded, Vicinity

_Any = TypeVar("_Any")


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


@dataclass(frozen=True, eq=False)
class PointwiseDensity:
    """Predictions of all samples of all drivers, (N, T) each: innovations [m], their variances [m^2], log-likelihoods.

    The log-likelihood [nats] is NaN if the sample does not count.
    """

    innovation_m: Array
    innovation_var: Array
    log_likelihood: Array

    @property
    def total(self) -> float:
        """Log-likelihood of all samples together [nats]."""
        return float(np.nansum(self.log_likelihood))

    def copy(self) -> "PointwiseDensity":
        """Return a copy that shares no arrays."""
        return PointwiseDensity(self.innovation_m.copy(), self.innovation_var.copy(), self.log_likelihood.copy())

    def of(self, driver: int) -> Predicted:
        """Return the samples of one driver."""
        return Predicted(self.innovation_m[driver], self.innovation_var[driver], self.log_likelihood[driver])

    def put(self, driver: int, samples: Predicted) -> None:
        """Replace the samples of one driver."""
        self.innovation_m[driver], self.innovation_var[driver], self.log_likelihood[driver] = samples


def unknown(drivers: int, samples: int) -> PointwiseDensity:
    """Return samples without any predictions yet: NaN everywhere."""
    return PointwiseDensity(*(np.full((drivers, samples), np.nan) for _ in range(3)))


def evaluate(data: Recorded, model: Model, work: Executor, who: Sequence[int] | None = None) -> PointwiseDensity:
    """Predict every sample, of all drivers or of the drivers in ``who``."""
    return evaluate_each(data, [model], work, who)[0]


def evaluate_each(
    data: Recorded, models: Sequence[Model], work: Executor, who: Sequence[int] | None = None
) -> list[PointwiseDensity]:
    """Return the predictions by each model, as of ``evaluate``; all filters may run side by side."""
    chosen = range(data.drivers) if who is None else who
    parts = work.map(predict_samples, together([job for model in models for job in jobs_of(data, model, chosen)]))
    predicted = iter([one for part in parts for one in part])
    found = [unknown(data.drivers, data.samples) for _ in models]
    for samples in found:
        for i in chosen:
            samples.put(i, next(predicted))
        samples.log_likelihood[~data.scored] = np.nan
    return found


def together(drivers: Sequence[_Any]) -> list[Sequence[_Any]]:
    """Divide drivers into parts, whose filters run side by side: full ones, or two equal ones if there are few."""
    size = min(ABREAST, -(-len(drivers) // 2))
    return [drivers[first : first + size] for first in range(0, len(drivers), size)] if drivers else []


def jobs_of(data: Recorded, model: Model, who: Sequence[int]) -> list[ChainJob]:
    """Return the jobs of filtering the drivers in ``who`` at a model."""
    return [
        ChainJob(data.chains[i], model.rows[i], ahead, data.is_rough)
        for i, ahead in zip(who, _leaders(data, model, who), strict=True)
    ]


def _leaders(data: Recorded, model: Model, who: Sequence[int]) -> list[Array]:
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


def filtered_states(data: Recorded, model: Model, work: Executor) -> Array:
    """Return position [m], speed [m/s], noise and held acceleration [m/s^2] of all vehicles, (T, V, 4)."""
    return np.ascontiguousarray(follow(data, model, work)[1][:, :, :STATE])


def follow(data: Recorded, model: Model, work: Executor) -> tuple[PointwiseDensity, Array]:
    """Predict every sample, and filter the states (T, V, 4 + A).

    The states are those of ``filtered_states``, then the logarithms of A preferences that wander in the model, in the
    order of their ``Adaptation``; NaN for vehicles that are no drivers.
    """
    jobs = jobs_of(data, model, range(data.drivers))
    outputs = [one for part in work.map(predict_states, together(jobs)) for one in part]
    y, variance, density = (np.array([o[k] for o in outputs]) for k in range(3))
    density[~data.scored] = np.nan
    return PointwiseDensity(y, variance, density), states_of(data, variance, [o[3] for o in outputs])


def states_of(data: Recorded, variance: Array, tracks: Sequence[Array]) -> Array:
    """Return the states of all vehicles (T, V, 4 + A), as of ``follow``, from the filters of all drivers.

    variance: of the innovations (N, T); tracks: means of each filter's state.
    """
    preferences = [track[:, STATE * c.position_m.shape[1] :] for c, track in zip(data.chains, tracks, strict=True)]
    wandering = max(one.shape[1] for one in preferences)
    states = np.full((*data.vicinity.leader.shape, STATE + wandering), np.nan)
    for i, (chain, track) in enumerate(zip(data.chains, tracks, strict=True)):
        states[:, i, STATE : STATE + preferences[i].shape[1]] = preferences[i]
        for m, column in enumerate(data.vicinity.columns(i, chain.position_m.shape[1])):
            known = np.isfinite(variance[i]) & _moves(chain, m)
            states[known, column, :STATE] = track[known, STATE * m : STATE * (m + 1)]
    if data.vicinity.is_whole_road:
        _see_first(data, tracks, states)
    return states


def between_measurements(data: Recorded, states: Array) -> Array:
    """Return how vehicles have moved, from filtered states (T, V, 4), also between two measurements.

    What a filter expects between measurements that are far apart jumps at the next measurement. A vehicle that is to
    drive as it was recorded must not.
    """
    if data.every == 1:
        return states
    moved, ends = states.copy(), np.arange(0, len(states), data.every)
    for i, chain in enumerate(data.chains):
        for m, column in enumerate(data.vicinity.columns(i, chain.position_m.shape[1])):
            identity = chain.identity[ends, m]
            same = np.flatnonzero((identity[1:] == identity[:-1]) & (identity[1:] >= 0))
            start, end = states[ends[same], column], states[ends[same + 1], column]
            way = (end[:, 0] - start[:, 0]) / data.apart_s
            for j in range(1, data.every):
                w = j / data.every
                between = (1.0 - w) * start + w * end
                bend = (1.0 - w) * (start[:, 1] - way) - w * (end[:, 1] - way)
                between[:, 0] += w * (1.0 - w) * data.apart_s * bend
                moved[ends[same] + j, column] = between
    return moved


def followed(around: Vicinity, samples: slice, states: Array) -> tuple[Ints, Array]:
    """Return whom each vehicle follows at some samples, -1 where nobody is known, and how far ahead the leader is in
    whole turns of the ring [m]; (T, V) both, for states (T, V, 4) at these samples.
    """
    ahead, ring, x = around.leader[samples], around.road.circumference_m, states[:, :, 0]
    of_leader = np.take_along_axis(x, np.maximum(ahead, 0), axis=1)
    leader = np.where(np.isfinite(of_leader), ahead, -1)
    headway = np.where(leader >= 0, of_leader - x, 0.0)
    turn = np.nan_to_num(ring * np.floor(headway / ring)) if ring else np.zeros(leader.shape)
    return leader, np.asarray(turn)


def _see_first(data: Recorded, tracks: Sequence[Array], states: Array) -> None:
    """Fill in the states of vehicles without a leader as those behind them see them.

    Such a vehicle does what nobody knows: as a driver on a free road it would be seen too fast or too slow.
    """
    leader, samples = data.vicinity.leader, np.arange(data.samples)
    for i, track in enumerate(tracks):
        ahead = leader[:, i]
        seen = (ahead >= 0) & (leader[samples, ahead] < 0) & np.isfinite(track[:, STATE]) & _moves(data.chains[i], 1)
        states[seen, ahead[seen], :STATE] = track[seen, STATE : 2 * STATE]


def _moves(chain: Chain, m: int) -> Mask:
    """Whether the speed of vehicle m of a chain is known at each sample: there are two positions of this vehicle."""
    identity, seen = chain.identity[:, m], np.cumsum(np.isfinite(chain.position_m[:, m]))
    is_new = np.diff(identity, prepend=-2) != 0
    before = np.maximum.accumulate(np.where(is_new, np.concatenate(([0], seen[:-1])), 0))
    return np.asarray((identity >= 0) & (seen - before >= 2))
