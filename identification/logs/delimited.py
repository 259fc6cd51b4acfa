"""Read the text of any logger as a table; encoding, delimiter and decimal mark are detected from its lines.

A file has comments and a preamble, a row of names, rows of units or remarks, and rows of mostly numbers or times. Only the last
are required.
"""

import codecs
import contextlib
import csv
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from identification.logs.pairs import STAMP, named_values
from identification.logs.raw_table import EMPTY, RawTable, plain
from identification.logs.units import QUANTITIES, factor_of, is_unit
from vpp_fmu.errors import BadInput
from vpp_fmu.files import read_bytes, shown

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "space": " "}
"""Delimiters by their name as an option; a space matches several."""

COMMENTS = ("#", "%", "//", "!")

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)

_LOOK = 400
"""Lines from the middle of the file, by which its form is detected: exceptions are at its head."""

_HEAD = 40
"""Lines after the first row of numbers in which names may still come."""

DAMAGED = 0.01
"""Maximum share of damaged lines, which are left out."""

_NUMBER = re.compile(r"[+-]?(\d[\d'\u2019\xa0\u202f.,]*|[.,]\d+)([eEdD][+-]?\d+)?")
_TIME = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([T ].*)?|(\d+ days? )?\d{1,2}:\d{2}(:\d{2})?([.,]\d+)?(\s*[AaPp][Mm])?")
_BOTH = re.compile(r"[+-]?\d{1,3}(?:([.,])\d{3})+([.,])\d*")
_MACHINE = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(E[+-]?\d+)?", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}(\1\d{3})*")


def read_delimited(path: str | os.PathLike, given: Mapping[str, str]) -> RawTable:
    """Read a text table. `given`: those of `encoding`, `delimiter` and `decimal` that are not to be detected. BadInput."""
    text, encoding = _decoded(path, read_bytes(path), given.get("encoding"))
    numbered = [
        (i, line) for i, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1) if line.strip()
    ]
    declared = numbered and re.fullmatch(r"sep=(.)", numbered[0][1].strip())
    damaged = [i for i, line in numbered if "\0" in line]
    lines = [(i, line) for i, line in numbered[1 if declared else 0 :] if "\0" not in line]
    notes = [(i, line) for i, line in lines if line.lstrip().startswith(COMMENTS)]
    body = [(i, line) for i, line in lines if not line.lstrip().startswith(COMMENTS)]
    if not body:
        raise BadInput(path, "file", f"{len(notes)} lines of comments and no other", "a table of numbers")
    read = {"encoding": encoding}
    if (pairs := named_values(body, _LOOK)) and len(pairs[1]) > 1 and "delimiter" not in given:
        names, data = pairs
        units, delimiter, separated = [""] * len(names), "", "a name before each value"
        left_out = {"comments": len(notes), "lines without these values": len(body) - len(data)}
        named = ""
    else:
        stamps = [STAMP.match(line) for _, line in body]
        if 2 * sum(map(bool, stamps)) > len(body):  # a serial monitor has written its time before each line
            body = [(i, line[stamp.end() if stamp else 0 :]) for (i, line), stamp in zip(body, stamps, strict=True)]
        else:
            stamps = []
        delimiter = _delimiter(path, body, given.get("delimiter"), declared.group(1) if declared else None)
        rows = [(i, _cells(line, delimiter)) for i, line in body]
        for (_, row), stamp in zip(rows, stamps, strict=False):
            row.append(stamp[1] if stamp and any(map(_is_value, row)) else "monitor")
        width = _width(path, rows)
        head, data, dropped, others = _parts(path, rows, width, delimiter)
        damaged += others
        if not head and (commented := _commented_head(notes, data[0][0], delimiter, width)):
            head = commented
            notes = notes[: -len(commented)]
        names, units, line = _header(path, head, width)
        remarks = max(0, len(head) - 1 - any(units))
        left_out = {"comments": len(notes), "lines before and after the names": remarks, **dropped}
        read["delimiter"] = {name: key for key, name in DELIMITERS.items()}.get(delimiter, delimiter)
        separated = f"cells separated by {read['delimiter']}"
        named = f", names on line {line}" if head else ", no names: columns are numbered"
    cells = [row for _, row in data]
    read["decimal"] = decimal = given.get("decimal") or _decimal(path, cells, delimiter)
    how = f"text in {encoding}, {separated}, decimal {'comma' if decimal == ',' else 'point'}{named}"
    columns = [_column(list(column), decimal) for column in zip(*cells, strict=True)]
    broken = sorted({row for column, _ in columns for row in _broken(column, decimal)})
    whole, lines_read = np.ones(len(data), bool), np.array([i for i, _ in data])
    if broken:
        whole[broken] = False
        damaged += lines_read[broken].tolist()
        cells = [row for row, good in zip(cells, whole, strict=True) if good]
        columns = [_column(list(column), decimal) for column in zip(*cells, strict=True)]
    if damaged:
        left_out[_said_of_damaged(path, sorted(damaged), len(data))] = len(damaged)
    return RawTable(
        source=str(path),
        columns={name: column for name, (column, _) in zip(names, columns, strict=True)},
        lines=lines_read[whole],
        units={name: own or unit for name, own, (_, unit) in zip(names, units, columns, strict=True) if own or unit},
        how_read=how,
        read=read,
        left_out={reason: number for reason, number in left_out.items() if number},
        decimal=decimal,
    )


