"""Tables: CSV files with a header."""

import csv
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.files import read_text, shown


@dataclass(frozen=True, eq=False)
class Table:
    """The content of a CSV file.

    `columns`: by name in the file's order, (n,) float if every cell is a finite number, else (n,) str as found.
    `lines`: (n,) line number of each row.
    """

    source: str
    columns: Mapping[str, np.ndarray]
    lines: np.ndarray

    def wrong(self, name: str, row: int, found: object, allowed: str, hint: str = "") -> BadInput:
        """The error that names a cell."""
        return BadInput(self.source, f"{name}, line {self.lines[row]}", found, allowed, hint)

    def numbers(self, name: str, gaps: Sequence[str] = ()) -> np.ndarray:
        """(n,) the column as float; `gaps`: cells that become NaN. BadInput names the first invalid cell."""
        cells = self.columns[name]
        if cells.dtype != object:
            return cells
        values = np.array([_number(cell) for cell in cells])
        for row in np.flatnonzero(~np.isfinite(values)):
            if cells[row].lower() not in gaps:
                allowed = "a finite number or an empty cell" if gaps else "a finite number"
                raise self.wrong(name, row, shown(cells[row]), allowed)
        return values


def read_table(path: str | os.PathLike) -> Table:
    """Read a CSV with a header. BadInput: not readable, no header, no rows, columns without or with the same name, ragged."""
    lines = read_text(path).split("\n")
    first = next((i for i, line in enumerate(lines) if line.strip()), None)
    if first is None:
        raise BadInput(path, "file", "an empty file", "a header and at least one row")
    names = _names(path, lines[first])
    rows = [(i, line) for i, line in enumerate(lines[first + 1 :], first + 2) if line.strip()]
    if not rows:
        raise BadInput(path, "file", "a header without rows", "a header and at least one row")
    columns = _all_numbers([line for _, line in rows], len(names))
    numbers = [i for i, _ in rows]
    if columns is None:
        numbers, cells = _cells(path, lines[first + 1 :], first + 1, len(names))
        columns = [_column(column) for column in zip(*cells, strict=True)]
    return Table(str(path), dict(zip(names, columns, strict=True)), np.array(numbers))


def _names(path: str | os.PathLike, line: str) -> list[str]:
    try:
        names = [name.strip() for name in next(csv.reader([line]))]
    except csv.Error as error:
        raise BadInput(path, "header", error, "names separated by commas") from error
    for i, name in enumerate(names):
        if not name:
            raise BadInput(path, f"header, column {i + 1}", "no name", "a name for each column")
        if not name.isprintable():  # it would break the single line of a message
            raise BadInput(path, f"header, column {i + 1}", shown(name), "a name of printable characters")
        if name in names[:i]:
            raise BadInput(path, f"column {name}", "more than one of that name", "each column once")
    return names


def _all_numbers(rows: Sequence[str], width: int) -> Sequence[np.ndarray] | None:
    """The columns of a table of finite numbers only; None for any other table. This is the fast path."""
    try:
        grid = np.loadtxt(rows, delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None
    return grid.T.copy() if grid.shape[1] == width and np.isfinite(grid).all() else None


def _cells(path: str | os.PathLike, lines: Sequence[str], before: int, width: int) -> tuple[list[int], list[list[str]]]:
    """Line numbers and cells of the rows after the first `before` lines."""
    reader = csv.reader(f"{line}\n" for line in lines)
    numbers, rows = [], []
    try:
        for cells in reader:
            if not cells or (len(cells) == 1 and cells[0].isspace()):
                continue
            if len(cells) != width:
                found = f"{len(cells)} cell{'s' * (len(cells) != 1)}"
                raise BadInput(path, f"line {before + reader.line_num}", found, f"{width} cells, as in the header")
            numbers.append(before + reader.line_num)
            rows.append([cell.strip() for cell in cells])
    except csv.Error as error:
        raise BadInput(path, f"line {before + reader.line_num}", error, "cells separated by commas") from error
    if not rows:
        raise BadInput(path, "file", "a header without rows", "a header and at least one row")
    return numbers, rows


def _column(cells: Sequence[str]) -> np.ndarray:
    if not math.isfinite(_number(cells[0])):
        return np.array(cells, dtype=object)
    values = np.array([_number(cell) for cell in cells])
    return values if np.isfinite(values).all() else np.array(cells, dtype=object)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
