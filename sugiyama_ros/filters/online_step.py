"""One step of the online filter, compiled, and the block of memory in which all its arrays lie.

A call from Python passes each array of a tuple on its own, which takes longer than a whole step. So Python passes the
block, and compiled code finds the arrays in it, one after the other: the block begins with the numbers from which their
shapes follow. ``kalman`` calls ``step``, or its parts with filterpy between them.
"""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.batch import SLOTS, UTILITIES, ActionGrid, Batch
from sugiyama_ros.driver.parameters import RHO, SIGMA_A, SIGMA_NU, SIGMA_V, UTILITY
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.control import is_contaminated
from sugiyama_ros.effects.shared import contaminated_normal
from sugiyama_ros.filters.alarm import Alarm, check_style, observe, predict_alarm, reset_alarm, update_alarm
from sugiyama_ros.filters.chain import AROUND
from sugiyama_ros.filters.noise import Noises, forget_noises, learn_noises, predict_noises, start_noises, update_noises
from sugiyama_ros.filters.predict import clear, has_line, linearise, linearise_chain, predict
from sugiyama_ros.filters.state import (
    LOOKED_AT,
    MOVING,
    STATE,
    Drivers,
    FilterStep,
    Linearised,
    Scene,
    State,
    is_last,
    points_of,
)
from sugiyama_ros.filters.update import (
    SETTLING,
    decides_otherwise,
    forget_vehicle,
    gross_in_a_row,
    innovation,
    log_density,
    noise_var_at,
    start_vehicle,
    update,
    weights,
)
from sugiyama_ros.jit import in_python_too, kernel

# Entries of ``Online.result``; the first ones are the numbers of an ``Estimate``. The covariance (3, 3) follows.
(
    _POSITION_M,
    _SPEED,
    _ACCELERATION,
    _MEAN_ACTION,
    _GAP_M,
    _APPROACH_RATE,
    _INNOVATION_M,
    _INNOVATION_VAR,
    _NIS,
    _LOG_LIKELIHOOD,
    _SCORED,
    _CHANGED,
    _JUMP,
) = range(13)
#: Number of these entries.
RESULTS = _JUMP + 1
# More entries than any filter needs; the system gives only the pages that are used.
_PLENTY = 1 << 22
# What a vehicle's sample is used for: there is none, the filter begins with it, or refuses it, or takes it in.
_NONE, _BEGINS, _REFUSED, TAKEN = range(4)


class Sizes(NamedTuple):
    """Numbers of vehicles, adapted parameters, models of the noises, columns of the alarm, and entries of a row."""

    vehicles: int
    adapted: int
    models: int
    columns: int
    width: int


#: Entries of the memory before the sample: where the next array begins, and ``Sizes``.
HEADER = 1 + len(Sizes._fields)


class _ChainSample(NamedTuple):
    """What the filter takes in: position and length (M,) [m], identity (M,), around (11,) as of ``Chain``, and when.

    when: (2,) time of the sample [s], and periods since the sample before.
    """

    position: Array
    identity: Ints
    length: Array
    around: Array
    when: Array


class _Book(NamedTuple):
    """What is kept of each vehicle, (M,): identity, periods waited for a sample, gross errors in a row, part.

    part: what the latest sample is used for. settled: (1,) samples since the driver's record began, 0 before it.
    """

    identity: Ints
    waited: Array
    gross: Ints
    part: Ints
    settled: Ints


class _Scratch(NamedTuple):
    """Arrays that every step overwrites: gain and shared (N,), half (N, N), weighed (5,) as of ``weigh``."""

    gain: Array
    shared: Array
    half: Array
    weighed: Array


class Online(NamedTuple):
    """Everything that the online filter knows and works on.

    result: ``RESULTS`` entries and a covariance; settings: (8,) the entries of ``Scene``, ``ActionGrid.braking`` and
    ``FilterStep.time_s``; step: as compiled code uses it, with the sample from which the next period was linearised;
    for Python its numbers that are no arrays are those of when the tuple was made.
    """

    sample: _ChainSample
    result: Array
    settings: Array
    book: _Book
    step: FilterStep
    scratch: _Scratch
    noises: Noises
    alarm: Alarm


# The next functions return the next array of the memory; at: (1,) where it begins, which they change.


@in_python_too
def _vector(memory: Array, at: Ints, size: int) -> Array:
    first = at[0]
    at[0] = first + size
    return memory[first : first + size]


