"""Findings as sentences: the first line of a verb and the first screen of its report, plain text in ASCII."""

import math
import re
from collections.abc import Mapping, Sequence

from vpp_fmu.digits import number
from vpp_fmu.kernel.types import Effect, Parameter


def size(value: float | None, unit: str = "1") -> str:
    """A value with its unit."""
    return f"{number(value)} {unit}".removesuffix(" 1")


def change(before: float | None, after: float | None, unit: str) -> str:
    """A value before and after: "0.182 -> 0.132 N"."""
    return f"{number(before)} -> {size(after, unit)}"


def clause(effect: Effect, values: Mapping[str, float]) -> str:
    """An effect in words with its sizes; `values`: parameters by full name."""
    if not effect.says:
        return effect.description
    return effect.says.format_map({p.name: limited(p, values[effect.full(p.name)]) for p in effect.parameters})


def sentence(clauses: Sequence[str]) -> str:
    """Clauses as one sentence."""
    text = ", and ".join(clauses)
    return f"{text[:1].upper()}{text[1:]}."


def thrust_error(unseen: bool, values: str, noise: float | None) -> str:
    """The thrust error beside the noise, as a sentence; `values` in words."""
    of = "Unseen" if unseen else "Cross-validated"
    return f"{of} thrust error {values}; noise {size(noise, 'N')}."


def words(name: str) -> str:
    """The name of an effect or parameter in a text or figure: "pitch backlash, half gap"; tables have the names as typed."""
    return re.sub(r"\.(?=[a-z])", ", ", name.replace("_", " "))


def titled(name: str) -> str:
    """A name as the first word of a title."""
    return words(name).capitalize()


def limited(parameter: Parameter, value: float) -> str:
    """A parameter's value with its unit, or "no limit"; at its limit form with what that means: "0 s (at once)"."""
    if parameter.unlimited is not None and math.isclose(value, parameter.unlimited, rel_tol=1e-3):
        return "no limit"
    at_limit = parameter.limit_form and value == parameter.default
    return size(value, parameter.unit) + (f" ({parameter.limit_form})" if at_limit else "")
