"""Measure a campaign on the rig: the files that `vpp identify` and `vpp diagnose` read.

Each part is a run of its own: tare, arm, run, ramp down. As the paper has it, the static map takes 40 minutes, the steps 15.
Commands stay within what the rig's rig.json declares, what --parameters tells of an earlier campaign, and the limits."""

from dataclasses import asdict, replace

import numpy as np
from tqdm import tqdm

from hil.campaign import PARTS, Plan, follow, measure, parts_for, plan_for, same_commands, seconds
from hil.commands import resampled
from hil.cycle import PERIOD
from hil.rig import ENDINGS
from hil.session import Setup, session
from vpp_fmu.cli import hil_options
from vpp_fmu.cli.options import SEED, number, whole
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder, read_text
from vpp_fmu.record import Record, read_record, write_record
from vpp_fmu.rig import FILE, Rig

EXAMPLE = "vpp hil campaign --virtual --hide linkage_play=0.5 -o campaigns/emulated"


def configure(parser):
    hil_options.add_rig(parser)
    parser.add_argument("--parameters", metavar="F", help="of an earlier campaign on this rig: what it may do")
    parser.add_argument(
        "--parts", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=f"of {', '.join(PARTS)} (default: all)"
    )
    parser.add_argument("--commands", metavar="R", help="instead: any record of time, omega_ref, beta_ref; gives record.csv")
    plan = Plan()
    for name, kind, text in (
        ("points", whole(2, 100), "a side of the static grid"),
        ("samples", whole(2, 10**6), "readings a point of the grid"),
        ("settle", number(0.1, 60.0, "s"), "before a point or a step counts"),
        ("levels", whole(1, 20), "of the other command for the steps"),
        ("section", number(5.0, 3600.0, "s"), "each of the three of the open loop"),
        ("validation", number(5.0, 3600.0, "s"), "of the validation record"),
        ("commands-seed", SEED, "of the open-loop and validation commands"),
    ):
        default = getattr(plan, "seed" if name == "commands-seed" else name)
        option = f"--{name}" if name != "validation" else "--validation-seconds"
        longer = ", longer for a rig slower than the paper's" if kind.unit else ""
        shown = f"{text} (default: {default:g} {kind.unit}{longer})".replace(" )", ")")
        parser.add_argument(option, type=kind, metavar="N", help=shown)
    add_output(parser)


def run(options):
    setup = replace(hil_options.setup_of(options, steps=True), map_is_known=False)
    plan = _plan(options, setup.allowed)
    commands = _commands(options.commands, setup) if options.commands else None
    folder = OutputFolder(options.output)
    hil_options.say_allowed(setup.allowed)
    hil_options.confirm(setup)
    parts = ("record",) if commands else tuple(part for part in options.parts if part in parts_for(setup.allowed))
    if not commands and len(parts) < len(options.parts):
        print("steps: speed and pitch both stand, so there are none")
    length = commands.time[-1] if commands else seconds(plan, parts, setup.allowed)
    print(f"{', '.join(parts)}: {length / 60.0:.1f} min on the rig")
    told, found = {"format": "vpp-hil/1", "plan": asdict(plan), "parts": {}}, {}
    if file := hil_options.which(options).file:
        folder.write(FILE, read_text(file))  # what reads the campaign must know it too
    for part in parts:
        one, record, ended = _measured(_again(setup, part), folder, part, plan, commands)
        told["parts"][part] = one.told() | {"ended": str(ended or "")}
        folder.write("hil.json", as_json(told))
        if ended:
            raise ended
        found[part] = record
        _write(folder, part, record, found)
        rows, ticks, lost = one.logged.rows, one.rig.ticks.ticks, one.logged.lost
        print(f"{part}: {len(record['omega_ref'])} rows, log {rows} rows of {ticks} ticks, {lost} lost")
    say_written(folder)


def _measured(setup: Setup, folder: OutputFolder, part: str, plan: Plan, commands: Record | None):
    """One part on the rig: (session, record, None), or (session, None, why it ended early)."""
    record = ended = None
    with tqdm(total=100, unit="%", desc=part, disable=None, leave=False) as bar:

        def progress(share):
            bar.update(round(100 * share) - bar.n)

        with session(setup, folder.path, f"log_{part}.csv.gz", watch=False) as one:
            try:
                record = (
                    follow(one.rig, commands, plan.settle, progress)
                    if commands
                    else measure(one.rig, part, plan, progress, setup.allowed)
                )
            except ENDINGS as reason:
                ended = reason
    return one, record, ended


def _again(setup: Setup, part: str) -> Setup:
    """The emulated rig for one part: the same rig, but no two parts have the same noise."""
    if setup.emulated is None:
        return setup
    seed = 100 * setup.emulated.seed + (*PARTS, "record").index(part)
    return replace(setup, emulated=replace(setup.emulated, seed=seed))


def _write(folder: OutputFolder, part: str, record: Record, found: dict[str, Record]) -> None:
    if part == "repeat" and "open_loop" in found and not same_commands(found["open_loop"], record):
        print("repeat: a slot was missed where a command changed, so the commands differ: kept as open_loop_again.csv")
        part = "open_loop_again"
    write_record(folder, f"{part}.csv", record)


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
