"""What an importer must know before what to start an SSP, as OMSimulator works it out; a cycle here is an algebraic loop."""

import io
import zipfile
from collections.abc import Mapping
from xml.etree import ElementTree

from vpp_fmu.ssp import SSD


def initial_graph(loop: Mapping[str, bytes]) -> dict[tuple, set]:
    """What must be known before what at t = 0, from the XMLs alone: node -> nodes it needs; a node is (component, variable)."""
    root = ElementTree.fromstring(loop["SystemStructure.ssd"])
    needs = {}
    for c in root.iter(f"{{{SSD}}}Connection"):
        needs[c.get("endElement"), c.get("endConnector")] = {(c.get("startElement"), c.get("startConnector"))}
    for component in root.iter(f"{{{SSD}}}Component"):
        name = component.get("name")
        with zipfile.ZipFile(io.BytesIO(loop[component.get("source")])) as packed:
            description = ElementTree.fromstring(packed.read("modelDescription.xml"))
        variables = [v.get("name") for v in description.find("ModelVariables")]
        everything = " ".join(str(i + 1) for i in range(len(variables)))  # what a missing list stands for
        for unknown in description.find("ModelStructure/InitialUnknowns"):
            listed = unknown.get("dependencies", everything).split()
            needs[name, variables[int(unknown.get("index")) - 1]] = {(name, variables[int(i) - 1]) for i in listed}
    return needs
