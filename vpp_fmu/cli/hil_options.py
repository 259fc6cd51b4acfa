"""What the sub-verbs of `vpp hil` share: which rig, how it is calibrated, what it may do, what is hidden in it."""

import sys
from importlib.resources import files

from hil.bench import Wiring, check_limits
from hil.calibration import read_calibration
from hil.emulator.rig import Rig
from hil.physics.rig_model import library
from hil.safety.limits import Limits, read_limits
from hil.session import Setup
from vpp_fmu.cli.options import SEED, whole
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet, read_parameters
from vpp_fmu.plants import Controller, FmuController, KernelController

EMULATED = files("hil.emulator") / "calibration.json"
WORD = "spin"


def add_rig(parser, fmu: bool = False) -> None:
    """The options that choose and describe the rig."""
    kinds = "emulated (default) or real" + (", or fmu PLANT.fmu" if fmu else "")
    parser.add_argument("--rig", nargs="+", default=["emulated"], metavar=("KIND", "PLANT.fmu") if fmu else "KIND", help=kinds)
    parser.add_argument("--calibration", metavar="C", help="the rig's calibration (default for the emulated rig: its own)")
    parser.add_argument("--limits", metavar="L", help="limits outside the controller (default: the paper's rig's)")
    parser.add_argument("--virtual", action="store_true", help="emulated rig on a clock of its own: fast, the same every time")
    text = "hide an effect in the emulated rig: NAME, NAME=SIZE or NAME.PARAMETER=SIZE; more than one may be given"
    parser.add_argument("--hide", action="append", default=[], metavar="EFFECT[=SIZE]", help=text)
    parser.add_argument("--seed", type=SEED, default=0, help="of everything random in the emulated rig (default: 0)")
    wiring = Wiring()
    parser.add_argument("--bus", type=whole(0, 255), default=wiring.bus, help=f"the real ADC's I2C bus (default: {wiring.bus})")
    parser.add_argument("--port", default=wiring.port, help=f"the real tachometer's port (default: {wiring.port})")
    parser.add_argument("--pwm", default=wiring.pwm, help=f"device of the real PWM chip (default: {wiring.pwm})")


def add_controller(parser) -> None:
    """The options that choose the controller."""
    parser.add_argument("--gains", metavar="G", help="the controller's parameters (default: the paper's, both actuators)")
    parser.add_argument("--controller", metavar="FMU", help="a controller FMU instead")


def setup_of(options) -> Setup:
    """The rig that the options describe."""
    kind = options.rig[0]
    if kind not in ("emulated", "real") or len(options.rig) > 1:
        raise BadInput("command line", "--rig", " ".join(options.rig), "emulated or real")
    real = kind == "real"
    if real and (options.virtual or options.hide):
        raise BadInput("command line", "--rig", "real with --virtual or --hide", "these for the emulated rig only")
    if real and not options.calibration:
        raise BadInput("command line", "--calibration", "none", "the real rig's own calibration (see hil/README.md)")
    calibration = read_calibration(options.calibration or str(EMULATED))
    limits = limits_of(options)
    check_limits(options.limits or "limits", calibration, limits.beta_min, limits.beta_max)
    if real:
        return Setup(calibration, limits, wiring=Wiring(options.bus, port=options.port, pwm=options.pwm))
    hidden = [_hidden(text) for text in options.hide]
    parameters = {name: value for _, values in hidden for name, value in values.items()}
    return Setup(calibration, limits, Rig(parameters, tuple(name for name, _ in hidden), options.seed), options.virtual)


def limits_of(options) -> Limits:
    """The limits as given, or the paper's rig's."""
    return read_limits(options.limits) if options.limits else Limits()


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
        return FmuController(options.controller)
    gains = read_parameters(options.gains, lambda _: CONTROLLER) if options.gains else ParameterSet(CONTROLLER)
    return KernelController(gains.values)


def plant_of(options) -> ParameterSet:
    """The plant's model with its parameters."""
    return read_parameters(options.parameters, plant) if options.parameters else ParameterSet(plant())


def confirm(setup: Setup) -> None:
    """On the real rig, wait until someone has typed that the propeller may turn."""
    if setup.emulated is not None:
        return
    print(f"This spins the propeller. Guard closed, nobody near it, emergency stop at hand? Type {WORD} to go on: ", end="")
    sys.stdout.flush()
    typed = sys.stdin.readline().strip()
    if typed != WORD:
        raise BadInput("confirmation", "typed word", repr(typed), WORD)
