"""The closed loop of plant and controller as one file: System Structure and Parameterization (SSP) 1.0.

The system is flat, and the parameter sets of all components have one name: libcosim, Ecos, OMSimulator and fmpy read this
form. Inputs that no component drives are inputs of the system; the outputs of the first component are its outputs. libcosim and
Ecos refuse connections to the system itself; a variant without the system's connectors is for them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

from vpp_fmu.export.archive import archive
from vpp_fmu.kernel.types import BOOLEAN, INTEGER, REAL, Signal
from vpp_fmu.parameters import ParameterSet, to_ssv
from vpp_fmu.units import base_unit

NAME = "VppLoop"
SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"

WIDTH, HEIGHT, GAP = 40.0, 40.0, 40.0
"""Size of a component and the margin around it, in the diagram's units."""

for prefix, address in (("ssd", SSD), ("ssc", SSC), ("ssv", SSV)):
    ElementTree.register_namespace(prefix, address)


@dataclass(frozen=True)
class _End:
    """One end of a connection: a signal of a component, or of the system itself (`element` is None)."""

    element: str | None
    signal: Signal


@dataclass(frozen=True)
class _Box:
    """A component in the diagram: its lower left corner, and the signals on its left and right side."""

    x: float
    y: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def at(self, name: str, output: bool) -> tuple[float, float]:
        names = self.outputs if output else self.inputs
        return self.x + WIDTH * output, self.y + HEIGHT * _height(names, name)


def loop_ssp(
    parts: Mapping[str, tuple[ParameterSet, bytes]], starts: Mapping[str, float], stop: float, connectors: bool = True
) -> bytes:
    """The archive: components by name, each with its parameters and its FMU, connected wherever an output has an input's name.

    Inputs that no component drives are inputs of the system, the first component's outputs are its outputs; `connectors`:
    whether the system has these. `starts`: start values of the inputs that no component drives, such as the wanted thrust
    [N]. `stop`: how long the default experiment takes [s]. The bytes depend on the arguments alone.
    """
    sets = {name: parameters for name, (parameters, _) in parts.items()}
    files = {"SystemStructure.ssd": _structure(sets, stop, connectors)}
    if connectors:
        files[f"resources/{NAME}.ssv"] = _system_values(sets, starts)
    for name, (parameters, fmu) in parts.items():
        files[f"resources/{name}.fmu"] = fmu
        files[f"resources/{name}.ssv"] = _values(parameters, starts)
    return archive(files)


def _structure(parts: Mapping[str, ParameterSet], stop: float, connectors: bool) -> bytes:
    connections = _connections(parts)
    inputs = [start.signal for start, _ in connections if start.element is None]
    outputs = [end.signal for _, end in connections if end.element is None]
    root = ElementTree.Element(f"{{{SSD}}}SystemStructureDescription", version="1.0", name=NAME)
    system = ElementTree.SubElement(root, f"{{{SSD}}}System", name=NAME)
    if connectors:
        system.append(_connectors(inputs, outputs))
        system.append(_binding(NAME))
    else:
        connections = [ends for ends in connections if all(end.element is not None for end in ends)]
    boxes = _placed(parts, {s.name for s in inputs})
    listed = ElementTree.SubElement(system, f"{{{SSD}}}Elements")
    listed.extend(_component(name, part, boxes[name]) for name, part in parts.items())
    links = ElementTree.SubElement(system, f"{{{SSD}}}Connections")
    links.extend(_connection(start, end, boxes) for start, end in connections)
    right = GAP + len(parts) * (WIDTH + GAP)
    ElementTree.SubElement(system, f"{{{SSD}}}SystemGeometry", _numbers(x1=0.0, y1=0.0, x2=right, y2=HEIGHT + 2.0 * GAP))
    units = ElementTree.SubElement(root, f"{{{SSD}}}Units")
    for unit in sorted({s.unit for p in parts.values() for s in (*p.model.inputs, *p.model.outputs) if s.kind == REAL}):
        element = ElementTree.SubElement(units, f"{{{SSC}}}Unit", name=unit)
        ElementTree.SubElement(element, f"{{{SSC}}}BaseUnit", base_unit(unit))
    ElementTree.SubElement(root, f"{{{SSD}}}DefaultExperiment", startTime="0.0", stopTime=repr(stop))
    return _text(root)


def _connections(parts: Mapping[str, ParameterSet]) -> list[tuple[_End, _End]]:
    """Connections: between components, then from the system's inputs, then to its outputs."""
    driven = {
        (to, signal.name): _End(of, signal)
        for of, source in parts.items()
        for to, sink in parts.items()
        for signal in source.model.outputs
        if of != to and signal.name in {s.name for s in sink.model.inputs}
    }
    inner = [(start, _End(to, start.signal)) for (to, _), start in driven.items()]
    outside = [(name, s) for name, part in parts.items() for s in part.model.inputs if (name, s.name) not in driven]
    first = next(iter(parts))
    shown = [(_End(first, s), _End(None, s)) for s in parts[first].model.outputs]
    return inner + [(_End(None, s), _End(name, s)) for name, s in outside] + shown


def _placed(parts: Mapping[str, ParameterSet], from_outside: set[str]) -> dict[str, _Box]:
    """Components from left to right, first those with inputs of the system."""
    order = sorted(parts, key=lambda name: not from_outside & {s.name for s in parts[name].model.inputs})
    return {
        name: _Box(
            GAP + i * (WIDTH + GAP),
            GAP,
            *(tuple(s.name for s in signals) for signals in (parts[name].model.inputs, parts[name].model.outputs)),
        )
        for i, name in enumerate(order)
    }


