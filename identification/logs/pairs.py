"""Read lines that name each value, as serial monitors and JSON lines do: "t=12 ms, rpm=4000", {"t": 12, "rpm": 4000}.

The commonest sequence of names makes the columns. A line of other names is left out and counted.
"""

import re
from collections import Counter
from collections.abc import Sequence

_NAME = r"[^\W\d][\w.]*(?:[ -][\w.]+)*(?:\s*[(\[][^()\[\]]*[)\]])?"
_VALUE = r"[+-]?\d+(?:[.,]\d+)*(?:[eE][+-]?\d+)?|[+-]?[.,]\d+|(?i:nan|null|none|inf|-inf)\b"
_UNIT = r"[^\W\d_]{1,9}(?:/[a-z]{1,4})?|%|°"
_PAIR = re.compile(rf"[\"']?({_NAME})[\"']?\s*[=:]\s*[\"']?({_VALUE})[\"']?(?:\s*({_UNIT})(?!\s*[=:(\[]))?(?=[\s,;|}}\]]|$)")
STAMP = re.compile(r"\s*(\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)\s*->\s*")
"""The time that the Arduino's serial monitor writes before a line."""

_BETWEEN = re.compile(r"[\s,;|{}\[\]]*")

MOSTLY = 0.9
"""Minimum share of the lines that have the same names."""


def named_values(body: Sequence[tuple[int, str]], look: int) -> tuple[list[str], list[tuple[int, list[str]]]] | None:
    """(names, rows of cells with their line numbers) if most of `look` lines from the middle name two values or more in the
    same order; else None."""
    middle = max(0, len(body) // 2 - look // 2)
    sample = [_pairs(line) for _, line in body[middle : middle + look]]
    names, many = Counter(tuple(name for name, _ in pairs) for pairs in sample).most_common(1)[0]
    if len(set(names)) < max(2, len(names)) or many < MOSTLY * len(sample):
        return None
    found = [(i, _pairs(line)) for i, line in body]
    rows = [(i, [value for _, value in pairs]) for i, pairs in found if tuple(name for name, _ in pairs) == names]
    return list(names), rows


def _pairs(line: str) -> list[tuple[str, str]]:
    """(name, value with its unit) of each pair; empty if the line contains anything else."""
    stamp = STAMP.match(line)
    pairs, place = [("time", stamp[1])] if stamp else [], stamp.end() if stamp else 0
    while place < len(line):
        place = _BETWEEN.match(line, place).end()
        if place == len(line):
            break
        if (found := _PAIR.match(line, place)) is None:
            return []
        pairs.append((found[1], f"{found[2]} {found[3] or ''}".strip()))
        place = found.end()
    return pairs
