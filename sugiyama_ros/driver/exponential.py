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
# ln 2 in two parts. The first part has so few bits that its product with a whole number is exact (Cody and Waite 1980).
_LN_2, _REST = 0.6931471803691238, 1.9082149292705877e-10
_BIAS, _MANTISSA_BITS = 1023, 52


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


@kernel
def _horner(r: float, above: float, coefficient: float) -> float:
    """One step of Horner's rule: r times the polynomial so far, plus the next coefficient."""
    # numba supplies the first argument of an intrinsic
    sum_: float = _fma(r, above, coefficient)  # type: ignore[call-arg]
    return sum_


@kernel(vectorised=True)
def exponential(x: float) -> float:
    """Compute exp(x) with a relative error below 1e-14.

    The argument is split into x = k ln 2 + r with |r| < 0.35. A Taylor polynomial gives exp(r), and the bits of k give
    2^k.

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
    rounded = bounded * _PER_LN_2 + _ROUNDING
    k = rounded - _ROUNDING
    r = _horner(-k, _REST, _horner(-k, _LN_2, bounded))
    p = _horner(r, 1.0 / 39916800.0, 1.0 / 3628800.0)
    p = _horner(r, _horner(r, p, 1.0 / 362880.0), 1.0 / 40320.0)
    p = _horner(r, _horner(r, p, 1.0 / 5040.0), 1.0 / 720.0)
    p = _horner(r, _horner(r, p, 1.0 / 120.0), 1.0 / 24.0)
    p = _horner(r, _horner(r, p, 1.0 / 6.0), 0.5)
    p = _horner(r, _horner(r, p, 1.0), 1.0)
    power: float = _of_bits((_bits(rounded) + _BIAS) << _MANTISSA_BITS)  # type: ignore[call-arg]
    return p * power
