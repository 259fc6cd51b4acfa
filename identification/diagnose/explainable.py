"""How much of an error could be explained at all, and how much of that is.

What two records of the same commands share beyond the model is the model's error, whatever the noise is: the mean product
of their residuals needs no noise level. It is taken from means over EXPLAINABLE seconds: above that band the rotor's own
vibration repeats too. On a record without a repeat the noise's power is taken off instead.
"""

import numpy as np

from identification.diagnose.noise import Blocks, blocks
from vpp_fmu.record import Record

BAND = 0.05
"""Means over this many seconds: errors below 10 Hz."""


def shared_power(first: Record, second: Record, predicted: np.ndarray) -> tuple[float, float]:
    """(mean product [N^2] of two records' residuals below 10 Hz, its standard error), `predicted` thrust (rows,) N.

    The standard error is from batches of 2 s, whose products are nearly independent.
    """
    at = blocks(first, BAND)
    product = (predicted_less(at, predicted, first) * predicted_less(at, predicted, second)).astype(float)
    size = max(1, round(2.0 / BAND))
    product = product[np.isfinite(product)]
    batches = product[: len(product) // size * size].reshape(-1, size).mean(axis=1)
    return float(product.mean()), float(batches.std(ddof=1) / np.sqrt(len(batches)))


def predicted_less(at: Blocks, predicted: np.ndarray, record: Record) -> np.ndarray:
    """Block means (blocks,) N of predicted less measured thrust."""
    return at.mean(predicted - record["thrust"])


def noise_power(first: Record, second: Record) -> float:
    """Power [N^2] of one record's noise below 10 Hz, from two records of the same commands."""
    difference = blocks(first, BAND).mean(first["thrust"] - second["thrust"])
    return 0.5 * float(np.nanmean(difference**2))


def error_power(record: Record, predicted: np.ndarray) -> float:
    """Power [N^2] below 10 Hz of a prediction's error, noise included."""
    return float(np.nanmean(predicted_less(blocks(record, BAND), predicted, record) ** 2))
