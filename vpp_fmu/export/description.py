"""modelDescription.xml of a model, for both flavours, from its declarations."""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from vpp_fmu.kernel.types import Model
from vpp_fmu.tracer import Layout
from vpp_fmu.units import base_unit

LOG_CATEGORIES = {"logStatusError": "calls that failed, and why", "logStatusFatal": "calls after which the instance is lost"}


@dataclass(frozen=True)
class Experiment:
    """The default experiment: how long, and at what step [s]."""

    stop: float = 10.0
    step: float = 0.004


TEN_SECONDS = Experiment()


def guid(content: str) -> str:
    """A GUID made from what the FMU is made of: the same content has the same one, on any day."""
    h = sha256(content.encode()).hexdigest()
    return f"{{{h[:8]}-{h[8:12]}-{h[12:16]}-{h[16:20]}-{h[20:32]}}}"


def variable_names(model: Model) -> list[str]:
    """FMU variable of each value, in the order of value references. States get a `state.` before, for an output may share
    a state's name."""
    layout = Layout.of(model)
    return [*layout.inputs, *layout.outputs, *layout.parameters, *(f"state.{x}" for x in layout.states)]


def model_description(model: Model, values: Mapping[str, float], content_guid: str, tool: str, experiment: Experiment) -> bytes:
    """The XML text. `values`: every parameter's start value. `tool` follows this project's name as generation tool."""
    root = Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=content_guid,
        description=model.description,
        version=version("vpp-fmu"),
        license="MIT",
        generationTool=f"vpp-fmu {version('vpp-fmu')}, {tool}",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    co_simulation = dict.fromkeys(
        ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate"), "true"
    )
    python = "pythonfmu" in tool
    SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model.name,
        needsExecutionTool=str(python).lower(),
        canNotUseMemoryManagementFunctions="true",
        **co_simulation,
    )
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
        real = {"unit": q.unit}
        if causality != "local":
            real |= {"min": repr(q.minimum), "max": repr(q.maximum), "nominal": repr(q.nominal)}
        if start is not None:
            real["start"] = repr(start)
        SubElement(SubElement(root, "ScalarVariable", attributes), "Real", real)
    return root


def _structure(model: Model) -> Element:
    """At a communication point no output depends on an input directly; at the start each is settled on all of them."""
    root = Element("ModelStructure")
    first = len(model.inputs) + 1
    outputs, unknowns = SubElement(root, "Outputs"), SubElement(root, "InitialUnknowns")
    settled_on = [*range(1, first), *range(first + len(model.outputs), first + len(model.outputs) + len(model.parameters))]
    for i in range(first, first + len(model.outputs)):
        SubElement(outputs, "Unknown", index=str(i), dependencies="")
        SubElement(unknowns, "Unknown", index=str(i), dependencies=" ".join(map(str, settled_on)))
    return root
