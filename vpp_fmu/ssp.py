"""The closed loop of plant and controller as one file: System Structure and Parameterization (SSP) 1.0.

Importers differ in how much of the standard they know. What is used here is what libcosim, Ecos, OMSimulator and fmpy all
read: one flat system without connectors of its own, and values bound to components, in sets of one name.
"""

from collections.abc import Mapping
from xml.etree import ElementTree

from vpp_fmu.export.archive import archive
from vpp_fmu.kernel.types import Signal
from vpp_fmu.parameters import ParameterSet, to_ssv
from vpp_fmu.units import base_unit

NAME = "VppLoop"
SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"

for prefix, address in (("ssd", SSD), ("ssc", SSC), ("ssv", SSV)):
    ElementTree.register_namespace(prefix, address)


def loop_ssp(parts: Mapping[str, tuple[ParameterSet, bytes]], starts: Mapping[str, float], stop: float) -> bytes:
    """The archive: components by name, each with its parameters and its FMU, connected wherever an output has an input's name.

    `starts`: start values of inputs that nothing is connected to, such as the wanted thrust [N]. `stop`: how long the default
    experiment takes [s]. The bytes depend on the arguments alone.
    """
    files = {"SystemStructure.ssd": _structure({name: parameters for name, (parameters, _) in parts.items()}, stop)}
    for name, (parameters, fmu) in parts.items():
        files[f"resources/{name}.fmu"] = fmu
        files[f"resources/{name}.ssv"] = _values(parameters, starts)
    return archive(files)


def _structure(parts: Mapping[str, ParameterSet], stop: float) -> bytes:
    root = ElementTree.Element(f"{{{SSD}}}SystemStructureDescription", version="1.0", name=NAME)
    system = ElementTree.SubElement(root, f"{{{SSD}}}System", name=NAME)
    ElementTree.SubElement(system, f"{{{SSD}}}Elements").extend(_component(name, part) for name, part in parts.items())
    connections = ElementTree.SubElement(system, f"{{{SSD}}}Connections")
    for signal, of, to in _connections(parts):
        ends = {"startElement": of, "startConnector": signal, "endElement": to, "endConnector": signal}
        ElementTree.SubElement(connections, f"{{{SSD}}}Connection", ends)
    units = ElementTree.SubElement(root, f"{{{SSD}}}Units")
    for unit in sorted({s.unit for p in parts.values() for s in (*p.model.inputs, *p.model.outputs)}):
        element = ElementTree.SubElement(units, f"{{{SSC}}}Unit", name=unit)
        ElementTree.SubElement(element, f"{{{SSC}}}BaseUnit", base_unit(unit))
    ElementTree.SubElement(root, f"{{{SSD}}}DefaultExperiment", startTime="0.0", stopTime=repr(stop))
    return _text(root)


def _connections(parts: Mapping[str, ParameterSet]) -> list[tuple[str, str, str]]:
    """(signal, component it leaves, component it enters)."""
    return [
        (signal.name, of, to)
        for of, source in parts.items()
        for to, sink in parts.items()
        for signal in source.model.outputs
        if of != to and signal.name in {s.name for s in sink.model.inputs}
    ]


def _component(name: str, parameters: ParameterSet) -> ElementTree.Element:
    attributes = {"name": name, "type": "application/x-fmu-sharedlibrary", "source": f"resources/{name}.fmu"}
    component = ElementTree.Element(f"{{{SSD}}}Component", attributes)
    connectors = ElementTree.SubElement(component, f"{{{SSD}}}Connectors")
    for kind, signals in (("input", parameters.model.inputs), ("output", parameters.model.outputs)):
        for signal in signals:
            connector = ElementTree.SubElement(connectors, f"{{{SSD}}}Connector", name=signal.name, kind=kind)
            ElementTree.SubElement(connector, f"{{{SSC}}}Real", unit=signal.unit)
    bindings = ElementTree.SubElement(component, f"{{{SSD}}}ParameterBindings")
    ElementTree.SubElement(bindings, f"{{{SSD}}}ParameterBinding", source=f"resources/{name}.ssv")
    return component


def _values(parameters: ParameterSet, starts: Mapping[str, float]) -> bytes:
    root = ElementTree.fromstring(to_ssv(parameters, NAME))
    listed = root.find(f"{{{SSV}}}Parameters")
    inputs: dict[str, Signal] = {s.name: s for s in parameters.model.inputs}
    for name in sorted(set(starts) & set(inputs)):
        element = ElementTree.SubElement(listed, f"{{{SSV}}}Parameter", name=name)
        ElementTree.SubElement(element, f"{{{SSV}}}Real", value=repr(float(starts[name])), unit=inputs[name].unit)
    return _text(root)


def _text(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
