"""python -m tests.studies imports: the same data in many formats, and the result of `vpp import csv` for each.

Aim: the imported data equal the original to the digits that were written, or there is one line with the reason, exit code 2 and
no output.
"""

import contextlib
import io
import sys
import tempfile
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))
from import_zoo import came_out, formats

from vpp_fmu.app.cli import main as vpp


def run(words: list[str]) -> tuple[int, str, str]:
    """The command line: exit code, output, errors."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = vpp(words)
    return code, out.getvalue(), err.getvalue()


def main(parser, arguments):
    parser.parse_args(arguments)
    counts = {False: [0, 0], True: [0, 0]}
    for format in formats():
        with tempfile.TemporaryDirectory() as folder:
            good, result = came_out(format, Path(folder), run)
        counts[bool(format.refused)][0] += good
        counts[bool(format.refused)][1] += 1
        print(f"{'as it must' if good else 'NOT SO':10}  {format.name:38}  {result}", flush=True)
    read, refused = counts[False], counts[True]
    print(f"\n{read[0]} of {read[1]} formats came out as they went in")
    print(f"{refused[0]} of {refused[1]} others: one line that says why not, nothing written")
