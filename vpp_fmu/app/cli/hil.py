"""Hardware in the loop: an emulated or a real rig in the plant's place, with the same loop, controllers and records.

Run a closed loop, measure a campaign, test the rig itself, or replay a recorded run with a controller. Before the first run on
a real rig read hil/README.md."""

import argparse
import contextlib
import getpass
import inspect
import json
import math
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from hil import calibrate
from hil.campaign import PARTS, CampaignSize, limits_for, plan_for
from hil.commands import PAPERS
from hil.devices.calibration import Calibration, calibration_file, check, never_measured, read_calibration, to_json
from hil.emulator.faults import check_fault
from hil.emulator.rig import CALIBRATION, POWERED, calibrated_for, effects_to_hide, with_effects
from hil.loop.bench import Wiring, check_limits
from hil.loop.cycle import PERIOD
from hil.loop.session import REPORT, Setup, found_log
from hil.page.operator_page import OperatorPage
from hil.replay import other_settings, replay
from hil.results.campaign_folder import Measuring, commands_of, records_of
from hil.results.outcome import (
    Outcome,
    carry_out,
    finish,
    finish_fmu,
    kept_of,
    limits_by_end,
    lines_of,
    of_log,
    reach,
    step_lines,
)
from hil.results.runs import begun, file_entry
from hil.run import ON_ALARM, LimitedPlant, Run, check_profile, run_on_rig, start_of
from hil.safety.limits import Limits
from hil.selftest import selftest
from hil.twin.band import read_band
from hil.twin.twin import Twin, twin_of
from identification.tune.controllers import rig_controller, said_of
from vpp_fmu.app.api.objects import as_gains, as_parameters
from vpp_fmu.app.cli.answer import Answer, Lines, say
from vpp_fmu.app.cli.options import (
    ADAPT,
    GAINS,
    SEED,
    Number,
    add_gains,
    add_output,
    commands_file,
    controller_file,
    plant_file,
    profile_file,
    run_file,
    whole,
)
from vpp_fmu.app.cli.output import written
from vpp_fmu.app.cli.prompts import Prompts
from vpp_fmu.app.report.pages.loop import headline
from vpp_fmu.app.report.pages.rig import calibration_page, campaign_page, fmu_page, replay_page, run_page, selftest_page
from vpp_fmu.date import now
from vpp_fmu.errors import BadInput, RecordWarning, VppError
from vpp_fmu.files import OutputFolder, read_text
from vpp_fmu.kernel.signals import BETA_REF, OMEGA_REF
from vpp_fmu.loop import run as run_loop
from vpp_fmu.parameters import ParameterSet, beside, check_same_model, knowledge_file, parameters_file
from vpp_fmu.plants import COMMANDS, Controller, FmuController, FmuPlant, KernelController, KernelPlant
from vpp_fmu.reach import warn_beyond_reach
from vpp_fmu.record import Record, read_profile, read_record
from vpp_fmu.rig import FILE, Rig, declared_rig, rig_file
from vpp_fmu.structured import as_json

EXAMPLE = "vpp hil run --profile step.csv --virtual -o out"

WORD = "spin"
EITHER = Number(BETA_REF.minimum, OMEGA_REF.maximum)
"""Range of both numbers of --start; each is checked against its own range later."""


class Which(NamedTuple):
    """The rig of --rig: its `kind`, the `plant` FMU in its place, and its rig.json as `file`."""

    kind: str = "emulated"
    plant: str | None = None
    file: str | None = None


def configure(parser):
    if sys.platform != "linux":
        parser.error(f"platform: found {sys.platform}, expected Linux: a rig needs its clock, PWM files, I2C and terminals")
    parts = parser.add_subparsers(dest="what", required=True, metavar="WHAT", parser_class=type(parser))
    for name, (text, add_options, do) in VERBS.items():
        listed = {"help": text} if text else {}
        own = parts.add_parser(name, **listed, description=inspect.getdoc(do), formatter_class=parser.formatter_class)
        own.epilog = f"example:\n  vpp hil {EXAMPLES[name]}"
        add_options(own)
        own.set_defaults(run=do)


def run(options):
    return options.run(options)


