"""Forward derivatives on any arithmetic: functions for floats or traced values also run on dual numbers.

    f(x + e d) = f(x) + e f'(x) d,   e^2 = 0        (Griewank and Walther, Evaluating Derivatives, ch. 3)

The tracer's tangents (`vpp_fmu.tracer.tangents`) differentiate a recorded graph. Dual numbers are part of what is recorded, so
a law may compute with the derivatives of a plant. A structurally zero tangent is None and costs nothing. The structure depends
on the model only, not on the numbers, so floats and traced values do the same operations in the same order.
"""

import operator
from math import log
from types import SimpleNamespace
from typing import Any

from vpp_fmu.kernel.ops import LN_10, Ops, Symbolic, Unseen
from vpp_fmu.kernel.vector import Vector


class Dual(Symbolic):
    """A value and its `tangents`, one for each direction; None: independent of that direction."""

    __slots__ = ("tangents", "value")

    def __init__(self, value: Any, tangents: tuple):
        self.value, self.tangents = value, tangents

    def __add__(self, other):
        y = _dual(other, self)
        return Dual(self.value + y.value, _each(_sum, self, y))

    def __radd__(self, other):
        return _dual(other, self) + self

    def __sub__(self, other):
        y = _dual(other, self)
        return Dual(self.value - y.value, _each(_difference, self, y))

    def __rsub__(self, other):
        return _dual(other, self) - self

    def __mul__(self, other):
        x, y = self.value, _dual(other, self)
        return Dual(x * y.value, _each(lambda d, e: _sum(_product(d, y.value), _product(e, x)), self, y))

    def __rmul__(self, other):
        return _dual(other, self) * self

    def __truediv__(self, other):
        y = _dual(other, self)
        quotient = self.value / y.value
        return Dual(quotient, _each(lambda d, e: _quotient(_difference(d, _product(e, quotient)), y.value), self, y))

    def __rtruediv__(self, other):
        return _dual(other, self) / self

    def __neg__(self):
        return Dual(-self.value, tuple(None if d is None else -d for d in self.tangents))

    def __pow__(self, n):
        """To a plain number."""
        if isinstance(n, Symbolic):
            raise Unseen("__pow__")
        return Dual(self.value**n, tuple(_product(d, n * self.value ** (n - 1)) for d in self.tangents))

    def __rpow__(self, base):
        value = base**self.value
        return Dual(value, tuple(_product(d, log(base) * value) for d in self.tangents))

    __hash__ = object.__hash__


def _comparing(compare):
    return lambda x, other: compare(x.value, _dual(other, x).value)


for _name in ("lt", "gt", "le", "ge", "eq", "ne"):
    setattr(Dual, f"__{_name}__", _comparing(getattr(operator, _name)))


class Duals(Ops):
    """Dual numbers of `width` directions on the arithmetic `ops`. Comparisons use the values only."""

    def __init__(self, ops: Any, width: int):
        self.ops, self._none = ops, (None,) * width

    def constant(self, value: Any) -> Dual:
        """A dual number without derivatives; a dual argument is returned unchanged."""
        return value if isinstance(value, Dual) else Dual(value, self._none)

    def seeded(self, value: Any, i: int) -> Dual:
        """A dual number whose derivative is 1 in direction i."""
        return Dual(value, tuple(1.0 if i == j else None for j in range(len(self._none))))

    def constants(self, named: Any) -> SimpleNamespace:
        """The attributes of a namespace as constants, those of vectors and of namespaces within it as well."""
        return SimpleNamespace(**{name: self._constant(value) for name, value in vars(named).items()})

    def _constant(self, value: Any) -> Any:
        if isinstance(value, SimpleNamespace):
            return self.constants(value)
        return Vector(map(self.constant, value)) if isinstance(value, tuple) else self.constant(value)

    def where(self, condition, yes, no):
        x, y = self.constant(yes), self.constant(no)

        def chosen(d, e):
            return None if d is None and e is None else self.ops.where(condition, _zero(d), _zero(e))

        return Dual(self.ops.where(condition, x.value, y.value), _each(chosen, x, y))

    def whole(self, x):
        return self.constant(self.ops.whole(x.value)) if isinstance(x, Dual) else self.ops.whole(x)

    def exp(self, x):
        return self._apply(x, self.ops.exp, lambda u, f: f)

    def expm1(self, x):
        return self._apply(x, self.ops.expm1, lambda u, f: f + 1.0)

    def log(self, x):
        return self._apply(x, self.ops.log, lambda u, f: 1.0 / u)

    def log10(self, x):
        return self._apply(x, self.ops.log10, lambda u, f: 1.0 / (LN_10 * u))

    def pow(self, x, y):
        x, y = self.constant(x), self.constant(y)
        value = self.ops.pow(x.value, y.value)
        moved = self._apply(x, lambda u: value, lambda u, f: y.value * self.ops.pow(u, y.value - 1.0))
        return Dual(value, _each(_sum, moved, self._apply(y, lambda u: value, lambda u, f: f * self.ops.log(x.value))))

    def atan2(self, y, x):
        y, x = self.constant(y), self.constant(x)
        value, square = self.ops.atan2(y.value, x.value), x.value * x.value + y.value * y.value
        return Dual(value, _each(lambda d, e: _difference(_product(d, x.value / square), _product(e, y.value / square)), y, x))

    def look_up(self, x, c, order=0):
        return self._apply(x, lambda u: self.ops.look_up(u, c, order), lambda u, f: self.ops.look_up(u, c, order + 1))

    def look_up_2(self, x, y, c, order_x=0, order_y=0):
        x, y = self.constant(x), self.constant(y)

        def value(more_x, more_y):
            return self.ops.look_up_2(x.value, y.value, c, order_x + more_x, order_y + more_y)

        moved = self._apply(x, lambda u: value(0, 0), lambda u, f: value(1, 0))
        return Dual(moved.value, _each(_sum, moved, self._apply(y, lambda u: value(0, 0), lambda u, f: value(0, 1))))

    def sqrt(self, x):
        # At 0 the slope is infinite. Physical results do not depend on a root of 0, so 1 / tiny limits the slope.
        return self._apply(x, self.ops.sqrt, lambda u, f: 0.5 / self.ops.maximum(f, TINY))

    def sin(self, x):
        return self._apply(x, self.ops.sin, lambda u, f: self.ops.cos(u))

    def cos(self, x):
        return self._apply(x, self.ops.cos, lambda u, f: -self.ops.sin(u))

    def tanh(self, x):
        return self._apply(x, self.ops.tanh, lambda u, f: 1.0 - f * f)

    def _apply(self, x, function, slope):
        if not isinstance(x, Dual):
            return function(x)
        value = function(x.value)
        if all(d is None for d in x.tangents):
            return self.constant(value)
        factor = slope(x.value, value)
        return Dual(value, tuple(_product(d, factor) for d in x.tangents))


TINY = 1e-150
"""Smaller than any root of a physical quantity; its inverse is finite."""


def _dual(x: Any, like: Dual) -> Dual:
    return x if isinstance(x, Dual) else Dual(x, (None,) * len(like.tangents))


def _each(rule, x: Dual, y: Dual) -> tuple:
    return tuple(map(rule, x.tangents, y.tangents))


def _zero(d: Any) -> Any:
    return 0.0 if d is None else d


def _sum(d, e):
    return e if d is None else d if e is None else d + e


def _difference(d, e):
    return d if e is None else -e if d is None else d - e


def _product(d, factor):
    return None if d is None else d * factor


def _quotient(d, divisor):
    return None if d is None else d / divisor
