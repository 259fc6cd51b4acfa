"""Exact solution of two coupled linear equations over a step with held inputs.

    x' = a11 x + a12 y + b1,   y' = a21 x + a22 y + b2

It is the closed form of the matrix exponential. Stiff circuits need no shorter steps: a fast mode decays to nothing.
"""

from typing import Any, NamedTuple

TINY = 1e-30
SAME = 1e-7
"""Two roots closer than this share of their size are separated by it; the error is its square."""


class Pair(NamedTuple):
    """Coefficients of the two equations; the matrix must be stable (trace < 0, determinant > 0)."""

    a11: Any
    a12: Any
    b1: Any
    a21: Any
    a22: Any
    b2: Any

    @property
    def determinant(self):
        return self.a11 * self.a22 - self.a12 * self.a21


def rest(pair: Pair) -> tuple[Any, Any]:
    """The equilibrium of both states."""
    d = pair.determinant
    return (pair.a12 * pair.b2 - pair.a22 * pair.b1) / d, (pair.a21 * pair.b1 - pair.a11 * pair.b2) / d


def moved(ops, pair: Pair, x, y, dt) -> tuple[Any, Any]:
    """The states after dt seconds."""
    x_rest, y_rest = rest(pair)
    kept, turned = _exponential(ops, pair, dt)
    p, q = x - x_rest, y - y_rest
    mean = 0.5 * (pair.a11 + pair.a22)
    return (
        x_rest + kept * p + turned * ((pair.a11 - mean) * p + pair.a12 * q),
        y_rest + kept * q + turned * (pair.a21 * p + (pair.a22 - mean) * q),
    )


def integrals(pair: Pair, before: tuple, after: tuple, dt) -> tuple[Any, Any]:
    """Integrals of both states over the step that led from `before` to `after`: from x' = A x + b, divided by A."""
    x_rest, y_rest = rest(pair)
    p, q, d = after[0] - before[0], after[1] - before[1], pair.determinant
    return x_rest * dt + (pair.a22 * p - pair.a12 * q) / d, y_rest * dt + (pair.a11 * q - pair.a21 * p) / d


def _exponential(ops, pair: Pair, dt):
    """(c, s) with exp(A dt) = c I + s (A - m I), m half of the trace; real or complex eigenvalues."""
    m, d = 0.5 * (pair.a11 + pair.a22), pair.determinant
    split = m * m - d
    apart = split > 0.0
    r = ops.sqrt(ops.maximum(ops.abs(split), SAME * SAME * d + TINY))
    # The slow root as a quotient: m + r would lose its digits if the roots are far apart.
    fast = m - r
    slow = ops.where(apart, d / fast, m)
    left, gone = ops.exp(slow * dt), ops.expm1(-2.0 * ops.where(apart, r, 0.0) * dt)
    swung = ops.exp(m * dt)
    kept = ops.where(apart, left * (1.0 + 0.5 * gone), swung * ops.cos(r * dt))
    turned = ops.where(apart, -0.5 * left * gone / r, swung * ops.sin(r * dt) / r)
    return kept, turned
