"""Quantities of a log's columns, and the factor from a log's unit, as parsed by pint, to a record's.

    value in a record = factor * value in the log

A unit may include a number: "4 ms" per row, "-1 N" for a load cell of opposite sign, "0.0123 N" per digit. "erpm/7" is the
electrical speed [rpm] of a motor with 7 pole pairs, "100 erpm/7" the same in hundreds. "us@1000=-5,2000=10" is a linear
calibration by two points: raw readings in us, and the values there in the record's unit:

    value in a record = factor * value in the log + offset
"""

import re
import tokenize
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pint

from vpp_fmu.units import registry


@dataclass(frozen=True)
class Quantity:
    """A quantity of a column: its `unit` in a record and its meaning. `turning`: Hz and 1/min are turns per time; `force`:
    grams and pounds are units of weight."""

    name: str
    unit: str
    meaning: str
    turning: bool = False
    force: bool = False


QUANTITIES = {
    q.name: q
    for q in (
        Quantity("time", "s", "time of a row"),
        Quantity("omega_ref", "rpm", "commanded speed", turning=True),
        Quantity("beta_ref", "deg", "commanded pitch"),
        Quantity("omega", "rpm", "measured speed", turning=True),
        Quantity("thrust", "N", "measured thrust", force=True),
        Quantity("beta", "deg", "measured pitch"),
        Quantity("voltage", "V", "supply voltage"),
        Quantity("current", "A", "supply current"),
        Quantity("torque", "N.m", "torque of the rotor"),
        Quantity("power", "W", "electrical power"),
        Quantity("signal", "", "signal to the motor's controller: us, % or 1, in the place of omega_ref"),
        Quantity("run", "", "number of a step's run"),
        Quantity("thrust_std", "N", "spread of the readings of a mean", force=True),
        Quantity("samples", "", "readings in a mean"),
    )
}
"""All quantities of a mapping, by name."""

_NO = (pint.errors.PintError, ValueError, TypeError, AttributeError, LookupError, ArithmeticError, SyntaxError, AssertionError)
_NO += (RecursionError, tokenize.TokenError)
"""Errors by which pint's parser of expressions rejects a text that is not a unit."""

_ELECTRICAL = re.compile(r"(?i)(\d*)\s*e[-_ ]?rpm\s*/\s*([1-9]\d*)")

_NEWTON_METRES = re.compile(r"N([cm]?m)\b")
"""As people write it: Nm, Ncm, mNm."""

_SPELLINGS = {
    "deg": "grad grads grade grados gradi º",
    "rpm": "upm umdr/min umdr./min tr/min tr/mn giri/min r.p.m. rev./min",
    "g": "gr grs gm gms",
    "A": "amp amps",
    "N*m": "n-m newton-metre newton-meter",
    "ft*lbf": "ft-lb ft-lbf lb-ft lbf-ft ft.lb",
    "inch*lbf": "in-lb in-lbf lb-in lbf-in",
    "inch*ozf": "in-oz oz-in ozf-in",
}
_SPELLED = {text: unit for unit, texts in _SPELLINGS.items() for text in texts.split()}
"""Units as people write them, in lower case, that pint does not know or takes for another: grad is no gon, gr no grain."""

_POINT = r"\s*([-+]?[\d.]+(?:e[-+]?\d+)?)\s*"
_CALIBRATION = re.compile(rf"(?i)([^@]*)@{_POINT}={_POINT},{_POINT}={_POINT}")

SIGNALS = {"us": "PWM", "%": "throttle", "1": "throttle", "": "DShot"}
"""Kind of a motor's signal by its unit."""


def factor_of(quantity: Quantity, unit: str) -> float | None:
    """The factor from a unit to the quantity's own; None if pint does not know the unit or its dimension differs.

    The text is tried as written, then in lower case: RPM is rpm, but MN is not mN.
    """
    if quantity.name == "signal":
        return _signal_factor(unit)
    if not quantity.unit:
        return 1.0 if unit.strip() in ("", "1", "-") else None
    if quantity.turning and (electrical := _ELECTRICAL.fullmatch(unit.strip())):
        return int(electrical[1] or 1) / int(electrical[2])
    unit = _NEWTON_METRES.sub(r"N \1", unit) if quantity.name == "torque" else unit
    for text in dict.fromkeys((unit.strip(), unit.strip().lower())):
        found = _parsed(text)
        if found is not None and (factor := _factor(quantity, found)) is not None:
            return factor
    return None


