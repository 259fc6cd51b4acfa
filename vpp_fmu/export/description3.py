"""modelDescription.xml as FMI 3.0 has it."""

from collections.abc import Mapping
from xml.etree.ElementTree import Element, SubElement

from vpp_fmu.export.description import (
    Experiment,
    Flavour,
    about,
    as_text,
    default_experiment,
    dependencies,
    log_categories,
    type_definitions,
    unit_definitions,
    variables,
)
from vpp_fmu.kernel.types import STRING, Model

TYPES = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "Enumeration": "Enumeration", "String": "String"}


def model_description_3(
    model: Model, values: Mapping[str, float], token: str, flavour: Flavour, experiment: Experiment
) -> bytes:
    """The XML text. `values`: every parameter's start value. `token`: what FMI 2.0 calls the guid."""
    fixed = {"fmiVersion": "3.0", "instantiationToken": token}
    root = Element("fmiModelDescription", fixed | about(model, flavour))
    can = (
        "canGetAndSetFMUState",
        "canHandleVariableCommunicationStepSize",
        "canSerializeFMUState",
        "providesDirectionalDerivatives",
    )
    SubElement(root, "CoSimulation", {"modelIdentifier": model.name} | dict.fromkeys(can, "true"))
    types = type_definitions(model, ("EnumerationType",))
    root.extend((unit_definitions(model), *types, log_categories(), default_experiment(experiment)))
    listed = SubElement(root, "ModelVariables")
    scalars = variables(model, values)
    for v in scalars:
        if v.place > 1:
            continue
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.description}
        attributes |= {"causality": v.causality, "variability": v.variability} | ({"initial": v.initial} if v.initial else {})
        typed = v.typed()
        element = SubElement(listed, TYPES[v.kind], attributes | typed)
        starts = [one.typed()["start"] for one in scalars[v.reference : v.reference + max(1, v.size)] if "start" in typed]
        if v.size:  # the reference of an array is that of its first element
            element.set("name", v.name.removesuffix("[1]"))
            SubElement(element, "Dimension", start=str(v.size))
        if starts and v.kind == STRING:
            del element.attrib["start"]
            for text in starts:
                SubElement(element, "Start", value=text)
        elif starts:
            element.set("start", " ".join(starts))
    time = {"name": "time", "valueReference": str(len(scalars)), "description": "simulation time", "causality": "independent"}
    SubElement(listed, "Float64", time | {"variability": "continuous", "unit": "s"})
    root.append(_structure(model))
    return as_text(root)


def _structure(model: Model) -> Element:
    root = Element("ModelStructure")
    outputs = [str(len(model.inputs) + k) for k, y in enumerate(model.outputs) if y.place < 2]
    scalars = (*model.inputs, *model.outputs, *model.parameters)
    settled_on = " ".join(str(r) for r in dependencies(model) if scalars[r].place < 2)
    for r in outputs:
        SubElement(root, "Output", valueReference=r, dependencies="")
    for r in outputs:
        SubElement(root, "InitialUnknown", valueReference=r, dependencies=settled_on)
    return root
