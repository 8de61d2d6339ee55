"""One step of the online filter, compiled. ``readable`` states the same step in Python."""

import math

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import SIGMA_NU, UTILITY
from sugiyama_ros.effects.contaminated_normal import contaminated_normal
from sugiyama_ros.effects.sensing import is_contaminated
from sugiyama_ros.filters.any_time import conclude_for
from sugiyama_ros.filters.causal_kernel import SETTLING
from sugiyama_ros.filters.linearisation import linearise
from sugiyama_ros.filters.measurement import log_density, measurement, noise_var_at, weights
from sugiyama_ros.filters.online_alarm import check_style, observe, predict_alarm, reset_alarm, update_alarm
from sugiyama_ros.filters.online_noise import (
    forget_noises,
    learn_noises,
    predict_noises,
    put_noises,
    start_noises,
    update_noises,
)
from sugiyama_ros.filters.online_result import fill_in
from sugiyama_ros.filters.online_state import (
    CHANGED,
    INNOVATION_M,
    INNOVATION_VAR,
    LOG_LIKELIHOOD,
    MEAN_ACTION,
    SCORED,
    Online,
    online_arrays,
)
from sugiyama_ros.filters.state import MOVING, STATE, Moment, Scene
from sugiyama_ros.filters.transform import add_noise, transform
from sugiyama_ros.filters.vehicles import forget_vehicle, gross_in_a_row, start_vehicle
from sugiyama_ros.jit import kernel

# What a vehicle's sample is used for: there is none, the filter begins with it, or refuses it, or takes it in.
_NONE, _BEGINS, _REFUSED, _TAKEN = 0, 1, 2, 3


@kernel
def step(memory: Array, layout: Ints) -> None:
    """Go on in time and take in the sample that stands in the memory; the result stands there afterwards.

    memory: of ``memory_for``; changed in place; layout: of ``layout_of``.
    """
    online = online_arrays(memory, layout)
    book, state, result = online.book, online.state, online.result
    given = online.scene
    scene = Scene(given[0], int(given[1]), given[2], given[3], given[4], given[5])
    if book.settled[0] > 0:
        _predict(online, scene)
    _meet(online)
    _sort(online, scene)
    if not math.isnan(result[INNOVATION_M]):
        _learn(online, scene)
    for m in range(len(state.known)):
        if book.part[m] == _TAKEN:
            _update(online, m, scene)
    first = STATE * len(state.known)
    result[CHANGED] = -1.0
    if not math.isnan(result[INNOVATION_M]) and len(online.alarm.known) > 0:
        check_style(online.alarm, state, first, result)
    for m in range(len(state.known)):
        if book.part[m] == _BEGINS:
            _begin(online, m, scene)
    row = online.drivers.parameters[0]
    if len(online.noises.weight) > 0:
        put_noises(online.noises, row)
    for k in range(len(online.drivers.adapted)):
        row[UTILITY[online.drivers.adapted[k]]] = math.exp(state.mean[first + k])
    result[MEAN_ACTION] = _linearise(online, scene)
    fill_in(result, state, online.linearised, online.sample.length, scene)
    result[SCORED] = 1.0 if not math.isnan(result[INNOVATION_M]) and book.settled[0] > SETTLING else 0.0


@kernel
def linearise_again(memory: Array, layout: Ints) -> None:
    """Linearise the next period anew, after the model has changed; arguments as for ``step``."""
    online = online_arrays(memory, layout)
    given = online.scene
    _linearise(online, Scene(given[0], int(given[1]), given[2], given[3], given[4], given[5]))


@kernel(allocates=False)
def _linearise(online: Online, scene: Scene) -> float:
    """Linearise the next period; returns what the own driver means to do [m/s^2]."""
    sample, scratch = online.sample, online.scratch
    for m in range(len(sample.length)):
        scratch.length[m] = sample.length[m]
    for k in range(len(sample.rear)):
        scratch.rear[k] = sample.rear[k]
    scratch.time_s[0] = sample.when[0]
    moment = Moment(scratch.length, scratch.rear, scratch.time_s[0])
    arrays = online.workspace, online.lanes, online.linearised
    mean_action: float = linearise(online.state, online.drivers, moment, scene, *arrays)
    return mean_action


@kernel(allocates=False)
def _predict(online: Online, scene: Scene) -> None:
    """Go on by the periods since the sample before."""
    state, linearised, periods = online.state, online.linearised, online.sample.when[1]
    if periods != 1.0:
        moment = Moment(online.scratch.length, online.scratch.rear, online.scratch.time_s[0])
        conclude_for(periods, state, online.drivers, moment, scene, online.workspace, online.lanes, linearised)
    transform(state.covariance, linearised, online.scratch.half)
    add_noise(state.covariance, linearised)
    for i in range(len(state.mean)):
        state.mean[i] = linearised.next_mean[i]
    if len(online.noises.weight) > 0:
        predict_noises(online.noises, linearised, online.scratch, periods)
    if len(online.alarm.known) > 0:
        predict_alarm(online.alarm, linearised, STATE * len(state.known), periods)


