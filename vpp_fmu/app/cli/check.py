"""Check a campaign: its files, missing data and quality problems. Run it first on new data.

Errors (exit code 2) make a fit meaningless; identify and diagnose refuse such data with the same message, and list warnings in
their reports. Without errors the model is fitted as by identify, to find problems that only a fit shows.
"""

from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from identification.gate.finding import KINDS
from identification.gate.template import write_template
from vpp_fmu.app.api.check import check
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.next_command import next_step
from vpp_fmu.app.cli.options import add_accept
from vpp_fmu.app.cli.output import answer, written
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
    with tqdm(disable=None, leave=False, bar_format="{desc} {elapsed}") as bar:
        said = replace(answer(options, check, stage=bar.set_description), figures=())  # the lines have them
    if options.output is None and said.failure is None:
        said = replace(said, written=[f"next: {next_step(Path(options.campaign), ('check.json',), options)[0]}"])
    return said
