"""The check of a campaign: its files, missing data and quality problems."""

from typing import Any

from identification.gate.contents import COLUMNS, FileContents
from identification.gate.files import File, said_of_size
from identification.gate.finding import ERROR, Finding
from identification.logger import Logger
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.result import Result
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput

FORMAT = "vpp-check/1"


class CheckResult(Result):
    """A campaign's files, missing data and quality problems. `found`: the findings of the quality gate.

    `files` with their contents (`held`), the `missing` ones with the consequence, and the model of the `logger` of the records,
    None if no model can be fitted."""

    verb = "check"
    writes = ("check.json",)
    found: tuple[Finding, ...]

    def __init__(
        self,
        campaign: Campaign,
        files: list[File],
        held: list[FileContents],
        missing: dict[str, str],
        found: tuple[Finding, ...],
        logger: Logger | None,
    ):
        super().__init__(found, source=campaign.label)
        self.campaign, self.files, self.held, self.missing, self.logger = campaign, files, held, missing, logger

    @property
    def ok(self) -> bool:
        """Whether `identify` and `diagnose` accept the campaign."""
        return not self.errors

    @property
    def errors(self) -> list[Finding]:
        """Findings that forbid a fit."""
        return [f for f in self.found if f.level == ERROR]

    @property
    def findings(self) -> tuple[str, ...]:
        """Quality problems of the data, one per line, errors first."""
        return tuple(finding.text for finding in self.found)

    @property
    def failure(self) -> BadInput | None:
        if not (codes := [f.code for f in self.errors]):
            return None
        what = f"{len(codes)} error{'s' * (len(codes) > 1)}: {', '.join(dict.fromkeys(codes))}"
        return BadInput(self.campaign.folder, "quality", what, "no errors", "vpp check --help, which explains each code")

    def headline(self) -> str:
        errors, files, findings = len(self.errors), len(self.held), len(self.found)
        count = f"{files} file{'s' * (files != 1)}"
        if errors:
            return f"The campaign can't be fitted: {errors} error{'s' * (errors > 1)} in {count}."
        doubt = f"{findings} warning{'s' * (findings != 1)}" if findings else "nothing found against these data"
        return f"The campaign can be fitted: {count}, {doubt}."

    def key_figures(self) -> list[tuple[str, str, str]]:
        errors = len(self.errors)
        counts = [("errors", str(errors), ""), ("warnings", str(len(self.found) - errors), "")]
        return [*((h.name, h.row()[1], "") for h in self.held), *counts]

    def to_dict(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "campaign": self.campaign.folder.name,
            "files": [h.summary() for h in self.held],
            "missing": self.missing,
            "rig": self.campaign.rig.summary(),
            "logger": self.logger and self.logger.summary(),
            "quality": [f.summary() for f in self.found],
            "errors": len(self.errors),
        }

    def lines(self) -> list[str]:
        table = [COLUMNS, *(h.row() for h in self.held)]
        widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
        lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]
        lines += [f"missing {name}: {cost}" for name, cost in self.missing.items()]
        lines.append(f"rig: {'; '.join(self.campaign.rig.lines())}")
        lines += [f"your logger: {line}" for line in (self.logger.lines if self.logger else ())]
        lines += said_of_size(self.files, self.campaign.rig.rotor.get("diameter"))
        return [*lines, *(self.findings or ["quality: nothing found against these data"])]

    @property
    def title(self) -> str:
        return f"Check of {self.campaign.folder.name}"

    def fill(self, page: Page) -> None:
        for line in (*self.campaign.rig.lines(), *self.findings):
            page.note(line)
