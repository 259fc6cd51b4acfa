"""Code blocks of the site's pages, in order: commands and scripts for a reader to type, and the tests that run them."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from docs.site.included import DOCS, with_included

_META = re.compile(r"---\n(.*?)\n---\n", re.S)
_FENCE = re.compile(r"^( *)```(\w*)(?: +title=\"(.+?)\")?\n(.*?)^\1```$", re.M | re.S)
_INDENTED = re.compile(r"(?:^    (?:vpp (?![\w-]+:)|export |\.venv/bin/).*\n)+", re.M)
_MARK = re.compile(r"<!-- (not run|run by|file): (.+?) -->\s*\Z")
_VPP = re.compile(r"^(?:\.venv/bin/)?vpp (?![\w-]+:)(.*)$", re.M)
_COMMANDS = r"sudo|cd|echo|vpp|fmpy|make|pip|pipx|uvx|python3?|docker|conda|avr-[\w+]+|avrdude|ssh"
_TYPED = re.compile(rf"^(?:\$ )?(?:\.?venv/bin/)?(?:{_COMMANDS}) ", re.M)


@dataclass(frozen=True)
class Block:
    """`kind`: sh, python, text, json, or "" where the page gives none. `file`: its file name. `skipped`: reason, or the test
    that runs it; empty if it is to be run. `run_by`: that test."""

    page: str
    kind: str
    text: str
    file: str = ""
    skipped: str = ""
    run_by: str = ""

    @property
    def typed(self) -> bool:
        """Whether a reader types it: commands or Python."""
        return self.kind in ("sh", "python") or (self.kind == "" and bool(_TYPED.search(self.text)))

    @property
    def vpp(self) -> list[str]:
        """Its `vpp` commands, without that word."""
        return _VPP.findall(self.text) if self.kind in ("", "sh") else []


@dataclass(frozen=True)
class Page:
    """A page: its blocks; `after`: the page in whose folder it continues; `seconds`: approximate time of its blocks."""

    name: str
    blocks: tuple[Block, ...]
    after: str
    seconds: float


def pages() -> list[Page]:
    """All pages that are written by hand, with the texts that they include."""
    return [page(path.relative_to(DOCS).as_posix()) for path in sorted(DOCS.rglob("*.md"))]


def page(name: str) -> Page:
    """A page by its path below docs/."""
    text = (DOCS / name).read_text(encoding="utf-8")
    found = _META.match(text)
    meta = dict(line.split(": ", 1) for line in found[1].splitlines()) if found else {}
    body = with_included(name, text[found.end() if found else 0 :])
    return Page(name, tuple(_blocks(name, body)), meta.get("after", ""), float(meta.get("seconds", 0)))


def _blocks(name: str, text: str) -> Iterator[Block]:
    fences = list(_FENCE.finditer(text))
    inside = [(fence.start(), fence.end()) for fence in fences]
    loose = [m for m in _INDENTED.finditer(text) if not any(begin <= m.start() < end for begin, end in inside)]
    for match in sorted([*fences, *loose], key=re.Match.start):
        mark = _MARK.search(text[: match.start()])
        kinds = {mark[1]: mark[2]} if mark else {}
        skipped = kinds.get("not run", "") or kinds.get("run by", "")
        if match.re is _INDENTED:
            yield Block(name, "sh", _dedented(match[0], 4), "", skipped, kinds.get("run by", ""))
        else:
            indent, kind, title, body = match.groups()
            file = title or kinds.get("file", "")
            yield Block(name, kind, _dedented(body, len(indent)), file, skipped, kinds.get("run by", ""))


def _dedented(text: str, width: int) -> str:
    return "".join(line[width:] if line[:width].isspace() else line for line in text.splitlines(keepends=True))
