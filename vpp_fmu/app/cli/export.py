"""Export plant, controller and adaptive twin as FMI 2.0 (or 3.0) co-simulation FMUs, and their closed loop as SSP.

The Python flavour runs wherever pythonfmu does; the native one is compiled C and needs no Python. Written beside each FMU: its
parameters (.ssv)."""

import io
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from identification.tune.controllers import rig_controller, said_of
from identification.tune.profile import reach
from vpp_fmu import __version__
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.inputs import ADAPT, GAINS, add_gains, add_plant, read_gains, read_plant
from vpp_fmu.app.cli.options import real
from vpp_fmu.app.cli.output import add_output, written
from vpp_fmu.errors import BadInput
from vpp_fmu.export import Experiment, native_fmu, python_fmu
from vpp_fmu.export.archive import archive
from vpp_fmu.export.cross_check import cross_check_folder, reference_files
from vpp_fmu.export.own_model import FORM, find_model
from vpp_fmu.export.toolchain import host, needs_glibc
from vpp_fmu.export.trial import step_dependence, try_fmu
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import ParameterSet, beside, check_same_model, knowledge_file, policy_file, read_parameters, to_ssv
from vpp_fmu.ssp import NAME, loop_ssp

EXAMPLE = "vpp export --parameters out/parameters.json --flavour both -o fmus"
SUFFIX = {"python": "", "native": ".native"}
FMI_3 = ".fmi3"
FLAT = ".flat"
"""Suffix of the loop without system connectors, for importers that do not support them."""


SECONDS = real(0.0, 1e9, "s", above=True)

ABOUT: Mapping[str, tuple[Callable, str]] = {
    "author": (str, "who made the model; this and the next ones are for the FMUs (default: as the model declares)"),
    "version": (str, "version of the model"),
    "license": (str, "the model's licence"),
    "copyright": (str, "the model's copyright"),
    "description": (str, "the model in words"),
    "stop_time": (SECONDS, "end of the default experiment, s"),
    "step_size": (SECONDS, "its communication step, s"),
    "tolerance": (real(0.0, 1.0, above=True), "its relative tolerance"),
}
"""Fields of a Model that an export may replace, with their types."""


def configure(parser):
    add_plant(parser, " (default: the paper's fine-tuned set)")
    add_gains(parser, GAINS)
    text = "a learned law as the controller: a policy.json (vpp_fmu/policy.py) or its folder; --gains are its fallback's"
    parser.add_argument("--policy", type=policy_file, metavar="FILE", help=text)
    text = "also the adaptive twin of the parameters' rig; I: identification.json of --parameters (default: the one beside F)"
    parser.add_argument("--twin", nargs="?", const="", type=knowledge_file, metavar="I", help=text)
    parser.add_argument("--adapt", nargs="+", metavar="NAME", help=ADAPT)
    parser.add_argument("--flavour", choices=("python", "native", "both"), default="python", help="default: python")
    text = "what native FMUs run on: this machine (default), or Linux, Windows and macOS (needs the extra 'cross')"
    parser.add_argument("--platforms", choices=("host", "all"), default="host", help=text)
    text = "of the standard (default: %(default)s); 3.0 for native FMUs, written as .fmi3.fmu"
    parser.add_argument("--fmi", choices=("2.0", "3.0"), default="2.0", help=text)
    parser.add_argument("--model", metavar="MODEL", help=f"export this model instead of plant and controller: {FORM}")
    for field, (kind, text) in ABOUT.items():
        name = "--model-version" if field == "version" else f"--{field.replace('_', '-')}"
        parser.add_argument(name, dest=f"about_{field}", metavar="TEXT" if kind is str else "X", type=kind, help=text)
    text = "also write inputs with reference outputs (_in.csv, _ref.csv, _ref.opt), and cross_check.zip: they and the FMUs, in "
    text += "the folders of the FMI project's cross-check"
    parser.add_argument("--cross-check", action="store_true", help=text)
    text = "also write the loop as VppLoop.flat.ssp, without connectors of the system, which libcosim and Ecos do not support"
    parser.add_argument("--flat", action="store_true", help=text)
    add_output(parser)


