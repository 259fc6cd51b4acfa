"""Several rotors in one log: columns whose names differ by a number or a side only, such as rpm_1 and rpm_2."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from identification.logs.mapping import proposed
from identification.logs.sheet import Sheet, split_unit
from vpp_fmu.errors import BadInput

TELL = ("omega", "omega_ref", "signal", "thrust")
"""Quantities of which each rotor has its own; several voltages are cells of a battery."""

_LABEL = re.compile(r"(?i)\d+|(?<![a-z])(?:left|right|front|rear|upper|lower)(?![a-z])")


@dataclass(frozen=True)
class Rotors:
    """`label`: of each column that is one rotor's alone, by name; `found`: all labels, in the file's order."""

    label: Mapping[str, str]
    found: tuple[str, ...]

    def others(self, rotor: str) -> set[str]:
        """Columns that are another rotor's."""
        return {name for name, label in self.label.items() if label != rotor}


def rotors(sheet: Sheet) -> Rotors:
    """The rotors of a log, by proposals for the same quantity under names with the same stem. Empty where it has one."""
    families: dict[tuple[str, str], dict[str, str]] = {}
    for name in sheet.columns:
        label = list(_LABEL.finditer(split_unit(name)[0]))
        if label and (found := proposed(sheet, name)):
            stem = f"{name[: label[-1].start()]}#{name[label[-1].end() :]}".casefold()
            families.setdefault((found[0], stem), {})[label[-1][0].casefold()] = name
    several = {key: names for key, names in families.items() if len(names) > 1}
    labels = tuple(dict.fromkeys(label for (q, _), names in several.items() if q in TELL for label in names))
    return Rotors({name: label for names in several.values() for label, name in names.items() if label in labels}, labels)


def chosen(sheet: Sheet, wanted: str | None, mapped: Iterable[str]) -> tuple[set[str], list[str]]:
    """(columns of the rotors that are not taken, what was said). The rotor is the `wanted` one, else that of the columns that
    the user has `mapped`, else the first. BadInput for a rotor that the log does not have."""
    there = rotors(sheet)
    if not there.found:
        if wanted is not None:
            raise BadInput(sheet.source, "--rotor", wanted, "a log with columns of several rotors, such as rpm_1 and rpm_2")
        return set(), []
    if wanted is not None and wanted.casefold() not in there.found:
        raise BadInput(sheet.source, "--rotor", wanted, f"one of {', '.join(there.found)}")
    own = [there.label[name] for name in mapped if name in there.label]
    rotor = wanted.casefold() if wanted is not None else own[0] if own else there.found[0]
    taken = ", ".join(name for name, label in there.label.items() if label == rotor)
    other = next(label for label in there.found if label != rotor)
    rest = f"{len(there.found)} in this log ({', '.join(there.found)})"
    return there.others(rotor), [f"rotors: {rest}; rotor {rotor} is taken, with {taken}; --rotor {other} takes the other"]
