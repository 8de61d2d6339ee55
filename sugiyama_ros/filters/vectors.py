"""Arithmetic on vectors of numbers that belong to filters which run side by side, one number for each filter.

An array of vectors has ABREAST numbers along its last axis. A vector is named by the array and by its number in the
array: entry (i, j) of an array of shape (N, N, ABREAST) is vector i N + j. Each function is a few vector instructions.
In a loop over the last axis, compilers would first have to find out whether the arrays overlap.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

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
def put_product(_: Any, into: Any, i: Any, *factors: Any) -> Any:
    """Make vector i of ``into`` the product of one or more vectors; factors: array and number of each."""
    return _signature(into, i, factors), _code("")


@intrinsic
def add_product(_: Any, into: Any, i: Any, *factors: Any) -> Any:
    """Add the product of one or more vectors to vector i of ``into``; factors: array and number of each."""
    return _signature(into, i, factors), _code("fadd")


@intrinsic
def subtract_product(_: Any, into: Any, i: Any, *factors: Any) -> Any:
    """Subtract the product of one or more vectors from vector i of ``into``; factors: array and number of each."""
    return _signature(into, i, factors), _code("fsub")
