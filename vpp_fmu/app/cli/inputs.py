"""Inputs that several verbs read: the plant's parameters, a controller's gains, and the uncertainty of the parameters."""

from vpp_fmu.app.cli.output import add_effects_from
from vpp_fmu.files import InFolder
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.own_effects import library_with
from vpp_fmu.parameters import (
    ParameterSet,
    gains_file,
    knowledge_file,
    parameters_file,
    read_parameters,
)

GAINS = "the controller's parameters (default: the published gains, within the limits and at the pace of the parameters' rig)"

ADAPT = "the plant's parameters that the twin adapts (default: thrust gain, pitch and reading offset, the slower lags)"
"""Help of --gains and of --adapt."""


FMU = "VppPlant", "VppController", "VppTwin"
plant_file, controller_file, twin_file = (InFolder((f"{name}.fmu", f"{name}.native.fmu")) for name in FMU)
profile_file = InFolder(("profile.csv",))
run_file = InFolder(("run.csv", "prediction.csv"))
commands_file = InFolder(("plan.csv", "next_experiment.csv", "validation.csv", "validation.csv.gz"))
"""Files of folders that verbs wrote, for arguments that name one of them."""


def add_gains(parser, text: str) -> None:
    """The option --gains."""
    parser.add_argument("--gains", type=gains_file, metavar="G", help=f"{text}; G: a file or its folder")


def add_knowledge(parser, text: str) -> None:
    """The option --knowledge."""
    parser.add_argument("--knowledge", type=knowledge_file, metavar="F", help=text)


def add_plant(parser, more: str = "", required: bool = False) -> None:
    """The options --parameters and --effects-from; `more`: end of the help."""
    text = f"the plant's parameters, a file or its folder{more}"
    parser.add_argument("--parameters", type=parameters_file, metavar="F", required=required, help=text)
    add_effects_from(parser)


def read_plant(options) -> ParameterSet:
    """The plant of --parameters, with effects of installed packages and of --effects-from; without parameters the paper's.
    BadInput."""
    given, library = getattr(options, "parameters", None), library_with(getattr(options, "effects_from", ()))
    return read_parameters(given, lambda names: plant(names, library)) if given else ParameterSet(plant())


def read_gains(options) -> ParameterSet | None:
    """The controller's values of --gains, None without them. BadInput."""
    return read_parameters(options.gains, lambda _: CONTROLLER) if options.gains else None
