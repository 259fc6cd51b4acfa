"""HTML of objects in a notebook."""

from collections.abc import Iterable, Sequence
from html import escape

from vpp_fmu.digits import TABLE, number


def table_html(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A small table as HTML; numbers with four significant digits, all text escaped."""
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join("<tr>" + "".join(f"<td>{escape(number(cell, TABLE))}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><caption>{escape(title)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
