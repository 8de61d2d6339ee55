"""exp of many numbers at once, in a form that compilers make vector instructions of; libm's takes one at a time."""

from numba import njit

from sugiyama_ros.road import Array, Ints

#: Arguments below this count as this: exp(-600) is far below anything that is added to it here.
LOWEST = -600.0
# Adding it rounds a float64 to a whole number, which then stands in the last bits.
_ROUNDING = 6755399441055744.0
_PER_LN_2 = 1.4426950408889634
# ln 2 in two parts, the first with few enough bits that its product with a whole number is exact (Cody and Waite 1980).
_LN_2, _REST = 0.6931471803691238, 1.9082149292705877e-10
_BIAS, _MANTISSA_BITS = 1023, 52


@njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def exponentials(x: Array, scratch: Array, bits: Ints, out: Array) -> None:
    """exp(x) into ``out``, all (K,), for LOWEST <= x <= 700; relative error below 1e-14.

    scratch: (K,), overwritten, and ``bits`` the same memory seen as integers. x = k ln 2 + r; the polynomial is
    Taylor's of exp(r), |r| < 0.35; 2^k is put together from its bits.
    """
    for j in range(len(x)):
        rounded = x[j] * _PER_LN_2 + _ROUNDING
        scratch[j] = rounded
        k = rounded - _ROUNDING
        r = (x[j] - k * _LN_2) - k * _REST
        tail = 1.0 / 40320.0 + r * (1.0 / 362880.0 + r * (1.0 / 3628800.0 + r * (1.0 / 39916800.0)))
        middle = 1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0 + r * tail)))
        out[j] = 1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * middle)))
    for j in range(len(x)):
        bits[j] = (bits[j] << _MANTISSA_BITS) + (_BIAS << _MANTISSA_BITS)
    for j in range(len(x)):
        out[j] *= scratch[j]
