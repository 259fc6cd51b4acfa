"""Convert a thrust stand's log to a file of a campaign: vpp import csv with what is known of an RCbenchmark (Tyto) stand.

The ESC's signal becomes omega_ref by a map, which the logs of a folder share. Cells behind stalls of the logger and repeated
readings are left empty, the mean thrust at rest is taken off, and rows of averages become static.csv."""

from identification.logs.intake import clock_of
from identification.logs.rcbenchmark import cleaned, preset
from identification.logs.sampling import SAMPLED
from vpp_fmu.app.cli.import_csv import add_reading, opened, planned, put, taken_in
from vpp_fmu.app.cli.import_place import add_kind
from vpp_fmu.digits import number

EXAMPLE = "vpp import rcbenchmark tuesday.csv --speed-map monday/speed_map.json -o tuesday"


def configure(parser):
    add_reading(parser)
    add_kind(parser, None, "which file of a campaign (default: record.csv of samples, static.csv of averages)")
    parser.add_argument("--backwards", action="store_true", help="the thrust was logged with the opposite sign")
    parser.add_argument("--keep-stalls", action="store_true", help="keep what was logged right behind a stall of the logger")


def run(options):
    section, table, lines = opened(options)
    options.map = preset(table, options.map, options.backwards, section.get("columns", ()))
    plan = planned(options, section, table, lines)
    step = clock_of(table, plan, "record", options.run_number).step
    if step > SAMPLED:
        options.kind = options.kind or "static"
        text = "so steady points and no record" if options.kind == "static" else "lags from them are wrong by as much"
        lines.append(f"averages: rows lie {number(1e3 * step)} ms apart, not 8 to 12 ms: {text}")
    options.kind = options.kind or "record"
    known, taken = taken_in(options, table, plan, stand=True)
    taken, said = cleaned(taken, options.keep_stalls)
    return put(options, table, plan, taken, known, lines, said)
