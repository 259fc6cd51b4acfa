"""Find several rotors in one log: columns whose names differ only by a number, a side, or A and B, such as rpm_1 and rpm_2."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from identification.logs.mapping import SIDES, moves, proposed
from identification.logs.raw_table import RawTable, split_unit
from vpp_fmu.errors import BadInput

TELL = ("omega", "omega_ref", "signal", "thrust")
"""Quantities that each rotor has separately; several voltages are cells of a battery."""

_LABEL = re.compile(rf"(?i)\d+|(?<![a-z])(?:{'|'.join(sorted(SIDES))})(?![a-z])")


@dataclass(frozen=True)
class Rotors:
    """`label`: rotor of each column that belongs to one rotor, by name; `found`: all labels in the file's order."""

    label: Mapping[str, str]
    found: tuple[str, ...]

    def others(self, rotor: str) -> set[str]:
        """Columns of the other rotors."""
        return {name for name, label in self.label.items() if label != rotor}


def rotors(table: RawTable) -> Rotors:
    """The rotors of a log, from columns of the same quantity whose names have the same stem. Empty if it has one rotor."""
    families: dict[tuple[str, str], dict[str, str]] = {}
    for name in table.columns:
        label = list(_LABEL.finditer(split_unit(name)[0]))
        if label and (found := proposed(table, name)):
            stem = f"{name[: label[-1].start()]}#{name[label[-1].end() :]}".casefold()
            families.setdefault((found[0], stem), {})[label[-1][0].casefold()] = name
    several = {key: names for key, names in families.items() if len(names) > 1}
    labels = tuple(dict.fromkeys(label for (q, _), names in several.items() if q in TELL for label in names))
    return Rotors({name: label for names in several.values() for label, name in names.items() if label in labels}, labels)


def chosen(table: RawTable, wanted: str | None, mapped: Iterable[str]) -> tuple[set[str], list[str]]:
    """(columns of the rotors that are not imported, messages). The rotor is the `wanted` one, else that of the columns that the
    user has `mapped`, else the first that turns. BadInput for an unknown rotor, or if only the thrust has several columns."""
    there = rotors(table)
    if not there.found:
        if wanted is not None:
            raise BadInput(table.source, "--rotor", wanted, "a log with columns of several rotors, such as rpm_1 and rpm_2")
        return set(), []
    if wanted is not None and wanted.casefold() not in there.found:
        raise BadInput(table.source, "--rotor", wanted, f"one of {', '.join(there.found)}")
    own = [there.label[name] for name in mapped if name in there.label]
    if wanted is None and len(set(own)) > 1:
        return set(), []  # a sum of cells
    cells = [name for name in there.label if proposed(table, name)[0] == "thrust"]
    if wanted is None and not own and len(cells) == len(there.label):
        found = f"{', '.join(cells)}, and one speed"
        hint = f"--map 'thrust={'+'.join(cells)}' for the cells of one rotor, or --rotor {there.found[0]}"
        raise BadInput(table.source, "thrust", found, "one thrust", hint)
    rotor = wanted.casefold() if wanted is not None else own[0] if own else _turning(table, there)
    taken = ", ".join(name for name, label in there.label.items() if label == rotor)
    other = next(label for label in there.found if label != rotor)
    rest = f"{len(there.found)} in this log ({', '.join(there.found)})"
    return there.others(rotor), [f"rotors: {rest}; rotor {rotor} is taken, with {taken}; --rotor {other} takes the other"]


def _turning(table: RawTable, there: Rotors) -> str:
    """The first rotor whose speed or signal moves; the first of all if none does."""
    drive = [n for n in there.label if proposed(table, n)[0] in ("omega", "omega_ref", "signal")]
    moving = {there.label[name] for name in drive if moves(table, name)}
    return next((label for label in there.found if label in moving), there.found[0])
