"""Tables of tests/README.md: each is between two comments, and the command that prints it also writes it there."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "tests" / "README.md"


def table(columns: Sequence[str], rows: Iterable[Sequence]) -> str:
    """A table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join('-' if cell is None else str(cell) for cell in line)} |\n" for line in lines)


def stored(name: str, page: str | None = None) -> str:
    """The table of that name in the page. KeyError: there is none."""
    return _place(name, PAGE.read_text() if page is None else page)[2]


def written(name: str, content: str, page: str) -> str:
    """The page with the table of that name replaced. KeyError: there is none."""
    found = _place(name, page)
    return page[: found.start(2)] + content + page[found.end(2) :]


def _place(name: str, page: str) -> re.Match:
    found = re.search(rf"(<!-- table {name}: [^>]*-->\n)(.*?)(<!-- end of {name} -->)", page, flags=re.DOTALL)
    if found is None:
        raise KeyError(name)
    return found


def add_write(parser) -> None:
    """Add the option that `show` takes."""
    parser.add_argument("--write", action="store_true", help="put the table into tests/README.md, too")


def show(name: str, content: str, write: bool) -> None:
    """Print a table; `write`: put it into the page."""
    print(f"\n{content}", end="")
    if write:
        PAGE.write_text(written(name, content, PAGE.read_text()))
