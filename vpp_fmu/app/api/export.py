"""Export parameters, or a model of one's own, as FMUs with their values and their loop."""

import io
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from identification.tune.controllers import rig_controller, said_of
from identification.tune.profile import reach
from vpp_fmu import __version__
from vpp_fmu.app.api.objects import PathLike, as_gains, as_parameters, changed, file_of
from vpp_fmu.errors import ARGUMENT, BadInput
from vpp_fmu.export import Experiment, native_fmu, python_fmu
from vpp_fmu.export.archive import archive
from vpp_fmu.export.cross_check import cross_check_folder, reference_files
from vpp_fmu.export.own_model import as_model, find_model
from vpp_fmu.export.toolchain import host, needs_glibc
from vpp_fmu.export.trial import step_dependence, try_fmu
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.types import Model
from vpp_fmu.parameters import ParameterSet, beside, check_same_model, parameters_file, read_parameters, to_ssv
from vpp_fmu.ssp import NAME, loop_ssp

FLAVOURS = {"python": ("python",), "native": ("native",), "both": ("python", "native")}
PLATFORMS, VERSIONS = ("host", "all"), ("2.0", "3.0")
SUFFIX = {"python": "", "native": ".native"}
FMI_3 = ".fmi3"
FLAT = ".flat"
"""Suffix of the loop without system connectors, for importers that do not support them."""

ABOUT = ("author", "version", "license", "copyright", "description", "stop_time", "step_size", "tolerance")
"""Fields of a Model that an export may replace."""


class Exported(dict[str, Path]):
    """Paths of the files by name. `remarks` on them, in words; `identity` of the exported parameters."""

    remarks: tuple[str, ...] = ()
    identity = ""


def export_fmu(
    parameters: Any,
    folder: PathLike | OutputFolder,
    gains: Any = None,
    flavour: str = "python",
    platforms: str = "host",
    fmi: str = "2.0",
    effects_from: Iterable[PathLike] = (),
    policy: Any = None,
    model: str | Model | type | None = None,
    values: Mapping[str, float] | None = None,
    twin: PathLike | bool | None = None,
    adapt: Sequence[str] | None = None,
    cross_check: bool = False,
    flat: bool = False,
    **fields: Any,
) -> Exported:
    """Write VppPlant and VppController as FMUs, with parameter values (.ssv) and their loop (.ssp); or a model of your
    own.

    `parameters`: a file, a set or a result, None: the paper's; or a Model or Slave. `model`: your own, as an object or
    "FILE.py:NAME"; then `parameters` is a file with its values, if any. `values` of parameters by name. `fields` (author,
    version, license, copyright, description, stop_time, step_size, tolerance) replace what the model declares.

    `gains`: the controller's (a file, a set, values by name; None: the published ones, scaled to the rig's time constant),
    within the limits of the parameters' rig. `policy`: a learned law in the controller's place, as VppPolicy; `gains` are then
    those of its fallback. `twin`: also the adaptive one: True, or the identification.json with its band; `adapt`: the names of
    its parameters. `flavour`: "python", "native" (compiled C without Python) or "both". `platforms`: "host", or "all" for
    Linux, Windows and macOS (native, needs the extra `cross`). `fmi`: "2.0" or "3.0" (native). `cross_check`: also reference
    outputs; `flat`: also the loop without connectors. Returns the paths by name. BadInput: options that do not fit together;
    CompilerMissing: no compiler for native FMUs.

    >>> files = vpp.export_fmu(vpp.identify(vpp.example_campaign(), starts=1), "fmus")
    >>> [name for name in files if name.endswith(".fmu")]
    ['VppPlant.fmu', 'VppController.fmu']
    """
    if isinstance(parameters, Model | type):
        parameters, model = None, parameters
    own, watched = model is not None, bool(twin)
    for name, found, options in (("flavour", flavour, FLAVOURS), ("platforms", platforms, PLATFORMS), ("fmi", fmi, VERSIONS)):
        if found not in options:
            raise BadInput(ARGUMENT, name, found, " or ".join(options))
    if unknown := set(fields) - set(ABOUT):
        raise BadInput(ARGUMENT, "argument", ", ".join(sorted(unknown)), f"one of {', '.join(ABOUT)}")
    of_own, both = "--model" if own else "--fmi 3.0", "both: the twin adapts these parameters"
    loop, only = "--flat with plant and controller of FMI 2.0: their loop", "--fmi 2.0, the only version of the cross-check"
    identified = "--twin with the --parameters of an identified plant"
    for wrong, name, found, allowed in (
        (policy is not None and own, "policy", "--policy and --model", "only one of them"),
        (watched and own, "twin", "--twin and --model", identified),
        (watched and parameters is None, "twin", "--twin without --parameters", identified),
        (adapt and not watched, "adapt", "--adapt without --twin", both),
        (
            platforms != "host" and flavour == "python",
            "platforms",
            f"{platforms} with --flavour python",
            "--flavour native or both",
        ),
        (flat and (own or fmi == "3.0"), "flat", f"--flat and {of_own}", loop),
        (cross_check and fmi == "3.0", "cross_check", "--fmi 3.0", only),
        (fmi == "3.0" and flavour != "native", "fmi", f"3.0 with --flavour {flavour}", "--flavour native"),
        (own and gains is not None, "gains", "--gains and --model", "only one of them"),
    ):
        if wrong:
            hint = "--parameters for the values of a model" if name == "gains" else ""
            raise BadInput(ARGUMENT, name, found, allowed, hint)
    remarks = []
    if model is not None:
        parts = [changed(_own(model, parameters), values or {})]
    else:
        held = as_parameters(parameters, effects_from)
        controller = rig_controller(held, as_gains(gains), file_of(gains or "gains") or "gains")
        remarks.append(said_of(controller, None if gains is None else file_of(gains)))
        if policy is not None:
            from vpp_fmu.policy import read_policy  # noqa: PLC0415 the main way needs no policy

            law = getattr(policy, "policy", policy)  # of a result
            controller = (law if hasattr(law, "in_place_of") else read_policy(law)).in_place_of(controller)
        parts = [changed(held, values or {}), controller, *([_twin(held, parameters, twin, adapt)] if watched else [])]
    parts = [about(part, fields) for part in parts]
    files: dict[str, Any] = exported(parts, FLAVOURS[flavour], platforms, fmi, flat)
    if own:
        name = parts[0].model.name
        where = model if isinstance(model, str) else name
        for each in FLAVOURS[flavour]:
            fmu = files[f"{name}{_suffix(each, fmi)}.fmu"]
            try_fmu(where, parts[0].model, parts[0].values, _experiment(parts), fmu, fmi)
        if found := step_dependence(parts[0].model, parts[0].values):
            text = f"note: {where} depends on the communication step: {found}. Give its effects a largest_step [s]"
            remarks.append(text)
    if cross_check:
        files |= _cross_check(parts, files)
    target = folder if isinstance(folder, OutputFolder) else OutputFolder(folder)
    written = Exported({name: target.write(name, content) for name, content in files.items()})
    if flavour == "python":
        remarks.append(
            "the Python FMUs need a host that runs in Python, such as fmpy; any other runs those of --flavour native"
        )
    if wanted := oldest_glibc(files):
        better = "" if find_spec("ziglang") else "; with the extra 'cross' (ziglang) they are linked to the oldest that serves"
        remarks.append(f"the native FMUs run with the GNU C library {wanted} and newer{better}")
    written.remarks, written.identity = tuple(remarks), parts[0].identity
    return written


