"""The strictly causal filter: drivers act on the filtered states of themselves and of the vehicles ahead.

The functions ``update`` and ``predict`` that are called here are those of ``abreast``, for chains side by side.

The paper takes what a driver perceives from smoothed measurements, which know the future, as a given control. Here the
mean action is a function of the filtered state and enters the covariance, so that an innovation depends on the past
alone. A driver is filtered together with a chain of vehicles ahead,

    own -> leader -> ... -> last.

Each but the last drives by the paper's model (Eq. ssm_form) behind the next. The last moves with an AR(1) acceleration,
because its leader is not known; so does a leader behind whom the chain has nobody else. For a driver the state is
(position, speed, noise, held). The noise n_t = rho n_{t-1} + shock is the acceleration beyond what the driver means and
the environment adds. The held acceleration is what the driver made the car do in the last period (the mean action,
except for effects). For the last vehicle the noise is the whole acceleration. Parameters that are adapted online follow
as logarithms that wander around their prior (Ornstein-Uhlenbeck), so that a parameter that the data do not determine
stays near its prior.

The modules ``predict`` and ``update`` state the model. This module filters recordings with it, several chains side by
side, so that all their drivers can consider their actions at once; ``online`` filters one driver as the samples come.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.batch import Batch, batch_for, consider, decide
from sugiyama_ros.driver.parameters import UTILITY, at_period
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.control import feels_accelerations, is_contaminated, remembers
from sugiyama_ros.filters.abreast import (
    ABREAST,
    OFF,
    SHRINK,
    SLOPE,
    STEP,
    Abreast,
    abreast_for,
    linearised_of,
    predict,
    share_columns,
    state_of,
    update,
)
from sugiyama_ros.filters.chain import NOT_ADAPTED, Adaptation, Chain, adaptation_of, chain_parameters
from sugiyama_ros.filters.predict import add_all_components, aim, has_line, linearise
from sugiyama_ros.filters.state import (
    LOOKED_AT,
    MOVING,
    STATE,
    Drivers,
    FilterStep,
    Scene,
    State,
    begin_past,
    entries_of_past,
    forget_past,
    periods_back,
    points_of,
    scene_at,
)
from sugiyama_ros.filters.update import (
    SETTLING,
    decides_otherwise,
    forget_vehicle,
    gross_in_a_row,
    innovation,
    log_density,
    start_vehicle,
    weights,
)
from sugiyama_ros.jit import kernel

# Arrays of a chain, in the order of ``Observed``.
_MEASURED = ("position_m", "identity", "length_m", "around")


class Observed(NamedTuple):
    """Recordings of C chains: position, identity, length (C, T, M) and around (C, T, 11), as in ``Chain``.

    start_s: (C,) time of the first sample [s]; samples: (C,) number of samples to filter, at most T.
    """

    position: Array
    identity: Ints
    length: Array
    around: Array
    start_s: Array
    samples: Ints


class Predicted(NamedTuple):
    """Innovation [m], its variance [m^2] and its log-likelihood, (T,) each, of the own position; NaN where none."""

    innovation: Array
    innovation_var: Array
    log_likelihood: Array


class _Trace(NamedTuple):
    """Arrays for what is known after the update with each sample; an array of length 0 is not filled.

    means: (C, T, 4 M + A); covariances: (C, T, 4 M + A, 4 M + A); motion: (C, T, 2), own acceleration and what the
    driver means to do [m/s^2], filled together with the covariances.
    """

    means: Array
    covariances: Array
    motion: Array


@dataclass(frozen=True, eq=False)
class Filtered:
    """What the causal filter says of one driver over T samples, after the update with each.

    innovation_m, innovation_var: (T,), NaN where nothing was predicted or measured; sample_log_likelihood: (T,), NaN
    where a sample does not count; mean: (T, 4 M + A), covariance: (T, 4 M + A, 4 M + A) of the chain's state and the
    adapted log parameters; acceleration, mean_action: (T,) [m/s^2] own. The own position is continuous, not wrapped.
    """

    innovation_m: Array
    innovation_var: Array
    sample_log_likelihood: Array
    mean: Array
    covariance: Array
    acceleration: Array
    mean_action: Array
    log_likelihood: float

    @property
    def scored(self) -> NDArray[np.bool_]:
        """(T,): whether a sample counts."""
        return np.isfinite(self.sample_log_likelihood)


class ChainJob(NamedTuple):
    """One driver to filter: the chain, the driver's parameters and those of the drivers ahead, as ``filter_chain``.

    is_rough: whether the mean actions have single precision, which takes three quarters of the time.
    """

    chain: Chain
    parameters: Array
    ahead: Array | None = None
    is_rough: bool = False


def filter_chain(
    chain: Chain, parameters: Array, adaptation: Adaptation = NOT_ADAPTED, ahead: Array | None = None
) -> Filtered:
    """Filter one driver's chain; ahead: parameters of the drivers ahead, as for ``chain_parameters``."""
    return next(filter_each([ChainJob(chain, parameters, ahead)], adaptation))[1]


