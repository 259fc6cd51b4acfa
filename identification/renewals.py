"""How often the measured speed is renewed, which distinguishes kinds of sensors: a mark gives a new value each part of a
revolution, a telemetry at fixed intervals, an encoder in each row.
"""

import numpy as np
from scipy.stats import binom

from vpp_fmu.record import Record
from vpp_fmu.sensors import ENCODER, MARK, TELEMETRY

FAST = 3.0
"""Minimum difference of two successive values of a changing speed, in digits."""

LEAST_CHANGE, MOVING = 0.05, 0.75
"""Quantiles of the changes between values: one digit; the change from which the speed moves."""

STRAY = 0.01
"""Share of renewal intervals (rows between two new values) that may have any length."""

STRAYS = {MARK: 0.1, ENCODER: 0.1, TELEMETRY: STRAY}
"""Share of renewal intervals that a kind need not explain: a rotor turns unevenly, a clock does not."""

HELD, MIXED = 0.1, 0.25
"""Rows are means if more than the first share of values are held for three rows and longer, and more than the second share of
those are followed by a mixed row: of means over two instants, half the pulses fall between them."""

UNLIKELY = 0.01
"""Level of the test that a kind explains the renewal intervals."""


def renewals(record: Record) -> tuple[np.ndarray, np.ndarray, bool]:
    """((intervals,) renewal intervals of the speed in rows, (intervals,) rows per revolution, whether rows mix two values).

    Only values that differ from the previous one by at least FAST digits, and more than most do, are used: equal values between
    them are then held values. A digit is constant, or, for a timed period, proportional to the square of the speed. Readings
    that are means over their row mix two values in the row between them, which is not counted."""
    shown = np.where(np.isfinite(record["omega"]), record["omega"], 0.0)
    changes = np.append(0.0, np.abs(np.diff(shown)))
    new = np.flatnonzero((changes > 0.0) & (shown > 0.0))
    if len(new) < 3:
        return np.zeros(0), np.zeros(0), False
    square = shown[new] ** 2
    digits = [np.quantile(changes[new] / scale, LEAST_CHANGE) * scale for scale in (1.0, square)]
    clear = changes[new] >= np.maximum(FAST * np.maximum(*digits), np.quantile(changes[new], MOVING))
    gaps, moving = np.diff(new), clear[1:] & clear[:-1]
    held = (gaps >= 3) & moving
    mixed = bool(held.sum() > HELD * moving.sum() and np.mean(gaps[1:][held[:-1]] == 1) > MIXED)
    if mixed:
        counts = np.append(gaps > 1, True)
        clear |= np.append(False, clear[:-1] & ~counts[:-1])
        new, clear = new[counts], clear[counts]
    kept = clear[1:] & clear[:-1]
    return np.diff(new)[kept], 60.0 / (shown[new[1:]][kept] * record.period), mixed


def renewal_score(rows: np.ndarray, *expected: np.ndarray | float) -> float:
    """Log-likelihood of renewal intervals (n,), in whole rows, for one of the `expected` intervals at unknown phase."""
    explained = np.mean([np.maximum(1.0 - np.abs(rows - np.maximum(each, 1.0)), 0.0) for each in expected], axis=0)
    return float(np.sum(np.log(np.maximum(explained, STRAY))))


def unexplained(kind: str, rows: np.ndarray, *expected: np.ndarray | float) -> bool:
    """Whether more renewal intervals (n,), in whole rows, than STRAYS of a kind differ from all the `expected` ones, by a
    binomial test. No phase explains a difference of one row."""
    strays = np.all([np.abs(rows - np.maximum(each, 1.0)) >= 1.0 for each in expected], axis=0)
    return bool(len(rows)) and float(binom.sf(np.sum(strays) - 1, len(rows), STRAYS[kind])) < UNLIKELY
