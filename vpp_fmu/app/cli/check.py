"""Check a campaign: its files, missing data and quality problems. Run it first on new data.

Errors (exit code 2) make a fit meaningless; identify and diagnose refuse such data with the same message, and list warnings in
their reports. Without errors the model is fitted as by identify, to find problems that only a fit shows.
"""

from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from identification.gate.contents import COLUMNS, FileContents, contents, missing
from identification.gate.files import File, files_of, said_of_size
from identification.gate.finding import ERROR, KINDS, Finding, check_accepted, settled
from identification.gate.gate import look
from identification.gate.template import write_template
from identification.identify import identify
from identification.logger import Logger
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.next_command import next_step
from vpp_fmu.app.cli.output import add_accept, written
from vpp_fmu.campaign import Campaign, read_campaign
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.files import OutputFolder
from vpp_fmu.structured import as_json

EXAMPLE = "vpp check campaigns/monday\n  vpp check --template campaigns/mine"

FORMAT = "vpp-check/1"


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
    accept, folder = check_accepted(options.accept), OutputFolder(options.output) if options.output else None
    with tqdm(disable=None, leave=False, bar_format="{desc} {elapsed}") as bar:
        bar.set_description("read")
        found = checked(read_campaign(options.campaign), accept, bar.set_description)
    if folder is not None:
        write_check(folder, found)
    lines, failure = [] if folder is None else written(options, folder), _failure(options.campaign, found)
    if folder is None and failure is None:
        lines = [f"next: {next_step(Path(options.campaign), ('check.json',), options)[0]}"]
    return Answer(headline(found), found.summary(), _lines(found), written=lines, failure=failure)


@dataclass(frozen=True, eq=False)
class Checked:
    """A campaign's `files` with their contents (`held`), the `missing` ones with the consequence, the gate's `findings`, and
    the model of the `logger` of the records, None if no model can be fitted."""

    campaign: Campaign
    files: list[File]
    held: list[FileContents]
    missing: dict[str, str]
    findings: tuple[Finding, ...]
    logger: Logger | None

    @property
    def errors(self) -> list[Finding]:
        """Findings that forbid a fit."""
        return [f for f in self.findings if f.level == ERROR]

    def summary(self) -> dict:
        """The content of check.json."""
        content = {"format": FORMAT, "campaign": self.campaign.folder.name, "files": [h.summary() for h in self.held]}
        content |= {
            "missing": self.missing,
            "rig": self.campaign.rig.summary(),
            "logger": self.logger and self.logger.summary(),
            "quality": [f.summary() for f in self.findings],
        }
        return content | {"errors": len(self.errors)}


def headline(found: Checked) -> str:
    """Whether the campaign can be fitted, in a sentence."""
    errors, files = len(found.errors), len(found.held)
    count = f"{files} file{'s' * (files != 1)}"
    if errors:
        return f"The campaign can't be fitted: {errors} error{'s' * (errors > 1)} in {count}."
    warnings = len(found.findings)
    doubt = f"{warnings} warning{'s' * (warnings != 1)}" if warnings else "nothing found against these data"
    return f"The campaign can be fitted: {count}, {doubt}."


def _failure(campaign: str, found: Checked) -> BadInput | None:
    codes = [f.code for f in found.errors]
    if not codes:
        return None
    what = f"{len(codes)} error{'s' * (len(codes) > 1)}: {', '.join(dict.fromkeys(codes))}"
    return BadInput(campaign, "quality", what, "no errors", "vpp check --help, which explains each code")


def checked(campaign: Campaign, accept: frozenset[str], stage=lambda text: None) -> Checked:
    """Check the files, and fit them unless there is an error. `stage` receives the name of each stage."""
    files = files_of(campaign, {})
    findings, logger = _fitted(campaign, look(campaign, accept=accept).findings, accept, stage)
    return Checked(campaign, files, contents(files), missing(campaign, files), findings, logger)


def write_check(folder: OutputFolder, found: Checked) -> None:
    """check.json."""
    folder.write("check.json", as_json(found.summary()))


def _fitted(
    campaign: Campaign, findings: tuple[Finding, ...], accept: frozenset[str], stage
) -> tuple[tuple[Finding, ...], Logger | None]:
    """The findings, with those of a fit unless there is an error, and the model of the logger."""
    if any(f.level == ERROR for f in findings):
        return findings, None
    try:
        found = identify(campaign, accept=accept, stage=stage)
        return found.quality, found.logger
    except BadInput as refused:
        evidence = f"found {refused.found}, expected {refused.allowed}"
        unfit = Finding("no_fit", refused.where, refused.field, 0.0, "1", evidence, "what is missing")
    except VppError as refused:
        unfit = Finding("no_fit", str(campaign.folder), "fit", 0.0, "1", str(refused), "the data tell too little")
    return settled([*findings, unfit], accept), None


def _lines(found: Checked) -> list[str]:
    table = [COLUMNS, *(h.row() for h in found.held)]
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]
    lines += [f"missing {name}: {cost}" for name, cost in found.missing.items()]
    lines.append(f"rig: {'; '.join(found.campaign.rig.lines())}")
    lines += [f"your logger: {line}" for line in (found.logger.lines if found.logger else ())]
    lines += said_of_size(found.files, found.campaign.rig.rotor.get("diameter"))
    return lines + ([finding.text for finding in found.findings] or ["quality: nothing found against these data"])
