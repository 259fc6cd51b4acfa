"""Tables as HTML."""

import re
from collections.abc import Sequence
from html import escape

from vpp_fmu.digits import number

_STARTS_AS_NUMBER = re.compile(r"[<>≈~±+\-−]?\s*\d")


def table(columns: Sequence[str], rows: Sequence[Sequence], caption: str) -> str:
    """A table of texts and numbers; a column of numbers only is set flush right. `caption` is HTML."""
    cells = [[number(value) for value in row] for row in rows]
    right = [
        all(_STARTS_AS_NUMBER.match(row[k]) or row[k] in {"", "–", "∞", "−∞"} for row in cells) for k in range(len(columns))
    ]
    head = "".join(_cell("th", text, flush) for text, flush in zip(columns, right, strict=True))
    body = "\n".join(
        "<tr>" + "".join(_cell("td", text, flush) for text, flush in zip(row, right, strict=True)) + "</tr>" for row in cells
    )
    return (
        f'<div class="table"><table>\n<caption>{caption}</caption>\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def _cell(tag: str, text: str, flush_right: bool) -> str:
    return f'<{tag} class="number">{escape(text)}</{tag}>' if flush_right else f"<{tag}>{escape(text)}</{tag}>"
