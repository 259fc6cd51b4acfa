"""Close the loop on the rig over a profile of wanted thrust (CSV with time, thrust_set).

Tares, arms, spins up, settles, runs, ramps down. Ctrl-C ramps down, a second one stops at once; what was measured is kept."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from hil.report import add_counts, add_difference, add_loops, add_timing, add_twin, judged_steps, said
from hil.rig import RunEnded
from hil.run import LimitedPlant, Run, run_on_rig, write_run
from hil.safety.limits import Limits
from hil.twin.band import Band, read_band
from hil.twin.twin import Twin
from vpp_fmu.cli import hil_options
from vpp_fmu.cli.options import Number
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.commands import idle
from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BETA_REF, OMEGA_REF
from vpp_fmu.loop import run as run_loop
from vpp_fmu.parameters import check_same_model
from vpp_fmu.plants import FmuPlant, KernelPlant
from vpp_fmu.record import Record, read_profile
from vpp_fmu.report import Page
from vpp_fmu.rig import Rig

EXAMPLE = "vpp hil run --parameters out/parameters.json --profile step.csv --beside fmus/VppPlant.fmu -o out"

EITHER = Number(BETA_REF.minimum, OMEGA_REF.maximum)
"""What either number of --start may be; which of the two is looked at when both are known."""


def configure(parser):
    parser.add_argument("--profile", metavar="P", required=True, help="CSV with time [s], thrust_set [N]")
    hil_options.add_controller(parser)
    hil_options.add_rig(parser, fmu=True)
    text = "the plant's parameters, for --twin and for what the rig may do (default: the paper's)"
    parser.add_argument("--parameters", metavar="F", help=text)
    text = "run the plant's model beside the rig and tell when the rig leaves its band; I: identification.json of --parameters"
    parser.add_argument("--twin", nargs="?", const="", metavar="I", help=f"{text} (default: the one beside F)")
    parser.add_argument("--beside", metavar="PLANT.fmu", help="the same loop with this plant too, and the difference in N")
    text = "commands that the run starts from, rpm and deg (default: the rig's lowest speed, the pitch next to 0)"
    parser.add_argument("--start", nargs=2, type=EITHER, metavar=("RPM", "DEG"), help=text)
    add_output(parser)


def run(options):
    profile = read_profile(options.profile)
    if hil_options.which(options, fmu=True).kind == "fmu":
        _on_fmu(options, profile)
        return
    setup, controller = hil_options.setup_of(options), hil_options.controller_of(options)
    _check_profile(profile, setup.limits)
    start = _start(options, setup.limits, setup.allowed)
    if options.parameters:
        setup = replace(setup, plant=hil_options.plant_of(options).values)
    twin, band = _twin(options)
    beside = _beside(options.beside, options, profile) if options.beside else None
    folder = OutputFolder(options.output)
    hil_options.say_allowed(setup.allowed)
    hil_options.confirm(setup)
    with tqdm(total=100, unit="%", disable=None if setup.virtual else True, leave=False) as bar:
        done = run_on_rig(
            setup,
            controller,
            profile,
            folder.path,
            start,
            twin,
            lambda share: bar.update(round(100 * share) - bar.n),
        )
    controller.close()
    _write(folder, done, beside, options, twin, band)
    say_written(folder)
    if done.ended:
        raise RunEnded(done.ended)


def _on_fmu(options, profile: Record) -> None:
    """The plant FMU in the rig's place: limits, controller, report and files are the same."""
    plant, folder = hil_options.which(options, fmu=True).plant, OutputFolder(options.output)
    record = _beside(plant, options, profile)
    write_run(folder.path / "run.csv", record)
    folder.write("hil.json", as_json({"format": "vpp-hil/1", "rig": "fmu", "plant": Path(plant).name}))
    page = Page("Hardware in the loop, with a plant FMU", f"{plant} over {options.profile}.")
    add_loops(page, {"plant FMU": record}, "")
    folder.write("report.html", page.html())
    _say({"plant FMU": record})
    say_written(folder)


def _beside(path: str, options, profile: Record) -> Record:
    """The same loop with a plant FMU behind the same limits."""
    limits, allowed = hil_options.limits_for(options, hil_options.allowed_of(options))
    _check_profile(profile, limits)
    start = _start(options, limits, allowed)
    plant, controller = LimitedPlant(FmuPlant(path), limits), hil_options.controller_of(options)
    record = run_loop(plant, controller, profile, start)
    plant.close()
    controller.close()
    return record


def _start(options, limits: Limits, allowed: Rig) -> tuple[float, float]:
    """Commands [rpm, deg] that the run starts from, which the limits let pass."""
    if options.start is None:
        return idle(allowed)
    ranges = (limits.omega_min, limits.omega_max, "rpm"), (limits.beta_min, limits.beta_max, "deg")
    for value, (low, high, unit) in zip(options.start, ranges, strict=True):
        if not low <= value <= high:
            raise BadInput("command line", "--start", f"{value:g} {unit}", f"{low:g} to {high:g} {unit}, as the limits have it")
    return tuple(options.start)


