"""Export plant and controller as FMI 2.0 co-simulation FMUs, and their closed loop as SSP.

The Python flavour runs wherever pythonfmu does; the native one is compiled C and needs no Python. Beside each FMU stand its
parameters (.ssv), and inputs with the outputs they must give (_in.csv, _ref.csv, _ref.opt)."""

import importlib
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from vpp_fmu.cli.output import add_effects_from, add_output, say_written
from vpp_fmu.errors import BadInput
from vpp_fmu.export import Experiment, native_fmu, python_fmu
from vpp_fmu.export.cross_check import reference_files
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.types import Model
from vpp_fmu.outputs import OutputSet
from vpp_fmu.own_effects import library_with
from vpp_fmu.parameters import ParameterSet, read_parameters, to_ssv
from vpp_fmu.ssp import NAME, loop_ssp
from vpp_fmu.units import base_unit

EXAMPLE = "vpp export --parameters out/parameters.json --flavour both -o fmus"
SUFFIX = {"python": "", "native": ".native"}
WANTED_THRUST = 8.0  # N; what the loop's archive starts on, where nobody says more


def configure(parser):
    parser.add_argument("--parameters", metavar="F", help="the plant's parameters (default: the paper's fine-tuned set)")
    add_effects_from(parser)
    parser.add_argument("--gains", metavar="G", help="the controller's parameters (default: the paper's, both actuators)")
    parser.add_argument("--flavour", choices=("python", "native", "both"), default="python", help="default: python")
    text = "what native FMUs run on: this machine (default), or Linux, Windows and macOS (needs the extra 'cross')"
    parser.add_argument("--platforms", choices=("host", "all"), default="host", help=text)
    parser.add_argument("--model", metavar="PACKAGE.MODULE:NAME", help="export this model instead of plant and controller")
    add_output(parser)


def run(options):
    parts = _own(options) if options.model else _plant_and_controller(options)
    folder = OutputSet(options.output, "export")
    flavours = ("python", "native") if options.flavour == "both" else (options.flavour,)
    for name, content in exported(parts, flavours, options.platforms).items():
        folder.write(name, content)
    say_written(folder, parts[0])


def _plant_and_controller(options) -> list[ParameterSet]:
    library = library_with(options.effects_from)
    model = (
        read_parameters(options.parameters, lambda names: plant(names, library))
        if options.parameters
        else ParameterSet(plant())
    )
    gains = read_parameters(options.gains, lambda _: CONTROLLER) if options.gains else ParameterSet(CONTROLLER)
    return [model, gains]


def _own(options) -> list[ParameterSet]:
    if options.gains:
        raise BadInput("vpp export", "--gains", "given with --model", "--parameters for a model's parameters")
    model = find_model(options.model)
    return [read_parameters(options.parameters, lambda _: model) if options.parameters else ParameterSet(model)]


def find_model(where: str) -> Model:
    """The model that `package.module:NAME` names; modules are also found in the current folder."""
    module, _, name = where.partition(":")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, ValueError, AttributeError) as error:
        raise BadInput("vpp export", "--model", f"{where} ({error})", "package.module:NAME of a kernel Model") from error
    if not isinstance(found, Model):
        raise BadInput("vpp export", "--model", f"{where}, a {type(found).__name__}", "the name of a kernel Model")
    for quantity in (*found.inputs, *found.outputs, *found.parameters, *found.states):
        try:
            base_unit(quantity.unit)
        except KeyError as error:
            what = f"{quantity.name} in {quantity.unit}"
            raise BadInput("vpp export", "--model", what, "units that vpp_fmu.units knows") from error
    return found


def exported(parts: Sequence[ParameterSet], flavours: Iterable[str], platforms: str = "host") -> dict[str, bytes | str]:
    """All files by name; nothing is written before all of them are made. Two parts or more also give their closed loop."""
    experiment = Experiment(stop=float(parts[0].source.get("record_seconds", 10.0)))
    make: dict[str, Callable[..., bytes]] = {"python": python_fmu, "native": native_fmu}
    found: dict[str, bytes | str] = {}
    for flavour in flavours:
        more = {"platforms": platforms} if flavour == "native" else {}
        fmus = {p.model.name: make[flavour](p.model, p.values, experiment, origins=_origins(p), **more) for p in parts}
        found |= {f"{name}{SUFFIX[flavour]}.fmu": fmu for name, fmu in fmus.items()}
        if len(parts) > 1:
            loop = {p.model.name: (p, fmus[p.model.name]) for p in parts}
            found[f"{NAME}{SUFFIX[flavour]}.ssp"] = loop_ssp(loop, {"thrust_set": WANTED_THRUST}, experiment.stop)
    for part in parts:
        name = part.model.name
        found |= {f"{name}.ssv": to_ssv(part, name), **reference_files(part.model, part.values, experiment)}
    return found


def _origins(parameters: ParameterSet) -> dict[str, str]:
    """Where values come from, for those that were estimated."""
    known = {name: e for name, e in parameters.estimates.items() if e.std is not None}
    return {name: f"estimated, standard deviation {e.std:.3g} {e.unit}".removesuffix(" 1") for name, e in known.items()}
