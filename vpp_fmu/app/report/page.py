"""A self-contained HTML page that opens from a file without a network."""

import re
from collections.abc import Sequence
from html import escape
from importlib.metadata import version
from importlib.resources import files
from textwrap import dedent

from vpp_fmu.app.report.canvas import MOST, SCRIPT, Figure
from vpp_fmu.app.report.style import FONT, SCHEME
from vpp_fmu.date import now
from vpp_fmu.digits import TABLE, number

_NUMBER = re.compile(r"[<>≈~±+\-−]?\s*(?!\d{4}-\d\d-\d\d)\d|[–∞]?$|−∞$")
"""Start of a number. A date is not a number, nor is a name that begins with a date."""

_WORDS = 20
"""Number of letters from which a text wraps at a readable width."""

_UNIT = re.compile(r"(?<=\d) (?=(?:N|rpm|deg|s|ms|Hz|V|A|W|K|%|nats?|N\.m|rpm/s|deg/s|m/s|kHz|mm|kg|min)(?![\w]))")
"""Space between a number and its unit."""

_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'"
"""Forbids all requests of the browser."""

_HINT = "Figures: point at a line to read it, drag to zoom, double-click to go back, click on a name to hide it."


_COLOURS = {
    "paper": ("#ffffff", "#14191f"),
    "ink": ("#1f2933", "#e4e9ee"),
    "quiet": ("#5f6c7b", "#9aa7b4"),
    "line": ("#d9dfe5", "#36404a"),
    "grid": ("#e8ecef", "#262e36"),
    "axis": ("#9aa5b1", "#5d6975"),
    "hovered": ("#f5f7f9", "#1d242b"),
    "warning": ("#fdf6ec", "#2b2317"),
}
"""Colours of the page by name, light and dark."""


def _colours(which: int) -> str:
    figures = {name: (light, dark) for light, (name, dark) in SCHEME.items()}
    return " ".join(f"--{name}: {both[which]};" for name, both in (_COLOURS | figures).items())


_STYLE = (
    f":root {{ {_colours(0)} }}\n@media screen and (prefers-color-scheme: dark) {{ :root {{ {_colours(1)} }} }}\n"
    f"body {{ font-family: {FONT}; }}\n{files(__package__).joinpath('page.css').read_text(encoding='utf-8')}"
)
"""The style sheet: for wide and narrow screens, light and dark, and for paper."""


class Link(str):
    """Text of a table or note that leads to a file, given relative to the page's folder."""

    file: str

    def __new__(cls, text: str, file: str) -> "Link":
        made = super().__new__(cls, text)
        made.file = file
        return made


