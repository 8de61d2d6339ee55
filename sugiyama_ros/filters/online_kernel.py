"""One step of the online filter, compiled. ``readable`` states the same step in Python."""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import RHO, SIGMA_A, SIGMA_NU, SIGMA_V, UTILITY
from sugiyama_ros.effects.control import is_contaminated
from sugiyama_ros.effects.shared import contaminated_normal
from sugiyama_ros.filters.alarm import check_style, observe, predict_alarm, reset_alarm, update_alarm
from sugiyama_ros.filters.causal import SETTLING
from sugiyama_ros.filters.noise import forget_noises, learn_noises, predict_noises, start_noises, update_noises
from sugiyama_ros.filters.online_memory import (
    ACCELERATION,
    APPROACH_RATE,
    CHANGED,
    GAP_M,
    INNOVATION_M,
    INNOVATION_VAR,
    JUMP,
    LOG_LIKELIHOOD,
    MEAN_ACTION,
    NIS,
    POSITION_M,
    RESULTS,
    SCORED,
    SPEED,
    Online,
    online_arrays,
)
from sugiyama_ros.filters.sample import (
    forget_vehicle,
    gross_in_a_row,
    log_density,
    measurement,
    noise_var_at,
    start_vehicle,
    weights,
)
from sugiyama_ros.filters.state import MOVING, STATE, FilterStep, Moment, Scene, is_last
from sugiyama_ros.filters.step import clear, conclude, linearise, predict, update
from sugiyama_ros.jit import kernel

# What a vehicle's sample is used for: there is none, the filter begins with it, or refuses it, or takes it in.
_NONE, _BEGINS, _REFUSED, TAKEN = 0, 1, 2, 3


@kernel
def step(memory: Array) -> None:
    """Go on in time and take in the sample that stands in the memory; the result stands there afterwards."""
    online = online_arrays(memory)
    if online.book.settled[0] > 0:
        _go_on(online)
        predict(online.step.state, online.step.out, online.scratch.half)
    _prepare(online)
    for m in range(len(online.book.part)):
        if online.book.part[m] == TAKEN:
            _weigh(online, m)
            weighed = online.scratch.weighed
            update(online.step.state, online.scratch.gain, weighed[2] * weighed[0], weighed[3])
            _teach(online, m)
    _finish(online)


# The parts of a step that `readable` calls from Python.


@kernel
def go_on(memory: Array) -> None:
    """Linearise the time since the sample before, if it is not a period, and let all that learns go on."""
    _go_on(online_arrays(memory))


@kernel
def prepare(memory: Array) -> None:
    """Decide what the samples are used for, and learn from the own innovation, before the update."""
    _prepare(online_arrays(memory))


@kernel
def weigh(memory: Array, m: int) -> None:
    """Fill in P H' of the sample of vehicle m, and ``weighed``.

    These are the innovation [m], the entry of H, both weights as of ``sample.weights``, and the variance [m^2] of the
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
        _conclude_for(periods, online.step)
    if len(online.noises.weight) > 0:
        predict_noises(online.noises, out, online.scratch.shared, online.scratch.half, periods)
    if len(online.alarm.known) > 0:
        predict_alarm(online.alarm, out, STATE * len(online.step.state.known), periods)


@kernel(allocates=False)
def _conclude_for(periods: float, step: FilterStep) -> None:
    """Linearise a step of any length, after ``linearise`` has linearised a period from the same state.

    The driver of the model decides once in a period. Between two samples that are not a period apart, the driver's
    action holds for the time that passes. The correlations become powers of the correlations over a period, and the
    noises keep what they add up to: the acceleration noise its stationary variance, the others their variance per
    second.
    """
    state, scene, out = step.state, step.scene, step.out
    length_s, memory = periods * scene.period_s, scene.memory**periods
    over = Scene(length_s, scene.horizon, scene.circumference_m, scene.last_rho, scene.last_shock_std, memory)
    clear(out)
    conclude(FilterStep(state, step.drivers, step.moment, over, step.workspace, step.batch, out))
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
def _prepare(online: Online) -> None:
    _meet(online)
    _sort(online)
    if not math.isnan(online.result[INNOVATION_M]):
        _learn(online)


@kernel(allocates=False)
def _meet(online: Online) -> None:
    """Forget the vehicles that other vehicles have taken the place of."""
    book, identity = online.book, online.sample.identity
    book.settled[0] = 1 if identity[0] != book.identity[0] else book.settled[0] + 1
    for m in range(len(identity)):
        book.waited[m] += online.sample.when[1]
        if identity[m] < 0 or identity[m] != book.identity[m]:
            forget_vehicle(m, online.step.state)
            if len(online.noises.weight) > 0:
                forget_noises(online.noises, m)
            book.identity[m], book.gross[m] = identity[m], 0


@kernel(allocates=False)
def _innovation(online: Online, m: int) -> tuple[float, float, float]:
    """Return the innovation [m] of vehicle m, its variance [m^2] and the slope of the measurement."""
    state, row, x = online.step.state, online.step.drivers.parameters[m], STATE * m
    position, circumference = state.mean[x], online.step.scene.circumference_m
    offset, factor = measurement(position, row, circumference)
    variance = factor * factor * state.covariance[x, x] + noise_var_at(position, row, circumference)
    y = online.sample.position[m] - position - offset
    if circumference > 0.0 and not math.isnan(y):
        y -= circumference * round(y / circumference)
    return y, variance, factor


@kernel(allocates=False)
def _sort(online: Online) -> None:
    """Decide what each vehicle's sample is used for, and put down the own innovation.

    The filter does not take in a gross error, unless so many come in a row that the filter must be wrong. Then it lets
    the vehicle go where it is measured.
    """
    book, result, state = online.book, online.result, online.step.state
    result[INNOVATION_M] = result[INNOVATION_VAR] = result[LOG_LIKELIHOOD] = math.nan
    for m in range(len(book.part)):
        book.part[m] = _NONE
        missing = math.isnan(online.sample.position[m])
        if state.known[m] != MOVING:
            if book.identity[m] >= 0 and not missing:
                book.part[m] = _BEGINS
            continue
        y, variance, _ = _innovation(online, m)
        if m == 0:
            result[INNOVATION_M], result[INNOVATION_VAR] = y, variance
        if missing:
            continue
        contaminated = is_contaminated(online.step.drivers.parameters[m])
        book.gross[m] = gross_in_a_row(m, book.gross[m], y, variance, contaminated, state, online.step.scene)
        book.part[m] = _REFUSED if book.gross[m] > 0 and not contaminated else TAKEN


@kernel(allocates=False)
def _learn(online: Online) -> None:
    """Learn from the driver's own innovation, before the update with it, and put down its log-likelihood."""
    noises, result, row = online.noises, online.result, online.step.drivers.parameters[0]
    y, variance = result[INNOVATION_M], result[INNOVATION_VAR]
    if len(noises.weight) > 0:
        position, circumference = online.step.state.mean[0], online.step.scene.circumference_m
        factor = measurement(position, row, circumference)[1]
        learn_noises(noises, y, variance, noise_var_at(position, row, circumference), factor)
    if len(noises.weight) == 0 or is_contaminated(row):
        result[LOG_LIKELIHOOD] = log_density(y, variance, row)
    else:
        share, factor = noises.outliers[0], noises.outliers[1]
        result[LOG_LIKELIHOOD] = contaminated_normal(y, variance, row[SIGMA_NU] ** 2, share, factor)[2]
    if len(online.alarm.known) > 0:
        observe(online.alarm, y, variance)


