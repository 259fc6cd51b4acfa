"""Interpolation in tables: binary search, linear or cubic pieces, and their derivatives. `tables.c` is the same text in C.

Cubic pieces are Hermite polynomials with the slopes of Fritsch and Butland (SIAM J. Sci. Stat. Comput. 5, 1984), as
in scipy's PchipInterpolator: where the points rise or fall, so does the curve, without overshoot. `look_up` and `look_up_2` do
the same arithmetic in the same order in both languages, since results are compared bit by bit. This file is part of a Python
FMU that has tables.
"""

from bisect import bisect_right
from itertools import pairwise
from typing import NamedTuple


class Curve(NamedTuple):
    """Points of a curve; `slopes` at them for cubic pieces, None for linear ones."""

    xs: tuple
    ys: tuple
    slopes: tuple | None


class Surface(NamedTuple):
    """A grid: zs row by row (a row for each of xs), then for cubic pieces the slopes in x, in y, and the mixed ones."""

    xs: tuple
    ys: tuple
    grid: tuple


KNOWN: dict = {}
"""Tables by their content: a step asks for the same ones again and again."""


def curve(xs, ys, method) -> Curve:
    """The points as a Curve. ValueError: invalid points or method."""
    return _known((_content(xs), _content(ys), method), lambda: _curve(_floats(xs), _floats(ys), _is_cubic(method)))


def surface(xs, ys, zs, method) -> Surface:
    """The grid as a Surface. ValueError: an invalid grid or method."""
    content = (_content(xs), _content(ys), tuple(map(_content, zs)), method)
    return _known(content, lambda: _surface(_floats(xs), _floats(ys), tuple(map(_floats, zs)), _is_cubic(method)))


def _known(content, make):
    if content not in KNOWN:
        if len(KNOWN) > 256:
            KNOWN.clear()
        KNOWN[content] = make()
    return KNOWN[content]


def _content(values):
    """What tells the values from others, at little cost for arrays of other libraries."""
    try:
        view = memoryview(values)
    except TypeError:
        return tuple(values)
    return view.format, view.tobytes()


def _floats(values):
    return tuple(map(float, values))


def _curve(xs, ys, cubic) -> Curve:
    _check(xs, len(ys), "ys")
    return Curve(xs, ys, _slopes(xs, ys) if cubic else None)


def _surface(xs, ys, rows, cubic) -> Surface:
    _check(xs, len(rows), "rows of zs")
    for row in rows:
        _check(ys, len(row), "columns of zs")
    grids = [rows]
    if cubic:
        along_x = _transposed([_slopes(xs, column) for column in _transposed(rows)])
        grids += [along_x, [_slopes(ys, row) for row in rows], [_slopes(ys, row) for row in along_x]]
    return Surface(xs, ys, tuple(z for grid in grids for row in grid for z in row))


def _is_cubic(method) -> bool:
    if method not in ("linear", "cubic"):
        raise ValueError(f"method of a table: found {method!r}, expected 'linear' or 'cubic'")
    return method == "cubic"


def _check(xs, n, what):
    if len(xs) < 2 or len(xs) != n:
        raise ValueError(f"table: found {len(xs)} points and {n} {what}, expected as many, and two at least")
    for before, after in pairwise(xs):
        if not before < after:
            raise ValueError(f"table: found {after} after {before}, expected points that rise")


def _transposed(rows):
    return list(zip(*rows, strict=True))


def _slopes(xs, ys):
    """Slopes that keep the curve monotone between points: weighted harmonic means inside, three-point formulas at the ends."""
    h = [b - a for a, b in pairwise(xs)]
    d = [(b - a) / width for (a, b), width in zip(pairwise(ys), h, strict=True)]
    if len(d) == 1:
        return (d[0], d[0])
    inside = []
    for h0, h1, d0, d1 in zip(h, h[1:], d, d[1:], strict=False):
        w0, w1 = h0 + 2.0 * h1, 2.0 * h0 + h1
        inside.append((w0 + w1) / (w0 / d0 + w1 / d1) if d0 * d1 > 0.0 else 0.0)
    return (_end(h[0], h[1], d[0], d[1]), *inside, _end(h[-1], h[-2], d[-1], d[-2]))


def _end(h0, h1, d0, d1):
    slope = ((2.0 * h0 + h1) * d0 - h0 * d1) / (h0 + h1)
    if slope * d0 <= 0.0:
        return 0.0
    return 3.0 * d0 if d0 * d1 < 0.0 and abs(slope) > 3.0 * abs(d0) else slope


def piece(d, h, y0, y1, m0, m1, cubic, order):
    """Derivative `order` of one piece of width h, d behind its left end."""
    rise = (y1 - y0) / h
    if not cubic:
        return y0 + d * rise if order == 0 else rise if order == 1 else 0.0
    c2 = (3.0 * rise - 2.0 * m0 - m1) / h
    c3 = (m0 + m1 - 2.0 * rise) / (h * h)
    if order == 0:
        return y0 + d * (m0 + d * (c2 + d * c3))
    if order == 1:
        return m0 + d * (2.0 * c2 + 3.0 * d * c3)
    return 2.0 * c2 + 6.0 * d * c3 if order == 2 else 6.0 * c3 if order == 3 else 0.0


def look_up(x, n, xs, ys, slopes, order):
    """Derivative `order` of a curve of n points at x."""
    if x < xs[0] or x > xs[n - 1]:
        return 0.0 if order else ys[0] if x < xs[0] else ys[n - 1]
    i = bisect_right(xs, x, 1, n - 1) - 1
    if slopes is None:
        return piece(x - xs[i], xs[i + 1] - xs[i], ys[i], ys[i + 1], 0.0, 0.0, False, order)
    return piece(x - xs[i], xs[i + 1] - xs[i], ys[i], ys[i + 1], slopes[i], slopes[i + 1], True, order)


def look_up_2(x, y, n, xs, m, ys, grid, order_x, order_y):
    """Derivative of a surface of n times m points at (x, y), of these orders in x and y."""
    if (order_x and (x < xs[0] or x > xs[n - 1])) or (order_y and (y < ys[0] or y > ys[m - 1])):
        return 0.0
    x = xs[0] if x < xs[0] else xs[n - 1] if x > xs[n - 1] else x
    y = ys[0] if y < ys[0] else ys[m - 1] if y > ys[m - 1] else y
    i, j = bisect_right(xs, x, 1, n - 1) - 1, bisect_right(ys, y, 1, m - 1) - 1
    cubic, size, d, h = len(grid) > n * m, n * m, y - ys[j], ys[j + 1] - ys[j]

    def across(row, first):
        """Along y in one row of the values or of their slopes in x."""
        at = first * size + row * m + j
        if not cubic:
            return piece(d, h, grid[at], grid[at + 1], 0.0, 0.0, False, order_y)
        return piece(d, h, grid[at], grid[at + 1], grid[at + 2 * size], grid[at + 2 * size + 1], True, order_y)

    y0, y1 = across(i, 0), across(i + 1, 0)
    m0, m1 = (across(i, 1), across(i + 1, 1)) if cubic else (0.0, 0.0)
    return piece(x - xs[i], xs[i + 1] - xs[i], y0, y1, m0, m1, cubic, order_x)
