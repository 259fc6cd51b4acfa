"""Convert a table to a file of a campaign: CSV of any delimiter, decimal mark, header, encoding, clock; Parquet, MAT, HDF5.

--map gives the column and the unit of each quantity: thrust=Fz:gf. A unit is any of pint's, with a factor if needed
("thrust=Fz:-1 gf"); without one it is the log's own. A time may start at any moment, or be a date ("iso"). omega=COLUMN:erpm/7
is the electrical speed of a motor with 7 pole pairs. beta_ref=COLUMN:us@1000=-5,2000=10 is a linear calibration: -5 deg at a
reading of 1000, 10 deg at 2000; thrust=COLUMN:mV@0.2=0,1.5=10 is one in N. thrust=A+B adds two columns. The signal to the
motor's controller can replace omega_ref, if omega is measured: a map between them is fitted to the log, and shared by all logs
of the folder. Other quantities are taken as the log's header says, unless NAME=- omits them; --propose prints them.
The mapping is saved in import.toml beside the record, and --map import.toml uses it again.

Names: time omega_ref beta_ref omega thrust beta voltage current torque power signal run thrust_std samples."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from identification.logs.clock import check_stamps
from identification.logs.commands import FILE as SPEED_MAP
from identification.logs.commands import map_beside
from identification.logs.containers import read_container
from identification.logs.delimited import DELIMITERS, read_delimited
from identification.logs.intake import Taken, signal_range, take_in, take_measured
from identification.logs.mapping import (
    FILE,
    FORMAT,
    Plan,
    completed,
    parse_fixed,
    parse_pairs,
    read_sections,
    section_of,
    to_toml,
)
from identification.logs.raw_table import RawTable
from identification.logs.rotors import chosen
from identification.logs.speed_map import SpeedMap, read_speed_map
from identification.logs.units import QUANTITIES
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.import_place import add_kind, add_speed_from, headline, placed
from vpp_fmu.app.cli.options import add_output, whole
from vpp_fmu.app.cli.output import written
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder

EXAMPLE = (
    "vpp import csv log.csv --propose\n"
    "  vpp import csv log.csv --map time=t:ms omega_ref=soll:rad/s omega=ist:rad/s thrust=Fz:gf -o mine --as open_loop"
)


def configure(parser):
    add_reading(parser)
    add_kind(parser, "open_loop", "which file of the campaign (default: %(default)s)")
    text = "print what the header proposes, and stop; with FILE save that as TOML for --map"
    parser.add_argument("--propose", nargs="?", const="", metavar="FILE", help=text)


def add_reading(parser) -> None:
    parser.add_argument("log", metavar="LOG", help="the table; .gz is unpacked")
    text = "NAME=COLUMN:UNIT, one or more, or an import.toml; for all other names as --propose says, where it is sure"
    parser.add_argument("--map", action="extend", nargs="+", default=[], metavar="M", help=text)
    text = "accept units that the log does not state and the importer guesses (thrust_g, throttle_%%); never a contradiction"
    parser.add_argument("--yes", action="store_true", help=text)
    text = "take a unit that contradicts the header, or a speed that looks electrical"
    parser.add_argument("--force", action="store_true", help=text)
    text = "of several rotors in one file, such as rpm_1 and rpm_2 (default: that of a column in --map)"
    parser.add_argument("--rotor", metavar="R", help=text)
    text = "of a log whose time starts again: the N-th run alone, from 1"
    parser.add_argument("--run", dest="run_number", type=whole(1, 100000), metavar="N", help=text)
    add_speed_from(parser)
    text = "a command or voltage that the log does not have: beta_ref=8:deg; may be repeated"
    parser.add_argument("--fixed", action="append", default=[], metavar="NAME=VALUE:UNIT", help=text)
    parser.add_argument(
        "--speed-map", metavar="M", help="speed_map.json of another log, for a signal (default: the folder's own)"
    )
    text = f"what parts cells: {', '.join(DELIMITERS)}, or one character (default: found out)"
    parser.add_argument("--delimiter", metavar="D", help=text)
    parser.add_argument("--decimal", choices=("point", "comma"), help="decimal mark (default: found out)")
    parser.add_argument("--encoding", metavar="E", help="such as utf-16 or cp1252 (default: found out)")
    add_output(parser)


def run(options):
    section, table, lines = opened(options)
    if options.propose is not None:
        return _propose(options, section, table, lines)
    plan = planned(options, section, table, lines)
    known, taken = taken_in(options, table, plan)
    return put(options, table, plan, taken, known, lines, [])


def taken_in(options, table: RawTable, plan: Plan, **more) -> tuple[SpeedMap | None, Taken]:
    """(the known map of a signal, the log) by the options; `more`: further ones of `take_in`. BadInput."""
    more |= {"force": options.force, "run": options.run_number}
    if options.speed_from == "measured":
        return None, take_measured(table, plan, options.kind, **more)
    known = known_map(options, plan)
    return known, take_in(table, plan, options.kind, known, **more)


def put(
    options, table: RawTable, plan: Plan, taken: Taken, known: SpeedMap | None, lines: list[str], corrections: list[str]
) -> Answer:
    """Write the file of the campaign, the mapping, and the signal's map if it is not the `known` one or not there yet."""
    place, saved = Path(options.output), plan
    sections = read_sections(place / FILE) if (place / FILE).exists() else {}
    if options.speed_from == "measured":  # the mapping says so to the next log
        taken = replace(taken, columns={name: column for name, column in taken.columns.items() if name != "omega"})
        others = {q: c for q, c in plan.columns.items() if q not in ("omega_ref", "omega", "signal")}
        fixed = {name: value for name, value in plan.fixed.items() if name != "omega_ref"}
        saved = replace(plan, columns={"omega_ref": plan.columns["omega"], **others}, fixed=fixed)
    section = saved.section(Path(options.log).name)
    folder, record, said = placed(place, options.kind, taken, options.replace, options.mend)
    folder.write(FILE, to_toml({**sections, options.kind: section}))
    if taken.speed_map is not None and not (known and (place / SPEED_MAP).exists()):
        folder.write(SPEED_MAP, (known or taken.speed_map).to_json())
    lines += [*said_of_columns(table, plan, taken), *taken.said, *corrections, *said]
    content = {"format": FORMAT, options.kind: section}
    return Answer(headline(folder, options.kind, record.columns, options.log), content, lines, written=written(options, folder))


