"""The primitives of the physics, and functions built on them.

An effect computes only through `+ - * / **`, the comparisons, `&` and `|` of conditions, and the methods below. On floats they
are `Numbers`; on traced values they record the operations (`vpp_fmu.tracer`). Both inherit the functions
built on the primitives, so a limit or a lag has one formula.
"""

import math
from functools import reduce

from vpp_fmu.kernel.exponential import exp, expm1
from vpp_fmu.kernel.tables import Curve, Surface, curve, look_up, look_up_2, surface

SERIES_BELOW = 0.3
"""Below this |x|, `relaxation` uses its series: the direct form loses digits, its derivative more."""

SERIES = tuple((-1.0) ** n / math.factorial(n + 1) for n in range(13))
"""0.3**13 / 14! < 1e-17: the series is exact to rounding where it is used."""

LN_10 = math.log(10.0)

WHOLE = 1.5 * 2.0**52
"""Adding and subtracting it rounds to a whole number: doubles of this size have no fraction."""


INSTEAD = {
    "__bool__": ("a condition of Python's", "ops.where(condition, yes, no), and & | for and, or"),
    "__invert__": ("~", "ops.logical_not(condition)"),
    "__float__": ("float()", "the value as it is, and ops.exp, ops.sqrt ... in place of functions of math"),
    "__int__": ("int()", "ops.whole(x), which rounds to the nearest, or ops.floor(x)"),
    "__index__": ("a value as an index or a count", "a plain number, or ops.table(x, xs, ys)"),
    "__mod__": ("%", "ops.mod(x, y)"),
    "__rmod__": ("%", "ops.mod(x, y)"),
    "__floordiv__": ("//", "ops.floor(x / y)"),
    "__rfloordiv__": ("//", "ops.floor(x / y)"),
    "__pow__": ("a derivative's base and exponent in **", "ops.pow(x, y)"),
    "__abs__": ("abs()", "ops.abs(x)"),
    "__round__": ("round()", "ops.whole(x)"),
    "__iter__": ("a loop over a value", "loops over plain numbers, or over a vector"),
}
"""Python constructs on numbers, and their replacements for symbols."""