def add_rig(parser, fmu: bool = False) -> None:
    add, wiring = parser.add_argument, Wiring()
    kinds = "emulated (default) or real" + (", or fmu PLANT.fmu, which runs its author's code" if fmu else "")
    text = f"{kinds}; and the rig's rig.json, which declares what it may do (default: what --parameters tells of its campaign, "
    text += "the paper's rig for the emulated one; the real rig needs one of the two)"
    add("--rig", nargs="+", action=_Rig, const=fmu, default=Which(), metavar=("KIND", "FILE"), help=text)
    add(
        "--calibration",
        type=calibration_file,
        metavar="C",
        help="the rig's calibration (default for the emulated rig: its own)",
    )
    add("--limits", metavar="L", help="limits outside the controller (default: what follows from the rig)")
    add("--virtual", action="store_true", help="emulated rig on a clock of its own: fast, the same every time")
    text = "hide an effect in the emulated rig: NAME, NAME=SIZE or NAME.PARAMETER=SIZE; may be repeated; ? lists them"
    add("--hide", action=_Hide, default=[], metavar="EFFECT[=SIZE]", help=text)
    add("--seed", type=SEED, default=0, help="of everything random in the emulated rig (default: 0)")
    add("--bus", type=whole(0, 255), default=wiring.bus, help=f"the real ADC's I2C bus (default: {wiring.bus})")
    add("--port", default=wiring.port, help=f"the real tachometer's port (default: {wiring.port})")
    add("--pwm", default=wiring.pwm, help=f"device of the real PWM chip (default: {wiring.pwm})")
    text = "outputs of the chip that ESC and LAC are on (default: 0 1, GPIO 12 and 13)"
    add("--pwm-channels", nargs=2, type=whole(0, 15), default=wiring.channels, metavar=("ESC", "LAC"), help=text)
    add("--operator", metavar="NAME", help="who runs it, for hil.json (default: the user)")


def _add_measurements(parser) -> None:
    text = "measure electrical power: voltage and current of the supply, and torque where it is wired; the emulated rig has "
    parser.add_argument("--power", action="store_true", help=f"{text}all three, a real one what its calibration wires")
    text = "serve a page with what the rig does, and STOP, on this machine's own address, which is printed"
    parser.add_argument(
        "--watch", nargs="?", type=whole(1024, 65535), const=0, metavar="PORT", help=f"{text} (default: a free port)"
    )


def _add_run(parser) -> None:
    add = parser.add_argument
    text = "CSV with time [s], thrust_set [N], or the folder of its profile.csv"
    add("--profile", type=profile_file, metavar="P", required=True, help=text)
    add_gains(parser, GAINS)
    text = "a controller FMU instead, or its folder; it runs its author's code"
    add("--controller", type=controller_file, metavar="FMU", help=text)
    add_rig(parser, fmu=True)
    text = "the plant's parameters, for --twin and for what the rig may do (default: the paper's)"
    add("--parameters", type=parameters_file, metavar="F", help=text)
    text = "run the adaptive twin beside the rig and tell when the rig is not its model; I: identification.json of --parameters"
    add("--twin", nargs="?", const="", type=knowledge_file, metavar="I", help=f"{text} (default: the one beside F)")
    add("--adapt", nargs="+", metavar="NAME", help=ADAPT)
    text = "what the twin's alarm does: tell (note), ramp down, idle at once (default: note); the exit code is 3 either way"
    add("--on-alarm", choices=tuple(ON_ALARM), default="note", metavar="WHAT", help=text)
    text = "on the emulated rig: inject a fault S seconds after the loop is closed (default: 1); an unknown name lists all"
    add("--inject", nargs="+", metavar=("FAULT", "S"), help=text)
    _add_measurements(parser)
    text = "the same loop with this plant FMU too, which runs its author's code, and the difference in N"
    add("--beside", type=plant_file, metavar="PLANT.fmu", help=text)
    text = "commands that the run starts from, rpm and deg (default: the rig's lowest speed, the pitch next to 0)"
    add("--start", nargs=2, type=EITHER, metavar=("RPM", "DEG"), help=text)
    add_output(parser)


PLAN = (
    ("points", "points", whole(2, 100), "a side of the static grid"),
    ("samples", "samples", whole(2, 10**6), "readings a point of the grid"),
    ("settle", "settle", Number(0.1, 60.0, "s"), "before a point or a step counts"),
    ("validation-seconds", "validation", Number(5.0, 3600.0, "s"), "of the validation record"),
)
"""Options of a campaign's plan: name, field of `CampaignSize`, kind, help."""