def _height(names: Iterable[str], name: str) -> float:
    """Position of a connector as a share of a side's height; the first is on top."""
    names = tuple(names)
    return 1.0 - (names.index(name) + 1.0) / (len(names) + 1.0)


def _connection(start: _End, end: _End, boxes: Mapping[str, _Box]) -> ElementTree.Element:
    ends = {"startElement": start.element, "startConnector": start.signal.name}
    ends |= {"endElement": end.element, "endConnector": end.signal.name}
    element = ElementTree.Element(f"{{{SSD}}}Connection", {k: v for k, v in ends.items() if v is not None})
    if start.element is not None and end.element is not None:
        (x1, y1), (x2, y2) = boxes[start.element].at(start.signal.name, True), boxes[end.element].at(end.signal.name, False)
        # A forward line turns half-way; a backward line passes below the components.
        points = [(x1 + 0.25 * GAP, y1), (x1 + 0.25 * GAP, 0.5 * GAP), (x2 - 0.25 * GAP, 0.5 * GAP), (x2 - 0.25 * GAP, y2)]
        if x2 > x1:
            points = [(0.5 * (x1 + x2), y1), (0.5 * (x1 + x2), y2)]
        listed = {f"points{axis}": " ".join(repr(p[i]) for p in points) for i, axis in enumerate("XY")}
        ElementTree.SubElement(element, f"{{{SSD}}}ConnectionGeometry", listed)
    return element


def _component(name: str, parameters: ParameterSet, box: _Box) -> ElementTree.Element:
    attributes = {"name": name, "type": "application/x-fmu-sharedlibrary", "source": f"resources/{name}.fmu"}
    component = ElementTree.Element(f"{{{SSD}}}Component", attributes)
    component.append(_connectors(parameters.model.inputs, parameters.model.outputs))
    corners = _numbers(x1=box.x, y1=box.y, x2=box.x + WIDTH, y2=box.y + HEIGHT)
    ElementTree.SubElement(component, f"{{{SSD}}}ElementGeometry", corners)
    component.append(_binding(name))
    return component


def _connectors(inputs: Iterable[Signal], outputs: Iterable[Signal]) -> ElementTree.Element:
    root = ElementTree.Element(f"{{{SSD}}}Connectors")
    for kind, side, signals in (("input", 0.0, tuple(inputs)), ("output", 1.0, tuple(outputs))):
        for signal in signals:
            connector = ElementTree.SubElement(root, f"{{{SSD}}}Connector", name=signal.name, kind=kind)
            connector.append(_type(signal))
            place = _numbers(x=side, y=_height((s.name for s in signals), signal.name))
            ElementTree.SubElement(connector, f"{{{SSD}}}ConnectorGeometry", place)
    return root


def _type(signal: Signal) -> ElementTree.Element:
    return ElementTree.Element(f"{{{SSC}}}{signal.kind}", {"unit": signal.unit} if signal.kind == REAL else {})


def _binding(name: str) -> ElementTree.Element:
    bindings = ElementTree.Element(f"{{{SSD}}}ParameterBindings")
    ElementTree.SubElement(bindings, f"{{{SSD}}}ParameterBinding", source=f"resources/{name}.ssv")
    return bindings


def _numbers(**numbers: float) -> dict[str, str]:
    return {name: repr(float(number)) for name, number in numbers.items()}


def _values(parameters: ParameterSet, starts: Mapping[str, float]) -> bytes:
    root = ElementTree.fromstring(to_ssv(parameters, NAME))
    _add_starts(root.find(f"{{{SSV}}}Parameters"), parameters.model.inputs, starts)
    return _text(root)


def _system_values(parts: Mapping[str, ParameterSet], starts: Mapping[str, float]) -> bytes:
    """Start values of the system's own inputs, for importers that pass them to the components."""
    root = ElementTree.Element(f"{{{SSV}}}ParameterSet", version="1.0", name=NAME)
    inputs = [start.signal for start, _ in _connections(parts) if start.element is None]
    _add_starts(ElementTree.SubElement(root, f"{{{SSV}}}Parameters"), inputs, starts)
    units = ElementTree.SubElement(root, f"{{{SSV}}}Units")
    for unit in sorted({s.unit for s in inputs if s.kind == REAL}):
        element = ElementTree.SubElement(units, f"{{{SSC}}}Unit", name=unit)
        ElementTree.SubElement(element, f"{{{SSC}}}BaseUnit", base_unit(unit))
    return _text(root)


def _add_starts(listed: ElementTree.Element, inputs: Iterable[Signal], starts: Mapping[str, float]) -> None:
    for signal in inputs:
        if signal.name in starts:
            element = ElementTree.SubElement(listed, f"{{{SSV}}}Parameter", name=signal.name)
            element.append(_start(signal, starts[signal.name]))


def _start(signal: Signal, value: float) -> ElementTree.Element:
    text = {REAL: repr(float(value)), BOOLEAN: str(value != 0.0).lower(), INTEGER: str(round(value))}[signal.kind]
    return ElementTree.Element(
        f"{{{SSV}}}{signal.kind}", {"value": text} | ({"unit": signal.unit} if signal.kind == REAL else {})
    )


def _text(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