def scale_of(quantity: Quantity, unit: str) -> tuple[float, float] | None:
    """(factor, offset) from a unit or a calibration to the quantity's own unit; None if it is neither."""
    found = _CALIBRATION.fullmatch(unit.strip())
    if found is None:
        factor = factor_of(quantity, unit)
        return None if factor is None else (factor, 0.0)
    try:
        raw, value, other_raw, other = map(float, found.groups()[1:])
    except ValueError:
        return None
    if raw == other_raw or value == other or not quantity.unit or quantity.name == "time":
        return None
    factor = (other - value) / (other_raw - raw)
    return factor, value - factor * raw


def contradicts(quantity: Quantity, given: str, header: str) -> bool:
    """Whether the unit given by a user for a column contradicts the unit in the log's header.

    A number in the given unit is the user's scale: "-1 gf" agrees with gf, "0.0123 N" with V, but "1000 N" not with gf.
    """
    if found := _CALIBRATION.fullmatch(given.strip()):
        pair = _known(quantity, found[1].strip()), _known(quantity, header)
        return None not in pair and pair[0].units != pair[1].units
    if quantity.name == "signal":
        return signal_unit(header) not in (None, signal_unit(given))
    electrical = quantity.turning and _ELECTRICAL.fullmatch(given.strip())
    mine, theirs = _known(quantity, "rpm" if electrical else given), _known(quantity, header)
    if mine is None or theirs is None:
        return False
    expected = _factor(quantity, 1.0 * theirs.units)
    if expected is None:
        return float(mine.magnitude) == 1.0
    return not np.isclose(_factor(quantity, 1.0 * mine.units), expected, rtol=1e-6)


def is_rate(text: str) -> bool:
    """Whether a unit is per time, such as deg/s."""
    found = _parsed(text.strip())
    return found is not None and found.units.dimensionality.get("[time]", 0) == -1


def is_unit(text: str) -> bool:
    """Whether pint knows a unit, of any dimension."""
    return text == "%" or _parsed(text.strip()) is not None or _parsed(text.strip().lower()) is not None


def signal_unit(unit: str) -> str | None:
    """The unit of a motor's signal as in SIGNALS: us, %, 1, or "" for DShot; None for any other."""
    text = unit.strip()
    if text in ("%", "1", ""):
        return text
    if text.lower() in ("percent", "pct"):
        return "%"
    found = _parsed(text)
    return "us" if found is not None and found.is_compatible_with("us") else None


def _signal_factor(unit: str) -> float | None:
    kind = signal_unit(unit)
    if kind is None:
        return None
    return float(_parsed(unit.strip()).to("us").magnitude) if kind == "us" else {"%": 0.01}.get(kind, 1.0)


def _factor(quantity: Quantity, found: pint.Quantity) -> float | None:
    units = registry()
    if quantity.force and found.check("[mass]"):
        found = found * units.standard_gravity
    if quantity.turning and found.check("1/[time]") and "radian" not in found.to_base_units().units._units:
        found = found * units.turn
    if found.dimensionless and "radian" not in found.to_base_units().units._units:
        return None  # pint reads a bare number as radians
    try:
        factor = float(found.to(quantity.unit).magnitude)
    except pint.errors.PintError:
        return None
    return factor if factor else None


def _known(quantity: Quantity, text: str) -> pint.Quantity | None:
    """A unit as pint parses it, preferably one of the quantity's dimension."""
    found = [f for t in dict.fromkeys((text.strip(), text.strip().lower())) if (f := _parsed(t)) is not None]
    return next((f for f in found if _factor(quantity, f) is not None), found[0] if found else None)


@lru_cache(maxsize=512)
def _parsed(text: str) -> pint.Quantity | None:
    number, unit = re.fullmatch(r"(?s)\s*([-+]?[\d.]*(?:[eE][-+]?\d+)?)\s*(.*?)\s*", text).groups()
    text = f"{number} {_SPELLED[unit.casefold()]}".strip() if unit.casefold() in _SPELLED else text
    if len(text) > 40 or not re.search(r"[^\W\d_]|[°%]", text) or re.search(r"[\d)]\s*(\*\*|\^)", text):
        return None  # a power of a number is not a unit, and pint would never finish 9**9**9
    try:
        return registry().Quantity(registry().parse_expression(re.sub(r"(?<=[A-Za-z])(-\d)", r"^\1", text)))
    except _NO:
        return None
