"""Convert a thrust stand's log to a file of a campaign: a map fitted to steady parts converts the ESC's signal to omega_ref.

Logs of one stand share the map of the first log in the folder. The pitch is fixed: beta_ref is 0, or the value of --fixed.
Quantities that the log did not measure, or measured before the row's time, are empty. Rows of averages become static.csv.
"""

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from identification.gate.sensors import multiples
from identification.gate.zero import Rest, tare
from identification.logs.clock import Clock
from identification.logs.commands import FILE as SPEED_MAP
from identification.logs.commands import map_beside
from identification.logs.delimited import read_delimited
from identification.logs.intake import Taken, within_ranges
from identification.logs.mapping import in_other_unit, parse_fixed
from identification.logs.rcbenchmark import REMEMBERED, Log, read_log
from identification.logs.speed_map import SpeedMap, fit_quality, fit_speed_map, read_speed_map, said_of_gross
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.import_place import add_kind, add_speed_from, headline, placed
from vpp_fmu.app.cli.options import add_output
from vpp_fmu.app.cli.output import written
from vpp_fmu.digits import number, signed
from vpp_fmu.errors import BadInput
from vpp_fmu.structured import as_json

EXAMPLE = "vpp import rcbenchmark tuesday.csv --speed-map monday/speed_map.json -o tuesday"


def configure(parser):
    parser.add_argument("log", metavar="LOG", help="CSV as the stand's program wrote it")
    text = "speed_map.json of another log (default: the folder's own, else fit one)"
    parser.add_argument("--speed-map", metavar="M", help=text)
    add_kind(parser, None, "which file of a campaign (default: record.csv of samples, static.csv of averages)")
    add_speed_from(parser)
    parser.add_argument("--fixed", metavar="beta_ref=V:UNIT", help="the pitch, which is fixed (default: beta_ref=0:deg)")
    parser.add_argument("--backwards", action="store_true", help="the thrust was logged with the opposite sign")
    parser.add_argument("--keep-stalls", action="store_true", help="keep what was logged right behind a stall of the logger")
    add_output(parser)


def run(options):
    log, beyond = read_log(options.log), []
    if options.backwards:
        log = replace(log, thrust=-log.thrust)
    pitch = _pitch(options, log)
    measured = options.speed_from == "measured"
    known, taken_over = (None, False) if measured else _speed_map(options, log)
    speed_map = known and known.reaching(log.steady_points().turns_from)
    kind = options.kind or ("static" if log.averaged else "record")
    omega_ref = log.filled_speed(_multiples(log)) if measured else speed_map.omega_ref(log.signal)
    record = log.record(omega_ref, options.keep_stalls)
    if zero := tare(record):
        record = record.with_columns(thrust=record["thrust"] - zero.mean)
    figures = findings(log, speed_map, zero, options.keep_stalls)
    columns = {name: column for name, column in record.columns.items() if not (measured and name == "omega")}
    columns["beta_ref"] = np.full(len(record), pitch)
    if kind != "static":
        columns, beyond = within_ranges(columns, log.names, log.source, "vpp import csv with --map")
    taken = Taken(columns, Clock(np.arange(len(record)), log.time, ""), (), log.source, speed_map)
    folder, put, said = placed(Path(options.output), kind, taken, options.replace, options.mend)
    if known:
        folder.write(SPEED_MAP, known.to_json())
    folder.write("import.json", as_json(figures))
    lines = [said_of_rows(figures), *said_of_averages(log, kind), *said_of_thrust(figures)]
    lines += said_of_map(figures["speed_map"], known, taken_over) if known else ["omega_ref: the measured speed"]
    lines += beyond + said
    return Answer(headline(folder, kind, put.columns, options.log), figures, lines, written=written(options, folder))


def _pitch(options, log: Log) -> float:
    """The fixed pitch, deg. BadInput if it is not declared and the log has a servo's column with changing values."""
    if options.fixed is not None:
        if [*(fixed := parse_fixed([options.fixed]))] != ["beta_ref"]:
            raise BadInput("command line", "--fixed", options.fixed, "beta_ref=VALUE:UNIT, such as beta_ref=8:deg")
        return fixed["beta_ref"]
    if other := in_other_unit(read_delimited(options.log, {}), "beta", log.names.values()):
        found = f"{other[0]}, pitch by its name, from {other[2]:g} to {other[3]:g} {other[1]}".rstrip()
        hint = "--fixed beta_ref=8:deg for a fixed pitch, or vpp import csv to map the column"
        raise BadInput(log.source, "beta_ref", found, "a pitch in degrees", hint)
    return 0.0


def _speed_map(options, log: Log) -> tuple[SpeedMap, bool]:
    """The given map, else the folder's, else one fitted to the log, and whether it is from another log. BadInput for a map of
    another kind of signal."""
    beside = None if options.speed_map else map_beside(options.output, log.span, options.log)
    found = read_speed_map(options.speed_map) if options.speed_map else beside or fitted(log)
    if found.signal != log.span:
        allowed = f"a map for {log.span.kind} {log.span.low:g} to {log.span.high:g}, which is in {options.log}"
        raise BadInput(options.speed_map, "signal, kind", found.signal.kind, allowed)
    return found, bool(options.speed_map or beside)


def _multiples(log: Log) -> np.ndarray:
    """Mask (n,) of doubled or halved speeds, if the log's steady parts give a map to compare with; else none."""
    with contextlib.suppress(BadInput):
        return multiples(log.record(fitted(log).omega_ref(log.signal)))[0]
    return np.zeros(len(log.time), bool)


