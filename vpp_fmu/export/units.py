"""Unit strings as FMI 2.0 writes them: factors and exponents of the SI base units."""

from math import pi
from xml.etree.ElementTree import Element, SubElement

SIMPLE = {
    "1": (1.0, {}),
    "s": (1.0, {"s": 1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "A": (1.0, {"A": 1}),
    "Hz": (1.0, {"s": -1}),
    "rad": (1.0, {"rad": 1}),
    "deg": (pi / 180.0, {"rad": 1}),
    "rpm": (2.0 * pi / 60.0, {"rad": 1, "s": -1}),
}
BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def base(unit: str) -> tuple[float, dict[str, int]]:
    """(factor, exponents by base unit) of a product of simple units such as `rpm.s/deg`; KeyError for an unknown one."""
    factor, exponents = 1.0, {}
    above, *below = unit.split("/")
    for sign, names in ((1, above.split(".")), *((-1, part.split(".")) for part in below)):
        for name in names:
            one, powers = SIMPLE[name]
            factor = factor * one if sign > 0 else factor / one
            for symbol, power in powers.items():
                exponents[symbol] = exponents.get(symbol, 0) + sign * power
    return factor, {symbol: exponents[symbol] for symbol in BASE if exponents.get(symbol)}


def definitions(units: set[str]) -> Element:
    """The `UnitDefinitions` of a model description, in alphabetical order."""
    root = Element("UnitDefinitions")
    for unit in sorted(units):
        factor, exponents = base(unit)
        attributes = {symbol: str(power) for symbol, power in exponents.items()}
        if factor != 1.0:
            attributes["factor"] = repr(factor)
        SubElement(SubElement(root, "Unit", name=unit), "BaseUnit", attributes)
    return root