@kernel(allocates=False)
def _meet(online: Online) -> None:
    """Forget the vehicles that other vehicles have taken the place of."""
    book, identity = online.book, online.sample.identity
    book.settled[0] = 1 if identity[0] != book.identity[0] else book.settled[0] + 1
    for m in range(len(identity)):
        book.waited[m] += online.sample.when[1]
        if identity[m] < 0 or identity[m] != book.identity[m]:
            forget_vehicle(m, online.state)
            if len(online.noises.weight) > 0:
                forget_noises(online.noises, m)
            book.identity[m], book.gross[m] = identity[m], 0


@kernel(allocates=False)
def _innovation(online: Online, m: int, scene: Scene) -> tuple[float, float, float]:
    """Return the innovation [m] of vehicle m, its variance [m^2] and the slope of the measurement."""
    row, x = online.drivers.parameters[m], STATE * m
    position, circumference = online.state.mean[x], scene.circumference_m
    offset, factor = measurement(position, row, circumference)
    variance = factor * factor * online.state.covariance[x, x] + noise_var_at(position, row, circumference)
    y = online.sample.position[m] - position - offset
    if circumference > 0.0 and not math.isnan(y):
        y -= circumference * round(y / circumference)
    return y, variance, factor


@kernel(allocates=False)
def _sort(online: Online, scene: Scene) -> None:
    """Decide what each vehicle's sample is used for, and put down the own innovation.

    The filter does not take in a gross error, unless so many come in a row that the filter must be wrong. Then it lets
    the vehicle go where it is measured.
    """
    book, result = online.book, online.result
    result[INNOVATION_M] = result[INNOVATION_VAR] = result[LOG_LIKELIHOOD] = math.nan
    for m in range(len(book.part)):
        book.part[m] = _NONE
        missing = math.isnan(online.sample.position[m])
        if online.state.known[m] != MOVING:
            if book.identity[m] >= 0 and not missing:
                book.part[m] = _BEGINS
            continue
        y, variance, _ = _innovation(online, m, scene)
        if m == 0:
            result[INNOVATION_M], result[INNOVATION_VAR] = y, variance
        if missing:
            continue
        contaminated = is_contaminated(online.drivers.parameters[m])
        book.gross[m] = gross_in_a_row(m, book.gross[m], y, variance, contaminated, online.state, scene)
        book.part[m] = _REFUSED if book.gross[m] > 0 and not contaminated else _TAKEN


@kernel(allocates=False)
def _learn(online: Online, scene: Scene) -> None:
    """Learn from the driver's own innovation, before the update with it, and put down its log-likelihood."""
    noises, result, row = online.noises, online.result, online.drivers.parameters[0]
    y, variance = result[INNOVATION_M], result[INNOVATION_VAR]
    if len(noises.weight) > 0:
        position, circumference = online.state.mean[0], scene.circumference_m
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
def _update(online: Online, m: int, scene: Scene) -> None:
    """Update everything with the position of vehicle m."""
    state, row, gain, x = online.state, online.drivers.parameters[m], online.scratch.gain, STATE * m
    y, variance, factor = _innovation(online, m, scene)
    weight, shrink = weights(y, variance, row)
    own_noise_var = noise_var_at(state.mean[x], row, scene.circumference_m) if m == 0 else 0.0
    size = len(gain)
    for i in range(size):
        gain[i] = factor * state.covariance[i, x]
    for i in range(size):
        state.mean[i] += gain[i] * (weight * y)
        for j in range(size):
            state.covariance[i, j] -= shrink * (gain[i] * gain[j])
    for i in range(size):
        gain[i] *= weight
    if len(online.noises.weight) > 0:
        update_noises(online.noises, x, gain, factor, weight * y, own_noise_var, online.scratch.shared)
    if len(online.alarm.known) > 0:
        update_alarm(online.alarm, gain, factor, x)


@kernel(allocates=False)
def _begin(online: Online, m: int, scene: Scene) -> None:
    """Take in a position of vehicle m, which is not MOVING yet."""
    book, state = online.book, online.state
    elapsed = book.waited[m] * scene.period_s
    start_vehicle(m, online.sample.position[m], elapsed, state, online.drivers.parameters, scene)
    book.waited[m] = 0.0
    if m == 0 and len(online.noises.weight) > 0:
        start_noises(online.noises, state.covariance)
    if m == 0 and len(online.alarm.known) > 0:
        reset_alarm(online.alarm)