def said_of_averages(log: Log, kind: str) -> list[str]:
    """A remark if rows are averages, not samples."""
    if not log.averaged:
        return []
    rows = f"rows lie {number(1e3 * log.interval)} ms apart, where the stand takes a sample every 8 to 12 ms: averages"
    return [f"{rows}, so steady points and no record" if kind == "static" else f"{rows}; lags from them are wrong by as much"]


def fitted(log: Log) -> SpeedMap:
    """The map of the log's own steady parts."""
    if log.speed is None:
        hint = "--speed-map M.json of another log of this stand"
        raise BadInput(log.source, "columns", "no speed", "the motor's optical or electrical speed", hint)
    return fit_speed_map(log.steady_points(), log.span, log.loaded_voltage, Path(log.source).name)


def findings(log: Log, speed_map: SpeedMap | None, zero: Rest | None, keep_stalls: bool) -> dict:
    """The content of import.json: the log, and its corrections. `speed_map` None: the speed is the measured one."""
    filled, behind = np.isfinite(log.thrust), log.stalled & ~log.repeated
    emptied = behind & (not keep_stalls)
    gaps = np.diff(log.time)[log.late[1:]]
    return {
        "format": "vpp-import/1",
        "log": Path(log.source).name,
        "columns": dict(log.names),
        "start": log.start,
        "seconds": float(log.time[-1]),
        "interval": log.interval,
        "rows": len(log.time),
        "clock_back": {"rows": log.mended[0], "seconds": log.mended[1]},
        "left_out": {reason: number for reason, number in log.dropped.items() if number},
        "thrust": {
            "filled": int(filled.sum()),
            "repeated": int(log.repeated.sum()),
            "behind_stalls": int((filled & behind).sum()),
            "kept": int((filled & ~log.repeated & ~emptied).sum()),
        },
        "stalls": {
            "number": len(gaps),
            "seconds": [float(gaps.min()), float(gaps.max())] if len(gaps) else None,
            "rows_behind": int(log.stalled.sum()),
            "emptied": not keep_stalls,
        },
        "tare": {name: getattr(zero, name) for name in ("mean", "spread", "readings")} if zero else None,
        "signal": {"kind": log.span.kind, "minimum": float(log.signal.min()), "maximum": float(log.signal.max())},
        "speed_map": speed_map
        and {
            "source": speed_map.source,
            "nominal_voltage": speed_map.nominal_voltage,
            "rms": speed_map.rms,
            "turns_from": speed_map.turns_from,
            "here": fit_quality(log.steady_points(), speed_map),
            "rows_beyond": int(np.sum(log.signal > speed_map.fitted_to)),
        },
    }


def said_of_rows(figures: dict) -> str:
    """Rows and columns in words."""
    left_out = ", ".join(f"{reason} {number}" for reason, number in figures["left_out"].items()) or "none"
    signal, back, clock = figures["signal"], figures["clock_back"], ""
    if back["rows"]:
        most = f"{1e3 * back['seconds']:.3g} ms"
        clock = f"clock: goes back in {back['rows']} rows, by {most} at most, less than a row: mended\n"
    return (
        f"rows: {figures['rows']} over {figures['seconds']:.2f} s, from {figures['start']:.6g} s of the log on; "
        f"left out: {left_out}\n{clock}"
        f"ESC signal: {signal['kind']}, {signal['minimum']:g} to {signal['maximum']:g}; "
        f"speed: {figures['columns'].get('speed', 'none')}"
    )


def said_of_thrust(figures: dict) -> list[str]:
    """The treatment of the thrust and its reason, in words."""
    thrust, stalls, zero = (figures[name] for name in ("thrust", "stalls", "tare"))
    lines = [
        f"thrust: {thrust['filled']} cells filled; {thrust['repeated']} repeat the last value, {thrust['behind_stalls']} more "
        f"stand behind a stall; {thrust['kept']} readings kept",
        "stalls: none",
        "tare: none, the log has no rest; thrust is as logged",
    ]
    if stalls["number"]:
        short, long = (1e3 * gap for gap in stalls["seconds"])
        share = stalls["rows_behind"] / figures["rows"]
        lines[1] = (
            f"stalls: {stalls['number']} gaps of {short:.0f} to {long:.0f} ms in rows of {1e3 * figures['interval']:.1f} ms; "
            f"speed and thrust of {stalls['rows_behind']} rows ({REMEMBERED} behind each, {share:.1%}) "
            f"{'left empty' if stalls['emptied'] else 'kept as logged'}"
        )
    if zero:
        lines[2] = (
            f"tare: {signed(zero['mean'])} N taken off, the mean of {zero['readings']} readings at rest "
            f"(spread {number(zero['spread'])} N)"
        )
    return lines


def said_of_map(figures: dict, known: SpeedMap, taken_over: bool) -> list[str]:
    """Source and fit of the map, in words."""
    here = figures["here"]
    own = f"rms {figures['rms']:.0f} rpm, nominal {figures['nominal_voltage']:.2f} V"
    worst = f"at most {here['largest']:.0f} rpm at signal {here['largest_at']:g}" if here["points"] else ""
    if not taken_over:
        return [f"speed map: fitted to {here['points']} steady parts, {own}, {worst}{said_of_gross(here)}"]
    lines = [f"speed map: taken over from {figures['source']} (there {own})"]
    if here["points"]:
        beyond = f", {here['points_beyond']} beyond its signals left out" if here["points_beyond"] else ""
        lines.append(
            f"speed map here: rms {here['rms']:.0f} rpm, {worst}, on {here['points']} steady parts{beyond}{said_of_gross(here)}"
        )
    if (low := figures["turns_from"]) < known.turns_from:
        lines.append(f"speed map: here the rotor turns from signal {low:g} on, there from {known.turns_from:g}")
    if figures["rows_beyond"]:
        lines.append(f"note: {figures['rows_beyond']} rows have a higher signal than the map was fitted to")
    return lines
