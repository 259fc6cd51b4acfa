"""How good a prediction is, and what limits it."""

import numpy as np

from vpp_fmu.record import Record


def rmse(error: np.ndarray) -> float:
    """Root mean square of an error (rows,), rows without a value left out; its unit."""
    seen = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(seen**2)))


def fit_percent(measured: np.ndarray, predicted: np.ndarray) -> float:
    """100 (1 - |measured - predicted| / |measured - its mean|) in %, as MATLAB's `compare`; NaN for a constant."""
    seen = np.isfinite(measured)
    y = measured[seen]
    spread = float(np.sqrt(np.mean((y - y.mean()) ** 2)))
    return 100.0 * (1.0 - rmse(y - predicted[seen]) / spread) if spread > 0 else float("nan")


def noise_floor(record: Record, repeat: Record, name: str = "thrust") -> float:
    """Standard deviation of one reading's noise, from two records of the same commands: their difference over sqrt 2."""
    return rmse(record[name] - repeat[name]) / np.sqrt(2.0)
