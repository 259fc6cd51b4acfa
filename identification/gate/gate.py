"""The gate: a campaign goes through, with what can't be trusted left empty, or is refused in one line."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import ThreadpoolController

from identification.gate.files import files_of, of_files
from identification.gate.finding import ERROR, Finding, check_accepted, refuse, settled
from identification.gate.sensors import screen, unusable
from identification.logger import Logger
from identification.run_in import without
from vpp_fmu.campaign import Campaign
from vpp_fmu.record import Record

RECORDS = ("open_loop", "repeat", "validation")


@dataclass(frozen=True)
class Passed:
    """A campaign and `further` records as they may be used: readings that can't be trusted are empty. `findings`: what was
    said of the files, errors first; without errors unless `look` made it. `logger`: the one that the records were corrected
    for; None: they are as the files hold them."""

    campaign: Campaign
    further: Mapping[str, Record]
    findings: tuple[Finding, ...]
    logger: Logger | None = None

    def changed(self, change: Callable[[Record], Record]) -> "Passed":
        """The same with each record changed, steps among them."""
        own = {n: change(r) for n in (*RECORDS, "static_raw") if (r := getattr(self.campaign, n)) is not None}
        campaign = replace(self.campaign, **own, steps=tuple(map(change, self.campaign.steps)))
        return replace(self, campaign=campaign, further={n: change(r) for n, r in self.further.items()})

    def without_run_ins(self, run_in: Callable[[Record], float]) -> "Passed":
        """The same with empty readings in the run-in [s] of each record that does not begin settled, and a finding for it."""
        found = []

        def emptied(record: Record) -> Record:
            if not (seconds := run_in(record)):
                return record
            told = f"begins in motion: its first {seconds:.2g} s are left out of every figure"
            cause = "the log begins less than a few lags after a command has moved"
            found.append(Finding("run_in", record.source, "time", seconds, "s", told, cause))
            return without(record, seconds)

        kept = self.changed(emptied)
        return replace(kept, findings=(*self.findings, *_of_one_file(found)))


def look(campaign: Campaign, further: Mapping[str, Record] | None = None, accept: Iterable[str] = ()) -> Passed:
    """All that the files show by themselves. `accept`: codes whose errors become warnings, and whose rows are kept."""
    accept, further = check_accepted(accept), dict(further or {})
    with _BLAS.limit(limits=1):  # threads cost more than they bring on matrices this narrow
        return _look(campaign, further, accept)


_BLAS = ThreadpoolController()


def _look(campaign: Campaign, further: Mapping[str, Record], accept: frozenset[str]) -> Passed:
    own = {n: r for n in RECORDS if (r := getattr(campaign, n)) is not None}
    found = [f for r in (own | further).values() for f in unusable(r)]
    short = {f.where for f in found if f.level == ERROR}
    unseen = {campaign.validation.source} if campaign.validation is not None else set()
    found = [f for f in found if f.where not in unseen or f.code == "thrust_dead"]  # nothing is fitted to it
    kept: dict[str, Record] = {}
    for name, record in (own | further).items():
        kept[name], faults = (record, ()) if record.source in short else screen(record, accept)
        found += faults
    for run in campaign.steps:
        found += screen(run)[1] if len(run) > 1 else ()
    found += of_files([f for f in files_of(campaign, further) if f.where not in short], campaign.rig)
    return Passed(
        replace(campaign, **{n: kept[n] for n in own}),
        {n: kept[n] for n in further},
        settled(_of_one_file(found), accept),
    )


def passed(campaign: Campaign, further: Mapping[str, Record] | None = None, accept: Iterable[str] = ()) -> Passed:
    """The same, for use: BadInput, one line, for the first error that is not accepted."""
    found = look(campaign, further, accept)
    refuse(found.findings)
    return found


def _of_one_file(findings: Iterable[Finding]) -> list[Finding]:
    """One finding a code, file and field: those of a file's many runs together."""
    groups: dict[tuple, list[Finding]] = {}
    for finding in dict.fromkeys(findings):
        where = finding.where.partition(", run ")[0]
        groups.setdefault((finding.code, where, finding.field), []).append(finding)
    found = []
    for (_, where, _), group in groups.items():
        first = group[0]
        told = f"{first.told}; so in {len(group)} runs" if len(group) > 1 else first.told
        value = float(np.sum([f.value for f in group])) if first.unit == "1" and len(group) > 1 else first.value
        found.append(replace(first, where=where, told=told, value=value))
    return found
