"""Read the text of any logger as a table; encoding, delimiter and decimal mark are detected from its lines.

A file has comments and a preamble, a row of names, rows of units or remarks, and rows of mostly numbers or times. Only the last
are required. Serial monitors and JSON lines name each value instead: "t=12 ms, rpm=4000", {"t": 12, "rpm": 4000}. The commonest
sequence of names makes the columns.
"""

import codecs
import contextlib
import csv
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from identification.logs.raw_table import EMPTY, RawTable, plain
from identification.logs.units import QUANTITIES, factor_of, is_unit
from vpp_fmu.errors import BadInput
from vpp_fmu.files import read_bytes, shown

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "space": " "}
"""Delimiters by their name as an option; a space matches several."""

COMMENTS = ("#", "%", "//", "!")

_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
"""Encodings by byte order mark."""

_LOOK = 400
"""Lines from the middle of the file, by which its form is detected: exceptions are at its head."""

_HEAD = 40
"""Lines after the first row of numbers in which names may still come."""

DAMAGED = 0.01
"""Maximum share of damaged lines, which are left out."""

MOSTLY = 0.9
"""Minimum share of the lines that name the same values."""

_NUMBER = re.compile(r"[+-]?(\d[\d'\u2019\xa0\u202f.,]*|[.,]\d+)([eEdD][+-]?\d+)?")
_TIME = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([T ].*)?|(\d+ days? )?\d{1,2}:\d{2}(:\d{2})?([.,]\d+)?(\s*[AaPp][Mm])?")
_BOTH = re.compile(r"[+-]?\d{1,3}(?:([.,])\d{3})+([.,])\d*")
_MACHINE = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(E[+-]?\d+)?", re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}(\1\d{3})*")
_BEHIND = re.compile(r"[A-Za-zµμ°%][\w/^·*°%-]{0,9}")
"""A unit behind a number."""

_NAME = r"[^\W\d][\w.]*(?:[ -][\w.]+)*(?:\s*[(\[][^()\[\]]*[)\]])?"
_VALUE = r"[+-]?\d+(?:[.,]\d+)*(?:[eE][+-]?\d+)?|[+-]?[.,]\d+|(?i:nan|null|none|inf|-inf)\b"
_UNIT = r"[^\W\d_]{1,9}(?:/[a-z]{1,4})?|%|°"
_PAIR = re.compile(rf"[\"']?({_NAME})[\"']?\s*[=:]\s*[\"']?({_VALUE})[\"']?(?:\s*({_UNIT})(?!\s*[=:(\[]))?(?=[\s,;|}}\]]|$)")
_BETWEEN = re.compile(r"[\s,;|{}\[\]]*")
_STAMP = re.compile(r"\s*(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\s*->\s*")
"""The time that the Arduino's serial monitor writes before a line."""