def _own(model: str | Model | type, parameters: Any) -> ParameterSet:
    """A model of one's own, with the values of a file if there is one."""
    name = model.__name__ if isinstance(model, type) else getattr(model, "name", "")
    found = find_model(model) if isinstance(model, str) else as_model(name, model)
    return ParameterSet(found) if parameters is None else read_parameters(parameters_file(parameters), lambda _: found)


def _twin(held: ParameterSet, given: Any, twin: Any, adapt: Sequence[str] | None) -> ParameterSet:
    """The adaptive twin of the plant, with the band from an identification.json (True: the one beside the parameters).
    BadInput."""
    from hil.twin.band import read_band  # noqa: PLC0415 the main way needs no twin
    from hil.twin.twin import twin_of  # noqa: PLC0415

    file = file_of(given) or "parameters"
    known_in = beside(file) if twin is True else twin
    if not Path(known_in).is_file():
        hint = "vpp identify CAMPAIGN -o out, then --parameters out/parameters.json --twin"
        raise BadInput(known_in, "file", "no such file", "the identification.json of --parameters: noise and model error", hint)
    band = read_band(known_in)
    check_same_model(known_in, held, file)
    return twin_of(held, band, adapt, "vpp export", held.sample_period)


def about(part: ParameterSet, given: Mapping[str, Any]) -> ParameterSet:
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
) -> dict[str, Any]:
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


def _cross_check(parts: Sequence[ParameterSet], files: Mapping[str, Any]) -> dict[str, bytes | str]:
    """Reference files of each FMU, and the archive of the cross-check."""
    experiment = _experiment(parts)
    found: dict[str, bytes | str] = {}
    folders: dict[str, Any] = {}
    for part in parts:
        references = reference_files(part.model, part.values, experiment)
        found |= references
        for flavour, suffix in SUFFIX.items():
            fmu = files.get(f"{part.model.name}{suffix}.fmu")
            if fmu is not None:
                tool = f"vpp-fmu-{flavour}/{__version__}"
                folders |= cross_check_folder(part.model.name, experiment, references, fmu, tool, host())
    return {**found, "cross_check.zip": archive(folders)}


def oldest_glibc(files: Mapping[str, Any]) -> str | None:
    """The oldest GNU C library with which all Linux libraries of the FMUs run; None without any."""
    found = []
    for name, content in files.items():
        if name.endswith((f"{SUFFIX['native']}.fmu", f"{FMI_3}.fmu")):
            with zipfile.ZipFile(io.BytesIO(content)) as packed:
                libraries = [n for n in packed.namelist() if n.startswith("binaries/") and n.endswith(".so")]
                found += [needs_glibc(packed.read(n)) for n in libraries]
    return max(filter(None, found), key=lambda v: [int(x) for x in v.split(".")], default=None)
