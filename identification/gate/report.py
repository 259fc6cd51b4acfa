"""The gate's findings on a report's page."""

from collections.abc import Sequence

from identification.gate.finding import ERROR, Finding
from vpp_fmu.report import Page


def quality_tile(findings: Sequence[Finding]) -> tuple[str, str, str]:
    """(label, value, note) for the first screen."""
    codes = list(dict.fromkeys(f.code.replace("_", " ") for f in findings))
    errors = sum(f.level == ERROR for f in findings)
    parts = [f"{n} {word}{'s' * (n > 1)}" for n, word in ((errors, "error"), (len(findings) - errors, "warning")) if n]
    return "quality of the data", ", ".join(parts) or "no findings", "; ".join(codes)


def add_quality(page: Page, findings: Sequence[Finding]) -> None:
    """Add the findings as a table, if there are any."""
    if not findings:
        return
    page.section("Quality of the data")
    rows = [(f.level, f.code, f"{f.file}, {f.field}", f.told, f.cause, f.advice) for f in findings]
    columns = ("level", "code", "where", "what shows it", "likely cause", "what to do")
    page.table(columns, rows, "Findings on the files, and on the fit to them, that limit the results below.")
