"""Units as FMI and SSP write them: exponents of the SI base units, factor and offset; and units for display.

A unit is text such as "rpm.s/deg": a point multiplies, a slash divides by the product behind it, a digit behind a symbol is
its power. pint defines the symbols.
"""

import importlib
import re
from functools import cache
from tokenize import TokenError

from vpp_fmu.errors import BadInput

BASE = {
    "kilogram": "kg",
    "meter": "m",
    "second": "s",
    "ampere": "A",
    "kelvin": "K",
    "mole": "mol",
    "candela": "cd",
    "radian": "rad",
}
"""The base units that FMI 2.0, FMI 3.0 and SSP 1.0 know, by pint's names."""

SHOWN = {"s": ("ms",), "rpm": ("rad/s",), "rad/s": ("rpm",), "deg": ("rad",), "rad": ("deg",), "N": ("gf", "kgf")}
"""Other units in which tools may show a value."""

TRIED = (
    "1, s, ms, Hz, rad, deg, rpm, m, mm, kg, g, N, A, V, W, Ohm, K, degC, Pa, bar, J, %, and products such as N.m/rad or m/s2"
)
"""Examples of valid units, for messages."""


class UnknownUnit(ValueError):
    """No unit, or one that FMI's base units cannot express; the message says why."""


def base_unit(unit: str) -> dict[str, str]:
    """The attributes of a BaseUnit: `base = factor * value + offset`. UnknownUnit."""
    factor, offset, exponents = _in_base_units(unit)
    attributes = {base: str(power) for base, power in exponents.items()}
    attributes |= {} if factor == 1.0 else {"factor": repr(factor)}
    return attributes | ({} if offset == 0.0 else {"offset": repr(offset)})


def check_unit(where: object, field: str, unit: str) -> None:
    """BadInput for a unit that FMI cannot express: where it is declared, and in which field."""
    try:
        base_unit(unit)
    except UnknownUnit as error:
        raise BadInput(where, field, str(error), TRIED) from error


def display_units(unit: str) -> dict[str, dict[str, str]]:
    """The attributes of each DisplayUnit by name: `shown = factor * value`."""
    factor = _in_base_units(unit)[0]
    return {shown: {"factor": repr(factor / _in_base_units(shown)[0])} for shown in SHOWN.get(unit, ())}


PINTS_ERRORS = (AttributeError, AssertionError, ValueError, TypeError, SyntaxError, ArithmeticError, TokenError)
"""What pint raises for a text that is no unit; its own exceptions are among them."""


@cache
def _in_base_units(unit: str) -> tuple[float, float, dict[str, int]]:
    text, units = _pints(unit), registry()
    try:
        quantities = [units.Quantity(x, text).to_base_units() for x in (0.0, 1.0, 2.0)]
    except PINTS_ERRORS as error:
        raise UnknownUnit(f"{unit!r} is no unit that pint knows") from error
    zero, one, two = (float(quantity.magnitude) for quantity in quantities)
    if abs((two - one) - (one - zero)) > 1e-9 * abs(one - zero):
        raise UnknownUnit(f"{unit!r} is not proportional to a base unit")
    found = {}
    for name, power in quantities[1]._units.items():
        if name not in BASE:
            raise UnknownUnit(f"{unit!r} is in {name}, FMI's base units are {', '.join(BASE.values())}")
        if power != round(power):
            raise UnknownUnit(f"{unit!r} has the power {power:g} of {BASE[name]}, FMI has whole ones")
        found[BASE[name]] = round(power)
    ordered = {base: found[base] for base in BASE.values() if base in found}
    return one - zero, zero, ordered


@cache
def registry():
    """The units of pint, with Ohm as FMI writes it, and r, rev and the U of German nameplates for a turn."""
    pint = importlib.import_module("pint")  # takes half a second, so it is imported on first use
    found = pint.UnitRegistry(autoconvert_offset_to_baseunit=True, on_redefinition="ignore")
    found.define("@alias ohm = Ohm")
    found.define("@alias turn = rev = r = U")
    return found


def _pints(unit: str) -> str:
    """The unit as pint writes it."""
    if not re.fullmatch(r"[^\s./*^()]+([./][^\s./*^()]+)*", unit):
        raise UnknownUnit(f"{unit!r} is not written as in N.m/rad")
    above, *below = unit.split("/")
    products = ["*".join(map(_power, product.split("."))) for product in (above, *below)]
    return " / ".join([products[0], *(f"({product})" for product in products[1:])])


def _power(symbol: str) -> str:
    """`m2` as a power; `1` stays."""
    found = re.fullmatch(r"(\D+?)(-?\d+)", symbol)
    return f"{found[1]}**({found[2]})" if found else "percent" if symbol == "%" else symbol
