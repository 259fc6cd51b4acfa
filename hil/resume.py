"""Data of an unfinished part of a campaign, from its logs and the events beside them."""

from pathlib import Path

import numpy as np

from hil.campaign import static_record, steps_record
from hil.cycle import PERIOD
from hil.log import events_of, read_events
from hil.session import found_log, read_log
from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record


def log_name(folder: Path, part: str) -> str:
    """The log of a part's next attempt; each attempt has its own."""
    names = (f"log_{part}.csv.gz" if k == 1 else f"log_{part}-{k}.csv.gz" for k in range(1, 1000))
    return next(name for name in names if not events_of(folder / name).exists())


def attempts(folder: Path, part: str) -> list[Path]:
    """The logs of a part's attempts so far, in order."""
    logs = [folder / (f"log_{part}.csv.gz" if k == 1 else f"log_{part}-{k}.csv.gz") for k in range(1, 1000)]
    return [log for log in logs if events_of(log).exists()]


def forget(folder: Path, part: str) -> None:
    """Start a part anew."""
    for log in attempts(folder, part):
        log.unlink(missing_ok=True)
        events_of(log).unlink()


def measured_so_far(folder: Path, part: str) -> list:
    """Of the static map its rows, of the steps the whole ones, of a record the longest piece from its beginning."""
    if part == "static":
        return [e["point"] for log in attempts(folder, part) for e in read_events(events_of(log)) if "point" in e]
    found = []
    for path in attempts(folder, part):
        events = read_events(events_of(path))
        whole = {event["recorded"] for event in events if "recorded" in event}
        spans = [event["record"] for event in events if "record" in event]
        wanted = [span for span in spans if part != "steps" or span["first"] in whole]
        if wanted:
            try:
                log = read_log(found_log(path))
            except BadInput:  # nothing of it reached the disk
                continue
            found += [piece(log, span["first"], span["count"]) for span in wanted]
    return found if part == "steps" else sorted(found, key=len)[-1:]


def piece(log: Record, first: int, count: int) -> Record:
    """Rows of a log as `hil.campaign.recorded` gives them: `count` slots from `first` on, as far as the run went."""
    running = np.isfinite(log["omega_wanted"])
    slots = np.rint(log.time[running] / PERIOD).astype(int) - first
    inside = (slots >= 0) & (slots < count)
    length = count if slots.max(initial=-1) >= count - 1 else int(slots[inside].max(initial=-1)) + 1
    rows = np.full((length, 4), np.nan)
    for k, name in enumerate(("omega_ref", "beta_ref", "omega", "thrust")):
        rows[slots[inside], k] = log[name][running][inside]
    for column in rows[:, :2].T:  # a command holds over the slots that were missed
        known = np.maximum.accumulate(np.where(np.isfinite(column), np.arange(length), 0))
        column[:] = column[known]
    columns = dict(zip(("omega_ref", "beta_ref", "omega", "thrust"), rows.T, strict=True))
    return Record({"time": np.arange(length) * PERIOD, **columns}, log.source)


def partial(part: str, have: list) -> Record | None:
    """The measured data as a record; None without any."""
    if not have:
        return None
    return static_record(have) if part == "static" else steps_record(have) if part == "steps" else have[0]
