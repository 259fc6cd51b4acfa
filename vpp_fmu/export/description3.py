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
    unit_definitions,
    variables,
)
from vpp_fmu.kernel.types import Model

TYPES = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}


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
    root.extend((unit_definitions(model), log_categories(), default_experiment(experiment)))
    listed = SubElement(root, "ModelVariables")
    for v in variables(model, values):
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.description}
        attributes |= {"causality": v.causality, "variability": v.variability} | ({"initial": v.initial} if v.initial else {})
        SubElement(listed, TYPES[v.kind], attributes | v.typed())
    time = {"name": "time", "valueReference": str(len(listed)), "description": "simulation time", "causality": "independent"}
    SubElement(listed, "Float64", time | {"variability": "continuous", "unit": "s"})
    root.append(_structure(model))
    return as_text(root)


def _structure(model: Model) -> Element:
    root = Element("ModelStructure")
    outputs = [str(r) for r in range(len(model.inputs), len(model.inputs) + len(model.outputs))]
    settled_on = " ".join(map(str, dependencies(model)))
    for r in outputs:
        SubElement(root, "Output", valueReference=r, dependencies="")
    for r in outputs:
        SubElement(root, "InitialUnknown", valueReference=r, dependencies=settled_on)
    return root