def filter_each(jobs: Sequence[ChainJob], adaptation: Adaptation = NOT_ADAPTED) -> Iterator[tuple[int, Filtered]]:
    """Yield the number of each job and what the filter says of its driver; filters run side by side where they can."""
    for i, predicted, (means, covariances, motion) in _filtered(jobs, 3, adaptation):
        total = float(np.nansum(predicted.log_likelihood))
        yield i, Filtered(*predicted, means, covariances, motion[:, 0], motion[:, 1], total)


def predict_samples(jobs: Sequence[ChainJob]) -> list[Predicted]:
    """Return how well each sample is predicted.

    Filters run side by side where they can, which takes less time than one after the other, with the same results.
    """
    found = {i: predicted for i, predicted, _ in _filtered(jobs, 0)}
    return [found[i] for i in range(len(jobs))]


def predict_states(jobs: Sequence[ChainJob]) -> list[tuple[Array, Array, Array, Array]]:
    """Return how well each sample of some drivers is predicted, and the states of their chains."""
    found = {i: (*predicted, trace.means.copy()) for i, predicted, trace in _filtered(jobs, 1)}
    return [found[i] for i in range(len(jobs))]


def log_likelihood(chain: Chain, parameters: Array, ahead: Array | None = None) -> float:
    """Return the log-likelihood of one driver's chain, Eq. SSM_Likelihood without the term of 2 pi."""
    return float(np.nansum(predict_samples([ChainJob(chain, parameters, ahead)])[0].log_likelihood))


def _filtered(
    jobs: Sequence[ChainJob], traced: int, given: Adaptation = NOT_ADAPTED
) -> Iterator[tuple[int, Predicted, _Trace]]:
    """Filter drivers, side by side where they can; traced: how many of the arrays of ``Trace`` are filled."""
    for numbers, adaptation in _side_by_side(jobs, given):
        some = [jobs[i] for i in numbers]
        samples = max(len(job.chain.position_m) for job in some)
        size = STATE * some[0].chain.position_m.shape[1] + len(adaptation.names)
        shapes = ((size,), (size, size), (2,))
        trace = _Trace(*(np.zeros((len(some) if k < traced else 0, samples, *shape)) for k, shape in enumerate(shapes)))
        predicted = _run(some, adaptation, trace, samples)
        for k, (i, job) in enumerate(zip(numbers, some, strict=True)):
            last = len(job.chain.position_m)
            own = _Trace(*(values[k, :last] if len(values) else values for values in trace))
            yield i, Predicted(*(values[k, :last] for values in predicted)), own


def _side_by_side(jobs: Sequence[ChainJob], given: Adaptation) -> Iterator[tuple[list[int], Adaptation]]:
    """Yield the numbers of jobs that can run side by side, a few at a time, and what adapts in their filters.

    Jobs of similar length run together, so that few filters end long before the others.
    """
    groups: dict[Any, list[int]] = defaultdict(list)
    for i, (chain, parameters, _, is_rough) in enumerate(jobs):
        adaptation = adaptation_of(parameters, given)
        same = (chain.position_m.shape[1], chain.period_s, chain.circumference_m, is_rough, adaptation)
        groups[same].append(i)
    for (*_, adaptation), numbers in groups.items():
        numbers.sort(key=lambda i: len(jobs[i].chain.position_m))
        for first in range(0, len(numbers), ABREAST):
            yield numbers[first : first + ABREAST], adaptation


