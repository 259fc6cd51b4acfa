"""A self-contained HTML page that opens from a file without a network."""

import re
from collections.abc import Sequence
from html import escape
from importlib.metadata import version
from textwrap import dedent

from plotly import graph_objects as go

from vpp_fmu.app.report.drawing import SCRIPT, Arrays, drawing, heading
from vpp_fmu.app.report.sheet import SHEET
from vpp_fmu.date import now
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


_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'"
"""Forbids all requests of the browser."""

_HINT = "Figures: point at a line to read it, drag to zoom, double-click to go back, click on a name to hide it."


class Page:
    """A report, built from top to bottom; `tiles` are always above everything else.

    `source`: the measurement and its date; it is above the title, with the date of the report.
    """

    def __init__(self, title: str, summary: str, source: str = ""):
        self.title = title
        self.source = source
        self.summary = summary
        self._tiles: list[str] = []
        self._parts: list[str] = []
        self._sections: list[str] = []
        self.figures: list[go.Figure] = []
        self._arrays = Arrays()
        self._tables = 0

    def tiles(self, tiles: Sequence[tuple[str, object, str]]) -> None:
        """Key figures (label, value, note) at the top of the page."""
        for label, value, note in tiles:
            self._tiles.append(
                f'<div class="tile"><div class="label">{escape(label).replace("_", "_<wbr>")}</div>'
                f'<div class="value">{escape(number(value))}</div><div class="small">{escape(note)}</div></div>'
            )

    def section(self, title: str, text: str = "") -> None:
        """A heading and its paragraphs, separated by empty lines."""
        self._sections.append(title)
        self._parts.append(f'<h2 id="section-{len(self._sections)}">{escape(title)}</h2>\n{_paragraphs(text)}')

    def figure(self, fig: go.Figure, caption: str) -> int:
        """A figure, as wide as the page; returns its number."""
        self.figures.append(fig)
        name = f"figure-{len(self.figures)}"
        title = heading(fig)
        self._parts.append(
            f'<figure><h3>{escape(title)}</h3>\n<div id="{name}" class="plot" data-title="{escape(title)}"></div>\n'
            f"<script>draw({name!r},{drawing(fig, self._arrays)})</script>\n"
            f"<figcaption><b>Figure {len(self.figures)}.</b> {escape(caption)}</figcaption></figure>"
        )
        return len(self.figures)

    def diagram(self, svg: str, title: str, caption: str) -> None:
        """A drawing that shows no data, as SVG in the text's own colour."""
        self._parts.append(f"<figure><h3>{escape(title)}</h3>\n{svg}\n<figcaption>{escape(caption)}</figcaption></figure>")

    def table(self, columns: Sequence[str], rows: Sequence[Sequence], caption: str) -> None:
        """A table; the columns' names include the units. Reals have four significant digits."""
        self._tables += 1
        self._parts.append(table(columns, rows, f"<b>Table {self._tables}.</b> {escape(caption)}"))

    def note(self, text: str) -> None:
        """An important remark."""
        self._parts.append(f"<aside>{_paragraphs(text)}</aside>")

    def html(self) -> str:
        """The page; the same input gives the same bytes."""
        script = f"<script>\n{SCRIPT}</script>\n" if self.figures else ""
        hint = f'<p class="hint">{_HINT}</p>\n' if self.figures else ""
        source = " · ".join(filter(None, (self.source, f"report of {now()[:10]}")))
        tiles = f'<div class="tiles">{"".join(self._tiles)}</div>\n' if self._tiles else ""
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escape(self.title)}</title>\n<style>{SHEET}</style>\n{script}</head>\n<body>\n<main>\n"
            f'<header><p class="source">{escape(source)}</p>\n<h1>{escape(self.title)}</h1>\n'
            f"{_paragraphs(self.summary)}</header>\n{tiles}{self._contents()}{hint}"
            + "\n".join(self._parts)
            + f"\n</main>\n<footer>Made by vpp-fmu {escape(version('vpp-fmu'))}.</footer>\n</body>\n</html>\n"
        )

    def _contents(self) -> str:
        """Links to the sections, if there are many."""
        if len(self._sections) < 3:
            return ""
        links = (f'<a href="#section-{k}">{escape(title)}</a>' for k, title in enumerate(self._sections, start=1))
        return f"<nav>{''.join(links)}</nav>\n"


def _paragraphs(text: str) -> str:
    """Text, split at empty lines, as escaped paragraphs; indented text, an equation, line by line."""
    parts = [part for part in text.split("\n\n") if part.strip()]
    return "\n".join(
        f"<pre>{escape(dedent(part))}</pre>" if part.startswith("    ") else f"<p>{escape(part.strip())}</p>" for part in parts
    )