def _check_profile(profile: Record, limits: Limits) -> None:
    """BadInput where the limits would end the run before the profile does."""
    largest = float(np.max(np.abs(profile["thrust_set"])))
    if largest >= limits.thrust_trip:
        allowed = f"less than {limits.thrust_trip:g} N of either sign, which stops the rotor"
        raise BadInput(profile.source, "thrust_set", f"{largest:g} N", allowed)
    if profile.time[-1] > limits.run_time:
        raise BadInput(profile.source, "time", f"{profile.time[-1]:g} s", f"at most the run time, {limits.run_time:g} s")


def _twin(options) -> tuple[Twin | None, Band | None]:
    if options.twin is None:
        return None, None
    if not options.twin and not options.parameters:
        raise BadInput(
            "command line", "--twin", "no --parameters", "the plant's parameters, or an identification.json for its band"
        )
    parameters = hil_options.plant_of(options)
    told = options.twin or Path(options.parameters).with_name("identification.json")
    band = read_band(told)
    if options.parameters:
        check_same_model(told, parameters, options.parameters)
    return Twin(KernelPlant(parameters.model, parameters.values), band), band


def _write(folder: OutputFolder, done: Run, beside: Record | None, options, twin: Twin | None, band: Band | None) -> None:
    told = done.session.told() | {"ended": done.ended, "profile": Path(options.profile).name}
    loops = {"rig": done.record} if len(done.record.time) > 1 else {}
    page = Page("Hardware in the loop", _summary(told, options))
    _tiles(page, told, done)
    if done.ended:
        page.note(f"The run ended early. {done.ended}.")
    if loops and beside is not None:
        loops["plant FMU"] = beside
    if loops:
        write_run(folder.path / "run.csv", done.record)
        add_loops(page, loops, "Pitch is not measured on the rig.")
    if len(loops) > 1:
        told["beside"] = {"plant": Path(options.beside).name, "rms_thrust": add_difference(page, *reversed(loops.items()))}
    if twin is not None:
        told["twin"] = _told_of_twin(page, done, twin, band)
    if done.session.timing:
        add_timing(page, done.session.timing, f"The loop had: {told['real_time']}.")
    states = [(t["time"], t["state"], t["why"]) for t in told["transitions"]]
    add_counts(page, told["counters"], states)
    folder.write("hil.json", as_json(told))
    folder.write("report.html", page.html())
    _say(loops)
    _say_rest(told, done)


def _told_of_twin(page: Page, done: Run, twin: Twin, band: Band) -> dict:
    log = done.log.part(np.isfinite(done.log["residual"]))
    text = (
        f"At most {twin.false_alarms:g} false alarms an hour; a constant {number(twin.smallest, 3)} N is found after "
        f"{twin.delay:.1f} s in the mean."
    )
    if len(log):
        add_twin(page, log.time, log["residual"], log["alarm"], (band.white**2 + band.slow**2) ** 0.5, text)
    rms = float(np.sqrt(np.mean(log["residual"] ** 2))) if len(log) else None
    return {
        "alarmed": twin.alarmed,
        "since": twin.since,
        "false_alarms_per_hour": twin.false_alarms,
        "smallest_found": twin.smallest,
        "delay": twin.delay,
        "residual_rms": rms,
    }


def _summary(told: dict, options) -> str:
    hidden = f" with {', '.join(told['hidden'])} hidden in it" if told["hidden"] else ""
    return (
        f"The {told['rig']} rig{hidden}, {told['time']} time, over {options.profile}. "
        f"Calibration {told['calibration']['sha256'][:12]}."
    )


def _tiles(page: Page, told: dict, done: Run) -> None:
    log, timing = told["log"], done.session.timing
    page.tiles([("rows in the log", f"{log['rows']}", f"{log['lost']} of {log['ticks']} ticks lost")])
    if timing:
        page.tiles([("late, p99.9", f"{1e6 * timing.late[2]:.0f} us", f"{timing.missed} slots missed")])
    if told["tares"]:
        tare = told["tares"][-1]
        page.tiles([("tare", f"{tare['zero_counts']:.1f} counts", f"noise {number(tare['noise_N'])} N")])
    healed = sum(n for device in told["counters"].values() for name, n in device.items() if name != "pulses")
    page.tiles([("healed", f"{healed}", "transfers and frames that failed once")])


def _say(loops: dict[str, Record]) -> None:
    for name, loop in loops.items():
        for step in judged_steps(loop):
            print(f"{said(step, name)}, overshoot {step.overshoot:.1f} %")


def _say_rest(told: dict, done: Run) -> None:
    if "beside" in told:
        print(f"rig and {told['beside']['plant']} differ by {number(told['beside']['rms_thrust'])} N rms")
    if "twin" in told:
        twin = told["twin"]
        said_so = f"alarm, since {twin['since']:.2f} s" if twin["alarmed"] else "no alarm"
        print(f"twin: {said_so}; residual {number(twin['residual_rms'])} N rms")
    log = told["log"]
    print(
        f"log: {log['rows']} rows of {log['ticks']} ticks, {log['lost']} lost{'; ' + log['failure'] if log['failure'] else ''}"
    )
    if done.session.timing:
        print(f"loop: {told['real_time']}\n{done.session.timing.text()}")
