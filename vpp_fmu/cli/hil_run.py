"""Close the loop on the rig over a profile of wanted thrust (CSV with time, thrust_set).

Tares, arms, spins up, settles, runs, ramps down. Ctrl-C ramps down, a second one stops at once; what was measured is kept."""

import contextlib
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from hil.cycle import PERIOD
from hil.page.operator_page import OperatorPage
from hil.report import add_loops
from hil.rig import RunEnded
from hil.run import LOG, ON_ALARM, LimitedPlant, Run, run_on_rig, write_run
from hil.runs import run_folder, told_by_files
from hil.safety.limits import Limits
from hil.session import Setup
from hil.twin.adaptive import CERTAIN, Adaptive, adaptable, adaptive
from hil.twin.band import Band, read_band
from hil.twin.twin import Twin
from identification.tune.controllers import said_of
from vpp_fmu.cli import hil_options
from vpp_fmu.cli.hil_outcome import ENDED_EARLY, finish, say_steps
from vpp_fmu.cli.options import Number
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.commands import idle
from vpp_fmu.date import now
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BETA_REF, OMEGA_REF
from vpp_fmu.loop import run as run_loop
from vpp_fmu.parameters import beside, check_same_model, parameters_file
from vpp_fmu.parquet import as_parquet, check_parquet
from vpp_fmu.plants import Controller, FmuPlant, KernelPlant
from vpp_fmu.record import Record, read_profile
from vpp_fmu.report import Page
from vpp_fmu.rig import Rig

EXAMPLE = "vpp hil run --parameters out/parameters.json --profile step.csv --beside fmus/VppPlant.fmu -o out"


class TwinAlarm(VppError):
    """The rig left its twin's band: its record is whole, and not what the model says."""

    code = 3


class LogLost(VppError):
    """The run came to its end, and its record did not."""


@dataclass(frozen=True, eq=False)
class _Task:
    """A run as the options have it: the rig, what drives it over which profile and from which commands on, and what is held
    beside it."""

    setup: Setup
    controller: Controller
    profile: Record
    start: tuple[float, float]
    twin: Twin | None
    band: Band | None
    adaptive: Adaptive | None
    beside: Record | None


EITHER = Number(BETA_REF.minimum, OMEGA_REF.maximum)
"""What either number of --start may be; which of the two is looked at when both are known."""


def configure(parser):
    parser.add_argument("--profile", metavar="P", required=True, help="CSV with time [s], thrust_set [N]")
    hil_options.add_controller(parser)
    hil_options.add_rig(parser, fmu=True)
    text = "the plant's parameters, for --twin and for what the rig may do (default: the paper's)"
    parser.add_argument("--parameters", type=parameters_file, metavar="F", help=text)
    text = "run the plant's model beside the rig and tell when the rig leaves its band; I: identification.json of --parameters"
    parser.add_argument("--twin", nargs="?", const="", metavar="I", help=f"{text} (default: the one beside F)")
    text = "what the twin's alarm does: tell (note), ramp down, idle at once (default: note); the exit code is 3 either way"
    text = "the plant's parameters that the twin adapts (default: thrust gain, pitch and reading offset, the slower lags)"
    parser.add_argument("--adapt", nargs="+", metavar="NAME", help=text)
    parser.add_argument("--on-alarm", choices=tuple(ON_ALARM), default="note", metavar="WHAT", help=text)
    hil_options.add_watch(parser)
    hil_options.add_records(parser)
    parser.add_argument(
        "--beside",
        metavar="PLANT.fmu",
        help="the same loop with this plant FMU too, which runs its author's code, and the difference in N",
    )
    text = "commands that the run starts from, rpm and deg (default: the rig's lowest speed, the pitch next to 0)"
    parser.add_argument("--start", nargs=2, type=EITHER, metavar=("RPM", "DEG"), help=text)
    add_output(parser)


def run(options):
    if options.records == "parquet":
        check_parquet()
    profile = read_profile(options.profile)
    if not options.controller:
        print(said_of(hil_options.gains_of(options), options.gains))
    if hil_options.which(options, fmu=True).kind == "fmu":
        if options.watch is not None:
            raise BadInput("command line", "--watch", "given with --rig fmu", "a rig: a loop of FMUs is over in seconds")
        _on_fmu(options, profile)
        return
    setup, controller = hil_options.setup_of(options), hil_options.controller_of(options)
    _check_profile(profile, setup.limits)
    start = _start(options, setup.limits, setup.allowed)
    if options.parameters:
        setup = replace(setup, plant=hil_options.plant_of(options).values)
    twin, band, adaptive = _twin(options, setup.allowed)
    beside = _beside(options.beside, options, profile) if options.beside else None
    parent = OutputFolder(options.output)
    hil_options.say_allowed(setup.allowed)
    begun = hil_options.begun(options, setup) | _of_twin(twin, band, adaptive)
    task = _Task(setup, controller, profile, start, twin, band, adaptive, beside)
    with hil_options.watched(options, begun) as page:
        hil_options.confirm(setup)
        _on_rig(options, task, begun | {"begun": now()}, parent, page)


