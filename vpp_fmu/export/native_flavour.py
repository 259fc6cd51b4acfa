"""The native FMU: one generated C file, compiled; it runs without Python."""

from collections.abc import Iterable, Mapping
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from vpp_fmu.errors import BadInput
from vpp_fmu.export.archive import archive
from vpp_fmu.export.c_text import c_text
from vpp_fmu.export.description import TEN_SECONDS, Experiment, Flavour, guid, model_description
from vpp_fmu.export.description3 import model_description_3
from vpp_fmu.export.documentation import documents
from vpp_fmu.export.toolchain import binaries
from vpp_fmu.kernel.types import Model


def native_fmu(
    model: Model,
    parameters: Mapping[str, float] | None = None,
    experiment: Experiment = TEN_SECONDS,
    platforms: str | Iterable[str] = "host",
    origins: Mapping[str, str] | None = None,
    version: str = "2.0",
) -> bytes:
    """An FMU of `model` in compiled C, with its source; its bytes depend on the arguments and the compiler alone.

    `parameters`, `origins`: as in `python_fmu`. `platforms`: "host" for this machine, "all" or names
    of `toolchain.TARGETS` with Zig's compiler. `version`: of FMI, 2.0 or 3.0. CompilerMissing where there is no compiler.
    """
    if model.black_box is not None:
        raise BadInput(model.name, "flavour", "native with a black box", "python, which alone can pack it")
    values = model.values(parameters)
    source = f"{model.name}.c"
    flavour = Flavour("C", {"needsExecutionTool": False, "providesDirectionalDerivative": True}, (source,))
    describe = {"2.0": model_description, "3.0": model_description_3}[version]
    identity = guid(c_text(model, values, "", version), describe(model, values, "", flavour, experiment))
    text = c_text(model, values, identity, version)
    about = documents(model, values, origins)
    if version == "3.0" and model.icon:
        about["terminalsAndIcons/icon.png"] = about.pop("model.png")
    return archive(
        {
            "modelDescription.xml": describe(model, values, identity, flavour, experiment),
            f"sources/{source}": text.encode(),
            "sources/buildDescription.xml": _build_description(model.name, source),
            **binaries(model.name, text, platforms, version),
            **about,
        }
    )


def _build_description(name: str, source: str) -> bytes:
    """Build description for FMI 3.0 tools; FMI 2.0 has it in the model description. It has no compiler options, because they
    differ between compilers; the source itself disables fused multiply-adds."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    SubElement(files, "SourceFile", name=source)
    SubElement(configuration, "Library", name="m", external="true", description="C's mathematical functions")
    indent(root)
    return tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
