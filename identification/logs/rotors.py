"""Find several rotors in one log: columns whose names differ only by a number, a side, or A and B, such as rpm_1 and rpm_2."""

import re
from collections.abc import Iterable

from identification.logs.mapping import SIDES, proposed
from identification.logs.raw_table import RawTable, split_unit
from vpp_fmu.errors import BadInput

TELL = ("omega", "omega_ref", "signal", "thrust")
"""Quantities that each rotor has separately; several voltages are cells of a battery."""

_LABEL = re.compile(rf"(?i)\d+|(?<![a-z])(?:{'|'.join(sorted(SIDES))})(?![a-z])")


def _rotors(table: RawTable) -> tuple[dict[str, str], tuple[str, ...]]:
    """(rotor of each column that belongs to one rotor, by name; all rotors in the file's order), from columns of the same
    quantity whose names have the same stem. Empty if the log has one rotor."""
    families: dict[tuple[str, str], dict[str, str]] = {}
    for name in table.columns:
        label = list(_LABEL.finditer(split_unit(name)[0]))
        if label and (found := proposed(table, name)):
            stem = f"{name[: label[-1].start()]}#{name[label[-1].end() :]}".casefold()
            families.setdefault((found[0], stem), {})[label[-1][0].casefold()] = name
    several = {key: names for key, names in families.items() if len(names) > 1}
    labels = tuple(dict.fromkeys(label for (q, _), names in several.items() if q in TELL for label in names))
    return {name: label for names in several.values() for label, name in names.items() if label in labels}, labels


def chosen(table: RawTable, wanted: str | None, mapped: Iterable[str]) -> tuple[set[str], list[str]]:
    """(columns of the rotors that are not imported, messages). The rotor is the `wanted` one, else that of the columns that the
    user has `mapped`. BadInput for an unknown rotor, for several and no choice, or if only the thrust has several columns."""
    rotor_of, there = _rotors(table)
    if not there:
        if wanted is not None:
            raise BadInput(table.source, "--rotor", wanted, "a log with columns of several rotors, such as rpm_1 and rpm_2")
        return set(), []
    if wanted is not None and wanted.casefold() not in there:
        raise BadInput(table.source, "--rotor", wanted, f"one of {', '.join(there)}")
    own = [rotor_of[name] for name in mapped if name in rotor_of]
    if wanted is None and len(set(own)) > 1:
        return set(), []  # a sum of cells
    cells = [name for name in rotor_of if proposed(table, name)[0] == "thrust"]
    if wanted is None and not own and len(cells) == len(rotor_of):
        found = f"{', '.join(cells)}, and one speed"
        hint = f"--map 'thrust={'+'.join(cells)}' for the cells of one rotor, or --rotor {there[0]}"
        raise BadInput(table.source, "thrust", found, "one thrust", hint)
    if wanted is None and not own:
        quantity, _, column = next(found for name in rotor_of if (found := proposed(table, name))[0] in TELL)
        hint = f"--rotor {there[0]}, or a column of one rotor, --map '{quantity}={column}'"
        raise BadInput(table.source, "rotors", f"{len(there)} ({', '.join(there)})", "one rotor", hint)
    rotor = wanted.casefold() if wanted is not None else own[0]
    taken = ", ".join(name for name, label in rotor_of.items() if label == rotor)
    others = {name for name, label in rotor_of.items() if label != rotor}
    return others, [f"rotors: {len(there)} in this log ({', '.join(there)}); rotor {rotor} is taken, with {taken}"]
