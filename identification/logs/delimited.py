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
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from identification.logs.raw_table import EMPTY, RawTable, plain
from identification.logs.units import QUANTITIES, factor_of, is_unit
from vpp_fmu.errors import BadInput
from vpp_fmu.files import read_bytes, shown

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "space": " "}
"""Delimiters by their name as an option; a space matches several."""

COMMENTS = ("#", "%", "//", "!")

_MARKS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32"}
_MARKS |= {codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
"""Encodings by byte order mark."""

_LOOK = 400
"""Lines from the middle of the file, by which its form is detected: exceptions are at its head."""

DAMAGED = 0.01
"""Maximum share of damaged lines, which are left out."""

MOSTLY = 0.9
"""Minimum share of the lines that name the same values."""

_NUMBER = re.compile(r"[+-]?(\d[\d'\u2019\xa0\u202f.,]*|[.,]\d+)([eEdD][+-]?\d+)?")
_TIME = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([T ].*)?|(\d+ days? )?\d{1,2}:\d{2}(:\d{2})?([.,]\d+)?(\s*[AaPp][Mm])?")
_BOTH = re.compile(r"[+-]?\d{1,3}(?:([.,])\d{3})+(?!\1)([.,])\d*")
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

Lines = Sequence[tuple[int, str]]
"""Lines with their numbers."""


def read_delimited(path: str | os.PathLike, given: Mapping[str, str]) -> RawTable:
    """Read a text table. `given`: those of `encoding`, `delimiter` and `decimal` that are not to be detected. BadInput."""
    text, encoding = _decoded(path, read_bytes(path), given.get("encoding"))
    lines = [(i, line) for i, line in enumerate(re.split(r"\r\n|\r|\n", text), 1) if line.strip()]
    body = [(i, line) for i, line in lines if not line.lstrip().startswith(COMMENTS)]
    if not body:
        raise BadInput(path, "file", f"{len(lines)} lines of comments and no other", "a table of numbers")
    left_out = Counter({"comments": len(lines) - len(body)})
    if pairs := without_names(body):
        left_out["lines without these values"] = len(body) + 1 - len(pairs)
    delimiter, rows, first = _split(path, pairs or body, "tab" if pairs else given.get("delimiter"))
    width = len(rows[first][1])
    head = _head(path, rows[: first + 1], width, delimiter)
    left_out["lines before the table"] = first - len(head)
    data, damaged = _data(path, rows[first:], width, [cells for _, cells in head], left_out)
    if not head:  # names in comments
        notes = [(i, _cells(line.lstrip("#%!/ "), delimiter)) for i, line in lines if i < data[0][0] and line[0] in "#%!/"]
        head = [(i, cells) for i, cells in notes if len(cells) == width and not _is_data(cells)][-2:]
        left_out["comments"] -= len(head)
    (_, one), (_, two), *_ = data
    if (one[0], two[0]) == ("1", "2") and one[-1] and all(len(cells) < width for _, cells in head):
        head = [(i, ["", *cells]) for i, cells in head]  # R gives the numbers of rows no name
    names, units, line = _header(path, head, width)
    left_out["lines before and after the names"] = max(0, len(head) - 1 - any(units))
    numbers, cells = np.array([i for i, _ in data]), [row for _, row in data]
    decimal = given.get("decimal") or _decimal(path, cells, delimiter)
    columns = [_column(column, decimal) for column in zip(*cells, strict=True)]
    broken = sorted({row for *_, rows in columns for row in rows})
    if damaged := sorted([*damaged, *numbers[broken].tolist()]):
        left_out[_said_of_damaged(path, damaged, len(data))] = len(damaged)
    read = {"encoding": encoding, "delimiter": {mark: name for name, mark in DELIMITERS.items()}.get(delimiter, delimiter)}
    form = "a name before each value" if pairs else f"cells separated by {read['delimiter']}"
    how = f"text in {encoding}, {form}, decimal {'comma' if decimal == ',' else 'point'}"
    how += "" if pairs else f", names on line {line}" if head else ", no names: columns are numbered"
    return RawTable(
        source=str(path),
        columns={name: np.delete(column, broken) for name, (column, *_) in zip(names, columns, strict=True)},
        lines=np.delete(numbers, broken),
        units={name: own or unit for name, own, (_, unit, _) in zip(names, units, columns, strict=True) if own or unit},
        how_read=how,
        read=read | {"decimal": decimal},
        left_out={reason: number for reason, number in left_out.items() if number},
        decimal=decimal,
    )


def _said_of_damaged(path, damaged: Sequence[int], rows: int) -> str:
    """The damaged lines by number, for `left_out`. BadInput if more than DAMAGED of the lines are damaged."""
    lines = f"line{'s' * (len(damaged) > 1)} {', '.join(map(str, damaged[:10]))}{', ...' * (len(damaged) > 10)}"
    if len(damaged) > DAMAGED * (rows + len(damaged)):
        found = f"{len(damaged)} damaged of {rows + len(damaged)}: cells are missing, too many, or no numbers"
        raise BadInput(path, lines, found, f"at most {100 * DAMAGED:g} % damaged lines", "the log without them")
    return f"damaged ({lines})"


def _decoded(path: str | os.PathLike, data: bytes, wanted: str | None) -> tuple[str, str]:
    """(text, encoding). Without a byte order mark, text that is not valid UTF-8 is taken as Windows-1252, unless other letters
    of it are UTF-8. Bytes that are invalid then damage their line only."""
    encoding = wanted or next((name for mark, name in _MARKS.items() if data.startswith(mark)), None)
    zeros = [data[k:4000:2].count(0) / max(1, len(data[k:4000:2])) for k in (0, 1)]
    if encoding is None and max(zeros) > 0.4 > min(zeros):
        encoding = "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
    if encoding is None:
        lines = data.split(b"\n")
        if sum(b"\0" in line for line in lines) > DAMAGED * len(lines):
            raise BadInput(path, "file", "bytes that are no text", "text, Parquet, MAT or HDF5")
        text = b"\n".join(line for line in lines if b"\0" not in line).decode("utf-8", "replace")  # no power-up garbage
        encoding = "utf-8" if "\ufffd" not in text or not text.replace("\ufffd", "").isascii() else "cp1252"
    errors = "replace" if not wanted and encoding in ("utf-8", "cp1252") else "strict"
    try:
        return data.decode(encoding, errors).removeprefix("\ufeff"), encoding
    except (UnicodeError, LookupError) as error:
        raise BadInput(path, "encoding", f"bytes that are no {encoding}", "the encoding it was written in") from error


def without_names(body: Lines) -> Lines:
    """Lines that name their values as rows of a table, its names first, if most lines from the middle name two or more in the
    same order; else none. A line of other names is left out."""
    sample = [_pairs(line)[0] for _, line in _middle(body)]
    names, many = Counter(sample).most_common(1)[0]
    if len(set(names)) < max(2, len(names)) or many < MOSTLY * len(sample):
        return []
    found = [(i, *_pairs(line)) for i, line in body]
    first = next(row for _, own, row in found if own == names)
    stamp = _STAMP.match(first)
    title = (stamp[0] if stamp else "") + "\t".join(names)
    return [(0, title), *((i, row) for i, own, row in found if own == names)]


def _middle(body: Lines) -> Lines:
    first = max(0, len(body) // 2 - _LOOK // 2)
    return body[first : first + _LOOK]


def _pairs(line: str) -> tuple[tuple[str, ...], str]:
    """(names, values with their units, separated by tabs) of a line of pairs; empty if the line contains anything else."""
    stamp = _STAMP.match(line)
    names, values, place = [], [], stamp.end() if stamp else 0
    while (place := _BETWEEN.match(line, place).end()) < len(line):
        if (found := _PAIR.match(line, place)) is None:
            return (), ""
        names.append(found[1])
        values.append(f"{found[2]} {found[3] or ''}".strip())
        place = found.end()
    return tuple(names), (stamp[0] if stamp else "") + "\t".join(values)


def _split(path, body: Lines, wanted: str | None) -> tuple[str, Rows, int]:
    """(delimiter, cells of the lines, place of the first row of numbers). The delimiter is the `wanted` one, else that by which
    most lines from the middle are rows of one width with the most numbers. BadInput if there are no such rows."""
    tried = [DELIMITERS.get(wanted, {"\\t": "\t"}.get(wanted, wanted))] if wanted else [*DELIMITERS.values()]
    if len(tried[0]) != 1 or tried[0].isalnum() or tried[0] in "\"'.+-\n":
        raise BadInput("command line", "--delimiter", shown(wanted), f"one character, or one of {', '.join(DELIMITERS)}")
    sample, scores = _middle(body), {}
    for delimiter in tried:
        rows = [row for _, line in sample if _is_data(row := _cells(line, delimiter))]
        width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
        rows = [row for row in rows if len(row) == width]
        filled = [cell for row in rows for cell in row if cell.lower() not in EMPTY]
        if width > 1 and 10 * len(rows) > len(sample):
            values = sum(map(_is_value, filled)) / len(filled)
            score = round(values * len(rows) / len(sample), 2), width if delimiter != " " else 0
            scores[delimiter] = score, width
    if not scores:
        found = f"{len(body)} line{'s' * (len(body) > 1)} without numbers"
        hint = f"--delimiter D for another than {', '.join(DELIMITERS)}"
        raise BadInput(path, "file", found, "rows of numbers under the names", hint)
    delimiter = max(scores, key=scores.get)
    width = scores[delimiter][1]
    rows = [(i, _cells(line, delimiter)) for i, line in body]
    data = [k for k, (_, cells) in enumerate(rows) if len(cells) == width and _is_data(cells)]
    # numbers behind a word may come before the names: LabVIEW counts its samples first
    first = next((k for k in data if _is_value(rows[k][1][0])), data[0])
    named = any(_of_width(cells, width) and not any(map(_is_value, cells)) for _, cells in rows[data[0] : first])
    return delimiter, rows, first if named else data[0]


def _cells(line: str, delimiter: str) -> list[str]:
    """The cells of a line; the time that a serial monitor has written before it becomes the last one."""
    if stamp := _STAMP.match(line):
        cells = _cells(line[stamp.end() :], delimiter)
        return [*cells, stamp[1] if any(map(_is_value, cells)) else "monitor"]
    if delimiter == " ":  # a unit in brackets belongs to its name
        return [cell.strip('"') for cell in re.findall(r'"[^"]*"|\S+(?:\s+[(\[{]\S*[)\]}](?!\S))*', line)]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
    except csv.Error:
        return line.split(delimiter)


def _is_value(cell: str) -> bool:
    """Whether a cell is a number, with or without a unit, or a time."""
    return _quantity(cell) is not None or bool(_TIME.fullmatch(cell)) or ("T" in cell and bool(_TIME.match(cell)))


def _quantity(text: str) -> tuple[str, str] | None:
    """(number, unit) of a cell such as "12.3 N", the unit "" if there is none."""
    if (found := _NUMBER.match(text)) is None:
        return None
    rest = text[found.end() :].strip()
    return (found[0], rest) if not rest or _BEHIND.fullmatch(rest) else None


def _is_data(cells: Sequence[str]) -> bool:
    """Whether half of a row's filled cells or more are values."""
    filled = [cell for cell in cells if cell.lower() not in EMPTY]
    return bool(filled) and 2 * sum(map(_is_value, filled)) >= len(filled)


def _head(path, rows: Rows, width: int, delimiter: str) -> Rows:
    """The rows of names, units or remarks before the first row of data, which is the last of `rows`."""
    *before, (line, _) = rows
    named = [len(cells) for _, cells in before if not _is_data(cells)]
    if delimiter == "," and named and 2 < named[-1] <= width / 1.5:
        allowed = f"{named[-1]} cells, one a name of the header (a comma can't separate cells and mark decimals too)"
        raise BadInput(path, f"line {line}", f"{width} cells", allowed)
    return [(i, cells) for i, cells in before if _of_width(cells, width) and not _is_data(cells)]


def _data(path, rows: Rows, width: int, names: Sequence[list[str]], left_out: Counter) -> tuple[Rows, list[int]]:
    """(rows of data, lines that are damaged). Others are counted in `left_out` by reason. BadInput."""
    data, damaged = [], []
    for line, cells in rows:
        if len(cells) == width or (len(cells) == width + 1 and not cells[-1]):
            if not any(sorted(cells) == sorted(row) for row in names):
                data.append((line, cells[:width]))
            elif cells in names:
                left_out["names once more"] += 1
            else:
                found, allowed = "the names again, in another order", "one order of the columns in all rows"
                raise BadInput(path, f"line {line}", found, allowed, "two files: that line begins the second")
        elif line == rows[-1][0]:
            left_out["cut off at the end"] += 1
        elif any(cells):
            damaged.append(line)
    if len(data) < 2:
        raise BadInput(path, "file", f"{len(data)} row of numbers", "two or more")
    return data, damaged


def _of_width(cells: Sequence[str], width: int) -> bool:
    """Whether a line before the numbers is a row of names, units or remarks for them. The last column may have no name (a comma
    at the line's end)."""
    more = len(cells) == width + 1 and (not cells[-1] or cells[-1].casefold() == "comment")  # LabVIEW's empty column
    return (len(cells) in (width, width - 1) or more) and sum(map(bool, cells)) * 2 >= width


def _header(path, head: Rows, width: int) -> tuple[list[str], list[str], int]:
    """(names, units, line of the names) of the rows before the numbers. Names are in the row of most different cells, of such
    rows in that before the units, else in the last."""
    if not head:
        return [str(k) for k in range(1, width + 1)], [""] * width, 0
    rows = [[*cells, *[""] * width][:width] for _, cells in head]
    twice = len(rows) > 1 and any(n > 1 for unit, n in Counter(rows[0]).items() if unit)  # names differ: LabVIEW's units
    units = next((k for k, row in enumerate(rows) if (k or twice) and _units(row)), len(rows))
    named = max(range(len(rows)), key=lambda k: (k != units, len({*rows[k]}), k == units - 1, k))
    names = []
    for k, name in enumerate(rows[named], 1):
        clean = " ".join(name.split())
        if not clean.isprintable():
            raise BadInput(path, f"line {head[named][0]}, column {k}", shown(clean), "a name of printable characters")
        names.append(f"{clean}.{k}" if clean in names else clean or str(k))
    found = [unit.strip("()[]{}<> ") for unit in rows[units]] if units < len(rows) else [""] * width
    return names, [unit if is_unit(unit) else "" for unit in found], head[named][0]


def _units(row: Sequence[str]) -> bool:
    """Whether a row before the numbers is a row of units: at least half of its cells are units of a quantity."""
    filled = [cell.strip("()[]{}<> ") for cell in row if cell.strip("()[]{}<> -")]
    return bool(filled) and 2 * sum(map(_is_unit, filled)) >= len(filled)


def _is_unit(text: str) -> bool:
    return any(factor_of(q, text) is not None for q in QUANTITIES.values() if q.unit or text in ("us", "µs", "%"))


def _decimal(path, rows: Sequence[Sequence[str]], delimiter: str) -> str:
    """The decimal mark: that of cells in which it can't separate thousands, if only one mark has such cells; else of most.
    BadInput if both marks occur, and each may separate thousands."""
    cells = [cell for row in rows[: 10 * _LOOK] for cell in row if _NUMBER.match(cell)]
    if both := next(filter(None, map(_BOTH.fullmatch, cells)), None):  # the other mark separates thousands
        return both[2]
    having = {",": [cell for cell in cells if "," in cell and _NUMBER.fullmatch(cell)]}
    having["."] = [cell for cell in cells if "." in cell and "," not in cell]
    if delimiter == ",":
        return "," if having[","] and not having["."] else "."
    proven = [mark for mark, own in having.items() if any(_NUMBER.fullmatch(c) and not _THOUSANDS.fullmatch(c) for c in own)]
    if all(having.values()) and not proven:
        found = "points and commas in cells of three digits behind them: either may separate thousands"
        raise BadInput(path, "decimal mark", found, "one that decides", "--decimal comma, or --decimal point")
    return proven[0] if len(proven) == 1 else "," if len(having[","]) > len(having["."]) else "."


def _column(cells: Sequence[str], decimal: str) -> tuple[np.ndarray, str, Collection[int]]:
    """(cells, as numbers if all are; the unit that follows all numbers, or ""; rows whose cell is damaged).

    A damaged cell has digits and is no number, as all but a share DAMAGED of the column's cells are. A word such as "overload"
    is a message of the logger and no damage.
    """
    with contextlib.suppress(ValueError):
        if decimal == ".":
            return _floats(cells), "", ()
    texts = [plain(cell, decimal) for cell in cells]
    with contextlib.suppress(ValueError):
        return _floats(texts), "", ()
    filled = [k for k, text in enumerate(texts) if text]
    bad = {k for k in filled if not _is_value(texts[k]) or (_NUMBER.fullmatch(texts[k]) and not _MACHINE.fullmatch(texts[k]))}
    if len(bad) > DAMAGED * len(filled) or not all(re.search(r"\d", texts[k]) for k in bad):
        bad = set()
    parts = [_quantity(texts[k]) for k in {*filled} - bad]
    units = {part[1] if part else None for part in parts}
    unit = next(iter(units)) if len(units) == 1 else None
    if unit is not None and (not unit or any(factor_of(q, unit) for q in QUANTITIES.values())):
        numbers = ["" if k in bad else plain(cell.removesuffix(unit), decimal) for k, cell in enumerate(cells)]
        if all(_MACHINE.fullmatch(number) for number in numbers if number):
            return _floats(numbers), unit, bad
    return np.array(cells, dtype=object), "", bad


def _floats(texts: Sequence[str]) -> np.ndarray:
    """Numbers, NaN for empty cells. ValueError for other text: 1_000, too, which Python reads."""
    return np.array(["x" if "_" in text else text or "nan" for text in texts]).astype(float)
