"""Convert a thrust stand's log to a file of a campaign: vpp import csv with what is known of an RCbenchmark (Tyto) stand.

The ESC's signal becomes omega_ref by a map, which the logs of a folder share. Cells behind stalls of the logger and repeated
readings are left empty, the mean thrust at rest is taken off, and rows of averages become static.csv."""

from dataclasses import replace
from pathlib import Path

from identification.gate.zero import Rest
from identification.logs.commands import FILE as SPEED_MAP
from identification.logs.intake import clock_of, take_in
from identification.logs.rcbenchmark import averaged, by_measured_speed, figures, preset, tared
from identification.logs.sampling import REMEMBERED
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.import_csv import (
    add_reading,
    known_map,
    planned,
    read_table,
    said_of_columns,
    said_of_table,
    saved_section,
)
from vpp_fmu.app.cli.import_place import add_kind, headline, placed
from vpp_fmu.app.cli.output import written
from vpp_fmu.digits import number, signed
from vpp_fmu.structured import as_json

EXAMPLE = "vpp import rcbenchmark tuesday.csv --speed-map monday/speed_map.json -o tuesday"


def configure(parser):
    add_reading(parser)
    add_kind(parser, None, "which file of a campaign (default: record.csv of samples, static.csv of averages)")
    parser.add_argument("--backwards", action="store_true", help="the thrust was logged with the opposite sign")
    parser.add_argument("--keep-stalls", action="store_true", help="keep what was logged right behind a stall of the logger")


def run(options):
    section = saved_section(options)
    table = read_table(options, section.get("read", {}))
    lines, measured = said_of_table(table), options.speed_from == "measured"
    options.map = preset(table, options.map, options.backwards)
    plan = planned(options, section, table, lines)
    step = clock_of(table, plan, "record", options.run_number).step
    kind = options.kind or ("static" if averaged(step) else "record")
    if averaged(step):
        text = "so steady points and no record" if kind == "static" else "lags from them are wrong by as much"
        lines.append(f"averages: rows lie {number(1e3 * step)} ms apart, not 8 to 12 ms: {text}")
    given = {"force": options.force, "run": options.run_number, "stand": True}
    known = None if measured else known_map(options, plan)
    taken = by_measured_speed(table, plan, kind, **given) if measured else take_in(table, plan, kind, known, **given)
    lines += [*said_of_columns(table, plan, taken), *taken.said, *taken.stalls.said]
    taken, zero = tared(replace(taken, columns=taken.stalls.emptied(taken.columns, options.keep_stalls)))
    found = figures(table, plan, taken, zero, options.keep_stalls)
    if measured:
        taken = replace(taken, columns={n: c for n, c in taken.columns.items() if n != "omega"})
    folder, put, said = placed(Path(options.output), kind, taken, options.replace, options.mend)
    if known := known or taken.speed_map:
        folder.write(SPEED_MAP, known.to_json())
    folder.write("import.json", as_json(found))
    lines += [*said_of_stalls(found), said_of_tare(zero), *said]
    return Answer(headline(folder, kind, put.columns, options.log), found, lines, written=written(options, folder))


def said_of_stalls(found: dict) -> list[str]:
    """Stalls of the logger and what became of the rows behind them, in words."""
    stalls = found["stalls"]
    if not stalls["number"]:
        return []
    short, long = (1e3 * gap for gap in stalls["seconds"])
    what = "left empty" if stalls["emptied"] else "kept as logged"
    return [
        f"stalls: {stalls['number']} gaps of {short:.0f} to {long:.0f} ms in rows of {1e3 * found['interval']:.1f} ms; "
        f"speed and thrust of {stalls['rows_behind']} rows ({REMEMBERED} behind each) {what}"
    ]


def said_of_tare(zero: Rest | None) -> str:
    """The tare in words."""
    if zero is None:
        return "tare: none, the log has no rest; thrust is as logged"
    return (
        f"tare: {signed(zero.mean)} N taken off, the mean of {zero.readings} readings at rest (spread {number(zero.spread)} N)"
    )
