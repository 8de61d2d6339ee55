"""The arrays of the online filter. All of them lie in one block of memory.

A call from Python passes each array of a tuple on its own, which takes longer than a whole step. So Python passes the
block, and compiled code finds the arrays in it, one after the other: the block begins with the numbers from which their
shapes follow.
"""

from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.batch import SLOTS, UTILITIES, ActionGrid, Batch
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.filters.alarm import Alarm
from sugiyama_ros.filters.noise import Noises
from sugiyama_ros.filters.state import (
    STATE,
    Drivers,
    FilterStep,
    Linearised,
    Moment,
    Scene,
    State,
    Workspace,
    points_of,
)
from sugiyama_ros.jit import in_python_too

#: Entries of ``Online.result`` before the covariance (3, 3); the first ones are the numbers of an ``Estimate``.
(
    POSITION_M,
    SPEED,
    ACCELERATION,
    MEAN_ACTION,
    GAP_M,
    APPROACH_RATE,
    INNOVATION_M,
    INNOVATION_VAR,
    NIS,
    LOG_LIKELIHOOD,
    SCORED,
    CHANGED,
    JUMP,
) = range(13)
#: Number of these entries.
RESULTS = 13
#: Numbers at the beginning of the memory, as of ``Sizes``.
HEADER = 5
_ACTIONS = len(ACTIONS)
# More numbers than any filter needs; the system gives only the pages that are used.
_PLENTY = 1 << 22


class Sizes(NamedTuple):
    """Numbers of vehicles, adapted parameters, models of the noises, columns of the alarm, and entries of a row."""

    vehicles: int
    adapted: int
    models: int
    columns: int
    width: int


class ChainSample(NamedTuple):
    """What the filter takes in: position and length (M,) [m], identity (M,), rear (3,), and when.

    when: (2,) time of the sample [s], and periods since the sample before.
    """

    position: Array
    identity: Ints
    length: Array
    rear: Array
    when: Array


class Book(NamedTuple):
    """What is kept of each vehicle, (M,): identity, periods waited for a sample, gross errors in a row, part.

    part: what the latest sample is used for. settled: (1,) samples since the driver's record began, 0 before it.
    """

    identity: Ints
    waited: Array
    gross: Ints
    part: Ints
    settled: Ints


class Scratch(NamedTuple):
    """Arrays that every step overwrites: gain and shared (N,), half (N, N), weighed (5,) as of ``online_kernel.weigh``.

    length (M,) [m], rear (3,) and time_s (1,): of the sample from which the next period was linearised.
    """

    gain: Array
    shared: Array
    half: Array
    weighed: Array
    length: Array
    rear: Array
    time_s: Array


class Online(NamedTuple):
    """Everything that the online filter knows and works on.

    result: ``RESULTS`` entries and a covariance; settings: (7,) the entries of ``Scene``, and ``ActionGrid.braking``;
    step: as compiled code uses it; for Python its numbers that are no arrays are those of when the tuple was made.
    """

    sample: ChainSample
    result: Array
    settings: Array
    book: Book
    step: FilterStep
    scratch: Scratch
    noises: Noises
    alarm: Alarm


@in_python_too
def _vector(memory: Array, at: int, size: int) -> tuple[Array, int]:
    """Return the next array of the memory, and where the one after it begins; so do the next functions."""
    return memory[at : at + size], at + size


@in_python_too
def _integers(memory: Array, at: int, size: int) -> tuple[Ints, int]:
    return memory[at : at + size].view(np.int64), at + size


@in_python_too
def _matrix(memory: Array, at: int, rows: int, columns: int) -> tuple[Array, int]:
    end = at + rows * columns
    return memory[at:end].reshape((rows, columns)), end


@in_python_too
def _integer_matrix(memory: Array, at: int, rows: int, columns: int) -> tuple[Ints, int]:
    end = at + rows * columns
    return memory[at:end].view(np.int64).reshape((rows, columns)), end


@in_python_too
def _stack(memory: Array, at: int, count: int, size: int) -> tuple[Array, int]:
    """The same for square matrices that stand one below the other."""
    end = at + count * size * size
    return memory[at:end].reshape((count, size, size)), end


@in_python_too
def _sample(memory: Array, at: int, m: int) -> tuple[ChainSample, Book, int]:
    position, at = _vector(memory, at, m)
    identity, at = _integers(memory, at, m)
    length, at = _vector(memory, at, m)
    rear, at = _vector(memory, at, 3)
    when, at = _vector(memory, at, 2)
    known_identity, at = _integers(memory, at, m)
    waited, at = _vector(memory, at, m)
    gross, at = _integers(memory, at, m)
    part, at = _integers(memory, at, m)
    settled, at = _integers(memory, at, 1)
    sample = ChainSample(position, identity, length, rear, when)
    return sample, Book(known_identity, waited, gross, part, settled), at


@in_python_too
def _state(memory: Array, at: int, m: int, a: int, width: int) -> tuple[State, Drivers, int]:
    n = STATE * m + a
    mean, at = _vector(memory, at, n)
    covariance, at = _matrix(memory, at, n, n)
    known, at = _integers(memory, at, m)
    parameters, at = _matrix(memory, at, m, width)
    adapted, at = _integers(memory, at, a)
    prior_mean, at = _vector(memory, at, a)
    prior_var, at = _vector(memory, at, a)
    return State(mean, covariance, known), Drivers(parameters, adapted, prior_mean, prior_var), at


