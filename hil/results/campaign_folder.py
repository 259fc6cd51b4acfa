"""A campaign's folder: one file per part, measured in turn. A part's data are made from the logs of its attempts, whether it
is complete or will be resumed. A row holds the readings at its time, and the commands that act from then on; `omega` is the
tachometer's held value."""

import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import count, takewhile
from pathlib import Path

import numpy as np

from hil.campaign import PARTS, STATIC, CampaignSize, follow, measure, parts_for, powered, same_commands, seconds
from hil.commands import grid, resampled
from hil.loop.columns import COLUMNS
from hil.loop.cycle import PERIOD
from hil.loop.log import events_of, read_events
from hil.loop.rig import ENDINGS, RunEnded
from hil.loop.room import check_room
from hil.loop.session import Session, Setup, found_log, read_log, session
from hil.page.operator_page import OperatorPage
from hil.results.runs import ENDED, ENDED_EARLY, RUNNING
from hil.safety.limits import Limits
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
        content |= {"status": RUNNING}
        folder.write("hil.json", as_json(content))
        for part in parts:
            if content["parts"].get(part, {}).get("whole"):
                say(f"{part}: measured already")
                continue
            if page:
                page.part(part, **self._grid(part), parts=parts, before=attempts(folder.path, part))
            one, ended = self._measured(folder.path, part, page)
            own = {"ended": str(ended or ""), "whole": not ended, "attempts": len(attempts(folder.path, part))}
            content["parts"][part] = one.summary() | own
            if ended:
                content |= {"status": ENDED_EARLY, "completed": now()}
            folder.write("hil.json", as_json(content))
            self._write(folder, part, not ended, say)
            if ended:
                raise ended
            say(f"{part}: log {one.logged.rows} rows of {one.rig.ticks.ticks} ticks, {one.logged.lost} lost")
        content |= {"status": ENDED, "completed": now()}
        folder.write("hil.json", as_json(content))
        return content

    def _measured(self, folder: Path, part: str, page) -> tuple[Session, BaseException | None]:
        """One part on the rig: (session, why it ended early, if it did)."""
        setup, ended = self._again(part), None
        done = len(measured_so_far(folder, part)) if part in ("static", "steps") else 0
        log = _log(folder, part, 1 + len(attempts(folder, part)))
        with session(setup, log, self._seconds(part), page=page) as one:
            try:
                if self.commands:
                    follow(one.rig, self.commands, self.plan.settle)
                else:
                    measure(one.rig, part, self.plan, setup.allowed, done)
            except ENDINGS as reason:
                ended = reason
        if one.logged.failure and not ended:
            ended = RunEnded(f"log: {one.logged.lost} rows lost: {one.logged.failure}")
        return one, ended

    def _seconds(self, part: str) -> float:
        return self.commands.time[-1] if self.commands else seconds(self.plan, [part], self.setup.allowed)

    def _grid(self, part: str) -> dict:
        """The points of a static map for the operator's page."""
        if part != "static":
            return {}
        speeds, pitches = zip(*grid(self.plan.points, self.setup.allowed), strict=True)
        return {"grid": {"speeds": sorted(set(speeds)), "pitches": sorted(set(pitches))}}

    def _again(self, part: str) -> Setup:
        """The emulated rig for one part: the same rig, but no two parts have the same noise."""
        if self.setup.emulated is None:
            return self.setup
        seed = 100 * self.setup.emulated.seed + (*PARTS, "record").index(part)
        return replace(self.setup, emulated=replace(self.setup.emulated, seed=seed))

    def _write(self, folder: OutputFolder, part: str, whole: bool, say: Callable[[str], None]) -> None:
        """Write the data of a part from its logs; those of an incomplete part go to its PARTIAL file."""
        have = measured_so_far(folder.path, part)
        if not have:
            return
        record, name = record_of(part, have, powered(self.setup.calibration.supply)), f"{part}.csv" if whole else part + PARTIAL
        if part == "repeat" and whole and (folder.path / "open_loop.csv").exists():
            first = measured_so_far(folder.path, "open_loop")
            if first and not same_commands(first[0], record):
                say("repeat: a slot was missed where a command changed, so the commands differ: kept as open_loop_again.csv")
                name = "open_loop_again.csv"
        write_record(folder, name, record)
        if whole:
            (folder.path / f"{part}{PARTIAL}").unlink(missing_ok=True)
        say(f"{part}: {len(record['omega_ref'])} rows in {name}{'' if whole else '; --resume goes on'}")


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


def attempts(folder: Path, part: str) -> list[Path]:
    """The logs of a part's attempts so far, in order; each has events beside it."""
    return list(takewhile(lambda log: events_of(log).exists(), (_log(folder, part, k) for k in count(1))))


def _log(folder: Path, part: str, attempt: int) -> Path:
    return folder / (f"log_{part}.csv.gz" if attempt == 1 else f"log_{part}-{attempt}.csv.gz")


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
    """A record from `count` slots of a log, from `first` on, as far as the run went. In missed slots the readings are NaN."""
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


def record_of(part: str, have: Sequence, power: Sequence[str] = ()) -> Record:
    """The content of a part's file from its data, as of `measured_so_far`; `power`: further columns of a static map. Steps are
    numbered by `run`."""
    if part == "static":
        return Record(dict(zip((*STATIC, *power), np.array(have, float).T, strict=True)), part)
    if part != "steps":
        return have[0]
    runs = [one.with_columns(run=np.full(len(one), float(k))) for k, one in enumerate(have)]
    names = ("run", "time", "omega_ref", "beta_ref", "omega", "thrust")
    return Record({name: np.concatenate([one[name] for one in runs]) for name in names}, part)