def run(options):
    _check(options)
    given = {field: getattr(options, f"about_{field}") for field in ABOUT}
    parts = [about(p, given) for p in (_own(options) if options.model else _plant_and_controller(options))]
    kind = (f" --model {parts[0].model.name}" if options.model else "") + (
        f" --fmi {options.fmi}" if options.fmi != "2.0" else ""
    )
    folder = OutputSet(options.output, f"export{kind}")
    flavours = ("python", "native") if options.flavour == "both" else (options.flavour,)
    files = exported(parts, flavours, options.platforms, options.fmi, options.flat)
    lines = []
    if not options.model:
        lines.append(said_of(parts[1], options.gains))
    else:
        tried(options.model, parts[0], files, flavours, options.fmi)
        if found := step_dependence(parts[0].model, parts[0].values):
            text = f"note: {options.model} depends on the communication step: {found}. Give its effects a largest_step [s]"
            lines.append(text)
    if options.cross_check:
        files |= _cross_check(parts, files)
    for name, content in files.items():
        folder.write(name, content)
    place = written(options, folder, parts[0])
    if flavours == ("python",):
        lines.append("the Python FMUs need a host that runs in Python, such as fmpy; any other runs those of --flavour native")
    if wanted := oldest_glibc(files):
        better = "" if find_spec("ziglang") else "; with the extra 'cross' (ziglang) they are linked to the oldest that serves"
        lines.append(f"the native FMUs run with the GNU C library {wanted} and newer{better}")
    fmus = [name for name in files if name.endswith(".fmu")]
    text = f"{' and '.join(fmus)} {'are' if len(fmus) > 1 else 'is'} in {folder.path}, FMI {options.fmi} for co-simulation."
    return Answer(text, {"format": "vpp-export/1", "fmi": options.fmi, "files": sorted(files)}, lines, written=place)


def tried(
    where: str, part: ParameterSet, files: Mapping[str, bytes | str], flavours: Iterable[str], fmi: str
) -> Mapping[str, bytes | str]:
    """The files of one model, each FMU of which was tried. BadInput."""
    for flavour in flavours:
        fmu = files[f"{part.model.name}{_suffix(flavour, fmi)}.fmu"]
        try_fmu(where, part.model, part.values, _experiment([part]), fmu, fmi)
    return files


def _cross_check(parts: Sequence[ParameterSet], files: Mapping[str, bytes | str]) -> dict[str, bytes | str]:
    """Reference files of each FMU, and the archive of the cross-check."""
    experiment, found, folders = _experiment(parts), {}, {}
    for part in parts:
        references = reference_files(part.model, part.values, experiment)
        found |= references
        for flavour, suffix in SUFFIX.items():
            fmu = files.get(f"{part.model.name}{suffix}.fmu")
            if fmu is not None:
                tool = f"vpp-fmu-{flavour}/{__version__}"
                folders |= cross_check_folder(part.model.name, experiment, references, fmu, tool, host())
    return {**found, "cross_check.zip": archive(folders)}


def oldest_glibc(files: Mapping[str, bytes | str]) -> str | None:
    """The oldest GNU C library with which all Linux libraries of the FMUs run; None without any."""
    found = []
    for name, content in files.items():
        if name.endswith((f"{SUFFIX['native']}.fmu", f"{FMI_3}.fmu")):
            with zipfile.ZipFile(io.BytesIO(content)) as packed:
                libraries = [n for n in packed.namelist() if n.startswith("binaries/") and n.endswith(".so")]
                found += [needs_glibc(packed.read(n)) for n in libraries]
    return max(filter(None, found), key=lambda v: [int(x) for x in v.split(".")], default=None)


def _check(options) -> None:
    """BadInput for options that do not fit together."""
    native = options.flavour != "python"
    if options.policy and options.model:
        raise BadInput("command line", "--policy", "--policy and --model", "only one of them")
    if options.twin is not None and (options.model or not options.parameters):
        given = "--twin and --model" if options.model else "--twin without --parameters"
        raise BadInput("command line", "--twin", given, "--twin with the --parameters of an identified plant")
    if options.adapt and options.twin is None:
        raise BadInput("command line", "--adapt", "--adapt without --twin", "both: the twin adapts these parameters")
    if options.platforms != "host" and not native:
        raise BadInput("command line", "--platforms", f"{options.platforms} with --flavour python", "--flavour native or both")
    if options.flat and (options.model or options.fmi == "3.0"):
        given = "--model" if options.model else "--fmi 3.0"
        raise BadInput(
            "command line", "--flat", f"--flat and {given}", "--flat with plant and controller of FMI 2.0: their loop"
        )
    if options.fmi == "3.0" and options.cross_check:
        raise BadInput("command line", "--cross-check", "--fmi 3.0", "--fmi 2.0, the only version of the cross-check")
    if options.fmi == "3.0" and options.flavour != "native":
        raise BadInput("command line", "--fmi", f"3.0 with --flavour {options.flavour}", "--flavour native")