def opened(options) -> tuple[dict, RawTable, list[str]]:
    """(content of the import.toml among --map, the log, how it was read and what was left out, in words). BadInput."""
    section = saved_section(options)
    table = read_table(options, section.get("read", {}))
    lines = [f"{Path(table.source).name}: {table.how_read}; {len(table)} rows, {len(table.columns)} columns"]
    if table.left_out:
        lines.append(f"left out: {', '.join(f'{reason} {count}' for reason, count in table.left_out.items())}")
    return section, table, lines


def known_map(options, plan: Plan) -> SpeedMap | None:
    """The given speed map for the plan's signal, else the folder's; None without a signal or a map. BadInput for a map of
    another kind of signal."""
    span = signal_range(plan)
    given = read_speed_map(options.speed_map) if options.speed_map else None
    if given and span and given.signal != span:
        raise BadInput(
            options.speed_map, "signal, kind", given.signal.kind, f"a map for {span.kind}, which is in {options.log}"
        )
    return given or (map_beside(options.output, span, options.log) if span else None)


def saved_section(options) -> dict:
    """Content of the import.toml among --map, empty without one. BadInput."""
    files = [word for word in options.map if "=" not in word]
    if len(files) > 1 or (files and not files[0].endswith(".toml")):
        raise BadInput("command line", "--map", " ".join(files), "NAME=COLUMN:UNIT, one or more, and at most one FILE.toml")
    return section_of(files[0], options.kind) if files else {}