@in_python_too
def _integers(memory: Array, at: Ints, size: int) -> Ints:
    first = at[0]
    at[0] = first + size
    return memory[first : first + size].view(np.int64)


@in_python_too
def _matrix(memory: Array, at: Ints, rows: int, columns: int) -> Array:
    first = at[0]
    at[0] = end = first + rows * columns
    return memory[first:end].reshape((rows, columns))


@in_python_too
def _integer_matrix(memory: Array, at: Ints, rows: int, columns: int) -> Ints:
    first = at[0]
    at[0] = end = first + rows * columns
    return memory[first:end].view(np.int64).reshape((rows, columns))


@in_python_too
def _stack(memory: Array, at: Ints, count: int, size: int) -> Array:
    """The same for square matrices that stand one below the other."""
    first = at[0]
    at[0] = end = first + count * size * size
    return memory[first:end].reshape((count, size, size))


@in_python_too
def _filter_step(memory: Array, at: Ints, sizes: Sizes, settings: Array) -> FilterStep:
    m, a = sizes.vehicles, sizes.adapted
    n, most = STATE * m + a, LOOKED_AT + a
    return FilterStep(
        State(_vector(memory, at, n), _matrix(memory, at, n, n), _integers(memory, at, m)),
        Drivers(
            _matrix(memory, at, m, sizes.width),
            _integers(memory, at, a),
            _vector(memory, at, a),
            _vector(memory, at, a),
        ),
        Scene(settings[0], int(settings[1]), settings[2], settings[3], settings[4], settings[5]),
        Linearised(
            _vector(memory, at, n),
            _matrix(memory, at, n, n),
            _matrix(memory, at, n, n),
            _integer_matrix(memory, at, n, n),
            _integers(memory, at, n),
            _integers(memory, at, n),
        ),
        Batch(
            _matrix(memory, at, -(-points_of(m, a) // SLOTS), UTILITIES + SLOTS * len(ACTIONS)),
            memory[:0].view(np.float32).reshape((0, 1)),
            ActionGrid(_vector(memory, at, len(ACTIONS)), _vector(memory, at, len(ACTIONS)), int(settings[6])),
            _vector(memory, at, len(ACTIONS)),
        ),
        _vector(memory, at, m),
        _vector(memory, at, AROUND),
        settings[7],
        _integer_matrix(memory, at, 2 * m, most),
        _matrix(memory, at, m * (3 + most), most),
        _integer_matrix(memory, at, m, 2),
        _matrix(memory, at, 2, 2 * most),
        _vector(memory, at, n),
        _vector(memory, at, n),
    )


@in_python_too
def _noises(memory: Array, at: Ints, n: int, j: int) -> Noises:
    return Noises(
        _vector(memory, at, 2),
        _matrix(memory, at, 2, 2),
        _vector(memory, at, j),
        _matrix(memory, at, j, 2),
        _stack(memory, at, j, 2),
        _matrix(memory, at, 2, n),
        _stack(memory, at, 2, n),
        _matrix(memory, at, j, 2),
        _vector(memory, at, 2),
        _vector(memory, at, 2),
        _vector(memory, at, 1),
        _vector(memory, at, 2),
        _vector(memory, at, j),
        _matrix(memory, at, j, 2),
        _stack(memory, at, j, 2),
    )


@in_python_too
def _alarm(memory: Array, at: Ints, n: int, c: int) -> Alarm:
    return Alarm(
        _matrix(memory, at, n, c),
        _matrix(memory, at, n, c),
        _vector(memory, at, c),
        _vector(memory, at, c),
        _vector(memory, at, 1),
        _vector(memory, at, 1),
        _vector(memory, at, 1),
        _integers(memory, at, 1),
        _vector(memory, at, 7),
    )


@in_python_too
def online_arrays(memory: Array) -> Online:
    """Return the arrays that lie in a memory of ``memory_for``."""
    header = memory[:HEADER].view(np.int64)
    at, sizes = header[:1], Sizes(header[1], header[2], header[3], header[4], header[5])
    at[0] = HEADER
    m, n = sizes.vehicles, STATE * sizes.vehicles + sizes.adapted
    sample = _ChainSample(
        _vector(memory, at, m),
        _integers(memory, at, m),
        _vector(memory, at, m),
        _vector(memory, at, AROUND),
        _vector(memory, at, 2),
    )
    result, settings = _vector(memory, at, RESULTS + 9), _vector(memory, at, 8)
    book = _Book(
        _integers(memory, at, m),
        _vector(memory, at, m),
        _integers(memory, at, m),
        _integers(memory, at, m),
        _integers(memory, at, 1),
    )
    scratch = _Scratch(
        _vector(memory, at, n),
        _vector(memory, at, n),
        _matrix(memory, at, n, n),
        _vector(memory, at, 5),
    )
    step = _filter_step(memory, at, sizes, settings)
    noises, alarm = _noises(memory, at, n, sizes.models), _alarm(memory, at, n, sizes.columns)
    return Online(sample, result, settings, book, step, scratch, noises, alarm)


def memory_for(sizes: Sizes) -> Array:
    """Return the memory of a filter, all 0 after the sizes."""
    memory = np.zeros(_PLENTY)
    header = memory[:HEADER].view(np.int64)
    header[1:] = sizes
    online_arrays(memory)
    return memory[: header[0]].copy()


@kernel
def step(memory: Array) -> None:
    """Go on in time and take in the sample that stands in the memory; the result stands there afterwards."""
    online = online_arrays(memory)
    if online.book.settled[0] > 0:
        _go_on(online)
        predict(online.step.state, online.step.out, online.scratch.half)
    _compare(online)
    for m in range(len(online.book.part)):
        if online.book.part[m] == TAKEN:
            _weigh(online, m)
            weighed = online.scratch.weighed
            update(online.step.state, online.scratch.gain, weighed[2] * weighed[0], weighed[3])
            _teach(online, m)
    _finish(online)


# The parts of a step, for an engine that predicts and updates by itself.


@kernel
def go_on(memory: Array) -> None:
    """Linearise the time since the sample before, if it is not a period, and let all that learns go on."""
    _go_on(online_arrays(memory))


@kernel
def compare(memory: Array) -> None:
    """Compare the samples with their predictions: decide what they are used for, and learn from the own innovation."""
    _compare(online_arrays(memory))


@kernel
def weigh(memory: Array, m: int) -> None:
    """Fill in P H' of the sample of vehicle m, and ``weighed``.

    These are the innovation [m], the entry of H, both weights as of ``update.weights``, and the variance [m^2] of the
    measurement noise of the driver's own position, 0 for another vehicle.
    """
    _weigh(online_arrays(memory), m)


@kernel
def teach(memory: Array, m: int) -> None:
    """Let all that learns know of the update with the sample of vehicle m."""
    _teach(online_arrays(memory), m)


@kernel
def finish(memory: Array) -> None:
    """Begin with new vehicles, linearise the next period, and fill in the result."""
    _finish(online_arrays(memory))


@kernel
def linearise_again(memory: Array) -> None:
    """Linearise the next period anew, after the model has changed."""
    _linearise(online_arrays(memory))


@kernel(allocates=False)
def _go_on(online: Online) -> None:
    periods, out = online.sample.when[1], online.step.out
    if periods != 1.0:
        _linearise_over(periods, online.step)
    if len(online.noises.weight) > 0:
        predict_noises(online.noises, out, online.scratch.shared, online.scratch.half, periods)
    if len(online.alarm.known) > 0:
        predict_alarm(online.alarm, out, STATE * len(online.step.state.known), periods)


@kernel(allocates=False)
def _linearise_over(periods: float, step: FilterStep) -> None:
    """Linearise a step of any length, after ``linearise_chain`` has linearised a period from the same state.

    The driver of the model decides once in a period. Between two samples that are not a period apart, the driver's
    action holds for the time that passes. The correlations become powers of the correlations over a period, and the
    noises keep what they add up to: the acceleration noise its stationary variance, the others their variance per
    second.
    """
    state, scene, out = step.state, step.scene, step.out
    clear(out)
    linearise(step, periods)
    for m in range(len(state.known)):
        if state.known[m] != MOVING:
            continue
        x, v, n = STATE * m, STATE * m + 1, STATE * m + 2
        row = step.drivers.parameters[m]
        out.noise[x, x] *= periods
        out.noise[v, v] += (periods - 1.0) * row[SIGMA_V] ** 2
        rho = scene.last_rho if is_last(m, state.known) else row[RHO]
        kept = rho**periods
        out.next_mean[n] = kept * state.mean[n]
        out.jacobian[n, n] = kept
        out.noise[n, n] *= (1.0 - kept * kept) / (1.0 - rho * rho)


@kernel(allocates=False)
def _compare(online: Online) -> None:
    """Forget the vehicles that others have taken the place of, decide what each sample is used for, and learn from it.

    The filter does not take in a gross error, unless so many come in a row that the filter must be wrong. Then it lets
    the vehicle go where it is measured.
    """
    book, result, state, identity = online.book, online.result, online.step.state, online.sample.identity
    result[_INNOVATION_M] = result[_INNOVATION_VAR] = result[_LOG_LIKELIHOOD] = math.nan
    book.settled[0] = 1 if identity[0] != book.identity[0] else book.settled[0] + 1
    for m in range(len(identity)):
        book.waited[m] += online.sample.when[1]
        if identity[m] < 0 or identity[m] != book.identity[m]:
            forget_vehicle(m, state)
            if len(online.noises.weight) > 0:
                forget_noises(online.noises, m)
            book.identity[m], book.gross[m] = identity[m], 0
    for m in range(len(identity)):
        book.part[m] = _NONE
        missing = math.isnan(online.sample.position[m])
        if state.known[m] != MOVING:
            if identity[m] >= 0 and not missing:
                book.part[m] = _BEGINS
            continue
        row = online.step.drivers.parameters[m]
        y, variance, _ = innovation(m, online.sample.position[m], state, row, online.step.scene)
        if m == 0:
            result[_INNOVATION_M], result[_INNOVATION_VAR] = y, variance
        if missing:
            continue
        contaminated = is_contaminated(row)
        if has_line(m, online.sample.around):
            decides_otherwise(m, y, variance, state, online.step.scene)
            book.gross[m] = 0
        else:
            book.gross[m] = gross_in_a_row(m, book.gross[m], y, variance, contaminated, state, online.step.scene)
        book.part[m] = _REFUSED if book.gross[m] > 0 and not contaminated else TAKEN
    if not math.isnan(result[_INNOVATION_M]):
        _learn(online)


@kernel(allocates=False)
def _learn(online: Online) -> None:
    """Learn from the driver's own innovation, before the update with it, and put down its log-likelihood."""
    noises, result, row = online.noises, online.result, online.step.drivers.parameters[0]
    y, variance = result[_INNOVATION_M], result[_INNOVATION_VAR]
    if len(noises.weight) > 0:
        now, scene = online.step.state, online.step.scene
        slope = innovation(0, online.sample.position[0], now, row, scene)[2]
        learn_noises(noises, y, variance, noise_var_at(now.mean[0], row, scene.circumference_m), slope)
    if len(noises.weight) == 0 or is_contaminated(row):
        result[_LOG_LIKELIHOOD] = log_density(y, variance, row)
    else:
        share, factor = noises.outliers[0], noises.outliers[1]
        result[_LOG_LIKELIHOOD] = contaminated_normal(y, variance, row[SIGMA_NU] ** 2, share, factor)[2]
    if len(online.alarm.known) > 0:
        observe(online.alarm, y, variance)


@kernel(allocates=False)
def _weigh(online: Online, m: int) -> None:
    state, row, x = online.step.state, online.step.drivers.parameters[m], STATE * m
    gain, weighed = online.scratch.gain, online.scratch.weighed
    y, variance, slope = innovation(m, online.sample.position[m], state, row, online.step.scene)
    weighed[0], weighed[1] = y, slope
    weighed[2], weighed[3] = weights(y, variance, row)
    weighed[4] = noise_var_at(state.mean[x], row, online.step.scene.circumference_m) if m == 0 else 0.0
    for i in range(len(gain)):
        gain[i] = slope * state.covariance[i, x]


@kernel(allocates=False)
def _teach(online: Online, m: int) -> None:
    gain, weighed, x = online.scratch.gain, online.scratch.weighed, STATE * m
    for i in range(len(gain)):
        gain[i] *= weighed[2]
    if len(online.noises.weight) > 0:
        weighted = weighed[2] * weighed[0]
        update_noises(online.noises, x, gain, weighed[1], weighted, weighed[4], online.scratch.shared)
    if len(online.alarm.known) > 0:
        update_alarm(online.alarm, gain, weighed[1], x)


@kernel(allocates=False)
def _finish(online: Online) -> None:
    book, state, result, noises = online.book, online.step.state, online.result, online.noises
    first, row = STATE * len(state.known), online.step.drivers.parameters[0]
    result[_CHANGED] = -1.0
    if not math.isnan(result[_INNOVATION_M]) and len(online.alarm.known) > 0:
        result[_CHANGED], result[_JUMP] = check_style(online.alarm, state, first)
    for m in range(len(state.known)):
        if book.part[m] == _BEGINS:
            _begin(online, m)
    if len(noises.weight) > 0:
        row[SIGMA_NU], row[SIGMA_A] = math.exp(noises.mean[0]), math.exp(noises.mean[1])
    for k in range(len(online.step.drivers.adapted)):
        row[UTILITY[online.step.drivers.adapted[k]]] = math.exp(state.mean[first + k])
    result[_MEAN_ACTION] = _linearise(online)
    _fill_in(online)
    result[_SCORED] = 1.0 if not math.isnan(result[_INNOVATION_M]) and book.settled[0] > SETTLING else 0.0


@kernel(allocates=False)
def _begin(online: Online, m: int) -> None:
    """Take in a position of vehicle m, which is not MOVING yet."""
    book, state, scene = online.book, online.step.state, online.step.scene
    elapsed = book.waited[m] * scene.period_s
    start_vehicle(m, online.sample.position[m], elapsed, state, online.step.drivers.parameters, scene)
    book.waited[m] = 0.0
    if m == 0 and len(online.noises.weight) > 0:
        start_noises(online.noises, state.covariance)
    if m == 0 and len(online.alarm.known) > 0:
        reset_alarm(online.alarm)


@kernel(allocates=False)
def _linearise(online: Online) -> float:
    """Linearise the next period; returns what the own driver means to do [m/s^2]."""
    sample, now, time_s = online.sample, online.step, online.sample.when[0]
    for m in range(len(sample.length)):
        now.length[m] = sample.length[m]
    for k in range(len(sample.around)):
        now.around[k] = sample.around[k]
    online.settings[7] = time_s
    known = now.state, now.drivers, now.scene, now.out, now.batch, now.length, now.around
    overwritten = now.places, now.root, now.points, now.chosen, now.slope, now.held_slope
    mean_action: float = linearise_chain(FilterStep(*known, time_s, *overwritten))
    return mean_action


@kernel(allocates=False)
def _fill_in(online: Online) -> None:
    """Fill in what follows from the state."""
    result, state, length, scene = online.result, online.step.state, online.sample.length, online.step.scene
    mean, period, lap = state.mean, scene.period_s, scene.circumference_m
    result[_POSITION_M] = mean[0] % lap if lap > 0.0 else mean[0]
    result[_SPEED] = mean[1]
    result[_ACCELERATION] = (online.step.out.next_mean[1] - mean[1]) / period
    result[_GAP_M], result[_APPROACH_RATE] = math.inf, 0.0
    if len(state.known) > 1 and state.known[1] == MOVING:
        result[_GAP_M] = mean[STATE] - mean[0] - 0.5 * (length[0] + length[1])
        result[_APPROACH_RATE] = mean[1] - mean[STATE + 1]
    result[_NIS] = result[_INNOVATION_M] ** 2 / result[_INNOVATION_VAR]
    _fill_in_covariance(result[RESULTS:].reshape((3, 3)), state.covariance, online.step.out.jacobian[1], period)


@kernel(allocates=False)
def _fill_in_covariance(out: Array, covariance: Array, next_speed: Array, period: float) -> None:
    """Fill in the covariance of own position, speed and acceleration.

    The next speed is v + dt a. So the acceleration is (v' - v) / dt, and so is its row of derivatives.
    """
    size = len(next_speed)
    for i in range(2):
        for j in range(2):
            out[i, j] = covariance[i, j]
        out[i, 2] = 0.0
    out[2, 2] = 0.0
    for k in range(size):
        slope = (next_speed[k] - 1.0) / period if k == 1 else next_speed[k] / period
        if slope == 0.0:
            continue
        for i in range(2):
            out[i, 2] += slope * covariance[i, k]
        for j in range(size):
            other = (next_speed[j] - 1.0) / period if j == 1 else next_speed[j] / period
            out[2, 2] += slope * covariance[k, j] * other
    out[2, 0], out[2, 1] = out[0, 2], out[1, 2]