def _said_of_damaged(path, damaged: Sequence[int], rows: int) -> str:
    """The damaged lines by number, for `left_out`. BadInput if more than DAMAGED of the lines are damaged."""
    shown_lines = ", ".join(map(str, damaged[:10])) + (", ..." if len(damaged) > 10 else "")
    lines = f"line{'s' * (len(damaged) > 1)} {shown_lines}"
    if len(damaged) > DAMAGED * (rows + len(damaged)):
        found = f"{len(damaged)} damaged of {rows + len(damaged)}: cells are missing, too many, or no numbers"
        raise BadInput(path, lines, found, f"at most {100 * DAMAGED:g} % damaged lines", "the log without them")
    return f"damaged ({lines})"


def _broken(column: np.ndarray, decimal: str) -> list[int]:
    """Rows whose cell is damaged: it has digits and is no number, as all but a share DAMAGED of the column's cells are.

    A word such as "overload" is a message of the logger and no damage.
    """
    if column.dtype.kind != "O":
        return []
    filled = [(k, text) for k, cell in enumerate(column.tolist()) if (text := plain(cell, decimal))]
    bad = [(k, text) for k, text in filled if not _is_value(text) or (_NUMBER.fullmatch(text) and not _MACHINE.fullmatch(text))]
    damage = 0 < len(bad) <= DAMAGED * len(filled) and all(re.search(r"\d", text) for _, text in bad)
    return [k for k, _ in bad] if damage else []


def _decoded(path: str | os.PathLike, data: bytes, wanted: str | None) -> tuple[str, str]:
    """(text, encoding). Without a byte order mark, text that is not valid UTF-8 is taken as Windows-1252, unless other letters
    of it are UTF-8. A line with a NUL, as power-up garbage has, becomes that NUL alone."""
    if wanted:
        try:
            return data.decode(wanted).removeprefix("\ufeff"), wanted
        except (LookupError, UnicodeError) as error:
            raise BadInput(path, "encoding", f"bytes that are no {wanted}", "the encoding it was written in") from error
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            try:
                return data.decode(encoding, "replace" if mark == codecs.BOM_UTF8 else "strict"), encoding.removesuffix("-sig")
            except UnicodeError as error:
                raise BadInput(
                    path, "encoding", f"a mark of {encoding} and bytes that are none", "a whole text file"
                ) from error
    zeros = [data[k:4000:2].count(0) / max(1, len(data[k:4000:2])) for k in (0, 1)]
    order = ["utf-16-le", "utf-16-be"] if zeros[1] > zeros[0] else ["utf-16-be", "utf-16-le"]
    wide = max(zeros) > 0.4 > min(zeros)
    lines = data.split(b"\n")
    garbage = [k for k, line in enumerate(lines) if b"\0" in line]
    if garbage and not wide and len(garbage) <= DAMAGED * len(lines):
        data = b"\n".join(b"\0" if b"\0" in line else line for line in lines)
    elif garbage and not wide:
        raise BadInput(path, "file", "bytes that are no text", "text, Parquet, MAT or HDF5")
    mostly_utf_8 = not data.decode("utf-8", "replace").replace("\ufffd", "").isascii()
    for encoding in [order[0]] if wide else ["utf-8"] if mostly_utf_8 else ["utf-8", "cp1252", "latin-1"]:
        with contextlib.suppress(UnicodeError):
            return data.decode(encoding, "replace" if mostly_utf_8 else "strict"), encoding
    raise BadInput(path, "file", "bytes that are no text", "text, Parquet, MAT or HDF5")