def read_table(options, read: dict) -> RawTable:
    """The log; `read`: options that read it, of an import.toml. BadInput."""
    decimal = {"point": ".", "comma": ","}.get(options.decimal)
    own = {"encoding": options.encoding, "delimiter": options.delimiter, "decimal": decimal}
    given = {**{name: text for name, text in read.items() if name in own}, **{n: t for n, t in own.items() if t is not None}}
    table = read_container(options.log)
    return read_delimited(options.log, given) if table is None else table


def planned(options, section: dict, table: RawTable, lines: list[str]) -> Plan:
    """The plan of columns: pairs of the command line override those of a TOML, or else a proposal completes them. BadInput."""
    own = parse_pairs([word for word in options.map if "=" in word], table, options.force)
    saved = [f"{q}={text}" for q, text in section.get("columns", {}).items() if q not in own]
    fixed = parse_fixed([f"{n}={text}" for n, text in section.get("fixed", {}).items()]) | parse_fixed(options.fixed)
    if saved and options.rotor:
        raise BadInput("command line", "--rotor", options.rotor, "no --rotor beside an import.toml, which names the columns")
    if saved:
        columns, said = parse_pairs(saved, table, options.force) | own, []
    else:
        others, said = chosen(table, options.rotor, [part for c in own.values() if c for part in table.parts(c.name)])
        lines += said
        if "time" not in own:
            check_stamps(table)
        columns, said = completed(table, own, fixed, others, options.yes)
    lines += said
    columns = {q: columns[q] for q in QUANTITIES if columns.get(q) and q not in fixed}
    if options.speed_from == "measured" and "omega" not in columns:
        hint = "--map omega=COLUMN:rpm, or --speed-from command"
        raise BadInput(table.source, "omega", "no column of measured speed", "one for --speed-from measured", hint)
    return Plan(columns, fixed, table.read)


def _propose(options, section: dict, table: RawTable, lines: list[str]) -> Answer:
    options.yes = True
    plan = planned(options, section, table, lines)
    try:
        (_, taken), refusal = taken_in(options, table, plan), []
    except BadInput as error:
        taken, refusal = None, [f"the import would refuse it: {error}"]
    lines += [*said_of_columns(table, plan, taken), f"as options: {plan.words()}", *refusal]
    content, place = {"format": FORMAT, options.kind: plan.section(Path(options.log).name)}, []
    if options.propose:
        folder, name = OutputFolder(Path(options.propose).parent), Path(options.propose).name
        if (folder.path / name).exists() and not options.replace:
            raise BadInput(options.propose, "file", "an existing file", "a new file", "--replace")
        folder.write(name, to_toml({options.kind: plan.section(Path(options.log).name)}))
        place = [f"saved in {options.propose}"]
    text = f"The header of {Path(options.log).name} proposes {len(plan.columns)} of {len(table.columns)} columns."
    return Answer(text, content, lines, written=place)


def said_of_columns(table: RawTable, plan: Plan, taken: Taken | None) -> list[str]:
    """Each column of the record, its source and range, in words, and the columns that are not used."""
    lines = []
    for quantity, column in plan.columns.items():
        values, unit = taken and taken.columns.get(quantity), QUANTITIES[quantity].unit
        span = ""
        if values is not None and np.isfinite(values).any():
            empty = int((~np.isfinite(values)).sum())
            span = f": {number(float(np.nanmin(values)))} to {number(float(np.nanmax(values)))} {unit}".rstrip()
            span += f", {empty} cells empty" if empty else ""
        how = f" ({column.sure})" if column.sure else ""
        lines.append(f"{quantity} <- {column.name}{f' in {column.unit}' if column.unit else ''}{how}{span}")
    lines += [f"{name} = {number(value)} {QUANTITIES[name].unit}, fixed" for name, value in plan.fixed.items()]
    used = {part for column in plan.columns.values() for part in table.parts(column.name)}
    unused = [name for name in table.columns if name not in used]
    return [*lines, f"not used: {', '.join(unused)}"] if unused else lines