def _add_campaign(parser) -> None:
    add = parser.add_argument
    add_rig(parser)
    add("--parameters", type=parameters_file, metavar="F", help="of an earlier campaign on this rig: what it may do")
    add("--parts", nargs="+", choices=PARTS, default=PARTS, metavar="PART", help=f"of {', '.join(PARTS)} (default: all)")
    add(
        "--commands", type=commands_file, metavar="R", help="instead: any record of time, omega_ref, beta_ref; gives record.csv"
    )
    for name, field, kind, text in PLAN:
        longer = f" {kind.unit}, longer for a rig slower than the paper's" if kind.unit else ""
        add(f"--{name}", type=kind, metavar="N", help=f"{text} (default: {getattr(CampaignSize(), field):g}{longer})")
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--resume", action="store_true", help="go on with the campaign in DIR: with the same options as before")
    again.add_argument("--replace", action="store_true", help="delete the campaign in DIR, and measure anew")
    _add_measurements(parser)
    add_output(parser)


def _add_calibrate(parser) -> None:
    add_rig(parser)
    parts = calibrate.PARTS
    text = f"of {', '.join(parts)} (default: all)"
    parser.add_argument("--parts", nargs="+", choices=parts, default=parts, metavar="PART", help=text)
    parser.add_argument("--answers", metavar="FILE", help="what would be typed, a line each (default: it is typed)")
    add_output(parser)


def _add_selftest(parser) -> None:
    add_rig(parser)
    seconds = Number(1.0, 3600.0, "s")
    parser.add_argument("--seconds", type=seconds, default=10.0, metavar="S", help="how long the loop runs (default: 10)")
    text = "so many busy processes beside the loop (2 without a number)"
    parser.add_argument("--load", nargs="?", type=whole(0, 64), const=2, default=0, metavar="N", help=text)
    add_output(parser)


def _add_replay(parser) -> None:
    text = "run.csv of vpp hil run, or its folder: time, thrust_set, thrust and the commands"
    parser.add_argument("recorded", type=run_file, metavar="RUN", help=text)
    text = "controller FMU, or its folder: thrust_set, thrust to omega_ref, beta_ref"
    parser.add_argument("controller", type=controller_file, metavar="CONTROLLER", help=text)
    add_output(parser)


def _run(options) -> Answer:
    """Close the loop on the rig over a profile of set-points (CSV with time, thrust_set).

    Tares, arms, spins up, settles, runs, ramps down. Ctrl-C ramps down, a second one stops at once; measured data are kept."""
    profile = read_profile(options.profile)
    lines = [] if options.controller else [said_of(gains_of(options), options.gains)]
    rig = options.rig
    if options.inject and rig.kind != "emulated":
        raise BadInput("command line", "--inject", f"--rig {rig.kind}", "an emulated rig, in which a fault can be injected")
    if rig.kind == "fmu":
        if options.watch is not None:
            raise BadInput("command line", "--watch", "--rig fmu", "an emulated or real rig: a loop of FMUs ends in seconds")
        folder = OutputFolder(options.output)
        record, limits = _fmu_loop(rig.plant, options, profile)
        found = finish_fmu(folder, rig.plant, record, limits)
        folder.write("report.html", fmu_page(rig.plant, options.profile, found).html())
        (steps,) = found.steps.values()
        return Answer(headline(steps), found.content, [*lines, *step_lines(found)], written=written(options, folder))
    setup, controller = setup_of(options), controller_of(options)
    check_profile(profile, setup.limits)
    start = start_of(options.start, setup.limits, setup.allowed)
    if options.parameters or (rig.kind == "emulated" and setup.allowed == PAPERS):
        known = as_parameters(options.parameters)
        plant = KernelPlant(known.model, known.values, PERIOD)
        warn_beyond_reach(profile, plant, reach(asdict(setup.limits), limits_by_end(controller.limits)))
    if options.parameters:
        setup = replace(setup, plant=as_parameters(options.parameters).values)
    twin = _twin(options)
    other = (Path(options.beside).name, _fmu_loop(options.beside, options, profile)[0]) if options.beside else None
    inject = _injected(options, setup, float(profile.time[-1] - profile.time[0]))
    parent = OutputFolder(options.output)
    lines.append(allowed_words(setup.allowed))
    content = _begun(options, setup) | ({"injected": dict(zip(("fault", "after"), inject, strict=True))} if inject else {})
    content |= {"twin": twin.summary()} if twin else {}
    content["controller"]["limits"] = limits_by_end(controller.limits)
    with contextlib.closing(controller), watched(options, content) as page, Lines(options) as shown:
        confirm(setup, lines)

        def run(folder: Path, after: Sequence[str]) -> Run:
            return run_on_rig(setup, controller, profile, folder, start, twin, after, page, inject)

        begun_now, report = content | {"begun": now()}, lambda found: run_page(found).html()
        done, folder, found = carry_out(run, begun_now, parent, page, shown, report, other)
    return _answer(found, [*lines, *shown], written(options, folder), done.failure)


