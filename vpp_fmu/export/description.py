"""modelDescription.xml of a model, for both flavours, from its declarations."""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from math import isfinite
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from vpp_fmu.kernel.types import Model
from vpp_fmu.tracer import Layout
from vpp_fmu.units import base_unit

LOG_CATEGORIES = {
    "logStatusDiscard": "questions without an answer",
    "logStatusError": "calls that failed, and why",
    "logStatusFatal": "calls after which the instance is lost",
}


@dataclass(frozen=True)
class Experiment:
    """The default experiment: how long, and at what step [s]."""

    stop: float = 10.0
    step: float = 0.004


TEN_SECONDS = Experiment()


@dataclass(frozen=True)
class Flavour:
    """In what the flavours' descriptions differ: the tool that made the FMU, what it can do, its source files."""

    tool: str
    capabilities: Mapping[str, bool]
    sources: tuple[str, ...] = ()


def guid(*content: str | bytes) -> str:
    """A GUID made from what the FMU is made of: the same content has the same one, on any day."""
    h = sha256(b"\0".join(c.encode() if isinstance(c, str) else c for c in content)).hexdigest()
    return f"{{{h[:8]}-{h[8:12]}-{h[12:16]}-{h[16:20]}-{h[20:32]}}}"


def variable_names(model: Model) -> list[str]:
    """FMU variable of each value, in the order of value references. States get a `state.` before, for an output may share
    a state's name."""
    layout = Layout.of(model)
    return [*layout.inputs, *layout.outputs, *layout.parameters, *(f"state.{x}" for x in layout.states)]


def model_description(
    model: Model, values: Mapping[str, float], content_guid: str, flavour: Flavour, experiment: Experiment
) -> bytes:
    """The XML text. `values`: every parameter's start value."""
    root = Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=content_guid,
        description=model.description,
        version=version("vpp-fmu"),
        license="MIT",
        generationTool=f"vpp-fmu {version('vpp-fmu')}, {flavour.tool}",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    can = {"canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate"}
    capabilities = {**dict.fromkeys(sorted(can), True), "canNotUseMemoryManagementFunctions": True, **flavour.capabilities}
    kind = SubElement(root, "CoSimulation", modelIdentifier=model.name)
    kind.attrib.update((name, str(value).lower()) for name, value in capabilities.items())
    if flavour.sources:
        listed = SubElement(kind, "SourceFiles")
        for name in flavour.sources:
            SubElement(listed, "File", name=name)
    units = SubElement(root, "UnitDefinitions")
    for unit in sorted({q.unit for q in (*model.inputs, *model.outputs, *model.parameters, *model.states)}):
        SubElement(SubElement(units, "Unit", name=unit), "BaseUnit", base_unit(unit))
    categories = SubElement(root, "LogCategories")
    for name, text in LOG_CATEGORIES.items():
        SubElement(categories, "Category", name=name, description=text)
    SubElement(root, "DefaultExperiment", startTime="0.0", stopTime=repr(experiment.stop), stepSize=repr(experiment.step))
    root.append(_variables(model, values))
    root.append(_structure(model))
    indent(root)
    return tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _variables(model: Model, values: Mapping[str, float]) -> Element:
    """Inputs are held between communication points, and said so (`discrete`): an importer must not interpolate a command."""
    moves = "discrete" if model.sample_time else "continuous"
    kinds = (
        [("input", "discrete", None, q, q.start) for q in model.inputs]
        + [("output", moves, "calculated", q, None) for q in model.outputs]
        + [("parameter", "fixed", "exact", q, values[q.name]) for q in model.parameters]
        + [("local", moves, "calculated", q, None) for q in model.states]
    )
    root = Element("ModelVariables")
    for vr, ((causality, variability, initial, q, start), name) in enumerate(zip(kinds, variable_names(model), strict=True)):
        attributes = {"name": name, "valueReference": str(vr), "description": q.description}
        attributes |= {"causality": causality, "variability": variability} | ({"initial": initial} if initial else {})
        low, high, nominal = _span(model, q.unit) if causality == "local" else (q.minimum, q.maximum, q.nominal)
        real = {"unit": q.unit, "min": low, "max": high, "nominal": nominal, "start": start}
        given = {
            k: x if k == "unit" else repr(float(x)) for k, x in real.items() if k == "unit" or (x is not None and isfinite(x))
        }
        SubElement(SubElement(root, "ScalarVariable", attributes), "Real", given)
    return root


def _span(model: Model, unit: str) -> tuple[float, float, float]:
    """(minimum, maximum, nominal) of a state: those of the signals in its unit, else wide around the size of a parameter."""
    like = [s for s in (*model.outputs, *model.inputs) if s.unit == unit]
    if like:
        return min(s.minimum for s in like), max(s.maximum for s in like), like[0].nominal
    nominal = max((p.nominal for p in model.parameters if p.unit == unit), default=1.0)
    return -1e6 * nominal, 1e6 * nominal, nominal


def _structure(model: Model) -> Element:
    """At a communication point no output depends on an input directly. At the start those of a model in continuous time are
    settled on all of them; those of a sampled law are start values until its first sample, and depend on nothing."""
    root = Element("ModelStructure")
    first = len(model.inputs) + 1
    outputs, unknowns = SubElement(root, "Outputs"), SubElement(root, "InitialUnknowns")
    first_parameter = first + len(model.outputs)
    settled_on = [*range(1, first), *range(first_parameter, first_parameter + len(model.parameters))]
    if model.sample_time is not None:
        settled_on = []
    for i in range(first, first + len(model.outputs)):
        SubElement(outputs, "Unknown", index=str(i), dependencies="")
        SubElement(unknowns, "Unknown", index=str(i), dependencies=" ".join(map(str, settled_on)))
    return root
