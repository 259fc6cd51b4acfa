"""Measures of prediction error."""

import numpy as np


def rmse(error: np.ndarray) -> float | None:
    """Root mean square of an error (rows,) without NaN, in its unit; None without a value."""
    seen = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(seen**2))) if len(seen) else None


def fit_percent(measured: np.ndarray, predicted: np.ndarray) -> float | None:
    """100 (1 - |measured - predicted| / |measured - its mean|) in %, as MATLAB's `compare`; None for a constant."""
    seen = np.isfinite(measured)
    y = measured[seen]
    spread = float(np.sqrt(np.mean((y - y.mean()) ** 2))) if len(y) else 0.0
    return 100.0 * (1.0 - rmse(y - predicted[seen]) / spread) if spread > 0 else None
