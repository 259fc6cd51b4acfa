"""The folder of a run, hil.json before the run, and the summary of a run from its files alone, if its process has died."""

import contextlib
import hashlib
import os
import platform
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from hil.loop.log import events_of, read_events
from hil.loop.session import REPORT, Setup, history, read_log, versions
from hil.loop.timing import timing
from vpp_fmu.date import now
from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record

RUNS = "runs"
"""Subfolder of a verb's output folder, with a folder per run by its start time."""

NAMES = ("hil.json", "log.csv", "run.csv", "report.html")
"""Files of the newest run to which the output folder has links."""

RUNNING, ENDED, ENDED_EARLY = "running", "ended", "ended early"
"""`status` in hil.json."""


def run_folder(parent: Path, date: str) -> Path:
    """Make a folder for a run that begins at `date` (ISO 8601), and links to its files beside `RUNS`.

    Ordinary files with the links' names are from an older version without run folders: they move to `runs/earlier`. BadInput
    if the system refuses.
    """
    name = date.partition("+")[0].replace(":", "").replace("-", "")
    try:
        for k in range(1, 1000):
            made = parent / RUNS / (name if k == 1 else f"{name}-{k}")
            with contextlib.suppress(FileExistsError):
                made.mkdir(parents=True)
                break
        for each in NAMES:
            _link(parent / each, Path(RUNS, made.name, each))
    except OSError as error:
        found = f"not writable ({(error.strerror or str(error)).lower()})"
        raise BadInput(parent, "output folder", found, "a folder that can be written") from error
    return made


def _link(at: Path, to: Path) -> None:
    if at.exists() and not at.is_symlink():
        earlier = at.parent / RUNS / "earlier"
        earlier.mkdir(exist_ok=True)
        free = (earlier / (at.name if k == 1 else f"{k}-{at.name}") for k in range(1, 10**6))
        at.rename(next(path for path in free if not path.exists()))
    temporary = at.with_name(f".{at.name}.{os.getpid()}.link")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(to)
    os.replace(temporary, at)


def sha256_of(path: str | os.PathLike) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def file_entry(path: str | os.PathLike) -> dict:
    """Entry of hil.json for an input file of a run."""
    return {"file": Path(path).name, "file_sha256": sha256_of(path)}


def begun(setup: Setup, calibration: str | os.PathLike, operator: str, given: Mapping[str, str | None]) -> dict:
    """Content of hil.json before anything turns: date, host, operator, setup. `given`: the other input files by role."""
    content = setup.summary()
    return {
        "format": "vpp-hil/1",
        "status": RUNNING,
        "begun": now(),
        "host": platform.node(),
        "operator": operator,
        "command": ["vpp", *sys.argv[1:]],
        **content,
        "calibration": file_entry(calibration) | content["calibration"],
        "versions": versions(),
        **{role: file_entry(path) for role, path in given.items() if path},
    }


def twin_entry(begun: Mapping, events: Iterable[Mapping]) -> dict:
    """The entry of hil.json for the twin, with the alarms of the events; empty without a twin."""
    return {"twin": {**begun["twin"], "alarms": [e["alarm"] for e in events if "alarm" in e]}} if "twin" in begun else {}


def summary_of_files(log: Path, begun: Mapping) -> tuple[Record | None, dict]:
    """(the log, None if it holds no row; content of `hil.json` for a run whose loop could not write it)."""
    try:
        record = read_log(log)
    except BadInput:  # a header and nothing else: it ended before its first tick
        record = None
    events = read_events(events_of(log))
    told = history(events, log.with_name(REPORT))
    rows = len(record) if record is not None else 0
    real_time = record is not None and begun.get("time") == "real"
    ends = [state["why"] for state in told["transitions"] if state["state"] in ("ramp down", "fault")]
    faults = [why for why in ends if why != "end of the run"]
    acted = [line.partition(": ")[2] for line in told["supervisor"]]
    ended = "; ".join([*faults[:1], *acted]) or "the loop was gone without a word"
    summary = {
        **begun,
        **twin_entry(begun, events),
        **told,
        "counters": next((event["counters"] for event in reversed(events) if "counters" in event), {}),
        "log": {"ticks": rows, "rows": rows, "lost": 0, "failure": ""},
        "timing": timing(record).summary() if real_time else None,
        "made_from": "the log",
        "ended": ended,
    }
    return record, summary
