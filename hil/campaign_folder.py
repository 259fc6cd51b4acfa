"""A campaign's folder: one file per part, measured in turn; a part that ended early is resumed from its logs."""

import json
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from hil.campaign import (
    PARTS,
    CampaignSize,
    follow,
    measure,
    parts_for,
    powered,
    same_commands,
    seconds,
    static_record,
    steps_record,
)
from hil.columns import COLUMNS
from hil.commands import grid, resampled, steps
from hil.cycle import PERIOD
from hil.log import events_of, read_events
from hil.page.operator_page import OperatorPage
from hil.rig import ENDINGS
from hil.room import check_room
from hil.runs import ENDED, ENDED_EARLY, RUNNING
from hil.safety.limits import Limits
from hil.session import Session, Setup, found_log, read_log, session
from vpp_fmu.date import now
from vpp_fmu.errors import BadInput, RecordWarning
from vpp_fmu.files import OutputFolder
from vpp_fmu.record import Record, read_record, write_record
from vpp_fmu.structured import as_json, read_object

PARTIAL = ".partial.csv"
"""Suffix of an incomplete part's data; readers of campaigns ignore such files."""

SAME = ("plan", "rig", "hidden", "physics", "seed", "limits", "allowed", "calibration")
"""Entries of hil.json that must be unchanged to resume a campaign."""


def _difference(before: object, now: object, where: str) -> tuple[str, str, str]:
    """(path, earlier value, present value) of the first entry of two JSON values that differs; `where`: their own path."""
    if isinstance(before, dict) and isinstance(now, dict):
        for name in [*before, *(name for name in now if name not in before)]:
            if before.get(name) != now.get(name):
                return _difference(before.get(name), now.get(name), f"{where}.{name}")
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for k, pair in enumerate(zip(before, now, strict=True)):
            if pair[0] != pair[1]:
                return _difference(*pair, f"{where}[{k}]")
    return where, *(json.dumps(value)[:80] for value in (before, now))


@dataclass(frozen=True, eq=False)
class Measuring:
    """A campaign: the rig, the plan and its parts; or instead `commands`, a record to apply."""

    setup: Setup
    plan: CampaignSize
    parts: Sequence[str] = PARTS
    commands: Record | None = None

    def begin(self, folder: Path, begun: dict, resume: bool, replace: bool = False) -> dict:
        """Content of hil.json before the first part; with `resume` the previous one, if the campaign is the same. BadInput; a
        folder that holds a campaign is refused, too, unless `replace`."""
        path = folder / "hil.json"
        content = json.loads(as_json(begun | {"plan": asdict(self.plan), "parts": {}}))
        before = read_object(path) if path.exists() else {}
        unfinished = "plan" in before and before.get("status") in (RUNNING, ENDED_EARLY)
        if not resume:
            held = [f"{part}.csv" for part in (*PARTS, "record") if (folder / f"{part}.csv").exists()]
            if (held or unfinished) and not replace:
                found = f"a campaign that has not ended, begun {before.get('begun')}" if unfinished else ", ".join(held)
                hint = "--resume to go on with it" if "plan" in before else "another folder"
                raise BadInput(folder, "campaign", found, "a folder without one", f"{hint}, or --replace to measure anew")
            return content
        if "plan" not in before:
            raise BadInput(folder, "--resume", "no campaign", "the folder of an earlier vpp hil campaign")
        for name in SAME:
            if before.get(name) != content.get(name):
                where, was, wanted = _difference(before.get(name), content.get(name), name)
                hint = "the options of the first call, or another folder"
                raise BadInput(path, where, was, f"{wanted}, as this call has it", hint)
        return before | {"resumed": [*before.get("resumed", []), content["begun"]]}

    def run(self, folder: OutputFolder, content: dict, page: OperatorPage | None, say: Callable[[str], None]) -> dict:
        """Measure the wanted parts that are not complete yet, in turn; returns the content of hil.json. The error that ended a
        part early is raised."""
        allowed = self.setup.allowed
        parts = ("record",) if self.commands else tuple(part for part in self.parts if part in parts_for(allowed))
        if not self.commands and len(parts) < len(self.parts):
            say("steps: speed and pitch both stand, so there are none")
        length = sum(map(self._seconds, parts))
        say(f"{', '.join(parts)}: {length / 60.0:.1f} min on the rig")
        check_room(folder.path / "log.csv.gz", COLUMNS, length)
        if "resumed" not in content:
            forget(folder.path)
        content, found = content | {"status": RUNNING}, {}
        folder.write("hil.json", as_json(content))
        for part in parts:
            if content["parts"].get(part, {}).get("whole"):
                say(f"{part}: measured already")
                found[part] = read_record(folder.path / f"{part}.csv") if part in ("open_loop", "repeat") else None
                continue
            if page:
                page.part(part, **self._extent(part), parts=parts, before=attempts(folder.path, part))
            one, record, ended = self._measured(folder.path, part, page)
            tried = len(attempts(folder.path, part))
            content["parts"][part] = one.summary() | {"ended": str(ended or ""), "whole": not ended, "attempts": tried}
            if ended:
                content |= {"status": ENDED_EARLY, "completed": now()}
            folder.write("hil.json", as_json(content))
            if ended:
                _keep(folder, part, powered(self.setup.calibration.supply), say)
                raise ended
            found[part] = record
            self._write(folder, part, found, say)
            rows, ticks, lost = one.logged.rows, one.rig.ticks.ticks, one.logged.lost
            say(f"{part}: {len(record['omega_ref'])} rows, log {rows} rows of {ticks} ticks, {lost} lost")
        content |= {"status": ENDED, "completed": now()}
        folder.write("hil.json", as_json(content))
        return content

    def _measured(self, folder: Path, part: str, page) -> tuple[Session, Record | None, BaseException | None]:
        """One part on the rig: (session, record, None), or (session, None, why it ended early)."""
        setup, record, ended = self._again(part), None, None
        have = measured_so_far(folder, part) if part in ("static", "steps") else []
        in_view = sys.stderr.isatty() and not setup.virtual  # the terminal's line shows the progress
        with (
            tqdm(total=100, unit="%", desc=part, disable=True if in_view else None, leave=False) as bar,
            session(setup, folder, log_name(folder, part), self._seconds(part), page=page) as one,
        ):

            def progress(share):
                one.rig.show_done(share)
                if setup.virtual:  # in real time a terminal must not delay the loop
                    bar.update(round(100 * share) - bar.n)

            try:
                if self.commands:
                    record = follow(one.rig, self.commands, self.plan.settle, progress)
                else:
                    record = measure(one.rig, part, self.plan, progress, setup.allowed, have)
            except ENDINGS as reason:
                ended = reason
        return one, record, ended

    def _seconds(self, part: str) -> float:
        return self.commands.time[-1] if self.commands else seconds(self.plan, [part], self.setup.allowed)

    def _extent(self, part: str) -> dict:
        """Size of a part for the operator's page; the length of a record is in its events."""
        if part == "static" and not self.commands:
            speeds, pitches = zip(*grid(self.plan.points, self.setup.allowed), strict=True)
            return {"grid": {"speeds": sorted(set(speeds)), "pitches": sorted(set(pitches))}}
        return {"steps": len(steps(self.plan.levels, self.setup.allowed))} if part == "steps" else {}

    def _again(self, part: str) -> Setup:
        """The emulated rig for one part: the same rig, but no two parts have the same noise."""
        if self.setup.emulated is None:
            return self.setup
        seed = 100 * self.setup.emulated.seed + (*PARTS, "record").index(part)
        return replace(self.setup, emulated=replace(self.setup.emulated, seed=seed))

    def _write(self, folder: OutputFolder, part: str, found: dict[str, Record], say: Callable[[str], None]) -> None:
        record, name = found[part], part
        if part == "repeat" and "open_loop" in found and not same_commands(found["open_loop"], record):
            say("repeat: a slot was missed where a command changed, so the commands differ: kept as open_loop_again.csv")
            name = "open_loop_again"
        write_record(folder, f"{name}.csv", record)
        (folder.path / f"{part}{PARTIAL}").unlink(missing_ok=True)