Rows = Sequence[tuple[int, list[str]]]
"""Cells by the number of their line."""


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
    left_out = Counter({"comments": len(notes), "lines before and after the names": 0})
    if "delimiter" not in given and len((pairs := named_values(body))[1]) > 1:
        names, data = pairs
        units, delimiter, how = [""] * len(names), "", "a name before each value"
        left_out["lines without these values"] = len(body) - len(data)
    else:
        delimiter = _delimiter(path, body, given.get("delimiter"), declared.group(1) if declared else None)
        rows = _split(body, delimiter)
        width = _width(path, rows)
        first = _first_row(rows, width)
        head = _head(path, rows[: first + 1], width, delimiter)
        left_out["lines before the table"] = first - len(head)
        data = _data(path, rows[first:], width, [cells for _, cells in head], left_out, damaged)
        if not head and (head := _commented(notes, data[0][0], delimiter, width)):
            left_out["comments"] -= len(head)
        names, units, line = _header(path, head, width)
        left_out["lines before and after the names"] = max(0, len(head) - 1 - any(units))
        read["delimiter"] = {name: key for key, name in DELIMITERS.items()}.get(delimiter, delimiter)
        how = f"cells separated by {read['delimiter']}"
    numbers, cells = np.array([i for i, _ in data]), [row for _, row in data]
    read["decimal"] = decimal = given.get("decimal") or _decimal(path, cells, delimiter)
    how = f"text in {encoding}, {how}, decimal {'comma' if decimal == ',' else 'point'}"
    if delimiter:
        how += f", names on line {line}" if head else ", no names: columns are numbered"
    columns = [_column(column, decimal) for column in zip(*cells, strict=True)]
    if broken := {row for column, _ in columns for row in _broken(column, decimal)}:
        whole = [k for k in range(len(data)) if k not in broken]
        damaged += numbers[[*broken]].tolist()
        numbers, columns = numbers[whole], [_column([cells[k][n] for k in whole], decimal) for n in range(len(names))]
    if damaged:
        left_out[_said_of_damaged(path, sorted(damaged), len(data))] = len(damaged)
    return RawTable(
        source=str(path),
        columns={name: column for name, (column, _) in zip(names, columns, strict=True)},
        lines=numbers,
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
    encoding = wanted or next((name for mark, name in _MARKS.items() if data.startswith(mark)), None)
    if encoding is None:
        zeros = [data[k:4000:2].count(0) / max(1, len(data[k:4000:2])) for k in (0, 1)]
        lines = data.split(b"\n")
        if max(zeros) > 0.4 > min(zeros):
            encoding = "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
        elif sum(b"\0" in line for line in lines) > DAMAGED * len(lines):
            raise BadInput(path, "file", "bytes that are no text", "text, Parquet, MAT or HDF5")
        else:
            data = b"\n".join(b"\0" if b"\0" in line else line for line in lines)
            text = data.decode("utf-8", "replace")
            other_letters = not text.replace("\ufffd", "").isascii()
            encoding = "utf-8" if "\ufffd" not in text or other_letters else "cp1252"
    for name in (encoding, "latin-1") if encoding == "cp1252" and not wanted else (encoding,):
        with contextlib.suppress(LookupError, UnicodeError):
            errors = "replace" if name == "utf-8" and not wanted else "strict"
            return data.decode(name, errors).removeprefix("\ufeff"), name
    raise BadInput(path, "encoding", f"bytes that are no {encoding}", "the encoding it was written in")


def named_values(body: Sequence[tuple[int, str]]) -> tuple[list[str], Rows]:
    """(names, rows) of lines that name their values, if most lines from the middle name two or more in the same order; else
    empty. A line of other names is left out."""
    middle = max(0, len(body) // 2 - _LOOK // 2)
    sample = [_pairs(line) for _, line in body[middle : middle + _LOOK]]
    names, many = Counter(tuple(name for name, _ in pairs) for pairs in sample).most_common(1)[0]
    if len(set(names)) < max(2, len(names)) or many < MOSTLY * len(sample):
        return [], []
    found = [(i, _pairs(line)) for i, line in body]
    return list(names), [(i, [cell for _, cell in pairs]) for i, pairs in found if tuple(name for name, _ in pairs) == names]


def _pairs(line: str) -> list[tuple[str, str]]:
    """(name, value with its unit) of each pair; empty if the line contains anything else."""
    stamp = _STAMP.match(line)
    pairs, place = [("time", stamp[1])] if stamp else [], stamp.end() if stamp else 0
    while (place := _BETWEEN.match(line, place).end()) < len(line):
        if (found := _PAIR.match(line, place)) is None:
            return []
        pairs.append((found[1], f"{found[2]} {found[3] or ''}".strip()))
        place = found.end()
    return pairs


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
    scores = {}
    for delimiter in DELIMITERS.values():
        rows = [_cells(line, delimiter) for _, line in body[middle : middle + _LOOK]]
        width, many = Counter(map(len, rows)).most_common(1)[0]
        filled = [cell for row in rows if len(row) == width for cell in row if cell.strip().lower() not in EMPTY]
        values = sum(map(_is_value, filled)) / max(1, len(filled))
        if width > 1:
            scores[delimiter] = (round(values * many / len(rows), 2), width if delimiter != " " else 0)
    if max(scores.values(), default=(0.0,))[0] < 0.1:
        raise _no_table(path, body)
    return max(scores, key=scores.get)


def _no_table(path, lines: Sequence) -> BadInput:
    found = f"{len(lines)} line{'s' * (len(lines) > 1)} without numbers"
    hint = f"--delimiter D for another than {', '.join(DELIMITERS)}"
    return BadInput(path, "file", found, "rows of numbers under the names", hint)


def _split(body: Sequence[tuple[int, str]], delimiter: str) -> Rows:
    """The cells of each line. If a serial monitor has written its time before most lines, it is the last column."""
    stamps = [_STAMP.match(line) for _, line in body]
    if 2 * sum(map(bool, stamps)) <= len(body):
        return [(i, _cells(line, delimiter)) for i, line in body]
    rows = [(i, _cells(line[stamp.end() if stamp else 0 :], delimiter)) for (i, line), stamp in zip(body, stamps, strict=True)]
    for (_, row), stamp in zip(rows, stamps, strict=True):
        row.append(stamp[1] if stamp and any(map(_is_value, row)) else "monitor")
    return rows


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":  # a unit in brackets belongs to its name
        return re.findall(r"\S+(?:\s+[(\[{]\S*[)\]}](?!\S))*", line)
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
    except csv.Error:
        return line.split(delimiter)


def _is_value(cell: str) -> bool:
    """Whether a cell is a number, with or without a unit, or a time."""
    text = cell.strip()
    return _quantity(text) is not None or bool(_TIME.fullmatch(text)) or ("T" in text and bool(_TIME.match(text)))


def _quantity(text: str) -> tuple[str, str] | None:
    """(number, unit) of a cell such as "12.3 N", the unit "" if there is none."""
    if (found := _NUMBER.match(text)) is None:
        return None
    rest = text[found.end() :].strip()
    return (found[0], rest) if not rest or _BEHIND.fullmatch(rest) else None


def _width(path, rows: Rows) -> int:
    """The commonest number of cells in rows with numbers."""
    middle = max(0, len(rows) // 2 - _LOOK)
    counts = Counter(len(cells) for _, cells in rows[middle : middle + 2 * _LOOK] if _is_data(cells))
    if not counts:
        raise _no_table(path, rows)
    return counts.most_common(1)[0][0]


def _is_data(cells: Sequence[str]) -> bool:
    """Whether half of a row's filled cells or more are values."""
    filled = [cell for cell in cells if cell.lower() not in EMPTY]
    return bool(filled) and 2 * sum(map(_is_value, filled)) >= len(filled)


def _first_row(rows: Rows, width: int) -> int:
    """Place of the first row of data: it has that width, and no names come after it (LabVIEW counts its samples first)."""
    data = [k for k, (_, cells) in enumerate(rows) if len(cells) == width and _is_data(cells)]
    before, last = [cells for _, cells in rows[: data[0]]], data[0]
    for k, (_, cells) in enumerate(rows[last + 1 : last + 1 + _HEAD], last + 1):
        filled = [cell for cell in cells if cell.lower() not in EMPTY]
        names = _of_width(filled, width) and not any(map(_is_value, filled)) and len(set(filled)) == len(filled)
        last = k if names and cells not in before else last
    return next((k for k in data if k >= last), data[0])


def _head(path, rows: Rows, width: int, delimiter: str) -> Rows:
    """The rows of names, units or remarks before the first row of data, which is the last of `rows`."""
    *before, (line, _) = rows
    named = [len(cells) for _, cells in before if not _is_data(cells)]
    if delimiter == "," and named and 2 < named[-1] <= width / 1.5:
        allowed = f"{named[-1]} cells, one a name of the header (a comma can't separate cells and mark decimals too)"
        raise BadInput(path, f"line {line}", f"{width} cells", allowed)
    return [(i, cells) for i, cells in before if _of_width(cells, width) and not _is_data(cells)]


def _data(path, rows: Rows, width: int, names: Sequence[list[str]], left_out: Counter, damaged: list[int]) -> Rows:
    """The rows of data. Others are counted in `left_out` by reason, or their lines are added to the `damaged`. BadInput."""
    data = []
    for line, cells in rows:
        if len(cells) != width and line == rows[-1][0]:
            left_out["cut off at the end"] += 1
        elif cells in names:
            left_out["names once more"] += 1
        elif any(sorted(cells) == sorted(row) for row in names):
            found, allowed = "the names again, in another order", "one order of the columns in all rows"
            raise BadInput(path, f"line {line}", found, allowed, "two files: that line begins the second")
        elif len(cells) == width or (len(cells) == width + 1 and not cells[-1]):
            data.append((line, cells[:width]))
        elif not any(cells):
            left_out["empty rows"] += 1
        else:
            damaged.append(line)
    if len(data) < 2:
        raise BadInput(path, "file", f"{len(data)} row of numbers", "two or more")
    return data


def _of_width(cells: Sequence[str], width: int) -> bool:
    """Whether a line before the numbers is a row of names, units or remarks for them. The last column may have no name (a comma
    at the line's end)."""
    more = len(cells) == width + 1 and (not cells[-1] or cells[-1].casefold() == "comment")  # LabVIEW's empty column
    return (len(cells) in (width, width - 1) or more) and sum(map(bool, cells)) * 2 >= width


def _commented(notes: Sequence[tuple[int, str]], first: int, delimiter: str, width: int) -> Rows:
    """The names, and perhaps their units, in the last two comments before the `first` line of numbers."""
    last = [(i, _cells(line.strip().lstrip("#%!/"), delimiter)) for i, line in notes if i < first][-2:]
    rows = [(i, cells) for i, cells in last if len(cells) == width and not _is_data(cells)]
    return rows if rows and (len(rows) == 1 or _units(rows[1][1])) and rows[-1] == last[-1] else rows[1:]


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
    proven: set[str] = set()
    for cell in (cell for row in rows[: 10 * _LOOK] for cell in row):
        if (both := _BOTH.fullmatch(cell)) and both[1] != both[2]:  # the other mark separates thousands
            return both[2]
        number = bool(_NUMBER.fullmatch(cell))
        if number and not both and not _THOUSANDS.fullmatch(cell):
            proven |= {"." if "." in cell else ","} & {*cell}
        commas += number and "," in cell
        points += "." in cell and "," not in cell and bool(_NUMBER.match(cell))
    if delimiter == ",":
        return "," if commas and not points else "."
    if len(proven) == 1:
        return proven.pop()
    if commas and points and not proven:
        found = "points and commas in cells of three digits behind them: either may separate thousands"
        raise BadInput(path, "decimal mark", found, "one that decides", "--decimal comma, or --decimal point")
    return "," if commas > points else "."


def _column(cells: Sequence[str], decimal: str) -> tuple[np.ndarray, str]:
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
