"""Tables as HTML."""

import re
from collections.abc import Sequence
from html import escape

from vpp_fmu.digits import number

_STARTS_AS_NUMBER = re.compile(
    r"[<>≈~±+\-−]?\s*(?!\d{4}-\d\d-\d\d)\d"
)  # a date is no number, nor is a name that begins with one

_WORDS, _PROSE = 20, 90
"""Number of letters from which a text wraps at a readable width; and from which a column of such texts gets a larger width, if
no other column does."""


def table(columns: Sequence[str], rows: Sequence[Sequence], caption: str) -> str:
    """A table of texts and numbers; columns of numbers are aligned right. `caption` is HTML."""
    cells = [[number(value) for value in row] for row in rows]
    right = [
        all(_STARTS_AS_NUMBER.match(row[k]) or row[k] in {"", "–", "∞", "−∞"} for row in cells) for k in range(len(columns))
    ]
    longest = [0 if right[k] else max((len(row[k]) for row in cells), default=0) for k in range(len(columns))]
    prose = sum(letters > _PROSE for letters in longest) == 1
    kinds = [
        ' class="number"'
        if right[k]
        else ' class="prose"'
        if prose and longest[k] > _PROSE
        else ' class="words"'
        if longest[k] > _WORDS
        else ' class="name"'
        if not any(" " in row[k] for row in cells)
        else ""
        for k in range(len(columns))
    ]
    head = "".join(f"<th{kind}>{escape(text)}</th>" for text, kind in zip(columns, kinds, strict=True))
    body = "\n".join(
        "<tr>" + "".join(f"<td{kind}>{escape(text)}</td>" for text, kind in zip(row, kinds, strict=True)) + "</tr>"
        for row in cells
    )
    return (
        f'<div class="table"><table>\n<caption>{caption}</caption>\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )
