"""exp and expm1, by the same operations on every machine. `exponential.c` is the same in C.

Every lag needs them for each new step length. The functions of C libraries round differently on each platform, and they run one
at a time; these are arithmetic without branches, which a compiler does for several simulations at once. With x = k ln 2 + r,
|r| <= ln 2 / 2, q = exp(r) - 1 is its Taylor polynomial, whose rest is below a tenth of a rounding error, and

    exp(x) = 2**k (q + 1),    expm1(x) = 2**k (q + (1 - 2**-k)).

Errors are below 1 unit in the last place of exp, 2 of expm1. ln 2 is the sum of two numbers, and k times the first is exact (as
in fdlibm). Above 700 (1e304) both overflow, and below -700 exp is 0. This file is part of a Python FMU that has exponentials.
"""

import math


def exp(x):
    """e**x. OverflowError: x is above 700."""
    if -700.0 <= x <= 700.0:
        k, q = _split(x)
        return math.ldexp(q + 1.0, k)
    return _beyond(x, 0.0)


def expm1(x):
    """e**x - 1, also near 0. OverflowError: x is above 700."""
    if -700.0 <= x <= 700.0:
        k, q = _split(x)
        return math.ldexp(q + (1.0 - math.ldexp(1.0, -k)), k)
    return _beyond(x, -1.0)


def _split(x):
    """(k, q) of x."""
    k = x * 1.4426950408889634 + 6755399441055744.0 - 6755399441055744.0  # 1.5 * 2**52: rounds to a whole number
    near, rest = x - k * 6.93147180369123816490e-01, k * 1.90821492927058770002e-10
    r = near - rest
    left = (near - r) - rest
    s = r * r
    t = s * s
    low = 1.0 / 2.0 + r * (1.0 / 6.0) + s * (1.0 / 24.0 + r * (1.0 / 120.0))
    high = 1.0 / 720.0 + r * (1.0 / 5040.0) + s * (1.0 / 40320.0 + r * (1.0 / 362880.0))
    top = 1.0 / 3628800.0 + r * (1.0 / 39916800.0) + s * (1.0 / 479001600.0 + r * (1.0 / 6227020800.0))
    return int(k), r + (left + s * (low + t * (high + t * top)))


def _beyond(x, below):
    if x < 0.0:
        return below
    if x < math.inf:
        raise OverflowError("math range error")
    return x
