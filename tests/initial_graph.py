"""The order in which an importer must compute the initial values of an SSP; a cycle is an algebraic loop."""

import io
import zipfile
from collections.abc import Mapping
from xml.etree import ElementTree

from vpp_fmu.ssp import SSD


def initial_graph(loop: Mapping[str, bytes]) -> dict[tuple, set]:
    """Dependencies at t = 0, from the XML files alone: node -> nodes that it needs; a node is (component, variable)."""
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
