"""The arrays of the compiled online filter. All of them lie in one block of memory.

A call from Python passes each array of a tuple on its own, which takes longer than a whole step. So Python passes the
block, and compiled code finds the arrays in it.
"""

from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.lanes import LANES, UTILITIES, ActionGrid, Lanes
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.state import STATE, Drivers, Linearised, Scene, State, Workspace, points_of
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
#: Entries of ``Alarm.colour``.
BLOCK, KEPT, QUIET, SAMPLES, SUM, BLOCKS, SQUARES = range(7)


class Sizes(NamedTuple):
    """Numbers of vehicles, adapted parameters, interacting models of the noises, and columns of the alarm."""

    vehicles: int
    adapted: int
    models: int
    columns: int


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


class Noises(NamedTuple):
    """The noises of ``noise.NoiseLearner`` with J interacting models, J = 0 where they are not learnt.

    mean, covariance: (2,) and (2, 2) of the logarithms; weight: (J,); means, covariances: (J, 2) and (J, 2, 2) of each
    model; d_mean, d_covariance: derivatives (2, N) and (2, N, N) of the state; kept: (J, 2) of the logarithms in a
    period; prior_mean, prior_var: (2,); stay: (1,) probability of the same model in the next period; outliers: (2,);
    share, were, spread: (J,), (J, 2) and (J, 2, 2), overwritten.
    """

    mean: Array
    covariance: Array
    weight: Array
    means: Array
    covariances: Array
    d_mean: Array
    d_covariance: Array
    kept: Array
    prior_mean: Array
    prior_var: Array
    stay: Array
    outliers: Array
    share: Array
    were: Array
    spread: Array

    @property
    def values(self) -> Array:
        """The noises (2,) themselves."""
        return np.exp(self.mean)

    def recall(self, mean: Array, covariance: Array) -> None:
        """Go on from a mean (2,) of the logarithms and its covariance (2, 2)."""
        self.mean[:] = self.means[:] = mean
        self.covariance[:] = self.covariances[:] = covariance


class Alarm(NamedTuple):
    """The alarm of ``alarm.StyleAlarm`` with C columns, C = 0 where no parameter is adapted.

    signature, moved: (N, C), the second is overwritten; known, seen: (C,); threshold: (1,); every: (1,) periods from
    one onset to the next; periods: (1,) since the alarm began; onsets: (1,) their number; colour: (7,), the entries
    ``BLOCK`` to ``SQUARES``: samples in a block, what is kept of the sums in a block, samples without an alarm at
    first; then the number of samples, the sum in this block, the number of blocks with forgetting, and the sum of
    their squares.
    """

    signature: Array
    moved: Array
    known: Array
    seen: Array
    threshold: Array
    every: Array
    periods: Array
    onsets: Ints
    colour: Array


class Scratch(NamedTuple):
    """Arrays that every step overwrites: gain and shared (N,), half (N, N).

    length (M,) [m], rear (3,) and time_s (1,): of the sample from which the next period was linearised.
    """

    gain: Array
    shared: Array
    half: Array
    length: Array
    rear: Array
    time_s: Array


class Online(NamedTuple):
    """Everything that the compiled filter knows and works on.

    scene: (6,) of ``Scene``; result: ``RESULTS`` entries and a covariance; braking: (1,) of ``ActionGrid``.
    """

    sample: ChainSample
    result: Array
    book: Book
    state: State
    drivers: Drivers
    scene: Array
    linearised: Linearised
    workspace: Workspace
    braking: Ints
    lanes: Lanes
    scratch: Scratch
    noises: Noises
    alarm: Alarm


