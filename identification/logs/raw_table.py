"""A log as a table of cells by name, before its columns are mapped to quantities, with units if the file has them."""

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.files import shown

EMPTY = frozenset(("", "nan", "na", "n/a", "#n/a", "null", "none", "nil", "-", "--", "---", "inf", "-inf", "+inf"))
EMPTY |= {"err", "error", "invalid", "timeout", "?", "#div/0!", "#value!", "#num!"}
EMPTY |= {"nan(ind)", "-nan(ind)", "-nan", "1.#qnan", "-1.#ind", "1.#inf"}
"""Cells that loggers write for a missing value, in lower case."""

_UNIT_IN_NAME = re.compile(r"^(.*?)[\s_]*(?:\(([^()]*)\)|\[([^\[\]]*)\]|\{([^{}]*)\}|<([^<>]*)>|\s/\s*(\S+)|,\s+(\S+))\s*$")


@dataclass(frozen=True, eq=False)
class RawTable:
    """`columns` by name in the file's order, (n,) float, datetime64[ns] or str; `units` by name, if the file has them; `lines`
    (n,): number of each row, counted in `rows_are` ("line" of a text, "row" of a container).

    `how_read`: how the file was read, in words; `read`: the same as options; `left_out`: numbers of skipped lines by reason;
    `decimal`: the decimal mark of cells that are text.
    """

    source: str
    columns: Mapping[str, np.ndarray]
    lines: np.ndarray
    units: Mapping[str, str] = field(default_factory=dict)
    how_read: str = ""
    read: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, int] = field(default_factory=dict)
    decimal: str = "."
    rows_are: str = "line"

    def __len__(self) -> int:
        return len(self.lines)

    def wrong(self, name: str, row: int, found: object, allowed: str, hint: str = "") -> BadInput:
        return BadInput(self.source, f"{name}, {self.rows_are} {self.lines[row]}", found, allowed, hint)

    def find(self, wanted: str) -> str:
        """Name of the column that matches a name, a name without its unit, or a number from 1; A+B is a sum. BadInput."""
        if wanted in self.columns:
            return wanted
        if "+" in wanted.strip("+"):
            return "+".join(self.find(part.strip()) for part in wanted.split("+"))
        for form in (_folded, lambda name: _folded(split_unit(name)[0])):
            found = [name for name in self.columns if form(name) == form(wanted)]
            if len(found) == 1:
                return found[0]
        names = list(self.columns)
        if wanted.strip().isdigit() and 1 <= int(wanted) <= len(names):
            return names[int(wanted) - 1]
        near = difflib.get_close_matches(_folded(wanted), map(_folded, names))
        allowed = " or ".join(name for name in names if _folded(name) in near) or f"one of {', '.join(names)}"
        allowed = allowed if len(allowed) < 400 else f"{allowed[:397]}..."
        raise BadInput(self.source, f"column {wanted}", "no such column", allowed)

    def parts(self, name: str) -> list[str]:
        """The columns of a name that `find` returned: several for a sum."""
        return [name] if name in self.columns else name.split("+")

    def unit(self, name: str) -> str | None:
        """Unit of a column: from the row of units, else from its name, else None; of a sum, that of all its columns."""
        if len(parts := self.parts(name)) > 1:
            units = {self.unit(part) for part in parts}
            return units.pop() if len(units) == 1 else None
        return self.units.get(name) or split_unit(name)[1] or None

    def numbers(self, name: str) -> np.ndarray:
        """The column (n,) as float, NaN for cells that are empty or not finite. BadInput for text names its first cell."""
        if len(parts := self.parts(name)) > 1:
            return np.sum([self.numbers(part) for part in parts], axis=0)
        cells = self.columns[name]
        if cells.dtype.kind == "f":
            return np.where(np.isfinite(cells), cells, np.nan)
        if cells.dtype.kind == "M":
            raise self.wrong(name, 0, f"a date, {cells[0]}", "a number")
        texts = [plain(cell, self.decimal) for cell in cells.tolist()]
        bad = next((row for row, text in enumerate(texts) if text and not _is_number(text)), 0)
        hint = "an empty cell there if the reading is missing"
        raise self.wrong(name, bad, shown(str(cells[bad])), "a number or an empty cell", hint)


def split_unit(name: str) -> tuple[str, str]:
    """(name, unit) of a header such as "Thrust (gf)", "Thrust [gf]" or "Thrust / gf"; the unit is "" if there is none."""
    found = _UNIT_IN_NAME.match(name)
    if found is None or not found.group(1).strip() or re.search(r"\S\[\d+\]\s*$", name):  # motor[1] is the second motor
        return name.strip(), ""
    return found.group(1).strip(), next((part for part in found.groups()[1:] if part), "").strip()


def plain(cell: str, decimal: str) -> str:
    """A cell as Python reads numbers: decimal point, E in exponents, no thousands separators; "" for a missing value."""
    text = re.sub(r"(?<=[\d.])[dD](?=[+-]?\d+$)", "E", cell.strip().replace("\u2212", "-"))
    if text.lower() in EMPTY:
        return ""
    for mark in ("'", "\u2019", "\xa0", "\u202f"):
        if mark in text:
            text = text.replace(mark, "")
    if decimal == ",":
        whole = re.fullmatch(r"[+-]?\d{1,3}(\.\d{3})+(,\d*)?", text)
        return (text.replace(".", "") if whole else text).replace(",", ".")
    return text.replace(",", "") if re.fullmatch(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?", text) else text


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _folded(name: str) -> str:
    return " ".join(name.split()).casefold()
