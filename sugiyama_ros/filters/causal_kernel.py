"""The causal filter of several chains, compiled; ``causal`` explains it.

The filters run side by side, sample by sample, so that all their drivers can consider their actions at once.
"""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.lanes import Lanes, consider, decide, lanes_for
from sugiyama_ros.driver.parameters import UTILITY
from sugiyama_ros.effects.control import feels_accelerations, remembers
from sugiyama_ros.effects.sensing import is_contaminated
from sugiyama_ros.filters.abreast import (
    OFF,
    SHRINK,
    SLOPE,
    STEP,
    Abreast,
    abreast_for,
    begin_period,
    linearised_of,
    predict,
    share_columns,
    state_of,
    take_in,
)
from sugiyama_ros.filters.linearisation import add_all_components, aim_all, conclude
from sugiyama_ros.filters.measurement import log_density, measurement, noise_var_at, weights
from sugiyama_ros.filters.past import begin_past, entries_of_past, forget_past
from sugiyama_ros.filters.state import (
    MOVING,
    STATE,
    Drivers,
    Moment,
    Scene,
    State,
    Workspace,
    points_of,
    workspace_for,
)
from sugiyama_ros.filters.vehicles import forget_vehicle, gross_in_a_row, start_vehicle
from sugiyama_ros.jit import kernel

#: Samples after the start of a vehicle's record (or after a break) whose innovations are not scored.
SETTLING = 6


class Observed(NamedTuple):
    """Recordings of C chains: position, identity, length (C, T, M) and rear (C, T, 3), as in ``Chain``.

    start_s: (C,) time of the first sample [s]; samples: (C,) number of samples to filter, at most T.
    """

    position: Array
    identity: Ints
    length: Array
    rear: Array
    start_s: Array
    samples: Ints


class Predicted(NamedTuple):
    """Innovation [m], its variance [m^2] and its log-likelihood, (T,) each, of the own position; NaN where none."""

    innovation: Array
    innovation_var: Array
    log_likelihood: Array


class Trace(NamedTuple):
    """Arrays for what is known after the update with each sample; an array of length 0 is not filled.

    means: (C, T, 4 M + A); covariances: (C, T, 4 M + A, 4 M + A); motion: (C, T, 2), own acceleration and what the
    driver means to do [m/s^2], filled together with the covariances.
    """

    means: Array
    covariances: Array
    motion: Array


class _Filters(NamedTuple):
    """What C filters keep from step to step.

    abreast: their states; known: (C, M) of ``State``; places, root, points: of ``Workspace``, with an axis of C before;
    parameters, prior_mean: of ``Drivers``, with an axis of C before; waited: (C, M) periods since a vehicle's first
    position; settled: (C, M) samples since a vehicle's record began; gross: (C, M) gross errors in a row.
    """

    abreast: Abreast
    known: Ints
    places: Ints
    root: Array
    points: Ints
    parameters: Array
    prior_mean: Array
    waited: Ints
    settled: Ints
    gross: Ints


class _Shared(NamedTuple):
    """What C filters share: arrays that every step overwrites, and the adapted parameters with their prior variance."""

    lanes: Lanes
    chosen: Array
    slope: Array
    held_slope: Array
    adapted: Ints
    prior_var: Array


@kernel(allocates=False)
def _drivers(c: int, filters: _Filters, shared: _Shared) -> Drivers:
    """Return the drivers of chain c."""
    return Drivers(filters.parameters[c], shared.adapted, filters.prior_mean[c], shared.prior_var)


@kernel(allocates=False)
def _parts(
    c: int, t: int, period_s: float, observed: Observed, filters: _Filters, shared: _Shared
) -> tuple[State, Drivers, Moment, Workspace]:
    """Return what the functions of ``linearisation`` take, of chain c at sample t."""
    moment = Moment(observed.length[c, t], observed.rear[c, t], observed.start_s[c] + t * period_s)
    own = filters.places[c], filters.root[c], filters.points[c]
    workspace = Workspace(*own, shared.chosen, shared.slope, shared.held_slope)
    return state_of(c, filters.abreast, filters.known), _drivers(c, filters, shared), moment, workspace


