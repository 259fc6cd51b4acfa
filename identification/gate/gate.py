"""The gate: a campaign passes, with untrusted readings emptied, or is rejected with one line."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import ThreadpoolController

from identification.gate.files import files_of, of_files
from identification.gate.finding import ERROR, Finding, check_accepted, refuse, settled
from identification.gate.sensors import FEWEST_UNSEEN, screen, unusable
from identification.logger import Logger
from identification.run_in import without
from vpp_fmu.campaign import Campaign
from vpp_fmu.record import Record

RECORDS = ("open_loop", "repeat", "validation")


@dataclass(frozen=True)
class Passed:
    """A campaign and `further` records for use: untrusted readings are empty. `findings`: on the files, errors first; only
    `look` returns errors. `logger`: the records are corrected for it; None: they are uncorrected."""

    campaign: Campaign
    further: Mapping[str, Record]
    findings: tuple[Finding, ...]
    logger: Logger | None = None

    def changed(self, change: Callable[[Record], Record]) -> "Passed":
        """The same with each record changed, including steps."""
        own = {n: change(r) for n in (*RECORDS, "static_raw") if (r := getattr(self.campaign, n)) is not None}
        campaign = replace(self.campaign, **own, steps=tuple(map(change, self.campaign.steps)))
        return replace(self, campaign=campaign, further={n: change(r) for n, r in self.further.items()})

    def without_run_ins(self, run_in: Callable[[Record], float]) -> "Passed":
        """The same with empty readings in the run-in [s] of each record that does not begin settled, and a finding for it."""
        found = []

        def emptied(record: Record) -> Record:
            if not (seconds := run_in(record)):
                return record
            message = f"begins in motion: its first {seconds:.2g} s are excluded"
            cause = "the log begins less than a few lags after a change of a command"
            found.append(Finding("run_in", record.source, "time", seconds, "s", message, cause))
            return without(record, seconds)

        kept = self.changed(emptied)
        return replace(kept, findings=(*self.findings, *_of_one_file(found)))


@ThreadpoolController().wrap(limits=1)  # on matrices this narrow one thread is faster
def look(campaign: Campaign, further: Mapping[str, Record] | None = None, accept: Iterable[str] = ()) -> Passed:
    """All findings on the files. `accept`: codes whose errors become warnings, and whose rows are kept."""
    accept, further = check_accepted(accept), dict(further or {})
    own = {n: r for n in RECORDS if (r := getattr(campaign, n)) is not None}
    fitted = [r for r in (own | further).values() if r is not campaign.validation]
    found = [f for r in fitted for f in unusable(r)]
    if campaign.validation is not None:
        found += [f for f in unusable(campaign.validation, FEWEST_UNSEEN) if f.code != "no_move"]
    short = {f.where for f in found if f.level == ERROR}
    kept: dict[str, Record] = {}
    for name, record in (own | further).items():
        kept[name], faults = (record, ()) if record.source in short else screen(record, accept)
        found += faults
    for run in campaign.steps:
        found += screen(run)[1] if len(run) > 1 else ()
    campaign, further = replace(campaign, **{n: kept[n] for n in own}), {n: kept[n] for n in further}
    found += of_files([f for f in files_of(campaign, further) if f.where not in short], campaign.rig)
    return Passed(campaign, further, settled(_of_one_file(found), accept))


def passed(campaign: Campaign, further: Mapping[str, Record] | None = None, accept: Iterable[str] = ()) -> Passed:
    """The result of `look`; BadInput for the first error that is not accepted."""
    found = look(campaign, further, accept)
    refuse(found.findings)
    return found


def _of_one_file(findings: Iterable[Finding]) -> list[Finding]:
    """One finding for each code, file and field: those of a file's runs are merged."""
    groups: dict[tuple, list[Finding]] = {}
    for finding in dict.fromkeys(findings):
        where = finding.where.partition(", run ")[0]
        groups.setdefault((finding.code, where, finding.field), []).append(finding)
    found = []
    for (_, where, _), group in groups.items():
        first = group[0]
        message = f"{first.told}; in {len(group)} runs" if len(group) > 1 else first.told
        value = float(np.sum([f.value for f in group])) if first.unit == "1" and len(group) > 1 else first.value
        found.append(replace(first, where=where, told=message, value=value))
    return found