def _run(jobs: Sequence[ChainJob], adaptation: Adaptation, trace: _Trace, samples: int) -> Predicted:
    """Run the compiled filter with fresh arrays, of each driver as long as it is there; (C, T) each."""
    chains, one = [job.chain for job in jobs], jobs[0].chain
    vehicles = one.position_m.shape[1]
    rows = at_period(np.array([chain_parameters(j.parameters, j.ahead, vehicles) for j in jobs]), one.period_s)
    predicted = Predicted(*(np.full((len(jobs), samples), np.nan) for _ in range(3)))
    places, prior_var = adaptation.arrays
    start_s, ends = np.array([chain.start_s for chain in chains]), np.array([chain.end for chain in chains])
    position, identity, length, around = (_stacked([getattr(chain, name) for chain in chains]) for name in _MEASURED)
    run(
        Observed(position, identity, length, around, start_s, ends),
        # contiguous, whatever the number of chains: the filter is compiled once
        Drivers(rows, places, np.ascontiguousarray(np.log(rows[:, 0, [UTILITY[k] for k in places]])), prior_var),
        ACTIONS,
        jobs[0].is_rough,
        scene_at(one.period_s, one.circumference_m, adaptation.relaxation_s),
        periods_back(rows, one.period_s),
        predicted,
        trace,
    )
    return predicted


def _stacked(arrays: Sequence[Any]) -> Any:
    """Stack arrays along a new first axis, always as a new array: views would be compiled anew.

    Shorter arrays are filled up with zeros, which nobody reads.
    """
    lengths = {len(one) for one in arrays}
    if len(lengths) == 1:
        return np.array(arrays)
    stacked = np.zeros((len(arrays), max(lengths), *arrays[0].shape[1:]), dtype=arrays[0].dtype)
    for row, one in zip(stacked, arrays, strict=True):
        row[: len(one)] = one
    return stacked


class _Filters(NamedTuple):
    """What C filters keep from step to step, and the arrays that they share.

    abreast: their states; known: (C, M) of ``State``; places, root, points: of ``FilterStep``, an axis of C before;
    parameters, prior_mean: of ``Drivers``, with an axis of C before; waited: (C, M) periods since a vehicle's first
    position; settled: (C, M) samples since a vehicle's record began; gross: (C, M) gross errors in a row. Shared:
    batch, chosen, slope and held_slope, which every step overwrites; adapted and prior_var of ``Drivers``.
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
    batch: Batch
    chosen: Array
    slope: Array
    held_slope: Array
    adapted: Ints
    prior_var: Array


@kernel(allocates=False)
def _drivers(c: int, filters: _Filters) -> Drivers:
    """Return the drivers of chain c."""
    return Drivers(filters.parameters[c], filters.adapted, filters.prior_mean[c], filters.prior_var)


@kernel(allocates=False)
def _step_of(c: int, t: int, observed: Observed, filters: _Filters, scene: Scene) -> FilterStep:
    """Return what the functions of ``predict`` take, of chain c at sample t."""
    time_s = observed.start_s[c] + t * scene.period_s
    return FilterStep(
        state_of(c, filters.abreast, filters.known),
        _drivers(c, filters),
        scene,
        linearised_of(c, filters.abreast),
        filters.batch,
        observed.length[c, t],
        observed.around[c, t],
        time_s,
        filters.places[c],
        filters.root[c],
        filters.points[c],
        filters.chosen,
        filters.slope,
        filters.held_slope,
    )


@kernel(allocates=False)
def _is_there(c: int, t: int, m: int, observed: Observed, filters: _Filters) -> bool:
    """Whether there is a vehicle m of chain c at sample t; what was known is forgotten if it has gone."""
    state, identity = state_of(c, filters.abreast, filters.known), observed.identity[c]
    filters.settled[c, m] += 1
    filters.waited[c, m] += 1
    if identity[t, m] < 0 or (t > 0 and identity[t, m] != identity[t - 1, m]):
        forget_vehicle(m, state)
        forget_past(m, state, _drivers(c, filters))
        filters.settled[c, m] = filters.gross[c, m] = 0
    return bool(identity[t, m] >= 0)


@kernel(allocates=False)
def _compare(c: int, t: int, m: int, observed: Observed, filters: _Filters, scene: Scene, predicted: Predicted) -> None:
    """Compare the sample of vehicle m of chain c with its prediction: put into ``Abreast.sample`` what it counts."""
    sample = filters.abreast.sample
    for row in range(len(sample)):
        sample[row, c] = 0.0
    if m == 0:
        predicted.innovation[c, t], predicted.innovation_var[c, t] = np.nan, np.nan
        predicted.log_likelihood[c, t] = np.nan
    if not _is_there(c, t, m, observed, filters):
        return
    state, parameters, waited = state_of(c, filters.abreast, filters.known), filters.parameters[c], filters.waited[c]
    known, position, x = state.known, observed.position[c, t, m], STATE * m
    y, variance, slope = innovation(m, position, state, parameters[m], scene)
    if m == 0 and known[0] == MOVING:
        predicted.innovation_var[c, t] = variance
    if math.isnan(position):
        return
    if known[m] != MOVING:
        start_vehicle(m, position, waited[m] * scene.period_s, state, parameters, scene)
        waited[m] = 0
        if known[m] == MOVING:
            begin_past(m, state, _drivers(c, filters), scene.period_s)
        return
    if m == 0:
        predicted.innovation[c, t] = y
        if filters.settled[c, m] > SETTLING:
            predicted.log_likelihood[c, t] = log_density(y, variance, parameters[m])
    before = state.covariance[x, x]
    if has_line(m, observed.around[c, t]):
        decides_otherwise(m, y, variance, state, scene)
    elif is_contaminated(parameters[m]):
        filters.gross[c, m] = gross_in_a_row(m, filters.gross[c, m], y, variance, True, state, scene)
    variance += slope * slope * (state.covariance[x, x] - before)
    step, shrink = weights(y, variance, parameters[m])
    sample[SLOPE, c], sample[OFF, c], sample[STEP, c], sample[SHRINK, c] = slope, -y, step, shrink


@kernel(allocates=False)
def _put_adapted(c: int, filters: _Filters) -> None:
    """Put the present values of the adapted parameters into the own driver's row."""
    first = STATE * filters.known.shape[1]
    for k in range(len(filters.adapted)):
        filters.parameters[c, 0, UTILITY[filters.adapted[k]]] = math.exp(filters.abreast.mean[first + k, c])


