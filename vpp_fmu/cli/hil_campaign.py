"""Measure a campaign on the rig: the files that `vpp identify` and `vpp diagnose` read.

Each part is a run of its own: tare, arm, run, ramp down. As the paper has it, the static map takes 40 minutes, the steps 15.
Commands stay within what the rig's rig.json declares, what --parameters tells of an earlier campaign, and the limits."""

import json
import sys
from dataclasses import asdict, replace

import numpy as np
from tqdm import tqdm

from hil.campaign import PARTS, Plan, follow, measure, parts_for, plan_for, same_commands, seconds
from hil.commands import grid, resampled, steps
from hil.cycle import PERIOD
from hil.resume import attempts, forget, log_name, measured_so_far, partial
from hil.rig import ENDINGS
from hil.session import Setup, session
from vpp_fmu.cli import hil_options
from vpp_fmu.cli.hil_outcome import ENDED, ENDED_EARLY, RUNNING
from vpp_fmu.cli.options import SEED, real, whole
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.date import now
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder, read_text
from vpp_fmu.parameters import parameters_file
from vpp_fmu.parquet import as_parquet, check_parquet
from vpp_fmu.record import Record, read_record, write_record
from vpp_fmu.rig import FILE, Rig
from vpp_fmu.structured import read_object

EXAMPLE = "vpp hil campaign --virtual --hide linkage_play=0.5 -o campaigns/emulated"

PARTIAL = ".partial.csv"
"""What is measured of a part that did not come to its end: no name that a campaign's reader takes."""

SAME = ("plan", "rig", "hidden", "physics", "seed", "limits", "allowed", "calibration")
"""Of hil.json: what must be as it was where a campaign goes on."""


def configure(parser):
    hil_options.add_rig(parser)
    text = "of an earlier campaign on this rig: what it may do"
    parser.add_argument("--parameters", type=parameters_file, metavar="F", help=text)
    parser.add_argument(
        "--parts", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=f"of {', '.join(PARTS)} (default: all)"
    )
    parser.add_argument("--commands", metavar="R", help="instead: any record of time, omega_ref, beta_ref; gives record.csv")
    plan = Plan()
    for name, kind, text in (
        ("points", whole(2, 100), "a side of the static grid"),
        ("samples", whole(2, 10**6), "readings a point of the grid"),
        ("settle", real(0.1, 60.0, "s"), "before a point or a step counts"),
        ("levels", whole(1, 20), "of the other command for the steps"),
        ("section", real(5.0, 3600.0, "s"), "each of the three of the open loop"),
        ("validation", real(5.0, 3600.0, "s"), "of the validation record"),
        ("commands-seed", SEED, "of the open-loop and validation commands"),
    ):
        default = getattr(plan, "seed" if name == "commands-seed" else name)
        option = f"--{name}" if name != "validation" else "--validation-seconds"
        longer = ", longer for a rig slower than the paper's" if kind.unit else ""
        shown = f"{text} (default: {default:g} {kind.unit}{longer})".replace(" )", ")")
        parser.add_argument(option, type=kind, metavar="N", help=shown)
    parser.add_argument("--resume", action="store_true", help="go on with the campaign in DIR: with the same options as before")
    hil_options.add_watch(parser)
    hil_options.add_records(parser)
    add_output(parser)


def run(options):
    if options.records == "parquet":
        check_parquet()
    setup = replace(hil_options.setup_of(options, steps=True), map_is_known=False)
    plan = _plan(options, setup.allowed)
    commands = _commands(options.commands, setup) if options.commands else None
    folder = OutputFolder(options.output)
    told = _told(options, setup, plan, folder)
    hil_options.say_allowed(setup.allowed)
    with hil_options.watched(options, told) as page:
        hil_options.confirm(setup)
        _measure(options, setup, plan, commands, folder, told, page)


def _measure(options, setup: Setup, plan: Plan, commands: Record | None, folder: OutputFolder, told: dict, page) -> None:
    """The parts that are wanted and not there yet, one after the other. What ended one before its time is raised."""
    parts = ("record",) if commands else tuple(part for part in options.parts if part in parts_for(setup.allowed))
    if not commands and len(parts) < len(options.parts):
        print("steps: speed and pitch both stand, so there are none")
    length = commands.time[-1] if commands else seconds(plan, parts, setup.allowed)
    print(f"{', '.join(parts)}: {length / 60.0:.1f} min on the rig", flush=True)
    if file := hil_options.which(options).file:
        folder.write(FILE, read_text(file))  # what reads the campaign must know it too
    told, found = told | {"status": RUNNING}, {}
    folder.write("hil.json", as_json(told))
    for part in parts:
        if told["parts"].get(part, {}).get("whole"):
            print(f"{part}: measured already")
            found[part] = read_record(folder.path / f"{part}.csv") if part in ("open_loop", "repeat") else None
            continue
        have = measured_so_far(folder.path, part) if part in ("static", "steps") else []
        if page:
            page.part(part, **_extent(part, plan, setup, commands), parts=parts, before=attempts(folder.path, part))
        one, record, ended = _measured(_again(setup, part), folder, part, plan, commands, have, page)
        told["parts"][part] = one.told() | {
            "ended": str(ended or ""),
            "whole": not ended,
            "attempts": len(attempts(folder.path, part)),
        }
        if ended:
            told |= {"status": ENDED_EARLY, "completed": now()}
        folder.write("hil.json", as_json(told))
        if ended:
            _keep(folder, part)
            raise ended
        found[part] = record
        _write(folder, part, record, found, options.records)
        (folder.path / f"{part}{PARTIAL}").unlink(missing_ok=True)
        rows, ticks, lost = one.logged.rows, one.rig.ticks.ticks, one.logged.lost
        print(f"{part}: {len(record['omega_ref'])} rows, log {rows} rows of {ticks} ticks, {lost} lost", flush=True)
    folder.write("hil.json", as_json(told | {"status": ENDED, "completed": now()}))
    say_written(folder)


