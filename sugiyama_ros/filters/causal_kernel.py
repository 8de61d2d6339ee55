"""The causal filter of several chains, compiled; ``causal`` explains it.

The filters run side by side, sample by sample, so that all their drivers can consider their actions at once.
"""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import UTILITY
from sugiyama_ros.effects.control import feels_accelerations, remembers
from sugiyama_ros.filters.expectation import consider, decide
from sugiyama_ros.filters.linearisation import add_all_components, aim_all, conclude
from sugiyama_ros.filters.measurement import log_density, measurement, noise_var_at, weights
from sugiyama_ros.filters.past import begin_past, entries_of_past, forget_past
from sugiyama_ros.filters.state import (
    MOVING,
    STATE,
    Drivers,
    Lanes,
    Linearised,
    Moment,
    Scene,
    State,
    Workspace,
    lanes_for,
    linearised_for,
    points_of,
    workspace_for,
)
from sugiyama_ros.filters.transform import add_noise, transform
from sugiyama_ros.filters.vehicles import forget_vehicle, start_vehicle
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
    """What C filters keep from step to step: the parts of State, Workspace and Drivers, each with an axis of C before.

    waited: (C, M) periods since a vehicle's first position; settled: (C,) samples since the driver's record began.
    """

    mean: Array
    covariance: Array
    known: Ints
    places: Ints
    root: Array
    points: Ints
    parameters: Array
    prior_mean: Array
    waited: Ints
    settled: Ints


class _Shared(NamedTuple):
    """What C filters share: arrays that every step overwrites, and the adapted parameters with their prior variance."""

    lanes: Lanes
    linearised: Linearised
    chosen: Array
    slope: Array
    held_slope: Array
    half: Array
    gain: Array
    adapted: Ints
    prior_var: Array


@kernel(allocates=False)
def _state(c: int, filters: _Filters) -> State:
    return State(filters.mean[c], filters.covariance[c], filters.known[c])


@kernel(allocates=False)
def _parts(
    c: int, t: int, period_s: float, observed: Observed, filters: _Filters, shared: _Shared
) -> tuple[State, Drivers, Moment, Workspace]:
    """Return what the functions of ``linearisation`` take, of chain c at sample t."""
    drivers = Drivers(filters.parameters[c], shared.adapted, filters.prior_mean[c], shared.prior_var)
    moment = Moment(observed.length[c, t], observed.rear[c, t], observed.start_s[c] + t * period_s)
    own = filters.places[c], filters.root[c], filters.points[c]
    return _state(c, filters), drivers, moment, Workspace(*own, shared.chosen, shared.slope, shared.held_slope)


@kernel(allocates=False)
def _update(state: State, gain: Array, y: float, step: float, shrink: float, live: Ints) -> None:
    """Take in an innovation; gain: (4 M + A,), P H'; step, shrink: as ``weights`` returns them."""
    mean, covariance = state.mean, state.covariance
    for i in live:
        mean[i] += gain[i] * step * y
        for j in range(len(gain)):
            covariance[i, j] -= gain[i] * gain[j] * shrink


@kernel(allocates=False)
def _take_in(
    c: int, t: int, observed: Observed, filters: _Filters, shared: _Shared, scene: Scene, predicted: Predicted
) -> None:
    """Update one filter with the samples of its vehicles."""
    state, parameters, waited = _state(c, filters), filters.parameters[c], filters.waited[c]
    mean, covariance, known = state.mean, state.covariance, state.known
    position, identity, gain = observed.position[c], observed.identity[c], shared.gain
    circumference = scene.circumference_m
    drivers = Drivers(parameters, shared.adapted, filters.prior_mean[c], shared.prior_var)
    predicted.innovation[c, t], predicted.innovation_var[c, t] = np.nan, np.nan
    predicted.log_likelihood[c, t] = np.nan
    filters.settled[c] += 1
    for m in range(len(known)):
        waited[m] += 1
        if identity[t, m] < 0 or (t > 0 and identity[t, m] != identity[t - 1, m]):
            forget_vehicle(m, state)
            forget_past(m, state, drivers)
            if m == 0:
                filters.settled[c] = 0
        if identity[t, m] < 0:
            continue
        x = STATE * m
        off, factor = measurement(mean[x], parameters[m], circumference)
        variance = factor * factor * covariance[x, x] + noise_var_at(mean[x], parameters[m], circumference)
        if m == 0 and known[0] == MOVING:
            predicted.innovation_var[c, t] = variance
        if math.isnan(position[t, m]):
            continue
        if known[m] != MOVING:
            start_vehicle(m, position[t, m], waited[m] * scene.period_s, state, parameters, scene)
            waited[m] = 0
            if known[m] == MOVING:
                begin_past(m, state, drivers, scene.period_s)
            continue
        y = position[t, m] - mean[x] - off
        if circumference > 0.0:
            y -= circumference * round(y / circumference)
        step, shrink = weights(y, variance, parameters[m])
        if m == 0:
            predicted.innovation[c, t] = y
            if filters.settled[c] > SETTLING:
                predicted.log_likelihood[c, t] = log_density(y, variance, parameters[m])
        for i in range(len(gain)):
            gain[i] = factor * covariance[x, i]
        _update(state, gain, y, step, shrink, shared.linearised.live)
    for k in range(len(shared.adapted)):
        parameters[0, UTILITY[shared.adapted[k]]] = math.exp(mean[STATE * len(known) + k])