def _keep(folder: OutputFolder, part: str, power: Sequence[str], say: Callable[[str], None]) -> None:
    """Write the data of an incomplete part to its PARTIAL file."""
    have = measured_so_far(folder.path, part)
    record = partial(part, have, power)
    if record is not None:
        write_record(folder, f"{part}{PARTIAL}", record)
        what = "points" if part == "static" else "steps" if part == "steps" else "rows"
        count = len(have) if part in ("static", "steps") else len(record)
        say(f"{part}: {count} {what} kept in {part}{PARTIAL}; --resume goes on")


def records_of(folder: Path) -> dict[str, Record]:
    """The complete parts of a campaign by name. BadInput."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)  # the verbs that fit them say it
        files = ((part, folder / f"{part}.csv") for part in (*PARTS, "record"))
        return {part: read_record(file) for part, file in files if file.exists() and part not in ("static", "steps")}


def commands_of(path: str, limits: Limits) -> Record:
    """Read a record of commands and resample it at the loop's times. BadInput if a command is outside the limits, because it
    would be cut."""
    record = read_record(path)
    ranges = {"omega_ref": (limits.omega_min, limits.omega_max, "rpm"), "beta_ref": (limits.beta_min, limits.beta_max, "deg")}
    for name, (low, high, unit) in ranges.items():
        outside = (record[name] < low) | (record[name] > high)
        if outside.any():
            row = int(np.argmax(outside))
            allowed = f"{low:g} to {high:g} {unit}, as the limits have it"
            raise BadInput(path, f"{name}, row {row + 1} of the data", f"{record[name][row]:.9g}", allowed)
    return resampled(record, PERIOD)


def log_name(folder: Path, part: str) -> str:
    """The log of a part's next attempt: each has its own."""
    names = (f"log_{part}.csv.gz" if k == 1 else f"log_{part}-{k}.csv.gz" for k in range(1, 1000))
    return next(name for name in names if not events_of(folder / name).exists())


def attempts(folder: Path, part: str) -> list[Path]:
    """The logs of a part's attempts so far, in order."""
    logs = [folder / (f"log_{part}.csv.gz" if k == 1 else f"log_{part}-{k}.csv.gz") for k in range(1, 1000)]
    return [log for log in logs if events_of(log).exists()]


def forget(folder: Path) -> None:
    """Delete a campaign's records and logs: parts of two campaigns would be read as one."""
    for part in (*PARTS, "open_loop_again", "record"):
        for log in attempts(folder, part):
            log.unlink(missing_ok=True)
            events_of(log).unlink()
        for suffix in (".csv", PARTIAL):
            (folder / f"{part}{suffix}").unlink(missing_ok=True)


def measured_so_far(folder: Path, part: str) -> list:
    """Data of a part: rows of the static map, complete steps, or the longest beginning of a record."""
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
    """Rows of a log in the form of `hil.campaign.recorded`: `count` slots from `first` on, as far as the run went."""
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


def partial(part: str, have: list, power: Sequence[str] = ()) -> Record | None:
    """The measured data as a record, None if there are none; `power`: further columns of a static map."""
    if not have:
        return None
    return static_record(have, power) if part == "static" else steps_record(have) if part == "steps" else have[0]