def _delimiter(path, body: Sequence[tuple[int, str]], wanted: str | None, declared: str | None) -> str:
    """The delimiter: as given, else that by which most lines are rows of one width with the most numbers."""
    if wanted:
        found = DELIMITERS.get(wanted, {"\\t": "\t"}.get(wanted, wanted))
        if len(found) != 1 or found.isalnum() or found in "\"'.+-\n":
            raise BadInput("command line", "--delimiter", shown(wanted), f"one character, or one of {', '.join(DELIMITERS)}")
        return found
    if declared:
        return declared
    middle = max(0, len(body) // 2 - _LOOK // 2)
    sample = [line for _, line in body[middle : middle + _LOOK]]
    scores = {}
    for delimiter in DELIMITERS.values():
        rows = [_cells(line, delimiter) for line in sample]
        width, many = Counter(map(len, rows)).most_common(1)[0]
        if width < 2:
            continue
        filled = [cell for row in rows if len(row) == width for cell in row if cell.strip().lower() not in EMPTY]
        values = sum(_is_value(cell) for cell in filled) / max(1, len(filled))
        scores[delimiter] = (round(values * many / len(rows), 2), width if delimiter != " " else 0)
    if scores and max(scores.values())[0] < 0.1 and len(body) <= _HEAD:
        found = f"{len(body)} line{'s' * (len(body) > 1)} without numbers"
        raise BadInput(path, "file", found, "rows of numbers under the names")
    if not scores or max(scores.values())[0] < 0.1:
        line, text = body[len(body) // 2]
        allowed = "cells separated by comma, semicolon, tab, bar or space"
        raise BadInput(path, f"line {line}", shown(text), allowed, "--delimiter D for another one")
    return max(scores, key=scores.get)


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
    except csv.Error:
        return line.split(delimiter)


def _is_value(cell: str) -> bool:
    """Whether a cell is a number, with or without a unit, or a time."""
    text = cell.strip()
    return (
        bool(_NUMBER.match(text) and _quantity(text))
        or bool(_TIME.fullmatch(text))
        or ("T" in text and bool(_TIME.match(text)))
    )


def _quantity(text: str) -> tuple[str, str] | None:
    """(number, unit) of a cell such as "12.3 N", the unit "" if there is none."""
    found = _NUMBER.match(text)
    if found is None:
        return None
    rest = text[found.end() :].strip()
    return (found.group(0), rest) if not rest or re.fullmatch(r"[A-Za-zµμ°%][\w/^·*°%-]{0,9}", rest) else None


def _width(path, rows: Sequence[tuple[int, list[str]]]) -> int:
    """The commonest number of cells in rows with numbers."""
    middle = max(0, len(rows) // 2 - _LOOK)
    counts = Counter(len(cells) for _, cells in rows[middle : middle + 2 * _LOOK] if _is_data(cells))
    if not counts:
        allowed = "rows with numbers in half of the cells or more"
        raise BadInput(path, f"line {rows[-1][0]}", shown(" ".join(rows[-1][1])), allowed)
    return counts.most_common(1)[0][0]


def _is_data(cells: Sequence[str]) -> bool:
    filled = [cell for cell in cells if cell.lower() not in EMPTY]
    return bool(filled) and 2 * sum(map(_is_value, filled)) >= len(filled)


def _parts(path, rows, width: int, delimiter: str):
    """(lines of the head, rows of data, numbers of dropped rows by reason, numbers of lines of another width). Data begin with
    the first row of that width."""
    first = _first_row(rows, width)
    head = [(i, _joined(cells) if delimiter == " " else cells) for i, cells in rows[:first]]
    named = [len(cells) for _, cells in head if not _is_data(cells)]
    if delimiter == "," and named and 2 < named[-1] <= width / 1.5:
        line, names = rows[first][0], named[-1]
        allowed = f"{names} cells, one a name of the header (a comma can't separate cells and mark decimals too)"
        raise BadInput(path, f"line {line}", f"{width} cells", allowed)
    head = [(i, cells) for i, cells in head if _of_width(cells, width) and not _is_data(cells)]
    preamble = first - len(head)
    data, dropped, damaged = [], Counter({"lines before the table": preamble}), []
    names = [cells for _, cells in head]
    for k, (line, cells) in enumerate(rows[first:], first):
        if len(cells) != width and k == len(rows) - 1:
            dropped["cut off at the end"] += 1
        elif cells in names:
            dropped["names once more"] += 1
        elif any(sorted(cells) == sorted(row) for row in names):
            found, allowed = "the names again, in another order", "one order of the columns in all rows"
            raise BadInput(path, f"line {line}", found, allowed, "two files: that line begins the second")
        elif len(cells) == width or (len(cells) == width + 1 and not cells[-1]):
            data.append((line, cells[:width]))
        elif not any(cells):
            dropped["empty rows"] += 1
        else:
            damaged.append(line)
    if len(data) < 2:
        raise BadInput(path, "file", f"{len(data)} row of numbers", "two or more")
    return head, data, dict(dropped), damaged


def _first_row(rows: Sequence[tuple[int, list[str]]], width: int) -> int:
    """Place of the first row of data: it has that width, and no names come after it (LabVIEW counts its samples first)."""
    first = next(k for k, (_, cells) in enumerate(rows) if len(cells) == width and _is_data(cells))
    before = [cells for _, cells in rows[:first]]
    for k, (_, cells) in enumerate(rows[first + 1 : first + 1 + _HEAD], first + 1):
        filled = [cell for cell in cells if cell.lower() not in EMPTY]
        names = _of_width(filled, width) and not any(map(_is_value, filled)) and len(set(filled)) == len(filled)
        if names and cells not in before:
            more = [n for n, (_, row) in enumerate(rows[k:], k) if len(row) == width and _is_data(row)]
            first = more[0] if more else first
    return first


def _joined(cells: Sequence[str]) -> list[str]:
    """Join units to their names, which a space as delimiter has separated."""
    found: list[str] = []
    for cell in cells:
        if found and re.fullmatch(r"[(\[{].*[)\]}]", cell):
            found[-1] += f" {cell}"
        else:
            found.append(cell)
    return found


def _of_width(cells: Sequence[str], width: int) -> bool:
    """Whether a line before the numbers is a row of names, units or remarks for them. The last column may have no name (a comma
    at the line's end)."""
    more = len(cells) == width + 1 and (not cells[-1] or cells[-1].casefold() == "comment")  # LabVIEW's empty column
    return (len(cells) in (width, width - 1) or more) and sum(map(bool, cells)) * 2 >= width


def _commented_head(notes, first: int, delimiter: str, width: int):
    """The last comment before the numbers, if it has as many names as there are columns; with a row of units, the last two."""
    before = [(i, line.lstrip().lstrip("#%!/").strip()) for i, line in notes if i < first]
    rows = [(i, _cells(line, delimiter)) for i, line in before[-2:]]
    if len(rows) == 2 and all(len(cells) == width and not _is_data(cells) for _, cells in rows) and _units(rows[1][1]):
        return rows
    rows = rows[-1:]
    return rows if rows and len(rows[0][1]) == width and not _is_data(rows[0][1]) else []


def _header(path, head, width: int) -> tuple[list[str], list[str], int]:
    """(names, units, line of the names) of the rows before the numbers. Names are in the row before the units, else in the
    last row of distinct cells."""
    if not head:
        return [str(k) for k in range(1, width + 1)], [""] * width, 0
    rows = [[*cells, *[""] * width][:width] for _, cells in head]
    twice = len(rows) > 1 and any(n > 1 for unit, n in Counter(rows[0]).items() if unit)  # names differ: LabVIEW's units
    units = next((k for k, row in enumerate(rows) if (k or twice) and _units(row)), None)
    distinct = [k for k, row in enumerate(rows) if all(row[:-1]) and len(set(row)) == width]
    most = max(range(len(rows)), key=lambda k: (k != units, len(set(rows[k])), k))  # X_Value before each name: LabVIEW
    named = units - 1 if units and (units - 1 in distinct or not distinct) else max(distinct, default=most)
    names = []
    for k, name in enumerate(rows[named], 1):
        clean = " ".join(name.split())
        if not clean.isprintable():
            raise BadInput(path, f"line {head[named][0]}, column {k}", shown(clean), "a name of printable characters")
        if clean in names:
            clean = f"{clean}.{k}"
        names.append(clean or str(k))
    found = [unit.strip("()[]{}<> ") for unit in rows[units]] if units is not None else [""] * width
    return names, [unit if is_unit(unit) else "" for unit in found], head[named][0]


def _units(row: Sequence[str]) -> bool:
    """Whether a row before the numbers is a row of units: at least half of its cells are units of a quantity."""
    filled = [cell.strip("()[]{}<> ") for cell in row if cell.strip("()[]{}<> -")]
    known = sum(
        any(factor_of(q, cell) is not None for q in QUANTITIES.values() if q.unit or cell in ("us", "µs", "%"))
        for cell in filled
    )
    return bool(filled) and 2 * known >= len(filled)


def _decimal(path, rows: Sequence[Sequence[str]], delimiter: str) -> str:
    """The decimal mark: that of cells in which it can't separate thousands, if only one mark has such cells; else of most.
    BadInput if both marks occur, and each may separate thousands."""
    commas = points = 0
    proven = set()
    for row in rows[: 10 * _LOOK]:
        for cell in row:
            if _NUMBER.fullmatch(cell) and not _THOUSANDS.fullmatch(cell) and not _BOTH.fullmatch(cell):
                proven |= {"."} if "." in cell else {","} if "," in cell else set()
            if "," not in cell:
                points += "." in cell and bool(_NUMBER.match(cell))
            elif found := _BOTH.fullmatch(cell):
                if found.group(1) != found.group(2):  # the other mark separates thousands
                    return found.group(2)
                commas += 1
            elif _NUMBER.fullmatch(cell):
                commas += 1
    if delimiter != "," and len(proven) == 1:
        return proven.pop()
    if delimiter != "," and commas and points and not proven:
        found = "points and commas in cells of three digits behind them: either may separate thousands"
        raise BadInput(path, "decimal mark", found, "one that decides", "--decimal comma, or --decimal point")
    return "," if commas and (not points or (delimiter != "," and commas > points)) else "."


def _column(cells: list[str], decimal: str) -> tuple[np.ndarray, str]:
    """(cells, as numbers if all are; the unit that follows all numbers, or "")."""
    if decimal == ".":
        try:
            return np.array([cell if "_" not in cell else "x" for cell in cells]).astype(float), ""
        except ValueError:
            pass
    texts = [plain(cell, decimal) for cell in cells]
    try:
        return np.array([text or "nan" for text in texts]).astype(float), ""
    except ValueError:
        pass
    parts = [_quantity(text) if text else ("", "") for text in texts[:50]]
    behind = {part[1] for text, part in zip(texts, parts, strict=False) if text and part} if all(parts) else set()
    if len(behind) == 1 and (unit := behind.pop()) and any(factor_of(q, unit) for q in QUANTITIES.values()):
        return np.array([text.removesuffix(unit).strip() for text in texts], dtype=object), unit
    return np.array(cells, dtype=object), ""
