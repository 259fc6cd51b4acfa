"""What the sub-verbs of `vpp hil` share: which rig, how it is calibrated, what it may do, what is hidden in it."""

import contextlib
import getpass
import os
import platform
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from hil.bench import Wiring, check_limits
from hil.calibration import never_measured, read_calibration
from hil.campaign import steep, within
from hil.commands import PAPERS
from hil.cycle import PERIOD
from hil.emulator.rig import Rig as Emulated
from hil.emulator.rig import calibrated_for
from hil.page.operator_page import OperatorPage
from hil.physics.rig_model import library
from hil.runs import sha256_of
from hil.safety.limits import Limits, limits_of, read_limits
from hil.session import Setup, versions
from identification.tune.controllers import rig_controller
from vpp_fmu.cli.hil_outcome import RUNNING
from vpp_fmu.cli.options import SEED, whole
from vpp_fmu.date import now
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet, read_parameters
from vpp_fmu.plants import Controller, FmuController, KernelController
from vpp_fmu.rig import Rig, declared_rig
from vpp_fmu.stopping import Stopped

EMULATED = files("hil.emulator") / "calibration.json"
WORD = "spin"


def add_rig(parser, fmu: bool = False) -> None:
    """The options that choose and describe the rig."""
    kinds = "emulated (default) or real" + (", or fmu PLANT.fmu, which runs its author's code" if fmu else "")
    text = f"{kinds}; and the rig's rig.json, which declares what it may do (default: what --parameters tells of its campaign, "
    text += "the paper's rig for the emulated one; the real rig needs one of the two)"
    parser.add_argument("--rig", nargs="+", default=["emulated"], metavar=("KIND", "FILE"), help=text)
    parser.add_argument("--calibration", metavar="C", help="the rig's calibration (default for the emulated rig: its own)")
    parser.add_argument("--limits", metavar="L", help="limits outside the controller (default: what follows from the rig)")
    parser.add_argument("--virtual", action="store_true", help="emulated rig on a clock of its own: fast, the same every time")
    text = "hide an effect in the emulated rig: NAME, NAME=SIZE or NAME.PARAMETER=SIZE; more than one may be given"
    parser.add_argument("--hide", action="append", default=[], metavar="EFFECT[=SIZE]", help=text)
    parser.add_argument("--seed", type=SEED, default=0, help="of everything random in the emulated rig (default: 0)")
    wiring = Wiring()
    parser.add_argument("--bus", type=whole(0, 255), default=wiring.bus, help=f"the real ADC's I2C bus (default: {wiring.bus})")
    parser.add_argument("--port", default=wiring.port, help=f"the real tachometer's port (default: {wiring.port})")
    parser.add_argument("--pwm", default=wiring.pwm, help=f"device of the real PWM chip (default: {wiring.pwm})")
    text = "outputs of the chip that ESC and LAC are on (default: 0 1, GPIO 12 and 13)"
    parser.add_argument(
        "--pwm-channels", nargs=2, type=whole(0, 15), default=wiring.channels, metavar=("ESC", "LAC"), help=text
    )
    parser.add_argument("--operator", metavar="NAME", help="who runs it, for hil.json (default: the user)")


def add_watch(parser) -> None:
    """The option that serves the operator's page."""
    text = (
        "serve a page with what the rig does, and STOP, on this machine's own address, which is printed (default: a free port)"
    )
    parser.add_argument("--watch", nargs="?", type=whole(1024, 65535), const=0, metavar="PORT", help=text)


def add_records(parser) -> None:
    """The option that writes records in another format, too."""
    text = "csv (default), or parquet: the same beside it, with units, exact to the bit; needs the extra 'import'"
    parser.add_argument("--records", choices=("csv", "parquet"), default="csv", metavar="FORMAT", help=text)


@contextlib.contextmanager
def watched(options, told: Mapping) -> Iterator[OperatorPage | None]:
    """The operator's page, where it is wanted, for as long as the context lasts; its address is printed. BadInput."""
    if options.watch is None:
        yield None
        return
    if options.virtual:
        raise BadInput(
            "command line", "--watch", "given with --virtual", "a run in real time: a virtual one is over in seconds"
        )
    page, ended = OperatorPage(told, options.watch), "ended as planned"
    print(f"operator's page: {page.address}", flush=True)
    try:
        yield page
    except (VppError, Stopped) as error:
        ended = " ".join(str(error).split())
        raise
    except BaseException as error:
        ended = type(error).__name__
        raise
    finally:
        page.close(ended)
        if page.broken:
            print(f"vpp hil: page: {page.broken}; the rig went on without it", file=sys.stderr)


