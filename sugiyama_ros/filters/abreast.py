"""The Kalman algebra of filters that run side by side, one vector instruction for all of them.

The modules ``predict`` and ``update`` have the same algebra for one filter. All filters have states of the same size,
so they differ only in their numbers, and in the entries of F that are 0: what may differ from 0 in one filter is
multiplied in all of them. A filter's results do not depend on the others, because a product with 0 changes no sum.

An array of vectors has ABREAST numbers along its last axis, one for each filter. A vector is named by the array and by
its number in the array: entry (i, j) of an array of shape (N, N, ABREAST) is vector i N + j. In a loop over the last
axis, compilers would first have to find out whether the arrays overlap.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.filters.state import STATE, Linearised, State
from sugiyama_ros.jit import kernel

#: Number of filters that run side by side.
ABREAST = 8
_VECTOR = ir.VectorType(ir.DoubleType(), ABREAST)


def _code(combine: str) -> Any:
    """Return what writes the code of a function: how the product is combined with what the first vector holds."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kinds = [*signature.args[:2], *signature.args[2]]
        rest = [builder.extract_value(values[2], k) for k in range(len(signature.args[2]))]
        arguments, places = [*values[:2], *rest], []
        for k in range(0, len(kinds), 2):
            data = context.make_array(kinds[k])(context, builder, arguments[k]).data
            number = context.cast(builder, arguments[k + 1], kinds[k + 1], types.intp)
            first = builder.gep(data, [builder.mul(number, ir.Constant(number.type, ABREAST))])
            places.append(builder.bitcast(first, _VECTOR.as_pointer()))
        into, *factors = places
        product = builder.load(factors[0], align=8)
        for factor in factors[1:]:
            product = builder.fmul(product, builder.load(factor, align=8))
        if combine:
            product = getattr(builder, combine)(builder.load(into, align=8), product)
        builder.store(product, into, align=8)
        return context.get_dummy_value()

    return generate


def _signature(into: Any, i: Any, factors: tuple[Any, ...]) -> Any:
    star: Any = types.StarArgTuple
    return types.void(into, i, star(factors))


@intrinsic
def _put_product(_: Any, into: Any, i: Any, *factors: Any) -> Any:
    """Make vector i of ``into`` the product of one or more vectors; factors: array and number of each."""
    return _signature(into, i, factors), _code("")


@intrinsic
def _add_product(_: Any, into: Any, i: Any, *factors: Any) -> Any:
    """Add the product of one or more vectors to vector i of ``into``; factors: array and number of each."""
    return _signature(into, i, factors), _code("fadd")


@intrinsic
def _subtract_product(_: Any, into: Any, i: Any, *factors: Any) -> Any:
    """Subtract the product of one or more vectors from vector i of ``into``; factors: array and number of each."""
    return _signature(into, i, factors), _code("fsub")


#: Rows of ``Abreast.sample``: slope of the measurement, predicted less measured position [m], and the weights of the
#: innovation in the mean and in the covariance, as of ``update.weights``. All are 0 where no sample is taken in.
SLOPE, OFF, STEP, SHRINK = range(4)


class Abreast(NamedTuple):
    """States of ABREAST filters with N entries each, and one linearised period of each; the last axis is the filter.

    mean: (N, ABREAST); covariance: (N, N, ABREAST); sample: (4, ABREAST), what is taken in next; next_mean, jacobian,
    noise: as in ``Linearised``; columns, counts: (ABREAST, N, N) and (ABREAST, N), of each filter; may_differ: (N, N),
    whether an entry of F may differ from 0 in any filter, with the columns of each row in ``shared_columns`` (N, N), in
    ascending order, and their numbers in ``shared_counts`` (N,); live: the entries whose covariances matter; gain,
    half: (N, ABREAST) and (N, N, ABREAST), overwritten.
    """

    mean: Array
    covariance: Array
    sample: Array
    next_mean: Array
    jacobian: Array
    noise: Array
    columns: Ints
    counts: Ints
    may_differ: Mask
    shared_columns: Ints
    shared_counts: Ints
    live: Ints
    gain: Array
    half: Array


