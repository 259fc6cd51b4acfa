"""modelDescription.xml of a model, from its declarations: the part common to all FMI versions, and FMI 2.0."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from math import inf, isfinite
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from vpp_fmu.kernel.calls import LOG_CATEGORIES
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import BOOLEAN, ENUMERATION, REAL, STRING, Model, Parameter, State
from vpp_fmu.tracer import Layout
from vpp_fmu.units import base_unit, display_units


@dataclass(frozen=True)
class Experiment:
    """The default experiment: duration and step [s], relative tolerance if there is one."""

    stop: float = 10.0
    step: float = 0.004
    tolerance: float | None = None


TEN_SECONDS = Experiment()


@dataclass(frozen=True)
class Flavour:
    """Data that differ between the flavours' descriptions: generation tool, capabilities, source files."""

    tool: str
    capabilities: Mapping[str, bool]
    sources: tuple[str, ...] = ()


def guid(*content: str | bytes) -> str:
    """A GUID from the content of the FMU: the same content has the same GUID."""
    h = sha256(b"\0".join(c.encode() if isinstance(c, str) else c for c in content)).hexdigest()
    return f"{{{h[:8]}-{h[8:12]}-{h[12:16]}-{h[16:20]}-{h[20:32]}}}"


def variable_names(model: Model) -> list[str]:
    """FMU variable of each value, in the order of value references. States have the prefix `state.`, since an output may have
    the same name."""
    layout = Layout.of(model)
    return [*layout.inputs, *layout.outputs, *layout.parameters, *(f"state.{x}" for x in layout.states)]


def variable_types(model: Model) -> list[str]:
    """FMI's type of each value, in the order of value references."""
    return [*(q.kind for q in (*model.inputs, *model.outputs, *model.parameters)), *[REAL] * len(model.states)]


def start_values(model: Model, values: Mapping[str, float]) -> list[float]:
    """Start value of each variable, in the order of value references: states settled on the inputs' start values. `values`: of
    every parameter."""
    simulation = Simulation(model, values)
    settled = [simulation.states[x.name] for x in model.states]
    first = [*(u.start for u in model.inputs), *[0.0] * len(model.outputs)]
    return [*first, *(values[p.name] for p in model.parameters), *settled]


def in_unit(parameter: Parameter) -> str:
    """The unit of this parameter for a message."""
    return "" if parameter.unit == "1" else f" {parameter.unit}"


def allowed(parameter: Parameter) -> str:
    """The parameter's range in words."""
    return f"{parameter.minimum} to {parameter.maximum}{in_unit(parameter)}"


@dataclass(frozen=True)
class Variable:
    """One FMU variable, for both versions of the standard."""

    name: str
    reference: int
    kind: str
    causality: str
    variability: str
    initial: str | None
    description: str
    unit: str
    minimum: float
    maximum: float
    nominal: float
    start: float | None
    items: tuple[str, ...]
    size: int
    place: int

    def typed(self) -> dict[str, str]:
        """The attributes of the type."""
        if self.kind == BOOLEAN:
            return {} if self.start is None else {"start": str(self.start != 0.0).lower()}
        if self.kind == STRING:
            return {} if self.start is None else {"start": self.items[round(self.start) - 1]}
        if self.kind == ENUMERATION:
            start = {} if self.start is None else {"start": str(round(self.start))}
            return {"declaredType": type_name(self.items), **start}
        real = {"min": self.minimum, "max": self.maximum} | ({"nominal": self.nominal} if self.kind == REAL else {})
        numbers = {k: x for k, x in (*real.items(), ("start", self.start)) if x is not None and isfinite(x)}
        text = {k: repr(float(x)) if self.kind == REAL else str(round(x)) for k, x in numbers.items()}
        shown = DISPLAYED.get(self.unit) if self.causality == "parameter" and self.nominal < 1.0 else None
        more = {"unit": self.unit} | ({"displayUnit": shown} if shown else {})
        return (more if self.kind == REAL else {}) | text


DISPLAYED = {"s": "ms"}
"""Display unit of parameters that are small in their unit."""


def variables(model: Model, values: Mapping[str, float]) -> list[Variable]:
    """All variables in the order of value references. `values`: every parameter's start value.

    Inputs are held between communication points and declared so (`discrete`): an importer must not interpolate a command. A
    state starts settled on the inputs, or at the importer's value (`approx`).
    """
    moves = "discrete" if model.sample_time else "continuous"
    starts = start_values(model, values)
    kinds = (
        [("input", "discrete", None, q) for q in model.inputs]
        + [("output", moves if q.kind == REAL else "discrete", "calculated", q) for q in model.outputs]
        + [("parameter", "tunable" if q.tunable else "fixed", "exact", q) for q in model.parameters]
        + [("local", moves, "approx", q) for q in model.states]
    )
    found = []
    for r, ((causality, variability, initial, q), name, kind) in enumerate(
        zip(kinds, variable_names(model), variable_types(model), strict=True)
    ):
        low, high, nominal = (-inf, inf, _nominal(model, q)) if causality == "local" else (q.minimum, q.maximum, q.nominal)
        start = None if causality == "output" else starts[r]
        attributes = (causality, variability, initial, q.description, q.unit, low, high, nominal, start)
        found.append(Variable(name, r, kind, *attributes, getattr(q, "items", ()), q.size, q.place))
    return found