def _answer(found: Outcome, lines: list[str], place: list[str], failure: VppError | None = None) -> Answer:
    """The answer of a run; `failure`: what went wrong in it."""
    content = found.content
    text = headline(next(iter(found.steps.values()))) if found.steps else "No row of the loop was measured."
    early = f"The run ended early: {content['ended']}. " if content["ended"] else ""
    return Answer(f"{early}{text}", content, [*lines, *lines_of(found)], written=place, failure=failure)


def _campaign(options) -> Answer:
    """Measure a campaign on the rig: the files that `vpp identify` and `vpp diagnose` read.

    Each part is a separate run: tare, arm, run, ramp down. With the paper's plan the static map takes 40 minutes, steps 15.
    Commands stay within the ranges of the rig's rig.json, those of the earlier campaign of --parameters, and the limits."""
    setup = replace(setup_of(options, steps=True), map_is_known=False)
    given = {field: getattr(options, name.replace("-", "_")) for name, field, *_ in PLAN}
    plan = replace(plan_for(setup.allowed), **{field: value for field, value in given.items() if value is not None})
    commands = commands_of(options.commands, setup.limits) if options.commands else None
    folder, measuring = OutputFolder(options.output), Measuring(setup, plan, options.parts, commands)
    content = measuring.begin(folder.path, _begun(options, setup), options.resume, options.replace)
    lines = [allowed_words(setup.allowed)]
    with watched(options, content) as page, Lines(options) as shown:
        confirm(setup, lines)
        if (file := options.rig.file) or not (folder.path / FILE).exists():  # readers of the campaign need it, too
            folder.write(FILE, read_text(file) if file else as_json(setup.allowed.commanded))
        content = measuring.run(folder, content, page, shown)
    parts = content["parts"]
    lost, rows = (sum(part["log"][name] for part in parts.values()) for name in ("lost", "rows"))
    text = f"Measured {', '.join(parts)} in {folder.path}: {rows} rows of the log, {lost} lost."
    folder.write("report.html", campaign_page(content, text, records_of(folder.path)).html())
    return Answer(text, content, [*lines, *shown], written=written(options, folder))


def _calibrate(options) -> Answer:
    """Measure the rig's calibration, step by step: weights on the load cell and its sign, pulses to pitch, the motor's start.

    Each step says what to do and waits for Enter, or for a number that you read. For load cell and pitch the ESC's supply is
    off; the last step turns the bare motor, without a propeller. --answers FILE: one answer per line, `#` begins a remark.
    Omitted parts are copied from --calibration, with operator and date."""
    setup, folder = setup_of(options, turning=False), OutputFolder(options.output)
    guide = Prompts(options.answers)
    bench = setup.bench()
    try:
        measured = calibrate.measured(
            bench, guide, options.parts, folder.path / REPORT, not setup.virtual, partial(print, flush=True)
        )
    finally:
        bench.close()
    found = calibrate.adopted(setup.calibration, measured, options.operator or _user(), now())
    check(folder.path / "calibration.json", found)
    content = to_json(found)
    folder.write("calibration.json", content)
    folder.write("report.html", calibration_page(setup.calibration, found, measured).html())
    unknown = never_measured(found)
    lines = [f"not measured yet: {', '.join(unknown)}; --rig real wants all"] if unknown else []
    text = f"Measured {', '.join(options.parts)}; calibration.json is {'not yet ' * bool(unknown)}ready for --rig real."
    return Answer(text, json.loads(content), lines, written=written(options, folder))


