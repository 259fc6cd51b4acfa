"""Residuals of an autoregressive prediction: in C if there is a compiler, else in numpy, with the same bits.

A search filters tens of thousands of columns. Numpy reads memory twice for each span of the filter, the compiled loop once.
"""

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files

import numpy as np

from vpp_fmu.errors import CompilerMissing
from vpp_fmu.native.compiler import compiled


def ar_residuals(values: np.ndarray, spans: Sequence[tuple[int, int]], factors: Sequence[float], scale: float) -> np.ndarray:
    """(rows - order, ...): values (rows,) or (rows, k), finite, divided by `scale`. For each of the `spans` of lags
    (first, last), its factor times the sum over these earlier rows is subtracted. `order` is the longest lag."""
    order = max((last for _, last in spans), default=0)
    values = np.ascontiguousarray(values, float)
    return (_compiled() or by_numpy)(values, order, spans, factors, scale)


def by_numpy(values: np.ndarray, order: int, spans, factors, scale: float) -> np.ndarray:
    """The same in numpy."""
    n, sums, residuals, part = len(values), None, values[order:] / scale, np.empty_like(values[order:])
    for (first, last), factor in zip(spans, factors, strict=True):
        if first == last:
            earlier = values[order - first : n - first]
        else:
            if sums is None:
                sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
            earlier = np.subtract(sums[order - first + 1 : n - first + 1], sums[order - last : n - last], out=part)
        residuals -= np.multiply(earlier, factor, out=part)
    return residuals


@cache
def _compiled() -> Callable | None:
    """The same in C; None without a compiler."""
    try:
        library = compiled((files("identification.fit") / "ar_filter.c").read_text())
    except CompilerMissing:
        return None
    run, count, array = library.ar_residuals, ctypes.c_long, ctypes.c_void_p
    run.argtypes = [array, count, count, count, count, array, array, ctypes.c_double, array, array]
    run.restype = None

    def by_c(values: np.ndarray, order: int, spans, factors, scale: float) -> np.ndarray:
        n, k = len(values), values[:1].size
        residuals, summed = np.empty((n - order, *values.shape[1:])), any(first != last for first, last in spans)
        ends, by = np.array(spans, ctypes.c_long).reshape(-1, 2), np.array(factors, float)
        sums = np.empty((n + 1) * k if summed else 0)
        at = [each.ctypes.data for each in (values, ends, by, sums, residuals)]
        run(at[0], n, k, order, len(spans), at[1], at[2], scale, at[3] if summed else None, at[4])
        return residuals

    return by_c
