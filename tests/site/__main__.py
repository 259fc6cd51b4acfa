"""Runs every command and script of the site's pages, and prints a line for each page.

python -m tests.site                          # all pages, several minutes
python -m tests.site how-to/fmpy.md           # some
"""

import sys
import tempfile
import time
from pathlib import Path

from tests.site.blocks import page, pages
from tests.site.run import Failed, run


def main(names: list[str]) -> int:
    """Exit code: 0, or 1 if a page failed."""
    found = [page(name) for name in names] or pages()
    failed, done = 0, {}
    with tempfile.TemporaryDirectory(prefix="vpp-site-") as folder:
        for each in found:
            typed = [block for block in each.blocks if block.typed or block.file]
            if not typed:
                continue
            skipped = sum(bool(block.skipped) for block in typed)
            began = time.monotonic()
            try:
                run(each, Path(folder), done)
                state = "ok"
            except Failed as error:
                failed += 1
                state = f"FAILED: {error}"
            counts = f"{len(typed) - skipped} blocks run, {skipped} not run or run by tests"
            print(f"{each.name:38} {counts:44} {time.monotonic() - began:5.1f} s  {state}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