def _selftest(options) -> Answer:
    """Test the rig without turning the rotor: loop timing, buses, calibration, pulse outputs, log."""
    setup, folder = setup_of(options, turning=False), OutputFolder(options.output)
    found = selftest(setup, options.seconds, folder.path, options.load)
    content = found.summary()
    folder.write("hil.json", as_json(content))
    folder.write("report.html", selftest_page(found, content, options.seconds).html())
    lines = [f"{'good' if one.good else 'BAD '}  {one.what}: {one.found}" for one in found.checks]
    if timing := found.session.timing:
        busy = f"{options.load} busy processes beside it"
        lines.insert(0, f"loop: {content['real_time']}; {busy}\n{timing.text()}")
    good = sum(one.good for one in found.checks)
    text = f"{good} of {len(found.checks)} checks of the rig are good."
    return Answer(text, content, lines, written=written(options, folder), failure=found.failure)


def _report(options) -> Answer:
    """Make run.csv, report.html and the end of hil.json from the log of a run whose loop was killed or crashed.

    The log's writer, a separate process, completes the log and then calls this. If the writer was killed, too, the rows that
    reached the disk are used as the log."""
    log = found_log(Path(options.log))
    folder = OutputFolder(log.parent)
    record, content, gone = of_log(log)
    if gone:
        say(options, f"vpp hil: the run ended: {content['ended']}")
    found = finish(folder, content, record, lambda found: run_page(found).html())
    say(options, f"made from the log: {kept_of(log.parent)}")
    return _answer(found, [], written(options, folder))


def _replay(options) -> Answer:
    """Feed the inputs of a recorded run to a controller FMU, and compare its commands with the recorded ones, to the bit.

    An FMU runs its author's code, with your rights."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)  # a run has more columns than a record needs
        recorded = read_record(options.recorded, ("time", "thrust_set", "thrust", *COMMANDS))
    if len(recorded) < 2:
        raise BadInput(options.recorded, "rows", len(recorded), "two or more")
    folder, controller = OutputFolder(options.output), FmuController(options.controller)
    other = other_settings(options.recorded, controller.starts())
    found = replay(recorded, controller)
    controller.close()
    text = f"{options.controller} on the {len(recorded)} rows of {options.recorded}: {found.said(other)}"
    folder.write("replay.json", as_json(found.summary()))
    folder.write("report.html", replay_page(found, text + ".").html())
    return Answer(f"{text}.", found.summary(), written=written(options, folder))


class _Hide(argparse.Action):
    """Appends an effect to hide. `?` prints the list of effects, and ends with exit code 0."""

    def __call__(self, parser, namespace, values, option_string=None):
        if values == "?":
            print(*effects_to_hide(), sep="\n")
            parser.exit()
        setattr(namespace, self.dest, [*getattr(namespace, self.dest), values])


class _Rig(argparse.Action):
    """Stores the words of --rig as Which; `const`: whether a plant FMU may be in the rig's place. BadInput."""

    def __call__(self, parser, namespace, values, option_string=None):
        words = list(values)
        kind = words.pop(0) if words[0] in ("emulated", "real", "fmu") else "emulated"
        plant = plant_file(words.pop(0)) if kind == "fmu" and words else None
        file = rig_file(words.pop(0)) if words else None
        if words or (kind == "fmu" and not (self.const and plant)) or (file and not Path(file).is_file()):
            allowed = "emulated or real" + (", or fmu PLANT.fmu" if self.const else "") + ", and a rig.json that is there"
            raise BadInput("command line", "--rig", " ".join(values), allowed)
        namespace.rig = Which(kind, plant, file)


def allowed_of(options, turning: bool = True) -> Rig:
    """The rig's ranges: those of its rig.json, else of the campaign of --parameters, else the paper's. BadInput for a real rig
    of unknown range that is to turn."""
    rig, rest = options.rig, None
    if getattr(options, "parameters", None):
        content = as_parameters(options.parameters).rig
        rest = None if content.unknown else content
    if rest is None and (rig.kind != "real" or not turning):
        rest = PAPERS
    if rig.file:
        return declared_rig(rig.file, rest)
    if rest is None:
        hint = "--rig real RIG.json, or --parameters that were identified on this rig"
        raise BadInput("command line", "--rig", "a real rig of unknown range", "a declared range of speed and pitch", hint)
    return rest


def _limits(options, allowed: Rig, steps: bool = False) -> tuple[Limits, Rig]:
    where = options.rig.file or getattr(options, "parameters", None) or "rig"
    return limits_for(allowed, where, options.limits, steps)