@kernel
def abreast_for(live: Ints, size: int) -> Abreast:
    """Return filters of which nothing is known, with states of ``size`` entries, of which those in ``live`` matter."""
    square = (size, size, ABREAST)
    return Abreast(
        np.zeros((size, ABREAST)),
        np.zeros(square),
        np.zeros((4, ABREAST)),
        np.zeros((size, ABREAST)),
        np.zeros(square),
        np.zeros(square),
        np.zeros((ABREAST, size, size), np.int64),
        np.zeros((ABREAST, size), np.int64),
        np.zeros((size, size), np.bool_),
        np.zeros((size, size), np.int64),
        np.zeros(size, np.int64),
        live,
        np.zeros((size, ABREAST)),
        np.zeros(square),
    )


@kernel(allocates=False)
def state_of(c: int, abreast: Abreast, known: Ints) -> State:
    """Return the state of filter c; known: (C, M)."""
    return State(abreast.mean[:, c], abreast.covariance[:, :, c], known[c])


@kernel(allocates=False)
def linearised_of(c: int, abreast: Abreast) -> Linearised:
    """Return the linearised period of filter c."""
    period = abreast.next_mean[:, c], abreast.jacobian[:, :, c], abreast.noise[:, :, c]
    return Linearised(*period, abreast.columns[c], abreast.counts[c], abreast.live)


@kernel(allocates=False)
def update(x: int, abreast: Abreast) -> None:
    """Update all filters with their samples of the position in entry x of the state."""
    mean, covariance, gain, sample, live = abreast.mean, abreast.covariance, abreast.gain, abreast.sample, abreast.live
    size = len(mean)
    for i in live:
        _put_product(gain, i, sample, SLOPE, covariance, x * size + i)
        _subtract_product(mean, i, gain, i, sample, STEP, sample, OFF)
    for a in range(len(live)):
        i = live[a]
        for b in range(a):
            j = live[b]
            _subtract_product(covariance, i * size + j, gain, i, gain, j, sample, SHRINK)
            _put_product(covariance, j * size + i, covariance, i * size + j)
        _subtract_product(covariance, i * size + i, gain, i, gain, i, sample, SHRINK)


@kernel(allocates=False)
def share_columns(c: int, abreast: Abreast) -> None:
    """Note the entries of F that may differ from 0 in filter c."""
    may_differ, columns, counts = abreast.may_differ, abreast.shared_columns, abreast.shared_counts
    for i in abreast.live:
        for k in range(abreast.counts[c, i]):
            column = abreast.columns[c, i, k]
            if may_differ[i, column]:
                continue
            may_differ[i, column] = True
            place = counts[i]
            while place > 0 and columns[i, place - 1] > column:
                columns[i, place] = columns[i, place - 1]
                place -= 1
            columns[i, place] = column
            counts[i] += 1


@kernel(allocates=False)
def predict(abreast: Abreast) -> None:
    """Go on by one period in all filters: F P F' + Q, for the live entries, and exactly symmetric."""
    covariance, jacobian, half, live = abreast.covariance, abreast.jacobian, abreast.half, abreast.live
    columns, counts, size = abreast.shared_columns, abreast.shared_counts, len(abreast.mean)
    for i in live:
        k = columns[i, 0]
        for j in live:
            _put_product(half, i * size + j, jacobian, i * size + k, covariance, k * size + j)
        for c in range(1, counts[i]):
            k = columns[i, c]
            for j in live:
                _add_product(half, i * size + j, jacobian, i * size + k, covariance, k * size + j)
    for a in range(len(live)):
        j = live[a]
        for d in range(a, len(live)):
            i = live[d]
            entry = i * size + j
            _put_product(covariance, entry, half, i * size + columns[j, 0], jacobian, j * size + columns[j, 0])
            for c in range(1, counts[j]):
                _add_product(covariance, entry, half, i * size + columns[j, c], jacobian, j * size + columns[j, c])
            if i // STATE == j // STATE:
                _add_product(covariance, entry, abreast.noise, entry)
            _put_product(covariance, j * size + i, covariance, entry)
    for i in range(size):
        _put_product(abreast.mean, i, abreast.next_mean, i)