class Page:
    """A report, built from top to bottom; `tiles` are always above everything else.

    `source`: the measurement and its date; it is above the title, with the date of the report.
    """

    def __init__(self, title: str, summary: str, source: str = ""):
        self.title = title
        self.source = source
        self.summary = summary.replace(" -> ", " → ")  # plain text has no arrow
        self._tiles: list[str] = []
        self._findings = ""
        self._parts: list[str] = []
        self._sections: list[str] = []
        self.figures: list[Figure] = []
        self._arrays: dict[str, int] = {}
        self._tables = 0

    def tiles(self, tiles: Sequence[tuple[str, object, str]]) -> None:
        """Key figures (label, value, note) at the top of the page."""
        for label, value, note in tiles:
            self._tiles.append(
                f'<div class="tile"><div class="label">{escape(label)}</div>'
                f'<div class="value">{escape(_whole(number(value)))}</div><div class="small">{escape(_whole(note))}</div></div>'
            )

    def findings(self, lines: Sequence[str]) -> None:
        """Add a short list under the tiles."""
        items = "".join(f"<li>{_html(line) if isinstance(line, Link) else escape(_whole(line))}</li>" for line in lines)
        self._findings = f'<ul class="findings">{items}</ul>\n' if lines else ""

    def section(self, title: str, text: str = "") -> None:
        """A heading and its paragraphs, separated by empty lines."""
        self._sections.append(title)
        self._parts.append(f'<h2 id="section-{len(self._sections)}">{escape(title)}</h2>\n{_paragraphs(text)}')

    def figure(self, fig: Figure, caption: str = "") -> None:
        """A figure, as wide as the page."""
        if fig.samples > MOST:
            caption += f" Drawn are at most {MOST} of the {fig.samples} samples, the extremes of every line among them."
        self.figures.append(fig)
        name = f"figure-{len(self.figures)}"
        title = escape(fig.title)
        self._parts.append(
            f'<figure><h3>{title}</h3>\n<div id="{name}" class="plot" data-title="{title}"></div>\n'
            f"<script>draw({name!r},{fig.drawing(self._arrays)})</script>\n"
            f"<figcaption><b>Figure {len(self.figures)}.</b> {escape(caption)}</figcaption></figure>"
        )

    def table(self, columns: Sequence[str], rows: Sequence[Sequence], caption: str) -> None:
        """A table; the columns' names include the units. Reals have four significant digits."""
        self._tables += 1
        self._parts.append(_table(columns, rows, f"<b>Table {self._tables}.</b> {escape(caption)}"))

    def note(self, text: str) -> None:
        self._parts.append(f"<aside>{_paragraphs(text)}</aside>")

    def remarks(self, lines: Sequence[str]) -> None:
        """Add remarks, given without capital and full stop, as paragraphs of one note."""
        if lines:
            self.note("\n\n".join(f"{line[0].upper()}{line[1:]}." for line in lines))

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
            f"<title>{escape(self.title)}</title>\n<style>{_STYLE}</style>\n{script}</head>\n<body>\n<main>\n"
            f'<header><p class="source">{escape(source)}</p>\n<h1>{escape(self.title)}</h1>\n'
            f"{_paragraphs(self.summary)}</header>\n{tiles}{self._findings}{self._contents()}{hint}"
            + "\n".join(self._parts)
            + f"\n</main>\n<footer>Made by vpp-fmu {escape(version('vpp-fmu'))}.</footer>\n</body>\n</html>\n"
        )

    def _contents(self) -> str:
        """Links to the sections, if there are many."""
        if len(self._sections) < 3:
            return ""
        links = (f'<a href="#section-{k}">{escape(title)}</a>' for k, title in enumerate(self._sections, start=1))
        return f"<nav>{''.join(links)}</nav>\n"


def _whole(text: str) -> str:
    """Text in which no line ends between a number and its unit."""
    return _UNIT.sub("\u00a0", text)


def _paragraphs(text: str) -> str:
    """Text, split at empty lines, as escaped paragraphs; indented text, an equation, line by line."""
    parts = [part for part in text.split("\n\n") if part.strip()]
    return "\n".join(
        f"<pre>{escape(dedent(part))}</pre>" if part.startswith("    ") else f"<p>{escape(_whole(part.strip()))}</p>"
        for part in parts
    )


def _table(columns: Sequence[str], rows: Sequence[Sequence], caption: str) -> str:
    """A table of texts and numbers; columns of numbers are aligned right. `caption` is HTML."""
    cells = [[value if isinstance(value, Link) else number(value, TABLE) for value in row] for row in rows]
    kinds = [_kind([row[k] for row in cells]) for k in range(len(columns))]
    marks = [f' class="{kind}"' if kind else "" for kind in kinds]

    def line(tag: str, texts: Sequence[str]) -> str:
        parts = (f"<{tag}{mark}>{_html(text)}</{tag}>" for text, mark in zip(texts, marks, strict=True))
        return f"<tr>{''.join(parts)}</tr>"

    body = "\n".join(line("td", row) for row in cells)
    return (
        f'<div class="table"><table>\n<caption>{caption}</caption>\n<thead>{line("th", columns)}</thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def _html(text: str) -> str:
    return f'<a href="{escape(text.file)}">{escape(text)}</a>' if isinstance(text, Link) else escape(text)


def _kind(cells: Sequence[str]) -> str:
    """The class of a column in the style sheet."""
    if all(map(_NUMBER.match, cells)):
        return "number"
    if max(map(len, cells)) > _WORDS:
        return "words"
    return "" if any(" " in cell for cell in cells) else "name"
