"""Measure the rig's calibration, step by step: weights on the load cell and its sign, pulses to pitch, where the motor starts.

Each step says what to do and waits for Enter, or for a number that you read. For load cell and pitch the ESC's supply is off;
the last step turns the bare motor, without a propeller. --answers FILE: the same answers, a line each, `#` a remark. A part
that is left out stays as --calibration has it, with who measured it and when."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from hil.calibrate import LoadCell, Measured, adopted, pitched, started, weighed
from hil.calibration import Calibration, check, never_measured, to_json
from hil.report import add_cell, add_pitch_table
from hil.session import REPORT
from vpp_fmu.cli import hil_options
from vpp_fmu.cli.output import add_output, say_written
from vpp_fmu.cli.prompts import Prompts
from vpp_fmu.date import now
from vpp_fmu.digits import number
from vpp_fmu.files import OutputFolder
from vpp_fmu.report import Page

EXAMPLE = "vpp hil calibrate --rig real --calibration wiring.json --operator Ada -o calibration"

PARTS = ("load_cell", "pitch", "esc")
MASSES = (0.0, 0.5, 1.0, 1.5)
"""kg."""
FRICTION = 0.05
"""N of residual above which friction is looked for (hil/README.md)."""
BARE = "bare"


def configure(parser):
    hil_options.add_rig(parser)
    text = f"of {', '.join(PARTS)} (default: all)"
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=text)
    parser.add_argument("--answers", metavar="FILE", help="what would be typed, a line each (default: it is typed)")
    add_output(parser)


def run(options):
    setup, folder = hil_options.setup_of(options, turning=False), OutputFolder(options.output)
    guide = Prompts(options.answers)
    before = setup.calibration
    cell = pitch = throttle = None
    bench = setup.bench()
    try:
        if "load_cell" in options.parts or "pitch" in options.parts:
            guide.do("press the emergency stop: the ESC has no supply, and the rotor stands")
        if "load_cell" in options.parts:
            masses = guide.numbers("weights to hang [kg]", MASSES, _weights, "two or more numbers that rise from 0 on")
            way = guide.choice("do the weights pull with the thrust, or against it", ("with", "against"))
            cell = weighed(bench, guide, masses, way == "with")
            print(said_of_cell(cell))
        if "pitch" in options.parts:
            present, most = tuple(round(1e6 * pulse, 3) for pulse in before.pulses), 1e6 * before.lac_period
            allowed = f"two or more numbers from 0 to {most:g} that rise"
            inside = lambda values: _rise(values) and values[0] >= 0.0 and values[-1] <= most  # noqa: E731
            pulses = guide.numbers("pulses to the pitch [us]", present, inside, allowed)
            pitch = pitched(bench, guide, [round(1e-6 * pulse, 9) for pulse in pulses])
            print(f"pitch: {min(pitch.pitches):g} to {max(pitch.pitches):g} deg, play {pitch.play:.2f} deg")
        if "esc" in options.parts:
            present, idle, most = (round(1e6 * pulse, 3) for pulse in (before.esc_max, before.esc_idle, before.esc_period))
            within = lambda values: len(values) == 1 and idle < values[0] < most  # noqa: E731
            question = "longest pulse that the ESC was taught, by its manual [us]"
            (longest,) = guide.numbers(question, (present,), within, f"a number above {idle:g} and below {most:g}")
            guide.choice("take the propeller OFF, then release the emergency stop; only the bare motor will turn", (BARE,))
            start = started(bench, folder.path / REPORT, supervised=not setup.virtual)
            throttle = start, round(1e-6 * longest, 9)
            print(f"throttle: the motor starts at {1e6 * start:g} us")
    finally:
        bench.close()
    measured = Measured(cell, pitch, throttle)
    found = _sourced(adopted(before, measured), options, measured)
    check(folder.path / "calibration.json", found)
    folder.write("calibration.json", to_json(found))
    folder.write("report.html", _page(before, found, measured).html())
    if unknown := never_measured(found):
        print(f"not measured yet: {', '.join(unknown)}; --rig real wants all")
    say_written(folder)


def _rise(values: Sequence[float]) -> bool:
    return len(values) > 1 and all(a < b for a, b in pairwise(values))


def _weights(values: Sequence[float]) -> bool:
    return _rise(values) and values[0] == 0.0


def said_of_cell(cell: LoadCell) -> str:
    """The load cell's line, and how straight it is."""
    worst = max(map(abs, cell.residuals))
    friction = ": look for friction" if max(worst, cell.hysteresis) > FRICTION else ""
    return (
        f"load cell: {1e3 * cell.newton_per_count:.5g} ± {1e3 * cell.std:.2g} mN a count, zero {cell.zero:.1f} counts, "
        f"residuals up to {number(worst)} N, hysteresis {number(cell.hysteresis)} N{friction}"
    )


def _sourced(found: Calibration, options, measured: Measured) -> Calibration:
    """With who measured what, when, and what was read, in its source."""
    cell, pitch, throttle = measured.cell, measured.pitch, measured.throttle
    own = {"who": options.operator or hil_options.user(), "when": now(), "how": "vpp hil calibrate"}
    source = {key: value for key, value in found.source.items() if key not in ("who", "when")}
    if cell:
        told = {"forces_N": cell.forces, "counts": cell.counts, "residuals_N": cell.residuals, "hysteresis_N": cell.hysteresis}
        source["load_cell"] = own | told | {"std_N_per_count": cell.std}
    if pitch:
        source["pitch"] = own | {"pulses_s": pitch.pulses, "up_deg": pitch.up, "down_deg": pitch.down, "play_deg": pitch.play}
    if throttle:
        source["esc"] = own | {"started_at_s": throttle[0], "taught_s": throttle[1]}
    return replace(found, source=source)


def _page(before: Calibration, found: Calibration, measured: Measured) -> Page:
    cell, pitch, throttle = measured.cell, measured.pitch, measured.throttle
    hashes = f"Sha256 {found.sha256[:12]}; it was {before.sha256[:12]}."
    page = Page("Calibration", f"{hashes} What was not measured stays as it was.")
    rows = []
    if cell:
        change = 100.0 * (cell.newton_per_count / before.newton_per_count - 1.0)
        page.tiles([("force per count", f"{1e3 * cell.newton_per_count:.5g} mN", f"± {1e3 * cell.std:.2g} mN")])
        page.tiles([("residuals", f"{number(max(map(abs, cell.residuals)))} N", f"hysteresis {number(cell.hysteresis)} N")])
        rows += [("force per count [mN]", 1e3 * before.newton_per_count, 1e3 * cell.newton_per_count, f"{change:+.2f} %")]
        rows += [("zero [counts]", before.zero, cell.zero, f"{cell.zero - before.zero:+.1f}")]
        add_cell(page, cell)
    if pitch:
        page.tiles([("play of the pitch", f"{pitch.play:.2f} deg", "at most, from one side against the other")])
        add_pitch_table(page, pitch)
    if throttle:
        page.tiles([("the motor starts at", f"{1e6 * throttle[0]:g} us", f"idle pulse {1e6 * found.esc_idle:g} us")])
        change = 1e6 * (found.esc_idle - before.esc_idle)
        rows += [("idle pulse [us]", 1e6 * before.esc_idle, 1e6 * found.esc_idle, f"{change:+.1f}")]
    if rows:
        page.table(("what", "before", "now", "change"), rows, "What the calibration said before, and what it says now.")
    told = found.source.items()
    page.table(
        ("section", "who", "when"),
        [(name, entry["who"], entry["when"]) for name, entry in told if isinstance(entry, dict) and "who" in entry],
        "Who measured what.",
    )
    return page
