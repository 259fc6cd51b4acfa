"""python -m tests.studies paper: the numbers of `vpp paper` that matter, beside the paper's.

They are those of a folder that `vpp paper -o FOLDER` wrote, or, without one, of a study that is done now.
"""

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.tables import add_write, show, table
from vpp_fmu.app.cli import main as vpp
from vpp_fmu.app.paper.published import COLUMNS, KEY, Row


def numbers(told: Mapping) -> str:
    """The table of a paper.json: what a reader wants to know first, without why it differs."""
    rows = {row["name"]: Row(**row) for row in told["rows"]}
    return table(_short(COLUMNS), [_short(rows[name].cells()) for name in KEY])


def _short(cells: Sequence) -> list:
    return [cells[COLUMNS.index(name)] for name in COLUMNS if name not in ("place", "why they differ")]


def main(arguments):
    parser = argparse.ArgumentParser(prog="python -m tests.studies paper", description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help="what `vpp paper` wrote")
    add_write(parser)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as made:
        if options.folder is None and vpp(["paper", "-o", made]):
            raise SystemExit(2)
        told = json.loads((options.folder or Path(made)).joinpath("paper.json").read_text())
    if options.write and not told["plan"]["as_the_paper"]:
        raise SystemExit(f"{options.folder}: a quick study is not written into a page")
    show("paper", numbers(told), options.write)