@kernel(allocates=False)
def _begin_sample(c: int, t: int, m: int, observed: Observed, filters: _Filters, shared: _Shared) -> bool:
    """Forget vehicle m of chain c if it has gone; returns whether a vehicle is there at sample t."""
    state, identity = state_of(c, filters.abreast, filters.known), observed.identity[c]
    filters.settled[c, m] += 1
    filters.waited[c, m] += 1
    if identity[t, m] < 0 or (t > 0 and identity[t, m] != identity[t - 1, m]):
        forget_vehicle(m, state)
        forget_past(m, state, _drivers(c, filters, shared))
        filters.settled[c, m] = filters.gross[c, m] = 0
    return bool(identity[t, m] >= 0)


@kernel(allocates=False)
def _meet(
    c: int, t: int, m: int, observed: Observed, filters: _Filters, shared: _Shared, scene: Scene, predicted: Predicted
) -> None:
    """Put the sample of vehicle m into ``Abreast.sample`` of chain c, if it is to be taken in."""
    sample = filters.abreast.sample
    for row in range(len(sample)):
        sample[row, c] = 0.0
    if m == 0:
        predicted.innovation[c, t], predicted.innovation_var[c, t] = np.nan, np.nan
        predicted.log_likelihood[c, t] = np.nan
    if not _begin_sample(c, t, m, observed, filters, shared):
        return
    state, parameters, waited = state_of(c, filters.abreast, filters.known), filters.parameters[c], filters.waited[c]
    mean, known, position, circumference = state.mean, state.known, observed.position[c, t, m], scene.circumference_m
    x = STATE * m
    off, factor = measurement(mean[x], parameters[m], circumference)
    variance = factor * factor * state.covariance[x, x] + noise_var_at(mean[x], parameters[m], circumference)
    if m == 0 and known[0] == MOVING:
        predicted.innovation_var[c, t] = variance
    if math.isnan(position):
        return
    if known[m] != MOVING:
        start_vehicle(m, position, waited[m] * scene.period_s, state, parameters, scene)
        waited[m] = 0
        if known[m] == MOVING:
            begin_past(m, state, _drivers(c, filters, shared), scene.period_s)
        return
    y = position - mean[x] - off
    if circumference > 0.0:
        y -= circumference * round(y / circumference)
    if m == 0:
        predicted.innovation[c, t] = y
        if filters.settled[c, m] > SETTLING:
            predicted.log_likelihood[c, t] = log_density(y, variance, parameters[m])
    if is_contaminated(parameters[m]):
        before = state.covariance[x, x]
        filters.gross[c, m] = gross_in_a_row(m, filters.gross[c, m], y, variance, True, state, scene)
        variance += factor * factor * (state.covariance[x, x] - before)
    step, shrink = weights(y, variance, parameters[m])
    sample[SLOPE, c], sample[OFF, c], sample[STEP, c], sample[SHRINK, c] = factor, -y, step, shrink


@kernel(allocates=False)
def _put_adapted(c: int, filters: _Filters, shared: _Shared) -> None:
    """Put the present values of the adapted parameters into the own driver's row."""
    first = STATE * filters.known.shape[1]
    for k in range(len(shared.adapted)):
        filters.parameters[c, 0, UTILITY[shared.adapted[k]]] = math.exp(filters.abreast.mean[first + k, c])


@kernel(allocates=False)
def _record(c: int, t: int, state: State, action: float, next_speed: float, period_s: float, trace: Trace) -> None:
    """Fill in the trace after the update with a sample."""
    if len(trace.means) > 0:
        for i in range(trace.means.shape[2]):
            trace.means[c, t, i] = state.mean[i]
    if len(trace.covariances) > 0:
        for i in range(trace.covariances.shape[2]):
            for j in range(trace.covariances.shape[2]):
                trace.covariances[c, t, i, j] = state.covariance[i, j]
        trace.motion[c, t, 0], trace.motion[c, t, 1] = (next_speed - state.mean[1]) / period_s, action


