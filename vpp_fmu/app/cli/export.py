"""Export plant, controller and adaptive twin as FMI 2.0 (or 3.0) co-simulation FMUs, and their closed loop as SSP.

The Python flavour runs wherever pythonfmu does; the native one is compiled C and needs no Python. Written beside each FMU: its
parameters (.ssv)."""

from collections.abc import Callable, Mapping

from vpp_fmu.app.api.export import FLAVOURS, PLATFORMS, VERSIONS, export_fmu
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.options import ADAPT, GAINS, Number, add_gains, add_output, add_plant
from vpp_fmu.app.cli.output import called, output, written
from vpp_fmu.export.own_model import FORM
from vpp_fmu.parameters import knowledge_file, policy_file

EXAMPLE = "vpp export --parameters out/parameters.json --flavour both -o fmus"
SECONDS = Number(0.0, 1e9, "s", above=True)

FIELDS: Mapping[str, tuple[Callable, str]] = {
    "author": (str, "who made the model; this and the next ones are for the FMUs (default: as the model declares)"),
    "version": (str, "version of the model"),
    "license": (str, "the model's licence"),
    "copyright": (str, "the model's copyright"),
    "description": (str, "the model in words"),
    "stop_time": (SECONDS, "end of the default experiment, s"),
    "step_size": (SECONDS, "its communication step, s"),
    "tolerance": (Number(0.0, 1.0, above=True), "its relative tolerance"),
}
"""Fields of a Model that an export may replace, with their types."""


def configure(parser):
    add_plant(parser, " (default: the paper's fine-tuned set)")
    add_gains(parser, GAINS)
    text = "a learned law as the controller: a policy.json (vpp_fmu/policy.py) or its folder; --gains are its fallback's"
    parser.add_argument("--policy", type=policy_file, metavar="FILE", help=text)
    text = "also the adaptive twin of the parameters' rig; I: identification.json of --parameters (default: the one beside F)"
    parser.add_argument("--twin", nargs="?", const=True, type=knowledge_file, metavar="I", help=text)
    parser.add_argument("--adapt", nargs="+", metavar="NAME", help=ADAPT)
    parser.add_argument("--flavour", choices=FLAVOURS, default="python", help="default: python")
    text = "what native FMUs run on: this machine (default), or Linux, Windows and macOS (needs the extra 'cross')"
    parser.add_argument("--platforms", choices=PLATFORMS, default="host", help=text)
    text = "of the standard (default: %(default)s); 3.0 for native FMUs, written as .fmi3.fmu"
    parser.add_argument("--fmi", choices=VERSIONS, default="2.0", help=text)
    parser.add_argument("--model", metavar="MODEL", help=f"export this model instead of plant and controller: {FORM}")
    for field, (kind, text) in FIELDS.items():
        name = "--model-version" if field == "version" else f"--{field.replace('_', '-')}"
        parser.add_argument(name, dest=f"about_{field}", metavar="TEXT" if kind is str else "X", type=kind, help=text)
    text = "also write inputs with reference outputs (_in.csv, _ref.csv, _ref.opt), and cross_check.zip: they and the FMUs, in "
    text += "the folders of the FMI project's cross-check"
    parser.add_argument("--cross-check", action="store_true", help=text)
    text = "also write the loop as VppLoop.flat.ssp, without connectors of the system, which libcosim and Ecos do not support"
    parser.add_argument("--flat", action="store_true", help=text)
    add_output(parser)


def run(options):
    about = {field: value for field in FIELDS if (value := getattr(options, f"about_{field}")) is not None}
    kind = f" --model {options.model}" if options.model else ""
    kind += f" --fmi {options.fmi}" if options.fmi != "2.0" else ""
    with output(options, kind) as folder:
        done = called(export_fmu, options, folder=folder, **about)
        place = written(options, folder, done.identity)
    fmus = [name for name in done if name.endswith(".fmu")]
    text = f"{' and '.join(fmus)} {'are' if len(fmus) > 1 else 'is'} in {folder.path}, FMI {options.fmi} for co-simulation."
    return Answer(text, {"format": "vpp-export/1", "fmi": options.fmi, "files": sorted(done)}, done.remarks, written=place)