@kernel(allocates=False)
def _predict(state: State, shared: _Shared) -> None:
    """Go on by one period, which is linearised."""
    transform(state.covariance, shared.linearised, shared.half)
    add_noise(state.covariance, shared.linearised)
    for i in range(len(state.mean)):
        state.mean[i] = shared.linearised.next_mean[i]


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
    for t in range(observed.position.shape[1]):
        used = 0
        for c in range(count):
            if t < ends[c]:
                _take_in(c, t, observed, filters, shared, scene, predicted)
                state, drivers, moment, workspace = _parts(c, t, period_s, observed, filters, shared)
                used = aim_all(state, drivers, moment, scene, workspace, lanes, used)
        consider(used, scene, lanes)
        changed = False
        for c in range(count):
            if t < ends[c]:
                state, drivers, moment, workspace = _parts(c, t, period_s, observed, filters, shared)
                changed = add_all_components(state, drivers, moment, scene, workspace, lanes) or changed
        decide(used, lanes, changed)
        for c in range(count):
            if t < ends[c]:
                state, drivers, moment, workspace = _parts(c, t, period_s, observed, filters, shared)
                action = conclude(state, drivers, moment, scene, workspace, lanes, shared.linearised)
                _record(c, t, state, action, shared.linearised.next_mean[1], period_s, trace)
                _predict(state, shared)


@kernel
def run(
    observed: Observed,
    drivers: Drivers,
    actions: Array,
    scene: Scene,
    periods_back: int,
    predicted: Predicted,
    trace: Trace,
) -> None:
    """Filter C chains over up to T samples, side by side: their drivers consider their actions in the same lanes.

    Parameters
    ----------
    observed
        The recordings.
    drivers
        Of all chains: parameters (C, M, WIDTH), adapted (A,), prior_mean (C, A), prior_var (A,). Row 0 of a chain's
        parameters is overwritten with the adapted values.
    actions
        Accelerations that the drivers consider [m/s^2], (K,).
    scene
        Period and road.
    periods_back
        Largest number of periods that any of the drivers looks back.
    predicted, trace
        Filled, (C, T) each, up to the number of samples of each chain. The log-likelihood is also NaN where a sample
        does not count.
    """
    count, _, vehicles = observed.position.shape
    adapted, a = drivers.adapted, len(drivers.adapted)
    past = entries_of_past(vehicles, periods_back)
    size, one = STATE * vehicles + a + past, workspace_for(vehicles, a, past)
    filters = _Filters(
        np.zeros((count, size)),
        np.zeros((count, size, size)),
        np.zeros((count, vehicles), np.int64),
        np.zeros((count, *one.places.shape), np.int64),
        np.zeros((count, *one.root.shape)),
        np.zeros((count, *one.points.shape), np.int64),
        drivers.parameters,
        drivers.prior_mean,
        np.zeros((count, vehicles), np.int64),
        np.zeros(count, np.int64),
    )
    for c in range(count):
        for k in range(a):
            filters.mean[c, STATE * vehicles + k] = drivers.prior_mean[c, k]
            filters.covariance[c, STATE * vehicles + k, STATE * vehicles + k] = drivers.prior_var[k]
    shared = _Shared(
        lanes_for(count * points_of(vehicles, a), actions, scene.period_s),
        linearised_for(_live(drivers.parameters, size, len(trace.means) > 0), size),
        one.chosen,
        one.slope,
        one.held_slope,
        np.zeros((size, size)),
        np.zeros(size),
        adapted,
        drivers.prior_var,
    )
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