def _on_rig(options, task: _Task, begun: dict, parent: OutputFolder, page: OperatorPage | None) -> None:
    """The run, and what it leaves. What ended it before its time is raised."""
    twin, profile = task.twin, task.profile
    if page:
        rows = round((profile.time[-1] - profile.time[0]) / PERIOD)
        page.part("run", rows=rows, band=task.band and task.band.width)
    folder = OutputFolder(run_folder(parent.path, begun["begun"]))
    folder.write("hil.json", as_json(begun))
    print(f"this run's files: {folder.path}", flush=True)
    try:
        done = _run(options, task, folder.path, page)
    except BaseException as error:
        _ended(folder, begun, error)
        raise
    if page:
        page.end(done.ended or "as planned")
    task.controller.close()
    told = done.session.told() | begun | {"ended": done.ended}
    if twin is not None:
        told["twin"] |= {"alarmed": twin.alarmed, "since": twin.since}
    if task.adaptive is not None:
        told["adaptive_twin"] |= {"alarms": [{"time": at, "points_to": what} for at, what in task.adaptive.alarms]}
    if options.records == "parquet":
        folder.write("run.parquet", as_parquet(done.record))
    finish(folder, told, done.log, task.beside and (Path(options.beside).name, task.beside))
    say_written(folder)
    if done.session.rig.alarms:
        raise TwinAlarm(f"twin: {done.session.rig.alarms[0][1]}{f'; the run ended: {done.ended}' if done.ended else ''}")
    if done.ended:
        raise RunEnded(done.ended)
    if (logged := done.session.logged).failure:
        raise LogLost(f"log: {logged.lost} of {logged.rows + logged.lost} rows lost: {logged.failure}")


def _run(options, task: _Task, folder: Path, page: OperatorPage | None) -> Run:
    report = [sys.executable, "-m", "vpp_fmu", "hil", "report", str(folder.absolute())]
    with tqdm(total=100, unit="%", disable=None if task.setup.virtual else True, leave=False) as bar:

        def progress(share):
            bar.update(round(100 * share) - bar.n)

        own = task.setup, task.controller, task.profile, folder, task.start, task.twin
        return run_on_rig(*own, progress, report, ON_ALARM[options.on_alarm], page, task.adaptive)


def _ended(folder: OutputFolder, begun: dict, error: BaseException) -> None:
    """What can be told of a run that an error ended, which nobody foresaw: of its log, where there is one."""
    why = " ".join(str(error).split()) or type(error).__name__
    log, record, told = folder.path / LOG, None, begun | {"status": ENDED_EARLY, "completed": now()}
    if log.exists():
        record, told = told_by_files(log, begun)
    with contextlib.suppress(BadInput):  # the first error is the one to be told
        if record is None:
            folder.write("hil.json", as_json(told | {"ended": why}))
        else:
            finish(folder, told | {"ended": why}, record)


def _of_twin(twin: Twin | None, band: Band | None, adaptive: Adaptive | None) -> dict:
    """What hil.json says of the twins before the run."""
    if twin is None:
        return {}
    told = {"false_alarms_per_hour": twin.false_alarms, "smallest_found": twin.smallest, "delay": twin.delay}
    print(f"adaptive twin: {adaptive.microseconds:.0f} us of a tick")
    adapted = {name: asdict(one) for name, one in adaptive.adapted.items()}
    learns = {"microseconds": adaptive.microseconds, "units": adaptive.units, "adapted": adapted, "certain": CERTAIN}
    return {"twin": told | {"noise": band.noise}, "adaptive_twin": learns}


def _on_fmu(options, profile: Record) -> None:
    """The plant FMU in the rig's place: limits, controller, report and files are the same."""
    plant, folder = hil_options.which(options, fmu=True).plant, OutputFolder(options.output)
    record = _beside(plant, options, profile)
    write_run(folder.path / "run.csv", record)
    if options.records == "parquet":
        folder.write("run.parquet", as_parquet(record))
    folder.write("hil.json", as_json({"format": "vpp-hil/1", "rig": "fmu", "plant": Path(plant).name}))
    page = Page("Hardware in the loop, with a plant FMU", f"{plant} over {options.profile}.")
    add_loops(page, {"plant FMU": record}, "")
    folder.write("report.html", page.html())
    say_steps({"plant FMU": record})
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


def _twin(options, allowed: Rig) -> tuple[Twin | None, Band | None, Adaptive | None]:
    """The twin that says when the rig leaves its band, that band, and the twin that learns."""
    if options.twin is None:
        if options.adapt:
            raise BadInput("command line", "--adapt", "given without --twin", "--twin, which adapts them")
        return None, None, None
    if not options.twin and not options.parameters:
        raise BadInput(
            "command line", "--twin", "no --parameters", "the plant's parameters, or an identification.json for its band"
        )
    parameters = hil_options.plant_of(options)
    told = options.twin or beside(options.parameters)
    band = read_band(told)
    if options.parameters:
        check_same_model(told, parameters, options.parameters)
    learning = adaptive(adaptable(parameters, "command line", options.adapt), band, options.adapt)
    return Twin(KernelPlant(parameters.model, parameters.values), band, rig=allowed), band, Adaptive(learning, PERIOD)
