"""Runs the blocks of a page in their order, in a separate folder."""

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.site.blocks import Block, Page, page


class Failed(Exception):
    """A block of a page does not do what the page says."""


def run(found: Page, folder: Path, done: dict[str, Path]) -> Path:
    """Run a page and return its folder; `done`: folders of the pages that were run before, by name. Raises Failed."""
    if found.name in done:
        return done[found.name]
    before = run(page(found.after), folder, done) if found.after else None
    own = Path(tempfile.mkdtemp(prefix=f"{Path(found.name).stem}-", dir=folder))
    if before:
        shutil.copytree(before, own, dirs_exist_ok=True)
    names, printed = {"__name__": "__main__"}, ""
    for block in found.blocks:
        if block.skipped:
            continue
        if block.file:
            (own / block.file).write_text(block.text)
        elif block.kind == "python":
            printed = _python(block, own, names)
        elif block.typed:
            printed = _shell(block, own)
        elif block.kind == "text":
            _expect(block, printed)
    done[found.name] = own
    return own


def _python(block: Block, folder: Path, names: dict) -> str:
    """Output of a script; the scripts of a page share their variables, as in a reader's session."""
    printed = io.StringIO()
    before = Path.cwd()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(printed):
            exec(compile(block.text, block.page, "exec"), names)
    except Exception as error:
        raise Failed(f"{block.page}: {type(error).__name__}: {error}\n{block.text}") from error
    finally:
        os.chdir(before)
    return printed.getvalue()


def _shell(block: Block, folder: Path) -> str:
    """Output of commands, which end at the first failure."""
    here = str(Path(sys.executable).parent)
    project = str(Path(__file__).parents[2])
    environment = os.environ | {"PATH": f"{here}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": project}
    script = block.text.replace(".venv/bin/", "")
    ended = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script], cwd=folder, env=environment, check=False, capture_output=True, text=True
    )
    if ended.returncode != 0:
        raise Failed(f"{block.page}: exit code {ended.returncode} of\n{script}\n{ended.stdout}{ended.stderr}")
    return ended.stdout


def _expect(block: Block, printed: str) -> None:
    """Check that a text after commands is a part of their output; "..." matches anything."""
    pattern = ".*".join(re.escape(part) for part in block.text.strip().split("..."))
    if not re.search(pattern, printed, flags=re.S):
        raise Failed(f"{block.page}: the page says\n{block.text}\nprinted was\n{printed}")
