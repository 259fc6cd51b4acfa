"""Make run.csv, report.html and the end of hil.json from a run's log: for a run whose loop could not do so itself.

A loop that is killed or crashes leaves its log whole, and the log's writer calls this by itself. Where that was killed too, the
rows that reached the disk are given the log's name first."""

import sys
from pathlib import Path

from hil.log import events_of
from hil.runs import told_by_files
from hil.session import found_log, read_log
from vpp_fmu.cli.hil_outcome import RUNNING, finish, kept_of
from vpp_fmu.cli.output import say_written
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.structured import check_kinds, read_object

BEGUN = {
    "status?": str,
    "rig?": str,
    "time?": str,
    "begun?": str,
    "hidden?": [str],
    "profile?": {"file?": str},
    "calibration?": {"sha256?": str},
    "twin?": {"false_alarms_per_hour": float, "smallest_found": float, "delay": float, "noise": float},
    "adaptive_twin?": {"units": {"*": str}, "alarms?": [{"time": float, "points_to": str}]},
}
"""What a report reads of hil.json."""

DONE = BEGUN | {
    "ended": str,
    "real_time?": str,
    "tares": [{"zero_counts": float, "noise_N": float}],
    "transitions": [{"time": float, "state": str, "why": str}],
    "counters": {"*": {"*": int}},
    "log": {"ticks": int, "rows": int, "lost": int, "failure": str},
    "timing?": dict,
}
"""The same of a run whose loop has written all it had to say."""

EXAMPLE = "vpp hil report out/runs/20260307T141500"


def configure(parser):
    parser.add_argument("log", metavar="LOG", help="the run's log.csv, or its folder")


def run(options):
    log = found_log(Path(options.log))
    folder = OutputFolder(log.parent)
    begun = _begun(log.with_name("hil.json"))
    if begun.get("status", RUNNING) == RUNNING:
        record, told = told_by_files(log, begun)
        check_kinds(events_of(log), told, DONE)
        print(f"vpp hil: the run ended: {told['ended']}", file=sys.stderr)
    else:
        record, told = read_log(log), begun  # its loop has said all that is to say
    finish(folder, told, record)
    print(f"made from the log: {kept_of(log.parent)}", file=sys.stderr)
    say_written(folder)


def _begun(path: Path) -> dict:
    """What hil.json says; nothing where there is none."""
    if not path.exists():
        return {"format": "vpp-hil/1"}
    told = read_object(path, "vpp-hil/1", "what vpp hil run has written")
    if "parts" in told:
        raise BadInput(path, "parts", "a campaign", "a run; a campaign goes on with vpp hil campaign --resume")
    check_kinds(path, told, BEGUN if told.get("status", RUNNING) == RUNNING else DONE)
    return told
