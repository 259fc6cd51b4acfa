"""How much of an error could be explained at all, and how much of that is.

What two records of the same commands share beyond the model is the model's error, whatever the noise is: the mean product
of their residuals needs no noise level. It is taken from means over EXPLAINABLE seconds: above that band the rotor's own
vibration repeats too. On a record without a repeat the noise's power is taken off instead.
"""

import numpy as np

from identification.diagnose.noise import BAND, Blocks, blocks
from identification.fit.tachometer import Tachometer
from vpp_fmu.record import Record


def shared_power(first: Record, second: Record, predicted: np.ndarray) -> float:
    """Mean product [N^2] of two records' residuals below 10 Hz, `predicted` thrust (rows,) N."""
    at = blocks(first, BAND)
    return float(np.nanmean(predicted_less(at, predicted, first) * predicted_less(at, predicted, second)))


def shared_speed(first: Record, second: Record, predicted: np.ndarray) -> float:
    """Mean product of two records' speed residuals below 10 Hz, over the power of their noise.

    `predicted` speed (rows,) rpm. Residuals are in units of what the tachometer can tell; where both records show the same
    to the last digit, that is all the noise there is.
    """
    edges = np.arange(0.0, first.time[-1] + BAND, BAND)
    means = []
    for record in (first, second):
        seen = Tachometer(record)
        residual = (seen.shows(predicted) - seen.measured) / seen.std
        block = np.digitize(record.time[seen.rows], edges) - 1
        count = np.bincount(block, minlength=len(edges))
        with np.errstate(invalid="ignore"):
            means.append(np.bincount(block, residual, len(edges)) / count)
    one, other = means
    noise = 0.5 * float(np.nanmean((one - other) ** 2)) * float(count[count > 0].mean())
    return float(np.nanmean(one * other)) / (noise or 1.0)


def predicted_less(at: Blocks, predicted: np.ndarray, record: Record) -> np.ndarray:
    """Block means (blocks,) N of predicted less measured thrust."""
    return at.mean(predicted - record["thrust"])


def slow_residual(record: Record, predicted: np.ndarray) -> np.ndarray:
    """Predicted less measured thrust [N] below 10 Hz, (blocks,); blocks without a reading left out."""
    residual = predicted_less(blocks(record, BAND), predicted, record)
    return residual[np.isfinite(residual)]