def _told(options, setup: Setup, plan: Plan, folder: OutputFolder) -> dict:
    """What hil.json says before the first part; with --resume what it said, if the campaign is the same. BadInput."""
    path = folder.path / "hil.json"
    now_told = json.loads(as_json(hil_options.begun(options, setup) | {"plan": asdict(plan), "parts": {}}))
    before = read_object(path) if path.exists() else {}
    unfinished = "plan" in before and before.get("status") in (RUNNING, ENDED_EARLY)
    if not options.resume:
        if unfinished:
            allowed = "--resume, or another folder"
            raise BadInput(folder.path, "campaign", f"one that did not come to its end, begun {before.get('begun')}", allowed)
        for part in (*PARTS, "record"):
            forget(folder.path, part)
        return now_told
    if "plan" not in before:
        raise BadInput(folder.path, "--resume", "no campaign", "a folder that vpp hil campaign has written to")
    for name in SAME:
        if before.get(name) != now_told.get(name):
            raise BadInput(
                path, name, f"{json.dumps(before.get(name))[:80]}", f"{json.dumps(now_told.get(name))[:80]}, as now asked for"
            )
    return before | {"resumed": [*before.get("resumed", []), now_told["begun"]]}


def _keep(folder: OutputFolder, part: str) -> None:
    """What was measured of a part that did not come to its end, beside the files that others read."""
    have = measured_so_far(folder.path, part)
    record = partial(part, have)
    if record is not None:
        write_record(folder, f"{part}{PARTIAL}", record)
        what = "points" if part == "static" else "steps" if part == "steps" else "rows"
        count = len(have) if part in ("static", "steps") else len(record)
        print(f"{part}: {count} {what} kept in {part}{PARTIAL}; --resume goes on", flush=True)


def _measured(setup: Setup, folder: OutputFolder, part: str, plan: Plan, commands: Record | None, have: list, page):
    """One part on the rig: (session, record, None), or (session, None, why it ended early)."""
    record = ended = None
    in_view = sys.stderr.isatty() and not setup.virtual  # it shows how much is done
    with (
        tqdm(total=100, unit="%", desc=part, disable=True if in_view else None, leave=False) as bar,
        session(setup, folder.path, log_name(folder.path, part), page=page) as one,
    ):

        def progress(share):
            one.rig.show_done(share)
            if setup.virtual:  # in real time a terminal must not hold the loop
                bar.update(round(100 * share) - bar.n)

        try:
            record = (
                follow(one.rig, commands, plan.settle, progress)
                if commands
                else measure(one.rig, part, plan, progress, setup.allowed, have)
            )
        except ENDINGS as reason:
            ended = reason
    return one, record, ended


def _extent(part: str, plan: Plan, setup: Setup, commands: Record | None) -> dict:
    """How much a part is, as the operator's page wants to know it; a record's own length stands in its events."""
    if part == "static" and not commands:
        speeds, pitches = zip(*grid(plan.points, setup.allowed), strict=True)
        return {"grid": {"speeds": sorted(set(speeds)), "pitches": sorted(set(pitches))}}
    return {"steps": len(steps(plan.levels, setup.allowed))} if part == "steps" else {}


def _again(setup: Setup, part: str) -> Setup:
    """The emulated rig for one part: the same rig, but no two parts have the same noise."""
    if setup.emulated is None:
        return setup
    seed = 100 * setup.emulated.seed + (*PARTS, "record").index(part)
    return replace(setup, emulated=replace(setup.emulated, seed=seed))


def _write(folder: OutputFolder, part: str, record: Record, found: dict[str, Record], records: str) -> None:
    if part == "repeat" and "open_loop" in found and not same_commands(found["open_loop"], record):
        print("repeat: a slot was missed where a command changed, so the commands differ: kept as open_loop_again.csv")
        part = "open_loop_again"
    write_record(folder, f"{part}.csv", record)
    if records == "parquet":
        folder.write(f"{part}.parquet", as_parquet(record))


def _commands(path: str, setup: Setup) -> Record:
    """The record to follow, at the loop's own times. BadInput where it asks for what the limits would not let pass: what was
    measured then would not be what was asked for."""
    record, limits = read_record(path), setup.limits
    ranges = {"omega_ref": (limits.omega_min, limits.omega_max, "rpm"), "beta_ref": (limits.beta_min, limits.beta_max, "deg")}
    for name, (low, high, unit) in ranges.items():
        outside = (record[name] < low) | (record[name] > high)
        if outside.any():
            row = int(np.argmax(outside))
            allowed = f"{low:g} to {high:g} {unit}, as the limits have it"
            raise BadInput(path, f"{name}, row {row + 1} of the data", f"{record[name][row]:.9g}", allowed)
    return resampled(record, PERIOD)


def _plan(options, allowed: Rig) -> Plan:
    fields = {"validation_seconds": "validation", "commands_seed": "seed"}
    named = ("points", "samples", "settle", "levels", "section", *fields)
    given = {fields.get(name, name): getattr(options, name) for name in named if getattr(options, name) is not None}
    return replace(plan_for(allowed), **given)