class Unseen(TypeError):
    """An operation on a symbol that `Ops` and the operators do not have: the operation, and what to write `instead`."""

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
    """Base of every arithmetic; subclasses define the primitives `exp expm1 log log10 pow sqrt sin cos tanh atan2 whole where
    look_up look_up_2`."""

    def __getattr__(self, name):
        known = [n for n in dir(self) if not n.startswith(("_", "look_up")) and callable(getattr(type(self), n, None))]
        raise AttributeError(f"no ops.{name}; one of {', '.join(known)}", name=name, obj=self)

    def abs(self, x):
        """|x|, same unit."""
        return self.where(x < 0.0, -x, x)

    def minimum(self, *values):
        """The smallest of two or more values."""
        return reduce(lambda x, y: self.where(y < x, y, x), values)

    def maximum(self, *values):
        """The largest of two or more values."""
        return reduce(lambda x, y: self.where(y > x, y, x), values)

    def logical_not(self, condition):
        """Whether the condition does not hold: 1.0 or 0.0."""
        return self.where(condition, 0.0, 1.0)

    def floor(self, x):
        """The largest whole number up to x; |x| < 2**51. Its derivative is 0."""
        nearest = self.whole(x)
        return self.where(nearest > x, nearest - 1.0, nearest)

    def ceil(self, x):
        """The smallest whole number from x on; |x| < 2**51. Its derivative is 0."""
        nearest = self.whole(x)
        return self.where(nearest < x, nearest + 1.0, nearest)

    def mod(self, x, y):
        """x - y floor(x / y): the remainder, with the sign of y."""
        return x - y * self.floor(x / y)

    def table(self, x, xs, ys, method="linear"):
        """The curve through the points (xs, ys) at x; the end values are held outside. `method`: "linear", or "cubic", which is
        monotone wherever the points are (PCHIP). Search is binary. ValueError: xs do not rise, or lengths differ."""
        return self.look_up(x, curve(xs, ys, method))

    def table_2(self, x, y, xs, ys, zs, method="linear"):
        """The surface through zs[i][j] at (xs[i], ys[j]); the edges are held outside. `method`: "linear" in each direction
        (bilinear), or "cubic" with the slopes of PCHIP along both. ValueError: xs or ys do not rise, or sizes differ."""
        return self.look_up_2(x, y, surface(xs, ys, zs, method))

    def clip(self, x, low, high):
        """x held within [low, high]."""
        return self.minimum(self.maximum(x, low), high)

    def gain(self, tau, dt):
        """Share of a distance that a first-order lag covers in dt: 1 - exp(-dt / tau). Exact for a held input."""
        return -self.expm1(-(dt / tau))

    def lag(self, x, u, tau, dt):
        """First-order lag from x towards u, held over dt. Exact; at x == u it stays to the bit."""
        return x + self.gain(tau, dt) * (u - x)

    def lag_ramp(self, x, before, after, tau, dt):
        """First-order lag from x, its input running straight from `before` to `after` over dt. Exact for a ramp."""
        covered = self.gain(tau, dt)
        return x + covered * (before - x) + (after - before) * (1.0 - covered * tau / dt)

    def relaxation(self, x):
        """(1 - exp(-x)) / x for x >= 0, with its limit 1 at x = 0 and a derivative that is right there too."""
        away = self.maximum(x, SERIES_BELOW)
        return self.where(x < SERIES_BELOW, self._relaxation_near_0(x), -self.expm1(-away) / away)

    def _relaxation_near_0(self, x):
        terms, power = SERIES, x
        while len(terms) > 1:  # in pairs (Estrin's scheme), which a processor does at once
            pairs = [low + power * high for low, high in zip(terms[::2], terms[1::2], strict=False)]
            terms, power = [*pairs, *terms[2 * len(pairs) :]], power * power
        return terms[0]

    def two_lag_step(self, tau_1, tau_2, dt):
        """Unit step response at dt of two lags in a row: 1 - (tau_1 e_1 - tau_2 e_2) / (tau_1 - tau_2).

        This form needs no special case for equal time constants. With x = dt / tau and the gain g = 1 - exp(-x) of the slower
        and of the faster lag, it is g_slow - x_slow (g_fast - g_slow) / d, d = x_fast - x_slow >= 0. Near d = 0 the quotient is
        (1 - g_slow) (1 - exp(-d)) / d.
        """
        # For equal constants the two functions pick different arguments, so that each gets half of the slope.
        x_1, x_2, g_1, g_2 = dt / tau_1, dt / tau_2, self.gain(tau_1, dt), self.gain(tau_2, dt)
        swapped = x_2 < x_1  # tau_2 is the slower
        slow, fast = self.where(swapped, x_2, x_1), self.where(swapped, x_1, x_2)
        g_slow, g_fast = self.where(swapped, g_2, g_1), self.where(swapped, g_1, g_2)
        d = fast - slow
        near, away = (1.0 - g_slow) * self._relaxation_near_0(d), (g_fast - g_slow) / self.maximum(d, SERIES_BELOW)
        return g_slow - slow * self.where(d < SERIES_BELOW, near, away)


class Numbers(Ops):
    """The primitives on plain floats; overflow, division by zero and negative roots raise as Python's do."""

    exp = staticmethod(exp)
    expm1 = staticmethod(expm1)
    log = staticmethod(math.log)
    log10 = staticmethod(math.log10)
    pow = staticmethod(math.pow)
    sqrt = staticmethod(math.sqrt)
    sin = staticmethod(math.sin)
    cos = staticmethod(math.cos)
    tanh = staticmethod(math.tanh)
    atan2 = staticmethod(math.atan2)

    @staticmethod
    def look_up(x, c: Curve, order=0):
        """Derivative number `order` of a curve at x."""
        return look_up(x, len(c.xs), c.xs, c.ys, c.slopes, order)

    @staticmethod
    def look_up_2(x, y, c: Surface, order_x=0, order_y=0):
        """Derivative of a surface at (x, y), of these orders in x and y."""
        return look_up_2(x, y, len(c.xs), c.xs, len(c.ys), c.ys, c.grid, order_x, order_y)

    @staticmethod
    def whole(x):
        """The whole number nearest to x, ties to even; |x| < 2**51. Its derivative is 0."""
        return x + WHOLE - WHOLE

    @staticmethod
    def where(condition, yes, no):
        """`yes` where the condition holds, else `no`; both were evaluated."""
        return yes if condition else no


NUMBERS = Numbers()
