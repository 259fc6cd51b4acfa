"""Unit strings as FMI 2.0 and SSP 1.0 write them: factors and exponents of the SI base units."""

import math

_SYMBOLS: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "s": (1.0, {"s": 1}),
    "Hz": (1.0, {"s": -1}),
    "rad": (1.0, {"rad": 1}),
    "deg": (math.pi / 180.0, {"rad": 1}),
    "rpm": (2.0 * math.pi / 60.0, {"rad": 1, "s": -1}),
    "m": (1.0, {"m": 1}),
    "kg": (1.0, {"kg": 1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "A": (1.0, {"A": 1}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "Ohm": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "H": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}),
}


def base_unit(unit: str) -> dict[str, str]:
    """A unit such as "rpm.s/deg" as the attributes of a BaseUnit in SSP and FMI: SI exponents and factor.

    A point multiplies, a slash divides by the product behind it. KeyError names a symbol that is not known.
    """
    factor, exponents = 1.0, dict.fromkeys(("kg", "m", "s", "A", "rad"), 0)
    above, *below = unit.split("/")
    for sign, product in ((1, above), *((-1, product) for product in below)):
        for symbol in product.split("."):
            scale, powers = _SYMBOLS[symbol]
            factor = factor * scale if sign > 0 else factor / scale
            for base, power in powers.items():
                exponents[base] += sign * power
    attributes = {base: str(power) for base, power in exponents.items() if power}
    return attributes if factor == 1.0 else {**attributes, "factor": repr(factor)}
