"""Values less what their past tells of them: compiled where there is a compiler, else by numpy; the same bits.

A search filters tens of thousands of columns: numpy goes through memory twice for each span of the past, the compiled loop
once in all.
"""

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files

import numpy as np

from vpp_fmu.errors import CompilerMissing
from vpp_fmu.native.compiler import compiled


def less_past(values: np.ndarray, spans: Sequence[tuple[int, int]], factors: Sequence[float], scale: float) -> np.ndarray:
    """(rows - order, ...): values (rows,) or (rows, k), finite, over `scale`, less for each of the `spans` (first, last) its
    factor times the sum over so many rows before; `order` is the longest."""
    order = max((last for _, last in spans), default=0)
    values = np.ascontiguousarray(values, float)
    return (_compiled() or by_numpy)(values, order, spans, factors, scale)


def by_numpy(values: np.ndarray, order: int, spans, factors, scale: float) -> np.ndarray:
    """The same without a compiler."""
    n, sums, left, part = len(values), None, values[order:] / scale, np.empty_like(values[order:])
    for (first, last), factor in zip(spans, factors, strict=True):
        if first == last:
            past = values[order - first : n - first]
        else:
            if sums is None:
                sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
            past = np.subtract(sums[order - first + 1 : n - first + 1], sums[order - last : n - last], out=part)
        left -= np.multiply(past, factor, out=part)
    return left


@cache
def _compiled() -> Callable | None:
    """The same by C; None where there is no compiler."""
    try:
        library = compiled((files("identification.fit") / "past.c").read_text())
    except CompilerMissing:
        return None
    run, count, array = library.less_past, ctypes.c_long, ctypes.c_void_p
    run.argtypes = [array, count, count, count, count, array, array, ctypes.c_double, array, array]
    run.restype = None

    def by_c(values: np.ndarray, order: int, spans, factors, scale: float) -> np.ndarray:
        n, k = len(values), values[:1].size
        left, summed = np.empty((n - order, *values.shape[1:])), any(first != last for first, last in spans)
        ends, by = np.array(spans, ctypes.c_long).reshape(-1, 2), np.array(factors, float)
        sums = np.empty((n + 1) * k if summed else 0)
        at = [each.ctypes.data for each in (values, ends, by, sums, left)]
        run(at[0], n, k, order, len(spans), at[1], at[2], scale, at[3] if summed else None, at[4])
        return left

    return by_c