@kernel(allocates=False)
def _weigh(online: Online, m: int) -> None:
    state, row, x = online.step.state, online.step.drivers.parameters[m], STATE * m
    gain, weighed = online.scratch.gain, online.scratch.weighed
    y, variance, factor = _innovation(online, m)
    weighed[0], weighed[1] = y, factor
    weighed[2], weighed[3] = weights(y, variance, row)
    weighed[4] = noise_var_at(state.mean[x], row, online.step.scene.circumference_m) if m == 0 else 0.0
    for i in range(len(gain)):
        gain[i] = factor * state.covariance[i, x]


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
    result[CHANGED] = -1.0
    if not math.isnan(result[INNOVATION_M]) and len(online.alarm.known) > 0:
        result[CHANGED], result[JUMP] = check_style(online.alarm, state, first)
    for m in range(len(state.known)):
        if book.part[m] == _BEGINS:
            _begin(online, m)
    if len(noises.weight) > 0:
        row[SIGMA_NU], row[SIGMA_A] = math.exp(noises.mean[0]), math.exp(noises.mean[1])
    for k in range(len(online.step.drivers.adapted)):
        row[UTILITY[online.step.drivers.adapted[k]]] = math.exp(state.mean[first + k])
    result[MEAN_ACTION] = _linearise(online)
    _fill_in(online)
    result[SCORED] = 1.0 if not math.isnan(result[INNOVATION_M]) and book.settled[0] > SETTLING else 0.0


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
    sample, scratch, now = online.sample, online.scratch, online.step
    for m in range(len(sample.length)):
        scratch.length[m] = sample.length[m]
    for k in range(len(sample.rear)):
        scratch.rear[k] = sample.rear[k]
    scratch.time_s[0] = sample.when[0]
    moment = Moment(scratch.length, scratch.rear, scratch.time_s[0])
    mean_action: float = linearise(
        FilterStep(now.state, now.drivers, moment, now.scene, now.workspace, now.batch, now.out)
    )
    return mean_action


@kernel(allocates=False)
def _fill_in(online: Online) -> None:
    """Fill in what follows from the state."""
    result, state, length, scene = online.result, online.step.state, online.sample.length, online.step.scene
    mean, period, lap = state.mean, scene.period_s, scene.circumference_m
    result[POSITION_M] = mean[0] % lap if lap > 0.0 else mean[0]
    result[SPEED] = mean[1]
    result[ACCELERATION] = (online.step.out.next_mean[1] - mean[1]) / period
    result[GAP_M], result[APPROACH_RATE] = math.inf, 0.0
    if len(state.known) > 1 and state.known[1] == MOVING:
        result[GAP_M] = mean[STATE] - mean[0] - 0.5 * (length[0] + length[1])
        result[APPROACH_RATE] = mean[1] - mean[STATE + 1]
    result[NIS] = result[INNOVATION_M] ** 2 / result[INNOVATION_VAR]
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