@kernel(allocates=False)
def _filter(
    observed: Observed,
    filters: _Filters,
    shared: _Shared,
    scene: Scene,
    predicted: Predicted,
    trace: Trace,
) -> None:
    """Run all filters over all samples; arguments as for ``run``."""
    count, lanes, period_s, ends = len(observed.samples), shared.lanes, scene.period_s, observed.samples
    abreast = filters.abreast
    for t in range(observed.position.shape[1]):
        for m in range(observed.position.shape[2]):
            for c in range(count):
                if t < ends[c]:
                    _meet(c, t, m, observed, filters, shared, scene, predicted)
            take_in(STATE * m, abreast)
        used = 0
        for c in range(count):
            if t < ends[c]:
                _put_adapted(c, filters, shared)
                state, drivers, moment, workspace = _parts(c, t, period_s, observed, filters, shared)
                used = aim_all(state, drivers, moment, scene, workspace, lanes, used)
        consider(used, period_s, scene.horizon, lanes)
        changed = False
        for c in range(count):
            if t < ends[c]:
                state, drivers, moment, workspace = _parts(c, t, period_s, observed, filters, shared)
                changed = add_all_components(state, drivers, moment, scene, workspace, lanes) or changed
        decide(used, lanes, changed)
        begin_period(abreast)
        for c in range(count):
            if t < ends[c]:
                state, drivers, moment, workspace = _parts(c, t, period_s, observed, filters, shared)
                action = conclude(state, drivers, moment, scene, workspace, lanes, linearised_of(c, abreast))
                share_columns(c, abreast)
                _record(c, t, state, action, abreast.next_mean[1, c], period_s, trace)
        predict(abreast)


@kernel
def run(
    observed: Observed,
    drivers: Drivers,
    actions: Array,
    is_rough: bool,
    scene: Scene,
    periods_back: int,
    predicted: Predicted,
    trace: Trace,
) -> None:
    """Filter C chains over up to T samples, side by side: their drivers consider their actions in the same lanes.

    C is at most ABREAST.

    actions: accelerations that the drivers consider [m/s^2], (K,).
    """
    count, _, vehicles = observed.position.shape
    adapted, a = drivers.adapted, len(drivers.adapted)
    past = entries_of_past(vehicles, periods_back)
    size, one = STATE * vehicles + a + past, workspace_for(vehicles, a, past)
    filters = _Filters(
        abreast_for(_live(drivers.parameters, size, len(trace.means) > 0), size),
        np.zeros((count, vehicles), np.int64),
        np.zeros((count, *one.places.shape), np.int64),
        np.zeros((count, *one.root.shape)),
        np.zeros((count, *one.points.shape), np.int64),
        drivers.parameters,
        drivers.prior_mean,
        np.zeros((count, vehicles), np.int64),
        np.zeros((count, vehicles), np.int64),
        np.zeros((count, vehicles), np.int64),
    )
    for c in range(count):
        for k in range(a):
            entry = STATE * vehicles + k
            filters.abreast.mean[entry, c] = drivers.prior_mean[c, k]
            filters.abreast.covariance[entry, entry, c] = drivers.prior_var[k]
    lanes = lanes_for(count * points_of(vehicles, a), actions, scene.period_s, is_rough)
    shared = _Shared(lanes, one.chosen, one.slope, one.held_slope, adapted, drivers.prior_var)
    _filter(observed, filters, shared, scene, predicted, trace)


@kernel
def _live(parameters: Array, size: int, everything: bool) -> Ints:
    """Return the entries of a state of ``size`` entries whose covariances matter; parameters: (C, M, WIDTH).

    Nothing depends on what drivers hold, unless they remember it or feel accelerations, or unless ``everything`` is
    recorded.
    """
    count, vehicles, _ = parameters.shape
    for c in range(count):
        for m in range(vehicles):
            row = parameters[c, m]
            everything = everything or remembers(row) or feels_accelerations(row)
    is_live = np.ones(size, np.bool_)
    if not everything:
        is_live[STATE - 1 : STATE * vehicles : STATE] = False
    return np.flatnonzero(is_live)
