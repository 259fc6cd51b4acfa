"""Tables as HTML."""

import re
from collections.abc import Sequence
from html import escape

from vpp_fmu.digits import number

_STARTS_AS_NUMBER = re.compile(r"[<>≈~±+\-−]?\s*\d")

_WORDS = 24
"""Letters from which on a text may wrap: it then keeps a width that can be read."""


def table(columns: Sequence[str], rows: Sequence[Sequence], caption: str) -> str:
    """A table of texts and numbers; a column of numbers only is set flush right. `caption` is HTML."""
    cells = [[number(value) for value in row] for row in rows]
    right = [
        all(_STARTS_AS_NUMBER.match(row[k]) or row[k] in {"", "–", "∞", "−∞"} for row in cells) for k in range(len(columns))
    ]
    kinds = [
        ' class="number"'
        if right[k]
        else ' class="words"'
        if max(map(len, (row[k] for row in cells)), default=0) > _WORDS
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