def _plant_and_controller(options) -> list[ParameterSet]:
    parameters = read_plant(options)
    controller = rig_controller(parameters, read_gains(options), options.gains)
    if options.policy:
        from vpp_fmu.policy import read_policy  # noqa: PLC0415 the main way needs no policy

        controller = read_policy(options.policy).in_place_of(controller)
    return [parameters, controller] + ([_twin(options, parameters)] if options.twin is not None else [])


def _twin(options, parameters: ParameterSet) -> ParameterSet:
    """The adaptive twin of the plant, with the band from the identification.json of --twin (default: the one beside the
    parameters). BadInput."""
    from hil.twin.adaptive import adaptable, adaptive  # noqa: PLC0415 the main way needs no twin
    from hil.twin.band import read_band  # noqa: PLC0415

    known_in = options.twin or beside(options.parameters)
    if not Path(known_in).is_file():
        hint = "vpp identify CAMPAIGN -o out, then --parameters out/parameters.json --twin"
        raise BadInput(known_in, "file", "no such file", "the identification.json of --parameters: noise and model error", hint)
    band = read_band(known_in)
    check_same_model(known_in, parameters, options.parameters)
    own = adaptable(parameters, "vpp export", options.adapt)
    return adaptive(own, band, options.adapt, sample_time=parameters.sample_period)


def _own(options) -> list[ParameterSet]:
    if options.gains:
        raise BadInput(
            "command line", "--gains", "--gains and --model", "only one of them", "--parameters for the values of a model"
        )
    model = find_model(options.model)
    return [read_parameters(options.parameters, lambda _: model) if options.parameters else ParameterSet(model)]


def about(part: ParameterSet, given: Mapping[str, object]) -> ParameterSet:
    """The part with these fields of its Model replaced; None: as declared. BadInput."""
    for field in ("stop_time", "step_size", "tolerance"):
        number = given.get(field)
        if number is not None and not (isinstance(number, float | int) and 0.0 < number < float("inf")):
            raise BadInput("vpp export", field, number, "a number above 0")
    return replace(part, model=replace(part.model, **{field: value for field, value in given.items() if value is not None}))


def _suffix(flavour: str, fmi: str) -> str:
    return FMI_3 if fmi == "3.0" else SUFFIX[flavour]


def _experiment(parts: Sequence[ParameterSet]) -> Experiment:
    usual, seconds, model = Experiment(), parts[0].source.get("record_seconds"), parts[0].model
    stop = float(seconds) if isinstance(seconds, int | float) else usual.stop
    step = model.step_size or parts[0].sample_period or usual.step
    return Experiment(max(model.stop_time or stop, step), step, model.tolerance)


def exported(
    parts: Sequence[ParameterSet],
    flavours: Iterable[str],
    platforms: str = "host",
    fmi: str = "2.0",
    flat: bool = False,
) -> dict[str, bytes | str]:
    """All files by name, made before any is written. With two parts or more, the loop of the first two is one of them; `flat`:
    a second time, without connectors of the system."""
    experiment = _experiment(parts)
    make: dict[str, Callable[..., bytes]] = {"python": python_fmu, "native": native_fmu}
    found: dict[str, bytes | str] = {}
    for flavour in flavours:
        more = {"platforms": platforms, "version": fmi} if flavour == "native" else {}
        fmus = {p.model.name: make[flavour](p.model, p.values, experiment, origins=_origins(p), **more) for p in parts}
        found |= {f"{name}{_suffix(flavour, fmi)}.fmu": fmu for name, fmu in fmus.items()}
        if len(parts) > 1 and fmi == "2.0":  # SSP 1.0 supports no other
            loop = {p.model.name: (p, fmus[p.model.name]) for p in parts[:2]}  # a twin monitors the loop and is no part of it
            wanted = {"thrust_set": float(f"{0.5 * sum(reach(parts[0], parts[1].values)):.2g}")}  # the middle of the reach
            for end in ("", FLAT)[: 1 + flat]:
                ssp = loop_ssp(loop, wanted, experiment.stop, connectors=not end)
                found[f"{NAME}{SUFFIX[flavour]}{end}.ssp"] = ssp
    return found | {f"{part.model.name}.ssv": to_ssv(part, part.model.name) for part in parts}


def _origins(parameters: ParameterSet) -> dict[str, str]:
    """Source of each estimated value."""
    known = {name: e for name, e in parameters.estimates.items() if e.std is not None}
    return {name: f"estimated, standard deviation {e.std:.3g} {e.unit}".removesuffix(" 1") for name, e in known.items()}
