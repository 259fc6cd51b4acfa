"""python -m tests.studies paper: the main numbers of `vpp paper`, beside the paper's.

They are those of a folder that `vpp paper -o FOLDER` wrote, or, without one, of a study that is run now.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.tables import add_write, show, table
from vpp_fmu.app.cli import main as vpp
from vpp_fmu.app.paper.published import COLUMNS, KEY, Row


def numbers(content: Mapping) -> str:
    """The table of a paper.json: its main rows, without the reasons of the differences."""
    rows = {row["name"]: Row(**row) for row in content["rows"]}
    return table(_short(COLUMNS), [_short(rows[name].cells()) for name in KEY])


def _short(cells: Sequence) -> list:
    return [cells[COLUMNS.index(name)] for name in COLUMNS if name not in ("place", "why they differ")]


def main(parser, arguments):
    parser.add_argument("folder", nargs="?", type=Path, help="what `vpp paper` wrote")
    add_write(parser)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as made:
        if options.folder is None and vpp(["paper", "-o", made]):
            raise SystemExit(2)
        content = json.loads((options.folder or Path(made)).joinpath("paper.json").read_text())
    if options.write and not content["plan"]["as_the_paper"]:
        raise SystemExit(f"{options.folder}: a quick study is not written into a page")
    show("paper", numbers(content), options.write)