def add_controller(parser) -> None:
    """The options that choose the controller."""
    text = (
        "the controller's parameters (default: the published gains, within the limits and at the pace of the parameters' rig)"
    )
    parser.add_argument("--gains", metavar="G", help=text)
    parser.add_argument("--controller", metavar="FMU", help="a controller FMU instead; it runs its author's code")


@dataclass(frozen=True)
class Which:
    """The words of --rig: `kind`, the `plant` FMU in the rig's place, the rig.json."""

    kind: str
    plant: str | None
    file: str | None


def which(options, fmu: bool = False) -> Which:
    """Which rig the options name."""
    words = list(options.rig)
    kind = words.pop(0) if words[0] in ("emulated", "real", "fmu") else "emulated"
    plant = words.pop(0) if kind == "fmu" and words else None
    file = words.pop(0) if words else None
    if words or (kind == "fmu" and not (fmu and plant)) or (file and not Path(file).is_file()):
        allowed = "emulated or real" + (", or fmu PLANT.fmu" if fmu else "") + ", and a rig.json that is there"
        raise BadInput("command line", "--rig", " ".join(options.rig), allowed)
    return Which(kind, plant, file)


def allowed_of(options, turning: bool = True) -> Rig:
    """What the rig may be asked for: as its rig.json declares, else as the campaign of --parameters measured it, else, of what
    is no real rig, the paper's. BadInput where a real one is to turn and nobody knows how far."""
    rig, rest = which(options, fmu=True), None
    if getattr(options, "parameters", None):
        told = plant_of(options).rig
        rest = None if told.unknown else told
    if rest is None and (rig.kind != "real" or not turning):
        rest = PAPERS
    if rig.file:
        return declared_rig(rig.file, rest)
    if rest is None:
        allowed = "real RIG.json, or --parameters that were identified from a campaign on it"
        raise BadInput("command line", "--rig", "real, without a range of speed and pitch", allowed)
    return rest


def limits_for(options, allowed: Rig, steps: bool = False) -> tuple[Limits, Rig]:
    """(limits outside the controller, the rig as far as they let it go). `steps`: commands may jump where the rig allows it."""
    freely = limits_of(allowed, which(options, fmu=True).file or getattr(options, "parameters", None) or "rig")
    freely = steep(freely, allowed) if steps else freely
    limits = read_limits(options.limits, allowed, freely) if options.limits else freely
    return limits, within(allowed, limits, freely)


def setup_of(options, steps: bool = False, turning: bool = True) -> Setup:
    """The rig that the options describe; `steps` as in `limits_for`, `turning`: whether it will."""
    kind = which(options).kind
    real = kind == "real"
    if real and (options.virtual or options.hide):
        raise BadInput("command line", "--rig", "real with --virtual or --hide", "these for the emulated rig only")
    if real and not options.calibration:
        raise BadInput("command line", "--calibration", "none", "the real rig's own calibration (see hil/README.md)")
    calibration = read_calibration(options.calibration or str(EMULATED))
    if real and turning and (unknown := never_measured(calibration)):
        allowed = "who and when, as vpp hil calibrate writes them where it has measured"
        raise BadInput(options.calibration, "source", f"nobody who measured {', '.join(unknown)}", allowed)
    limits, allowed = limits_for(options, allowed_of(options, turning), steps)
    if not real and not options.calibration:
        calibration = calibrated_for(calibration, allowed)
    check_limits(options.limits or "limits", calibration, limits.beta_min, limits.beta_max)
    if real:
        return Setup(calibration, limits, wiring=_wiring(options), allowed=allowed)
    hidden = [_hidden(text) for text in options.hide]
    parameters = {name: value for _, values in hidden for name, value in values.items()}
    emulated = Emulated(parameters, tuple(name for name, _ in hidden), options.seed)
    return Setup(calibration, limits, emulated, options.virtual, allowed=allowed)


def _wiring(options) -> Wiring:
    channels = tuple(options.pwm_channels)
    if channels[0] == channels[1]:
        raise BadInput("command line", "--pwm-channels", f"{channels[0]} twice", "two outputs")
    return Wiring(options.bus, port=options.port, pwm=options.pwm, channels=channels)


def say_allowed(allowed: Rig) -> None:
    """Within what the rig will be commanded, and where that comes from."""
    print(f"commands within {', '.join(allowed.command_lines())}")


