"""Check a campaign: its files, missing data and quality problems. Run it first on new data.

Errors (exit code 2) make a fit meaningless; identify and diagnose refuse such data with the same message, and list warnings in
their reports. Without errors the model is fitted as by identify, to find problems that only a fit shows.
"""

import contextlib
from pathlib import Path

from tqdm import tqdm

from identification.gate.finding import KINDS
from identification.gate.template import write_template
from vpp_fmu.app.api.check import check
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.next_command import next_step
from vpp_fmu.app.cli.options import add_accept
from vpp_fmu.app.cli.output import called, output, written
from vpp_fmu.app.report.pages.check import FORMAT
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder

EXAMPLE = "vpp check campaigns/monday\n  vpp check --template campaigns/mine"


def configure(parser):
    parser.add_argument("campaign", nargs="?", metavar="CAMPAIGN", help="folder of the campaign")
    text = "write a small valid campaign into DIR, with a README.md that explains every column, instead"
    parser.add_argument("--template", metavar="DIR", help=text)
    add_accept(parser)
    parser.add_argument("-o", "--output", metavar="DIR", help="folder to write check.json to (default: only print)")
    lines = [f"  {code:14} {kind.meaning}" + f" [--accept {kind.accept}]" * bool(kind.accept) for code, kind in KINDS.items()]
    parser.epilog += "\n\npossible findings:\n" + "\n".join(lines)


def run(options):
    if (options.campaign is None) == (options.template is None):
        found = "neither" if options.campaign is None else "both"
        raise BadInput("command line", "CAMPAIGN, --template", found, "one of them")
    if options.template is not None:
        folder = OutputFolder(options.template)
        write_template(folder)
        names = sorted(path.name for path in folder.path.iterdir())
        text = f"{folder.path} holds a small valid campaign; its README.md explains every column."
        return Answer(text, {"format": FORMAT, "template": names}, written=written(options, folder))
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(output(options)) if options.output else None
        bar = stack.enter_context(tqdm(disable=None, leave=False, bar_format="{desc} {elapsed}"))
        bar.set_description("read")
        found = called(check, options, stage=bar.set_description)
        place = []
        if folder is not None:
            found.write(folder)
            place = written(options, folder)
    failure = None
    if codes := [f.code for f in found.errors]:
        what = f"{len(codes)} error{'s' * (len(codes) > 1)}: {', '.join(dict.fromkeys(codes))}"
        failure = BadInput(options.campaign, "quality", what, "no errors", "vpp check --help, which explains each code")
    elif folder is None:
        place = [f"next: {next_step(Path(options.campaign), ('check.json',), options)[0]}"]
    return Answer(found.headline(), found.to_dict(), found.lines(), written=place, failure=failure)
