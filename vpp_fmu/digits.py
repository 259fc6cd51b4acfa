"""Numbers as text with significant digits, so that a rig of 1 N is shown as precisely as one of 200 N.

A fixed number of decimals suits quantities of the same scale on every rig: shares, correlations, times in a record.
"""

import math
from numbers import Integral, Real

DIGITS = 3
"""Significant digits in a sentence, title, legend or card: a thrust error is known to some per cent, a parameter to less."""

TABLE = 4
"""Significant digits in a table: the fourth still shows which of two values is smaller."""

UNCERTAINTY = 2
"""Significant digits of a standard deviation: from a hundred readings it is known to 7 %."""

MOST = 7
"""Digits of a value with almost no uncertainty, as from data without noise."""

LEAST_CHANCE = 1e-6
"""Smaller p-values are not shown: the tails of the distribution are not validated there."""

_MISSING = "–"


def number(value, digits: int = DIGITS) -> str:
    """A value with `digits` significant digits, and all those before the point; a missing value as a dash, text unchanged.

    Trailing zeros of exact values are dropped (0.5, 6000). Below 1e-3, and from 1e6 on, a power of ten is used.
    """
    if value is None or (isinstance(value, Real) and math.isnan(value)):
        return _MISSING
    if isinstance(value, (bool, Integral)) or not isinstance(value, Real):
        return str(value)
    if value == 0 or math.isinf(value):
        return {0.0: "0", math.inf: "∞"}.get(value, "−∞")
    rounded = float(f"{value:.{digits - 1}e}")
    exponent = math.floor(math.log10(abs(rounded)))
    if not -3 <= exponent < 6:
        text = f"{rounded:.{digits - 1}e}"
        return _short(text, value)
    return _short(f"{value:.0f}" if exponent >= digits else f"{rounded:.{digits - 1 - exponent}f}", value)


def signed(value, digits: int = DIGITS) -> str:
    """The same with the sign of positive values."""
    return f"{'+' if isinstance(value, Real) and value > 0 else ''}{number(value, digits)}"


def chance(p: float, equals: str = "") -> str:
    """A p-value; below LEAST_CHANCE only this bound."""
    return f"< {LEAST_CHANCE:.0e}".replace("e-0", "e-") if p < LEAST_CHANCE else f"{equals}{number(p, 2)}"


def with_uncertainty(value: float, half: float, unit: str = "") -> str:
    """A value and half of its interval, both to the last significant digit of the latter."""
    unit = unit and f" {unit}"
    if not 0.0 < half < math.inf or math.isnan(value):
        return f"{number(value)}{unit}"
    return f"{_to(value, half)} ± {_to(half, half)}{unit}"


def interval(low: float, high: float, unit: str = "") -> str:
    """Two ends, to the last significant digit of their distance."""
    unit = unit and f" {unit}"
    if not 0.0 < high - low < math.inf:
        return f"{number(low)}{unit}" if low == high else f"{number(low)} to {number(high)}{unit}"
    return f"{_to(low, high - low)} to {_to(high, high - low)}{unit}"


def _to(value: float, uncertainty: float) -> str:
    """The value to the last of UNCERTAINTY digits of its uncertainty, MOST digits in all."""
    last = math.floor(math.log10(float(f"{uncertainty:.{UNCERTAINTY - 1}e}"))) - UNCERTAINTY + 1
    size = math.floor(math.log10(abs(value))) if value else last
    last = max(last, size - MOST + 1)
    text = f"{value:.{max(0, -last)}f}" if -3 <= max(size, last) < 6 else f"{value:.{max(0, size - last)}e}"
    return text if float(text) else text.removeprefix("-")


def _short(text: str, value: float) -> str:
    """Without trailing zeros if the text equals the value: they would claim more digits than it has."""
    head, e, tail = text.partition("e")
    trimmed = head.rstrip("0").rstrip(".") if "." in head else head
    return f"{trimmed}{e}{tail}" if math.isclose(float(text), value, rel_tol=1e-9) else text