def _hidden(text: str) -> tuple[str, dict[str, float]]:
    """A hidden effect's name and its parameters, from NAME, NAME=SIZE or NAME.PARAMETER=SIZE."""
    known = {e.name: e for e in library(commanded=False) if e.off is not None}
    left, _, size = text.partition("=")
    name, _, parameter = left.partition(".")
    if name not in known:
        raise BadInput("command line", "--hide", name, f"one of {', '.join(known)}")
    effect = known[name]
    values = dict(effect.probe)
    if size or parameter:
        chosen = next((p for p in effect.parameters if p.name == (parameter or effect.parameters[0].name)), None)
        if chosen is None:
            raise BadInput("command line", "--hide", left, f"one of {', '.join(f'{name}.{p.name}' for p in effect.parameters)}")
        values[chosen.name] = _size(left, size, chosen)
    return name, {f"{name}.{own}": value for own, value in values.items()}


def _size(name: str, text: str, parameter) -> float:
    allowed = f"a number from {parameter.minimum:g} to {parameter.maximum:g} {parameter.unit}".removesuffix(" 1")
    try:
        value = float(text)
    except ValueError as error:
        raise BadInput("command line", f"--hide {name}", text or "no size", allowed) from error
    if not parameter.minimum <= value <= parameter.maximum:
        raise BadInput("command line", f"--hide {name}", text, allowed)
    return value


def controller_of(options) -> Controller:
    """A fresh controller as the options have it."""
    if options.controller and options.gains:
        raise BadInput("command line", "--controller", "given with --gains", "one of the two")
    if options.controller:
        return FmuController(options.controller, dt=PERIOD)
    return KernelController(gains_of(options).values, PERIOD)


def begun(options, setup: Setup) -> dict:
    """What hil.json says before anything turns: when, where, who, with what; each file with its hash."""
    calibration, limits = options.calibration or str(EMULATED), setup.limits
    told = {
        "format": "vpp-hil/1",
        "status": RUNNING,
        "begun": now(),
        "host": platform.node(),
        "operator": options.operator or user(),
        "command": ["vpp", *sys.argv[1:]],
        **setup.told(),
        "calibration": {**_file(calibration), "sha256": setup.calibration.sha256, "source": dict(setup.calibration.source)},
        "limits": {name: getattr(limits, name) for name in limits.__dataclass_fields__},
        "versions": versions(),
    }
    given = {"limits_file": options.limits, "rig_file": which(options).file, "parameters": getattr(options, "parameters", None)}
    given |= {"profile": getattr(options, "profile", None)}
    told |= {name: _file(path) for name, path in given.items() if path}
    if hasattr(options, "controller"):
        kind, path = ("FMU", options.controller) if options.controller else ("kernel", options.gains)
        told["controller"] = {"kind": kind, **(_file(path) if path else {"gains": gains_of(options).source["made_by"]})}
        if not options.controller:
            told["controller"]["parameters"] = dict(gains_of(options).values)
    return told


def _file(path: str | os.PathLike) -> dict:
    return {"file": Path(path).name, "file_sha256": sha256_of(path)}


def user() -> str:
    """Who runs this."""
    with contextlib.suppress(KeyError, OSError):  # a process may belong to a number that nobody has named
        return getpass.getuser()
    return str(os.getuid())


def gains_of(options) -> ParameterSet:
    """The kernel's controller for the rig that the options name, a sample a tick where its file does not say otherwise.
    BadInput where given limits leave the rig's."""
    parameters, file = plant_of(options), which(options, fmu=True).file
    given = read_parameters(options.gains, lambda _: CONTROLLER) if options.gains else None
    rig = declared_rig(file, parameters.rig) if file else None
    return rig_controller(parameters, given, options.gains, rig, tick_of(given))


def tick_of(given: ParameterSet | None) -> float | None:
    """s: the loop's tick, for a controller whose file names no sample time."""
    return None if given is not None and "sample_time" in given.estimates else PERIOD


def plant_of(options) -> ParameterSet:
    """The plant's model with its parameters."""
    given = getattr(options, "parameters", None)
    return read_parameters(given, plant) if given else ParameterSet(plant())


def confirm(setup: Setup) -> None:
    """On the real rig, wait until someone has typed that the propeller may turn."""
    if setup.emulated is not None:
        return
    print(f"This spins the propeller. Guard closed, nobody near it, emergency stop at hand? Type {WORD} to go on: ", end="")
    sys.stdout.flush()
    typed = sys.stdin.readline().strip()
    if typed != WORD:
        raise BadInput("confirmation", "typed word", repr(typed), WORD)
