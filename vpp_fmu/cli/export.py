"""Export plant and controller as FMI 2.0 co-simulation FMUs that run under Python."""

from vpp_fmu.cli.output import add_output, say_written
from vpp_fmu.export import Experiment, python_fmu
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet, read_parameters, to_ssv

EXAMPLE = "vpp export --parameters out/parameters.json -o fmus"


def configure(parser):
    parser.add_argument("--parameters", metavar="F", help="the plant's parameters (default: the paper's fine-tuned set)")
    parser.add_argument("--gains", metavar="G", help="the controller's parameters (default: the paper's, both actuators)")
    parser.add_argument("--flavour", choices=("python",), default="python", help="what the FMUs run on (default: python)")
    add_output(parser)


def run(options):
    model = read_parameters(options.parameters, plant) if options.parameters else ParameterSet(plant())
    gains = read_parameters(options.gains, lambda _: CONTROLLER) if options.gains else ParameterSet(CONTROLLER)
    export(OutputFolder(options.output), model, gains)


def export(folder, model, gains):
    """Write both FMUs and their parameters."""
    experiment = Experiment(stop=float(model.source.get("record_seconds", 10.0)))
    for part in (model, gains):
        name = part.model.name
        folder.write(f"{name}.fmu", python_fmu(part.model, part.values, experiment))
        folder.write(f"{name}.ssv", to_ssv(part, name))
    say_written(folder)