@kernel(allocates=False)
def _record(c: int, t: int, state: State, action: float, next_speed: float, period_s: float, trace: _Trace) -> None:
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
def _filter(observed: Observed, filters: _Filters, scene: Scene, predicted: Predicted, trace: _Trace) -> None:
    """Run all filters over all samples; arguments as for ``run``."""
    count, ends, abreast = len(observed.samples), observed.samples, filters.abreast
    for t in range(observed.position.shape[1]):
        for m in range(observed.position.shape[2]):
            for c in range(count):
                if t < ends[c]:
                    _compare(c, t, m, observed, filters, scene, predicted)
            update(STATE * m, abreast)
        used = 0
        for c in range(count):
            if t < ends[c]:
                _put_adapted(c, filters)
                used = aim(_step_of(c, t, observed, filters, scene), used)
        consider(used, scene.period_s, scene.horizon, filters.batch)
        changed = False
        for c in range(count):
            if t < ends[c]:
                changed = add_all_components(_step_of(c, t, observed, filters, scene)) or changed
        decide(used, filters.batch, changed)
        abreast.jacobian[:] = 0.0
        abreast.noise[:] = 0.0
        for c in range(count):
            if t < ends[c]:
                step = _step_of(c, t, observed, filters, scene)
                action = linearise(step, 1.0)
                share_columns(c, abreast)
                _record(c, t, step.state, action, abreast.next_mean[1, c], scene.period_s, trace)
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
    trace: _Trace,
) -> None:
    """Filter C chains, at most ABREAST, over up to T samples; actions: (K,) [m/s^2] that the drivers consider."""
    count, _, vehicles = observed.position.shape
    a, past = len(drivers.adapted), entries_of_past(vehicles, periods_back)
    size, most = STATE * vehicles + a + past, LOOKED_AT + a
    abreast = abreast_for(_live(drivers.parameters, size, len(trace.means) > 0), size)
    for c in range(count):
        for k in range(a):
            entry = STATE * vehicles + k
            abreast.mean[entry, c] = drivers.prior_mean[c, k]
            abreast.covariance[entry, entry, c] = drivers.prior_var[k]
    filters = _Filters(
        abreast,
        np.zeros((count, vehicles), np.int64),
        np.zeros((count, 2 * vehicles, most), np.int64),
        np.zeros((count, vehicles * (3 + most), most)),
        np.zeros((count, vehicles, 2), np.int64),
        drivers.parameters,
        drivers.prior_mean,
        np.zeros((count, vehicles), np.int64),
        np.zeros((count, vehicles), np.int64),
        np.zeros((count, vehicles), np.int64),
        batch_for(count * points_of(vehicles, a), actions, scene.period_s, is_rough),
        np.zeros((2, 2 * most)),
        np.zeros(size),
        np.zeros(size),
        drivers.adapted,
        drivers.prior_var,
    )
    _filter(observed, filters, scene, predicted, trace)


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