@in_python_too
def _linearised(memory: Array, at: int, n: int) -> tuple[Linearised, int]:
    next_mean, at = _vector(memory, at, n)
    jacobian, at = _matrix(memory, at, n, n)
    noise, at = _matrix(memory, at, n, n)
    columns, at = _integer_matrix(memory, at, n, n)
    counts, at = _integers(memory, at, n)
    live, at = _integers(memory, at, n)
    return Linearised(next_mean, jacobian, noise, columns, counts, live), at


@in_python_too
def _workspace(memory: Array, at: int, m: int, a: int) -> tuple[Workspace, int]:
    n, most, drivers = STATE * m + a, 5 + a, max(m - 1, 1)
    places, at = _integer_matrix(memory, at, 2 * drivers, most)
    root, at = _matrix(memory, at, drivers * (3 + most), most)
    points, at = _integer_matrix(memory, at, drivers, 2)
    chosen, at = _matrix(memory, at, 2, 2 * most)
    slope, at = _vector(memory, at, n)
    held_slope, at = _vector(memory, at, n)
    return Workspace(places, root, points, chosen, slope, held_slope), at


@in_python_too
def _batch(memory: Array, at: int, slots: int, braking: int) -> tuple[Batch, int]:
    blocks, at = _matrix(memory, at, -(-slots // SLOTS), UTILITIES + SLOTS * _ACTIONS)
    actions, at = _vector(memory, at, _ACTIONS)
    backward, at = _vector(memory, at, _ACTIONS)
    added, at = _vector(memory, at, _ACTIONS)
    rough = memory[:0].view(np.float32).reshape((0, 1))
    return Batch(blocks, rough, ActionGrid(actions, backward, braking), added), at


@in_python_too
def _scratch(memory: Array, at: int, m: int, n: int) -> tuple[Scratch, int]:
    gain, at = _vector(memory, at, n)
    shared, at = _vector(memory, at, n)
    half, at = _matrix(memory, at, n, n)
    weighed, at = _vector(memory, at, 5)
    length, at = _vector(memory, at, m)
    rear, at = _vector(memory, at, 3)
    time_s, at = _vector(memory, at, 1)
    return Scratch(gain, shared, half, weighed, length, rear, time_s), at


@in_python_too
def _noises(memory: Array, at: int, n: int, j: int) -> tuple[Noises, int]:
    mean, at = _vector(memory, at, 2)
    covariance, at = _matrix(memory, at, 2, 2)
    weight, at = _vector(memory, at, j)
    means, at = _matrix(memory, at, j, 2)
    covariances, at = _stack(memory, at, j, 2)
    d_mean, at = _matrix(memory, at, 2, n)
    d_covariance, at = _stack(memory, at, 2, n)
    kept, at = _matrix(memory, at, j, 2)
    prior_mean, at = _vector(memory, at, 2)
    prior_var, at = _vector(memory, at, 2)
    stay, at = _vector(memory, at, 1)
    outliers, at = _vector(memory, at, 2)
    share, at = _vector(memory, at, j)
    were, at = _matrix(memory, at, j, 2)
    spread, at = _stack(memory, at, j, 2)
    known = mean, covariance, weight, means, covariances, d_mean, d_covariance
    return Noises(*known, kept, prior_mean, prior_var, stay, outliers, share, were, spread), at


@in_python_too
def _alarm(memory: Array, at: int, n: int, c: int) -> tuple[Alarm, int]:
    signature, at = _matrix(memory, at, n, c)
    moved, at = _matrix(memory, at, n, c)
    known, at = _vector(memory, at, c)
    seen, at = _vector(memory, at, c)
    threshold, at = _vector(memory, at, 1)
    every, at = _vector(memory, at, 1)
    periods, at = _vector(memory, at, 1)
    onsets, at = _integers(memory, at, 1)
    colour, at = _vector(memory, at, 7)
    return Alarm(signature, moved, known, seen, threshold, every, periods, onsets, colour), at


@in_python_too
def _find(memory: Array) -> tuple[Online, int]:
    """Return all arrays of a memory, and where the last one ends."""
    m, a, j, c, width = memory[:HEADER].view(np.int64)
    n = STATE * m + a
    sample, book, at = _sample(memory, HEADER, m)
    result, at = _vector(memory, at, RESULTS + 9)
    settings, at = _vector(memory, at, 7)
    state, drivers, at = _state(memory, at, m, a, width)
    out, at = _linearised(memory, at, n)
    workspace, at = _workspace(memory, at, m, a)
    batch, at = _batch(memory, at, points_of(m, a), int(settings[6]))
    scratch, at = _scratch(memory, at, m, n)
    noises, at = _noises(memory, at, n, j)
    alarm, at = _alarm(memory, at, n, c)
    s = settings
    scene = Scene(s[0], int(s[1]), s[2], s[3], s[4], s[5])
    moment = Moment(scratch.length, scratch.rear, scratch.time_s[0])
    step = FilterStep(state, drivers, moment, scene, workspace, batch, out)
    return Online(sample, result, settings, book, step, scratch, noises, alarm), at


@in_python_too
def online_arrays(memory: Array) -> Online:
    """Return the arrays that lie in a memory of ``memory_for``."""
    return _find(memory)[0]


def memory_for(sizes: Sizes) -> Array:
    """Return the memory of a filter, all 0 after the sizes."""
    memory = np.zeros(_PLENTY)
    memory[:HEADER].view(np.int64)[:] = sizes
    return memory[: _find(memory)[1]].copy()
