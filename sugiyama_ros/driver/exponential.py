"""The exponential function, written so that compilers turn a loop of calls into vector instructions.

The function in libm takes one number at a time. The functions here take numbers of double precision, or of single
precision, twice as many of which fit into a vector.
"""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic

from sugiyama_ros.jit import kernel

#: Smallest argument, in double and in single precision; smaller arguments count as this one. exp(-600) and exp(-87) are
#: far below anything that is added to them here.
LOWEST = -600.0, -87.0
# Adding this constant rounds a number to a whole number, and leaves the whole number in the last bits.
_ROUNDING = 6755399441055744.0, 12582912.0
_PER_LN_2 = 1.4426950408889634
_LN_2 = 0.6931471805599453
_MANTISSA_BITS = 52, 23
# Whether the precision shows the polynomial's highest terms.
_HAS_HIGH = 1.0, 0.0
# Callers leave out the first argument, which numba supplies.
_intrinsic: Callable[..., Any] = intrinsic


@_intrinsic
def like(_: Any, x: Any, number: Any) -> Any:
    """Convert x to the precision of another number."""
    return number(x, number), lambda context, builder, signature, values: context.cast(
        builder, values[0], signature.args[0], signature.return_type
    )


@_intrinsic
def _of_width(_: Any, pair: Any, number: Any) -> Any:
    """Return the constant of a pair for double or single precision, in the precision of another number."""

    def choose(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        value = builder.extract_value(values[0], 0 if number == types.float64 else 1)
        return context.cast(builder, value, types.float64, number)

    return number(pair, number), choose


@_intrinsic
def _times_power(_: Any, x: Any, rounded: Any) -> Any:
    """Multiply x by 2^k, where the last bits of ``rounded`` are k: the bits of k are added to the exponent of x."""
    whole, shift = (types.int64, _MANTISSA_BITS[0]) if x == types.float64 else (types.int32, _MANTISSA_BITS[1])

    def add_to_exponent(context: Any, builder: Any, _: Any, values: Any) -> Any:
        kind = context.get_value_type(whole)
        bits, k = (builder.bitcast(value, kind) for value in values)
        return builder.bitcast(builder.add(bits, builder.shl(k, kind(shift))), context.get_value_type(x))

    return x(x, x), add_to_exponent


@_intrinsic
def _fma(_: Any, x: Any, y: Any, z: Any) -> Any:
    """Compute x y + z with one rounding, in the precision of x."""

    def fma(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fma(*(context.cast(builder, v, a, x) for v, a in zip(values, signature.args, strict=True)))

    return x(x, y, z), fma


@kernel(vectorised=True)
def multiply_add(x: float, y: float, z: float) -> float:
    """Compute x y + z with one rounding, in one instruction; the precision is that of x."""
    sum_: float = _fma(x, y, z)
    return sum_


@kernel(vectorised=True)
def exponential(x: float) -> float:
    """Compute exp(x) with a relative error below 3e-14, and below 1e-15 for x between -10 and 1.

    In single precision the error is below 6e-6, and below 2e-7 for x between -1 and 1.

    The argument is split into x = k ln 2 + r with |r| < 0.35. The bits of k give 2^k. A polynomial gives exp(r): of all
    polynomials of degree 10 that begin with 1 + r, the one with the smallest largest relative error (3e-16, by Remez'
    algorithm). Its terms are added in a tree (Estrin's scheme), so that few operations wait for one another.

    x: at most 700; numbers below ``LOWEST`` count as ``LOWEST``.

    References
    ----------
    Cody and Waite, Software Manual for the Elementary Functions (1980).
    """
    lowest, rounding = _of_width(LOWEST, x), _of_width(_ROUNDING, x)
    bounded = x if x > lowest else lowest
    rounded = multiply_add(bounded, _PER_LN_2, rounding)
    k = rounded - rounding
    r = multiply_add(-k, _LN_2, bounded)
    square = r * r
    low = multiply_add(r, 0.16666666666611335, 0.4999999999999832)
    low = multiply_add(square, low, like(1.0, r) + r)
    middle = multiply_add(r, 0.008333333370982337, 0.04166666666814233)
    middle = multiply_add(square, multiply_add(r, 0.00019841185067513597, 0.0013888888515119044), middle)
    if _of_width(_HAS_HIGH, x) > 0.0:
        high = multiply_add(square, 2.747672038718833e-07, multiply_add(r, 2.763506824943625e-06, 2.48019323958082e-05))
        middle = multiply_add(square * square, high, middle)
    p = multiply_add(square * square, middle, low)
    power: float = _times_power(p, rounded)
    return power
