"""The primitives of the physics, and functions built on them.

An effect computes only through `+ - * /`, the comparisons `<` and `>`, and the methods below. On floats they are the
maths library's (`Numbers`); on traced values they record the operations (`vpp_fmu.tracer`). Both inherit the functions
built on the primitives, so a limit or a lag has one formula.
"""

import math

SERIES_BELOW = 0.3
"""Below this |x|, `relaxation` uses its series: the direct form loses digits, its derivative more."""

SERIES_TERMS = 13
"""0.3**13 / 14! < 1e-17: the series is exact to rounding where it is used."""

WHOLE = 1.5 * 2.0**52
"""Adding and subtracting it rounds to a whole number: doubles of this size have no fraction."""


INSTEAD = {
    "__bool__": ("a condition of Python's", "ops.where(condition, yes, no)"),
    "__eq__": ("==", "< or >, which tell numbers apart"),
    "__ne__": ("!=", "< or >, which tell numbers apart"),
    "__le__": ("<=", "< or ops.where(x > y, no, yes)"),
    "__ge__": (">=", "> or ops.where(x < y, no, yes)"),
    "__pow__": ("**", "products such as x * x, ops.sqrt, ops.exp"),
    "__rpow__": ("**", "products such as x * x, ops.sqrt, ops.exp"),
    "__float__": ("float()", "the value as it is, and ops.exp, ops.sqrt ... in place of functions of math"),
    "__int__": ("int()", "ops.whole(x), which rounds to the nearest"),
    "__index__": ("a value as an index or a count", "a plain number"),
    "__mod__": ("%", "x - n * ops.whole(x / n)"),
    "__rmod__": ("%", "x - n * ops.whole(x / n)"),
    "__floordiv__": ("//", "ops.whole(x / y - 0.5)"),
    "__rfloordiv__": ("//", "ops.whole(x / y - 0.5)"),
    "__abs__": ("abs()", "ops.abs(x)"),
    "__round__": ("round()", "ops.whole(x)"),
    "__iter__": ("a loop over a value", "loops over plain numbers"),
}
"""Python constructs on numbers, and their replacements for symbols."""


class Unseen(TypeError):
    """An operation other than `Ops` and + - * / < > on a symbol: the operation, and what to write `instead`."""

    def __init__(self, method: str):
        self.method = method
        self.what, self.instead = INSTEAD[method]
        super().__init__(f"{self.what} can't be traced or differentiated: write {self.instead}")


class Symbolic:
    """A value that refuses operations that are not recorded."""

    __slots__ = ()


def _refusing(method: str):
    def refuse(self, *_):
        raise Unseen(method)

    return refuse


for _method in INSTEAD:
    setattr(Symbolic, _method, _refusing(_method))


class Ops:
    """Base of every arithmetic; subclasses define `exp expm1 sqrt sin cos tanh whole where`."""

    def abs(self, x):
        """|x|, same unit."""
        return self.where(x < 0.0, -x, x)

    def minimum(self, x, y):
        """The smaller of x and y."""
        return self.where(y < x, y, x)

    def maximum(self, x, y):
        """The larger of x and y."""
        return self.where(y > x, y, x)

    def clip(self, x, low, high):
        """x held within [low, high]."""
        return self.minimum(self.maximum(x, low), high)

    def gain(self, tau, dt):
        """Share of a distance that a first-order lag covers in dt: 1 - exp(-dt / tau). Exact for a held input."""
        return -self.expm1(-dt / tau)

    def lag(self, x, u, tau, dt):
        """First-order lag from x towards u, held over dt. Exact; at x == u it stays to the bit."""
        return x + self.gain(tau, dt) * (u - x)

    def lag_ramp(self, x, before, after, tau, dt):
        """First-order lag from x, its input running straight from `before` to `after` over dt. Exact for a ramp."""
        covered = self.gain(tau, dt)
        return x + covered * (before - x) + (after - before) * (1.0 - covered * tau / dt)

    def relaxation(self, x):
        """(1 - exp(-x)) / x for x >= 0, with its limit 1 at x = 0 and a derivative that is right there too."""
        small = x < SERIES_BELOW
        terms = 1.0
        for n in range(SERIES_TERMS, 1, -1):
            terms = 1.0 - x / float(n) * terms
        away = self.where(small, SERIES_BELOW, x)
        return self.where(small, terms, -self.expm1(-away) / away)

    def two_lag_step(self, tau_1, tau_2, dt):
        """Unit step response at dt of two lags in a row: 1 - (tau_1 e_1 - tau_2 e_2) / (tau_1 - tau_2).

        This form needs no special case for equal time constants: with the slower and the faster constant,
        e_fast = e_slow exp(-d), d = dt (slow - fast) / (slow fast) >= 0, and the quotient becomes `relaxation(d)`.
        """
        # For equal constants the two functions pick different arguments, so that each gets half of the slope.
        slow, fast = self.maximum(tau_1, tau_2), self.minimum(tau_2, tau_1)
        apart = dt * (slow - fast) / (slow * fast)
        left = self.exp(-dt / slow)
        return self.gain(slow, dt) - left * (dt / slow) * self.relaxation(apart)


class Numbers(Ops):
    """The primitives on plain floats; overflow, division by zero and negative roots raise as Python's do."""

    exp = staticmethod(math.exp)
    expm1 = staticmethod(math.expm1)
    sqrt = staticmethod(math.sqrt)
    sin = staticmethod(math.sin)
    cos = staticmethod(math.cos)
    tanh = staticmethod(math.tanh)

    @staticmethod
    def whole(x):
        """The whole number nearest to x, ties to even; |x| < 2**51. Its derivative is 0."""
        return x + WHOLE - WHOLE

    @staticmethod
    def where(condition, yes, no):
        """`yes` where the condition holds, else `no`; both were evaluated."""
        return yes if condition else no


NUMBERS = Numbers()