def setup_of(options, steps: bool = False, turning: bool = True) -> Setup:
    """The rig that the options describe; `steps` as in `limits_for`, `turning`: whether the rotor will turn. BadInput."""
    real = options.rig.kind == "real"
    if real and (options.virtual or options.hide):
        raise BadInput("command line", "--rig", "real with --virtual or --hide", "an emulated rig for these options")
    if real and not options.calibration:
        raise BadInput(
            "command line", "--calibration", "nothing", "the real rig's calibration file", "vpp hil calibrate --rig real"
        )
    calibration = read_calibration(options.calibration or str(CALIBRATION))
    if real and turning and (unknown := never_measured(calibration)):
        found = f"no operator and date for {', '.join(unknown)}"
        raise BadInput(options.calibration, "source", found, "who measured each part, and when", "vpp hil calibrate --rig real")
    limits, allowed = _limits(options, allowed_of(options, turning), steps)
    if not real and not options.calibration:
        calibration = calibrated_for(calibration, allowed)
    if getattr(options, "power", False):
        calibration = _with_power(calibration, options.calibration)
    check_limits(options.limits or "limits", calibration, limits.beta_min, limits.beta_max)
    if real:
        return Setup(calibration, limits, wiring=_wiring(options), allowed=allowed)
    return Setup(calibration, limits, with_effects(options.hide, options.seed), options.virtual, allowed=allowed)


def _with_power(calibration: Calibration, file: str | None) -> Calibration:
    """The calibration of a rig that measures its power. BadInput for a given one without voltage or current."""
    if file is None:
        return replace(calibration, supply=POWERED)
    if missing := [name for name in ("voltage", "current") if name not in calibration.supply]:
        raise BadInput(file, "supply", f"no {' and no '.join(missing)}", "both voltage and current wired, for --power")
    return calibration


def _wiring(options) -> Wiring:
    channels = tuple(options.pwm_channels)
    if channels[0] == channels[1]:
        raise BadInput("command line", "--pwm-channels", f"output {channels[0]} twice", "two different outputs")
    return Wiring(options.bus, port=options.port, pwm=options.pwm, channels=channels)


def gains_of(options) -> ParameterSet:
    """The kernel's controller for the rig of the options; it samples once per tick, unless its file has another sample time.
    BadInput if its limits exceed the rig's."""
    parameters, file = as_parameters(options.parameters), options.rig.file
    given = as_gains(options.gains)
    rig = declared_rig(file, parameters.rig) if file else None
    return rig_controller(parameters, given, options.gains, rig, tick_of(given))


def tick_of(given: ParameterSet | None) -> float | None:
    """The loop's tick [s], for a controller whose file has no sample time; else None."""
    return None if given is not None and "sample_time" in given.estimates else PERIOD


def controller_of(options) -> Controller:
    """A new controller from the options. BadInput."""
    if options.controller and options.gains:
        raise BadInput("command line", "--controller", "--controller and --gains", "only one of them")
    if options.controller:
        return FmuController(options.controller, dt=PERIOD)
    return KernelController(gains_of(options).values, PERIOD)


def _fmu_loop(path: str, options, profile: Record) -> tuple[Record, dict[str, tuple[float, float]]]:
    """(the loop with a plant FMU, the ranges of its commands)."""
    limits, allowed = _limits(options, allowed_of(options))
    check_profile(profile, limits)
    start, controller = start_of(options.start, limits, allowed), controller_of(options)
    reached = reach(asdict(limits), limits_by_end(controller.limits))
    with contextlib.closing(controller), contextlib.closing(LimitedPlant(FmuPlant(path), limits)) as plant:
        warn_beyond_reach(profile, plant, reached)
        return run_loop(plant, controller, profile, start), reached


def _twin(options) -> Twin | None:
    """The twin of the options; None without --twin. BadInput."""
    if options.twin is None:
        if options.adapt:
            raise BadInput("command line", "--adapt", "--adapt without --twin", "both: the twin adapts these parameters")
        return None
    if not options.twin and not options.parameters:
        needed = "the plant's parameters, or an identification.json for the twin's band"
        raise BadInput("command line", "--twin", "no model of the rig", needed, "--parameters F")
    parameters = as_parameters(options.parameters)
    source = options.twin or beside(options.parameters)
    band = read_band(source)
    if options.parameters:
        check_same_model(source, parameters, options.parameters)
    return Twin(twin_of(parameters, band, options.adapt, "command line"), on_alarm=ON_ALARM[options.on_alarm])


