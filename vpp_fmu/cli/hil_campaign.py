"""Measure a campaign on the rig: the files that `vpp identify` and `vpp diagnose` read.

Each part is a run of its own: tare, arm, run, ramp down. As the paper has it, the static map takes 40 minutes, the steps 15."""

from dataclasses import asdict, replace

from tqdm import tqdm

from hil.campaign import PARTS, Plan, follow, measure, same_commands, seconds, steep
from hil.commands import resampled
from hil.cycle import PERIOD
from hil.rig import ENDINGS
from hil.session import Setup, session
from vpp_fmu.cli import hil_options
from vpp_fmu.cli.options import SEED, number, whole
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.files import OutputFolder
from vpp_fmu.record import Record, read_record, write_record

EXAMPLE = "vpp hil campaign --virtual --hide linkage_play=0.5 -o campaigns/emulated"


def configure(parser):
    hil_options.add_rig(parser)
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
        shown = f"{text} (default: {default:g} {kind.unit})".replace(" )", ")")
        parser.add_argument(option, type=kind, default=default, metavar="N", help=shown)
    add_output(parser)


def run(options):
    plan = _plan(options)
    setup = hil_options.setup_of(options)
    setup = replace(setup, limits=steep(setup.limits), map_is_known=False)
    commands = resampled(read_record(options.commands), PERIOD) if options.commands else None
    folder = OutputFolder(options.output)
    hil_options.confirm(setup)
    parts = ("record",) if commands else tuple(options.parts)
    length = commands.time[-1] if commands else seconds(plan, parts)
    print(f"{', '.join(parts)}: {length / 60.0:.1f} min on the rig")
    told, found = {"format": "vpp-hil/1", "plan": asdict(plan), "parts": {}}, {}
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
                    follow(one.rig, commands, plan.settle, progress) if commands else measure(one.rig, part, plan, progress)
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


def _plan(options) -> Plan:
    own = {name: getattr(options, name) for name in ("points", "samples", "settle", "levels", "section")}
    return Plan(**own, validation=options.validation_seconds, seed=options.commands_seed)