def _shapes(sizes: Sizes) -> list[tuple[int, int]]:
    """Rows and columns of all arrays, in the order of ``online_arrays``; a stack of matrices as one tall matrix."""
    m, a, j, c = sizes
    n, most = STATE * m + a, 5 + a
    sample = [(m, 1), (m, 1), (m, 1), (3, 1), (2, 1)]
    book = [(m, 1)] * 4 + [(1, 1)]
    state = [(n, 1), (n, n), (m, 1)]
    drivers = [(m, ROW.width), (a, 1), (a, 1), (a, 1)]
    linearised = [(n, 1), (n, n), (n, n), (n, n), (n, 1), (n, 1)]
    d = max(m - 1, 1)
    workspace = [(2 * d, most), (d * (3 + most), most), (d, 2), (2, 2 * most), (n, 1), (n, 1)]
    k = len(ACTIONS)
    lanes = [(1, 1), (-(-points_of(m, a) // LANES), UTILITIES + LANES * k), (k, 1), (k, 1), (k, 1)]
    noises = [(2, 1), (2, 2), (j, 1), (j, 2), (2 * j, 2), (2, n), (2 * n, n)]
    noises += [(j, 2), (2, 1), (2, 1), (1, 1), (2, 1), (j, 1), (j, 2), (2 * j, 2)]
    alarm = [(n, c), (n, c), (c, 1), (c, 1), (1, 1), (1, 1), (1, 1), (1, 1), (7, 1)]
    scratch = [(n, 1), (n, 1), (n, n), (m, 1), (3, 1), (1, 1)]
    result, scene = (RESULTS + 9, 1), (len(Scene._fields), 1)
    of_model = [*drivers, scene, *linearised, *workspace, *lanes, *scratch]
    return [*sample, result, *book, *state, *of_model, *noises, *alarm]


def layout_of(sizes: Sizes) -> Ints:
    """Return where each array begins in the memory, and its rows and columns, (arrays, 3)."""
    shapes = np.array(_shapes(sizes), np.int64)
    ends = np.cumsum(shapes[:, 0] * shapes[:, 1])
    return np.column_stack([ends - shapes[:, 0] * shapes[:, 1], shapes])


def memory_for(layout: Ints) -> Array:
    """Return the memory for a layout, all 0."""
    return np.zeros(int(layout[-1, 0] + layout[-1, 1] * layout[-1, 2]))


@in_python_too
def _vector(memory: Array, layout: Ints, k: int) -> Array:
    start, rows, columns = layout[k, 0], layout[k, 1], layout[k, 2]
    return memory[start : start + rows * columns]


@in_python_too
def _integers(memory: Array, layout: Ints, k: int) -> Ints:
    return _vector(memory, layout, k).view(np.int64)


@in_python_too
def _matrix(memory: Array, layout: Ints, k: int) -> Array:
    return _vector(memory, layout, k).reshape((layout[k, 1], layout[k, 2]))


@in_python_too
def _integer_matrix(memory: Array, layout: Ints, k: int) -> Ints:
    return _integers(memory, layout, k).reshape((layout[k, 1], layout[k, 2]))


@in_python_too
def _stack(memory: Array, layout: Ints, k: int) -> Array:
    """Return square matrices that stand one below the other."""
    rows, columns = layout[k, 1], layout[k, 2]
    return _vector(memory, layout, k).reshape((rows // columns, columns, columns))


@in_python_too
def _noises(memory: Array, layout: Ints, k: int) -> Noises:
    """Return the arrays of the noises; the first one has number k."""
    return Noises(
        mean=_vector(memory, layout, k),
        covariance=_matrix(memory, layout, k + 1),
        weight=_vector(memory, layout, k + 2),
        means=_matrix(memory, layout, k + 3),
        covariances=_stack(memory, layout, k + 4),
        d_mean=_matrix(memory, layout, k + 5),
        d_covariance=_stack(memory, layout, k + 6),
        kept=_matrix(memory, layout, k + 7),
        prior_mean=_vector(memory, layout, k + 8),
        prior_var=_vector(memory, layout, k + 9),
        stay=_vector(memory, layout, k + 10),
        outliers=_vector(memory, layout, k + 11),
        share=_vector(memory, layout, k + 12),
        were=_matrix(memory, layout, k + 13),
        spread=_stack(memory, layout, k + 14),
    )


@in_python_too
def _alarm(memory: Array, layout: Ints, k: int) -> Alarm:
    """Return the arrays of the alarm; the first one has number k."""
    return Alarm(
        signature=_matrix(memory, layout, k),
        moved=_matrix(memory, layout, k + 1),
        known=_vector(memory, layout, k + 2),
        seen=_vector(memory, layout, k + 3),
        threshold=_vector(memory, layout, k + 4),
        every=_vector(memory, layout, k + 5),
        periods=_vector(memory, layout, k + 6),
        onsets=_integers(memory, layout, k + 7),
        colour=_vector(memory, layout, k + 8),
    )


@in_python_too
def online_arrays(memory: Array, layout: Ints) -> Online:
    """Return the arrays that lie in a memory with a layout of ``layout_of``."""
    at, to = memory, layout
    vector, matrix, integers = _vector, _matrix, _integers
    return Online(
        ChainSample(vector(at, to, 0), integers(at, to, 1), vector(at, to, 2), vector(at, to, 3), vector(at, to, 4)),
        vector(at, to, 5),
        Book(integers(at, to, 6), vector(at, to, 7), integers(at, to, 8), integers(at, to, 9), integers(at, to, 10)),
        State(vector(at, to, 11), matrix(at, to, 12), integers(at, to, 13)),
        Drivers(matrix(at, to, 14), integers(at, to, 15), vector(at, to, 16), vector(at, to, 17)),
        vector(at, to, 18),
        Linearised(
            vector(at, to, 19),
            matrix(at, to, 20),
            matrix(at, to, 21),
            _integer_matrix(at, to, 22),
            integers(at, to, 23),
            integers(at, to, 24),
        ),
        Workspace(
            _integer_matrix(at, to, 25),
            matrix(at, to, 26),
            _integer_matrix(at, to, 27),
            matrix(at, to, 28),
            vector(at, to, 29),
            vector(at, to, 30),
        ),
        integers(at, to, 31),
        Lanes(
            matrix(at, to, 32),
            memory[:0].view(np.float32).reshape((0, 1)),
            ActionGrid(vector(at, to, 33), vector(at, to, 34), integers(at, to, 31)[0]),
            vector(at, to, 35),
        ),
        Scratch(
            vector(at, to, 36),
            vector(at, to, 37),
            matrix(at, to, 38),
            vector(at, to, 39),
            vector(at, to, 40),
            vector(at, to, 41),
        ),
        _noises(at, to, 42),
        _alarm(at, to, 57),
    )