def dependencies(model: Model) -> list[int]:
    """Value references on which the start value of each output depends.

    At a communication point no output depends on an input directly. At the start the outputs of a continuous model are
    settled on all inputs and parameters. Those of a sampled law are start values until its first sample, and depend on nothing.
    """
    if model.sample_time is not None:
        return []
    first = len(model.inputs) + len(model.outputs)
    return [*range(len(model.inputs)), *range(first, first + len(model.parameters))]


def unit_definitions(model: Model) -> Element:
    """UnitDefinitions, which both versions of the standard write alike."""
    root = Element("UnitDefinitions")
    real = [q for q in (*model.inputs, *model.outputs, *model.parameters) if q.kind == REAL]
    for unit in sorted({"s", *(q.unit for q in (*real, *model.states))}):  # time is in s
        element = SubElement(root, "Unit", name=unit)
        SubElement(element, "BaseUnit", base_unit(unit))
        for name, attributes in display_units(unit).items():
            SubElement(element, "DisplayUnit", {"name": name} | attributes)
    return root


def type_name(items: Iterable[str]) -> str:
    """The name of the enumeration of these items."""
    return "_".join(items)


def type_definitions(model: Model, tags: Sequence[str]) -> list[Element]:
    """TypeDefinitions of the enumerations, if there are any. `tags`: the nested elements of a type in this version."""
    listed = {q.items for q in (*model.inputs, *model.outputs, *model.parameters) if q.kind == ENUMERATION}
    root = Element("TypeDefinitions")
    for items in sorted(listed):
        element, named = root, {"name": type_name(items)}
        for tag in tags:
            element, named = SubElement(element, tag, named), {}
        for number, item in enumerate(items, 1):
            SubElement(element, "Item", name=item, value=str(number))
    return [root] if listed else []


def log_categories() -> Element:
    """LogCategories, which both versions of the standard write alike."""
    root = Element("LogCategories")
    for name, text in LOG_CATEGORIES.items():
        SubElement(root, "Category", name=name, description=text)
    return root


def about(model: Model, flavour: Flavour) -> dict[str, str]:
    """Attributes of the root (name, what its author says about it, tool) in both versions of the standard."""
    said = {name: getattr(model, name) for name in ("author", "version", "copyright", "license")}
    return {
        "modelName": model.name,
        "description": model.description,
        **{name: text for name, text in said.items() if text},
        "generationTool": f"vpp-fmu {version('vpp-fmu')}, {flavour.tool}",
        "variableNamingConvention": "structured",
    }


def default_experiment(experiment: Experiment) -> Element:
    """DefaultExperiment, which both versions of the standard write alike."""
    more = {} if experiment.tolerance is None else {"tolerance": repr(experiment.tolerance)}
    times = {"startTime": "0.0", "stopTime": repr(experiment.stop), "stepSize": repr(experiment.step)}
    return Element("DefaultExperiment", times | more)


def as_text(root: Element) -> bytes:
    """The XML text."""
    indent(root)
    return tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def model_description(
    model: Model,
    values: Mapping[str, float],
    content_guid: str,
    flavour: Flavour,
    experiment: Experiment,
) -> bytes:
    """FMI 2.0's XML text. `values`: every parameter's start value."""
    fixed = {"fmiVersion": "2.0", "guid": content_guid, "numberOfEventIndicators": "0"}
    root = Element("fmiModelDescription", fixed | about(model, flavour))
    can = {"canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate"}
    capabilities = {**dict.fromkeys(sorted(can), True), "canNotUseMemoryManagementFunctions": True, **flavour.capabilities}
    kind = SubElement(root, "CoSimulation", modelIdentifier=model.name)
    kind.attrib.update((name, str(value).lower()) for name, value in capabilities.items())
    if flavour.sources:
        listed = SubElement(kind, "SourceFiles")
        for name in flavour.sources:
            SubElement(listed, "File", name=name)
    types = type_definitions(model, ("SimpleType", "Enumeration"))
    root.extend((unit_definitions(model), *types, log_categories(), default_experiment(experiment)))
    listed = SubElement(root, "ModelVariables")
    for v in variables(model, values):
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.description}
        attributes |= {"causality": v.causality, "variability": v.variability} | ({"initial": v.initial} if v.initial else {})
        SubElement(SubElement(listed, "ScalarVariable", attributes), v.kind, v.typed())
    root.append(_structure(model))
    return as_text(root)


def _nominal(model: Model, x: State) -> float:
    """The nominal value of a state: as declared, else of a signal in its unit, else the largest of such parameters. It has no
    range: a signal's is that of its own."""
    if x.nominal is not None:
        return x.nominal
    like = next((s.nominal for s in (*model.outputs, *model.inputs) if s.unit == x.unit), None)
    return like or max((p.nominal for p in model.parameters if p.unit == x.unit), default=1.0)


def _structure(model: Model) -> Element:
    """FMI 2.0 counts variables from 1."""
    root = Element("ModelStructure")
    outputs, unknowns = SubElement(root, "Outputs"), SubElement(root, "InitialUnknowns")
    settled_on = " ".join(str(r + 1) for r in dependencies(model))
    for r in range(len(model.inputs), len(model.inputs) + len(model.outputs)):
        SubElement(outputs, "Unknown", index=str(r + 1), dependencies="")
        SubElement(unknowns, "Unknown", index=str(r + 1), dependencies=settled_on)
    return root
