"""Commands that a rig may receive: within its ranges and slew rates, rounded to readable numbers.

Commands are arrays (rows, 2) of speed [rpm] and pitch [deg], each row held for one step. All commands that a verb writes or
sends come from `commanded`.
"""

from math import floor, inf, isfinite, log10

import numpy as np

from vpp_fmu.rig import Rig

FINE = 1e-4
"""Commands are rounded to the power of ten below this share of their range: 0.1 of 4000 rpm, 0.001 of 15 deg."""

DIGITS = 9
"""Significant digits that a record's file keeps: a command must not need more."""


def ends(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """(lowest, highest) speed and pitch, each (2,)."""
    return tuple(np.array(end, float) for end in zip(rig.speed, rig.pitch, strict=True))


def commanded(rig: Rig, targets: np.ndarray, step: float) -> np.ndarray:
    """Commands (rows, 2) that follow `targets` (rows, 2) at the maximum slew rate, a row every `step` seconds, from the first
    target on. Ends of a range that are no round numbers are approached to within FINE; a range of one value is exact."""
    slews = rig.speed_slew, rig.pitch_slew
    columns = zip(np.asarray(targets, float).T, *ends(rig), slews, strict=True)
    return np.column_stack([_followed(column, low, high, slew * step) for column, low, high, slew in columns])


def _followed(targets: np.ndarray, low: float, high: float, largest: float) -> np.ndarray:
    """Commands of one channel, with changes of at most `largest` per row.

    They are computed in whole units of the last digit, because rounding errors of decimals add up beyond a limit.
    """
    unit = 10.0 ** _decimals(low, high, largest)
    lowest, highest = _first_from(low, unit), -_first_from(-high, unit)
    if not low < high or lowest > highest:
        return np.full(len(targets), low)
    wanted = np.rint(np.clip(targets, low, high) * unit).clip(lowest, highest).astype(int)
    if isfinite(largest):
        most = -_first_from(-largest, unit)
        at, reached = int(wanted[0]), []
        for target in wanted.tolist():
            at += min(max(target - at, -most), most)
            reached.append(at)
        wanted = np.array(reached)
    return wanted / unit


def _decimals(low: float, high: float, largest: float) -> int:
    """Number of decimals of a command of this range that may change by `largest` per row: `largest` is met to a hundredth,
    and a file keeps all of them."""
    most = DIGITS - 1 - max(0, floor(log10(max(abs(low), abs(high), 1.0))))
    span = high - low
    wanted = -floor(log10(FINE * span)) if span > 0.0 else 0
    if 0.0 < largest < inf:
        wanted = max(wanted, 2 - floor(log10(largest)))
    return min(max(wanted, 0), most)


def _first_from(value: float, unit: float) -> int:
    """The smallest whole number of units that, written as a decimal, is at least a value."""
    count = round(value * unit)
    return count if count / unit >= value else count + 1


def idle(rig: Rig) -> tuple[float, float]:
    """Commands [rpm, deg] that a loop begins from: the lowest speed, and the pitch next to 0."""
    (omega, beta), *_ = commanded(rig, np.array([[rig.speed[0], 0.0]]), inf).tolist()
    return omega, beta
