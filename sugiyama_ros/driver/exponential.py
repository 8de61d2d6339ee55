"""The exponential function, written so that compilers turn a loop of calls into vector instructions.

The function in libm takes one number at a time.
"""

from typing import Any

from numba import types
from numba.extending import intrinsic

from sugiyama_ros.jit import kernel

#: Smallest argument; smaller arguments count as this one. exp(-600) is far below anything that is added to it here.
LOWEST = -600.0
# Adding this constant rounds a float64 to a whole number, and leaves the whole number in the last bits.
_ROUNDING = 6755399441055744.0
_PER_LN_2 = 1.4426950408889634
_LN_2 = 0.6931471805599453
_MANTISSA_BITS = 52


@intrinsic
def _bits(_: Any, x: Any) -> Any:
    """Read the bits of a float64 as an integer."""
    return types.int64(types.float64), lambda context, builder, _, values: builder.bitcast(
        values[0], context.get_value_type(types.int64)
    )


@intrinsic
def _of_bits(_: Any, bits: Any) -> Any:
    """Read the bits of an integer as a float64."""
    return types.float64(types.int64), lambda context, builder, _, values: builder.bitcast(
        values[0], context.get_value_type(types.float64)
    )


@intrinsic
def _fma(_: Any, x: Any, y: Any, z: Any) -> Any:
    """Compute x y + z with one rounding."""
    number = types.float64
    return number(number, number, number), lambda context, builder, _, values: builder.fma(*values)


@kernel(vectorised=True)
def multiply_add(x: float, y: float, z: float) -> float:
    """Compute x y + z with one rounding, in one instruction."""
    # numba supplies the first argument of an intrinsic
    sum_: float = _fma(x, y, z)  # type: ignore[call-arg]
    return sum_


@kernel(vectorised=True)
def exponential(x: float) -> float:
    """Compute exp(x) with a relative error below 3e-14, and below 1e-15 for x between -10 and 1.

    The argument is split into x = k ln 2 + r with |r| < 0.35. The bits of k give 2^k. A polynomial gives exp(r): of all
    polynomials of degree 10 that begin with 1 + r, the one with the smallest largest relative error (3e-16, by Remez'
    algorithm). Its terms are added in a tree (Estrin's scheme), so that few operations wait for one another.

    Parameters
    ----------
    x : float
        At most 700. Numbers below ``LOWEST`` count as ``LOWEST``.

    Returns
    -------
    float
        exp(x).

    References
    ----------
    Cody and Waite, Software Manual for the Elementary Functions (1980).
    """
    bounded = x if x > LOWEST else LOWEST
    rounded = multiply_add(bounded, _PER_LN_2, _ROUNDING)
    k = rounded - _ROUNDING
    r = multiply_add(-k, _LN_2, bounded)
    square = r * r
    low = multiply_add(square, multiply_add(r, 0.16666666666611335, 0.4999999999999832), 1.0 + r)
    middle = multiply_add(r, 0.008333333370982337, 0.04166666666814233)
    middle = multiply_add(square, multiply_add(r, 0.00019841185067513597, 0.0013888888515119044), middle)
    high = multiply_add(square, 2.747672038718833e-07, multiply_add(r, 2.763506824943625e-06, 2.48019323958082e-05))
    square *= square
    p = multiply_add(square, multiply_add(square, high, middle), low)
    # the last bits of k, as the exponent: p times 2^k
    power: float = _of_bits(_bits(p) + (_bits(rounded) << _MANTISSA_BITS))  # type: ignore[call-arg]
    return power