def _injected(options, setup: Setup, length: float) -> tuple[str, float] | None:
    """The fault to inject and its time [s] in a run of so many seconds; None without --inject. BadInput."""
    if not options.inject:
        return None
    name, *when = options.inject
    check_fault(name, setup.virtual)
    try:
        after = float(*when) if when else min(1.0, length)
    except (TypeError, ValueError):
        after = math.nan
    if not 0.0 <= after <= length:
        raise BadInput("command line", "--inject", " ".join(when), f"one number from 0 to {length:g} s, the profile's length")
    return name, after


def _begun(options, setup: Setup) -> dict:
    """The content of hil.json before the rotor turns; each file with its hash."""
    given = {"limits_file": options.limits, "rig_file": options.rig.file, "parameters": options.parameters}
    given["profile"] = getattr(options, "profile", None)
    content = begun(setup, options.calibration or str(CALIBRATION), options.operator or _user(), given)
    if not hasattr(options, "controller"):
        return content
    if options.controller:
        return content | {"controller": {"kind": "FMU", **file_entry(options.controller)}}
    gains = gains_of(options)
    source = file_entry(options.gains) if options.gains else {"gains": gains.source["made_by"]}
    return content | {"controller": {"kind": "kernel", **source, "parameters": dict(gains.values)}}


def _user() -> str:
    with contextlib.suppress(KeyError, OSError):  # the user's number may have no name
        return getpass.getuser()
    return str(os.getuid())


def allowed_words(allowed: Rig) -> str:
    """The ranges of the rig's commands and their sources, in words."""
    return f"commands within {', '.join(allowed.command_lines())}"


def confirm(setup: Setup, lines: Sequence[str]) -> None:
    """On the real rig, print the `lines` about the run, and wait until someone has typed that the propeller may turn."""
    if setup.emulated is not None:
        return
    print(*lines, sep="\n")
    print(f"This spins the propeller. Guard closed, nobody near it, emergency stop at hand? Type {WORD} to go on: ", end="")
    sys.stdout.flush()
    typed = sys.stdin.readline().strip()
    if typed != WORD:
        raise BadInput("confirmation", "typed word", repr(typed), WORD)


def watched(options, content: Mapping) -> contextlib.AbstractContextManager[OperatorPage | None]:
    """A context with the operator's page, if --watch is given; its address is printed. BadInput."""
    if options.watch is None:
        return contextlib.nullcontext()
    if options.virtual:
        allowed = "a run in real time: a virtual one ends in seconds"
        raise BadInput("command line", "--watch", "--watch and --virtual", allowed)
    page = OperatorPage(content, options.watch)
    print(f"operator's page: {page.address}", flush=True)  # at once, with --quiet too, because the page has STOP
    return page


VERBS = {
    "run": ("a closed loop over a profile of wanted thrust", _add_run, _run),
    "campaign": ("static map, steps, open loop, its repeat, validation: what `vpp identify` reads", _add_campaign, _campaign),
    "calibrate": ("weights, pitch table, polarity and the throttle's idle, step by step", _add_calibrate, _calibrate),
    "selftest": ("jitter, buses, calibration, pulse outputs", _add_selftest, _selftest),
    "report": ("", lambda own: own.add_argument("log", metavar="LOG", help="the run's log.csv, or its folder"), _report),
    "replay": ("a recorded run once more through a controller FMU", _add_replay, _replay),
}
"""The sub-verbs: a line for `vpp hil --help` (none: not listed, as the log's writer calls it), the options, and the run, whose
docstring is its help."""

EXAMPLES = {
    "run": "run --parameters out/parameters.json --profile step.csv --beside fmus/VppPlant.fmu -o out",
    "campaign": "campaign --virtual --hide linkage_play=0.5 -o campaigns/emulated",
    "calibrate": "calibrate --rig real --calibration wiring.json --operator Ada -o calibration",
    "selftest": "selftest --seconds 60 --load 2 -o selftest",
    "report": "report out/runs/20260307T141500",
    "replay": "replay out/run.csv fmus/VppController.fmu -o replay",
}
