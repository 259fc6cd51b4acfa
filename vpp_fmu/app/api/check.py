"""Check a campaign: the quality gate on its files, then on a fit."""

from collections.abc import Callable, Iterable

from identification.gate.contents import contents, missing
from identification.gate.files import files_of
from identification.gate.finding import ERROR, Finding, check_accepted, settled
from identification.gate.gate import look
from identification.identify import identify
from identification.logger import Logger
from vpp_fmu.app.api.objects import PathLike, as_campaign
from vpp_fmu.app.report.pages.check import CheckResult
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput, VppError


def check(
    campaign: PathLike | Campaign, accept: Iterable[str] = (), stage: Callable[[str], None] = lambda text: None
) -> CheckResult:
    """Check a campaign: its files, missing data and quality problems. Run it first on new data.

    `accept`: codes of findings to ignore (`vpp check --help` lists them). `stage` receives the name of each stage. Problems of
    the data are in the result (`ok`, `findings`); BadInput is for files that can't be read, and for unknown codes.

    >>> vpp.check(vpp.example_campaign()).ok
    True
    """
    accepted = check_accepted(accept)
    whole = as_campaign(campaign)
    files = files_of(whole, {})
    found, logger = _fitted(whole, look(whole, accept=accepted).findings, accepted, stage)
    return CheckResult(whole, files, contents(files), missing(whole, files), found, logger)


def _fitted(
    campaign: Campaign, findings: tuple[Finding, ...], accept: frozenset[str], stage: Callable[[str], None]
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
