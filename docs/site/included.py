"""Include sections of READMEs in pages of the site, with their links and pictures."""

import re
from collections.abc import Iterator
from os.path import normpath, relpath
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

INCLUDE = re.compile(r"^<!-- include (?P<file>\S+?)(?: # (?P<title>.+?))? -->$", re.M)
"""A line that is replaced by a file without its title, or by the section of that title without its heading; Python
is a block of code under the file's name."""

_HEADING = re.compile(r"(#+) (.*)")
_LINK = re.compile(r"(!?)\[([^]]*)\]\((?!https?:)([^)#\s]+)(#[^)]*)?\)")
_ITEM = re.compile(r" *(?:[-*]|\d+\.) ")


class Missing(Exception):
    """A page includes a file or a section that is not there."""


def with_included(page: str, text: str) -> str:
    """The Markdown of a page, with the included text; `page`: its path below docs/."""

    folder = PurePosixPath("docs", page).parent

    def included(found: re.Match) -> str:
        above = [len(match[1]) for line in prose(text[: found.start()]) if (match := _HEADING.match(line))]
        body = section(found["file"], found["title"], (above or [1])[-1] + 1)
        return _LINK.sub(lambda link: _moved(link, PurePosixPath(found["file"]).parent, page), body)

    own = _LINK.sub(lambda link: _moved(link, folder, page) if _leaves(folder / link[3]) else link[0], text)
    return python_markdown(INCLUDE.sub(included, own))


def _leaves(target: PurePosixPath) -> bool:
    return not normpath(target).startswith("docs/")


def section(file: str, title: str | None, level: int) -> str:
    """A section of a file, or the file, without its heading; its own headings begin at `level`."""
    if not (ROOT / file).is_file():
        raise Missing(f"{file}: no such file")
    lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
    if file.endswith(".py"):
        return "\n".join([f'```python title="{PurePosixPath(file).name}"', *lines, "```"])
    heads = [(k, *_HEADING.match(lines[k]).groups()) for k in _outside_fences(lines) if _HEADING.match(lines[k])]
    if title is None:
        begin, depth, end = heads[0][0], len(heads[0][1]), len(lines)
    else:
        at = next((n for n, (_, _, words) in enumerate(heads) if words == title), None)
        if at is None:
            raise Missing(f"{file}: no section {title!r}")
        begin, depth = heads[at][0], len(heads[at][1])
        end = next((k for k, marks, _ in heads[at + 1 :] if len(marks) <= depth), len(lines))
    inside = {k: f"{'#' * (len(marks) - depth - 1 + level)} {words}" for k, marks, words in heads}
    return "\n".join(inside.get(k, lines[k]) for k in range(begin + 1, end)).strip("\n")


def homes() -> dict[str, str]:
    """The first page that includes a file, by file."""
    found: dict[str, str] = {}
    for path in sorted(DOCS.rglob("*.md")):
        for match in INCLUDE.finditer(path.read_text(encoding="utf-8")):
            found.setdefault(match["file"], path.relative_to(DOCS).as_posix())
    return found


def picture(file: str) -> str:
    """The site's path of a picture of the project."""
    return f"pictures/{PurePosixPath(file).name}"


def pictures() -> Iterator[str]:
    """Files of pictures in pages, and in the text that they include."""
    for path in sorted(DOCS.rglob("*.md")):
        text = path.read_text(encoding="utf-8")
        folder = path.relative_to(ROOT).parent
        named = (normpath(folder / link[3]) for link in _LINK.finditer(text) if link[1])
        yield from (file for file in named if not file.startswith("docs/"))
        for match in INCLUDE.finditer(text):
            for link in _LINK.finditer(section(match["file"], match["title"], 2)):
                if link[1]:
                    yield normpath(PurePosixPath(match["file"]).parent / link[3])


def _moved(link: re.Match, folder: PurePosixPath, page: str) -> str:
    """A link of a file in `folder`, converted for `page`. Without a page of the site, the file is only named."""
    bang, words, target, anchor = link[1], link[2], link[3], link[4] or ""
    file = normpath(folder / target)
    if not (ROOT / file).exists():
        raise Missing(f"{page}: {words} leads to {file}, which is not there")
    if bang:
        return f"![{words}]({relpath(picture(file), PurePosixPath(page).parent)})"
    home = file.removeprefix("docs/") if file.startswith("docs/") else homes().get(file)
    if home and (DOCS / home).suffix == ".md":
        return f"[{words}]({relpath(home, PurePosixPath(page).parent)}{anchor})"
    return f"`{file}`" if words.strip("`") in (target, file) else f"{words} (`{file}`)"


def prose(text: str) -> list[str]:
    """The lines outside fenced blocks."""
    lines = text.splitlines()
    return [lines[k] for k in _outside_fences(lines)]


def _outside_fences(lines: list[str]) -> Iterator[int]:
    fence = ""
    for k, line in enumerate(lines):
        mark = re.match(r" *(```+|~~~+)", line)
        if fence:
            fence = "" if mark and mark[1].startswith(fence) else fence
        elif mark:
            fence = mark[1]
        else:
            yield k


def python_markdown(text: str) -> str:
    """The text in the dialect of Python-Markdown: an empty line before a list, four spaces before the lines of an item."""
    lines = text.splitlines()
    outside = set(_outside_fences(lines))
    found: list[str] = []
    in_list = loose = False
    for k, line in enumerate(lines):
        new = line
        if k in outside:
            item = bool(_ITEM.match(line))
            before = found[-1] if found else ""
            if item and before.strip() and not before.startswith((" ", "|", "<!--")) and not _ITEM.match(before):
                found.append("")
            if line.strip() and not line.startswith(" ") and not item:
                in_list = in_list and bool(before.strip())  # a lazy continuation belongs to the item
            if item and not line.startswith(" "):
                if in_list and loose and before.strip() and not _ITEM.match(before):
                    found.append("")  # the item before had a paragraph of its own, which would go on
                loose = False
            loose = loose or (in_list and not line.strip())
            in_list = in_list or item
            if in_list and re.match(r" {2,3}\S", line):
                new = "    " + line.lstrip()
                if item and before.strip() and not _ITEM.match(before.replace("    ", "", 1)):
                    found.append("")
        found.append(new)
    return "\n".join(found) + "\n"
