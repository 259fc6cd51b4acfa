"""python -m tests.interop: both flavours in every installed importer; prints a table of results and of reasons for failures.
`python -m tests.interop exporter`: users' models in the same hosts, beside pythonfmu (`exporter.py`).

A missing importer is skipped; `make interop` installs those that are available. An importer whose dependencies conflict with
this project's has its own environment, in a folder of its package's name beside this one's `bin`.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import zipfile
from functools import partial
from graphlib import CycleError, TopologicalSorter
from importlib.util import find_spec
from itertools import product
from pathlib import Path

import numpy as np

from hil.twin.band import Band
from hil.twin.twin import twin_of
from tests.interop import exporter, hosts
from tests.interop.trials import BEFORE, COMMANDS, IMPORTERS, LOOP_STEPS, NOT_RUN, STEP, STEPS, WANTED
from vpp_fmu.app.api.export import exported
from vpp_fmu.errors import CompilerMissing
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.fmu import Fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.parameters import ParameterSet

sys.path.append(str(Path(__file__).parents[1]))
from initial_graph import initial_graph

BAND = Band(white=0.12, slow=0.04, slow_time=1.0, steady=0.1)
"""Band of the twin; its numbers belong to no rig."""
REST = dict.fromkeys(COMMANDS, 0.0)

PLANT = ParameterSet(plant(("torque_map", "motor"))).replaced(
    {"torque_map.q20": 0.15, "torque_map.q22": 0.25, "motor.friction": 0.01, "motor.loss": 150.0, "motor.idle": 3.0}
)
"""The plant with torque and power, so that importers show all outputs of a plant."""


def alone() -> list[np.ndarray]:
    """Allowed outputs of a plant alone at the end: under the commands, or at rest if the importer cannot set them."""
    plant = Simulation(PLANT.model, PLANT.values)
    rows = [list(plant.start(REST).values())]
    for k in range(BEFORE + STEPS):
        rows.append(list(plant.advance(REST if k < BEFORE else COMMANDS, STEP).values()))
    return [np.array(rows[-1]), np.array(rows[0])]


def loops(wanted: float) -> list[np.ndarray]:
    """Allowed outputs of the loop. Importers differ in whether the set-point acts at the first step, in whether the plant steps
    in parallel with the controller or after it, and in when they read."""
    found = []
    for late, sequential in ((0, False), (1, False), (0, True)):
        plant, controller = Simulation(PLANT.model, PLANT.values), Simulation(CONTROLLER)
        shown = plant.start(REST)
        commands = controller.start({"thrust_set": wanted, "thrust": shown["thrust"]})
        for k in range(LOOP_STEPS + 2):
            asked = {"thrust_set": 0.0 if k < late else wanted, "thrust": shown["thrust"]}
            next_commands = controller.advance(asked, STEP)
            shown, commands = plant.advance(next_commands if sequential else commands, STEP), next_commands
            if k > LOOP_STEPS - 4:
                found.append(np.array(list(shown.values())))
    return found


def interpreter(importer: str) -> str:
    """The Python of the importer's own environment if it has one, else this one."""
    own = Path(sys.prefix, IMPORTERS[importer].package, "bin", "python")
    return str(own) if own.exists() else sys.executable


def start(path: Path) -> str:
    """Whether the loop can be initialised in the order of its dependencies, without an algebraic loop."""
    with zipfile.ZipFile(path) as packed:
        graph = initial_graph({name: packed.read(name) for name in packed.namelist()})
    try:
        return f"no cycle in {len([*TopologicalSorter(graph).static_order()])} variables"
    except CycleError as error:
        return f"CYCLE: {error.args[1]}"


def trial(importer: str, case: str, flavour: str, folder: Path):
    """(result, None) or (None, reason of the failure)."""
    command = [interpreter(importer), str(Path(__file__).with_name("trials.py")), importer, case, flavour, str(folder)]
    libraries = os.pathsep.join([str(Path(sys.prefix, "lib")), os.environ.get("LD_LIBRARY_PATH", "")])
    paths = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"LD_LIBRARY_PATH": libraries, "PYTHONPATH": paths}
    with tempfile.TemporaryDirectory() as work:
        try:
            done = subprocess.run(command, cwd=work, env=environment, check=False, capture_output=True, text=True, timeout=120)
        except subprocess.TimeoutExpired:
            return None, "no end after 120 s"
    if done.returncode < 0:
        return None, f"signal {-done.returncode}"
    if done.returncode:
        return None, done.stderr.strip().splitlines()[-1][:100]
    return json.loads(done.stdout.splitlines()[-1]), None


def judged(shown, allowed: list[np.ndarray]) -> str:
    """Distance from the nearest of the allowed outputs."""
    off = min(float(np.max(np.abs(np.array(shown) - right) / np.maximum(np.abs(right), 1.0))) for right in allowed)
    return "same bits" if off == 0.0 else f"off by {off:.0e}" if off < 1e-5 else f"OTHER: {[round(x, 6) for x in shown]}"


def row(importer: str, flavour: str, folder: Path, expected: dict) -> tuple[list[str], object]:
    cells, shown = [], None
    for case in ("alone", "loop", "twice"):
        if not hasattr(IMPORTERS[importer], "loop" if case == "twice" else case):
            cells.append("-")
            continue
        shown, problem = trial(importer, case, flavour, folder)
        if problem:
            cells.append(f"fails: {problem}")
        elif case == "twice":
            cells.append("same" if shown[0] == shown[1] else f"differs: {shown}")
        else:
            cells.append(judged(shown, expected[case]))
    return cells, shown


def not_python(flavours: list[str]) -> None:
    """Plant, controller and twin in the C host and in every checker that is installed."""
    parts = {"plant": PLANT, "controller": ParameterSet(CONTROLLER)}
    parts["twin"] = twin_of(parts["plant"], BAND)
    print("| host or checker | FMU | exit code: what it printed last |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder, fmus = Path(name), {}
        makers = [("Python", "2.0", python_fmu)] + [
            ("native", version, partial(native_fmu, version=version)) for version in ("2.0", "3.0") if "native" in flavours
        ]
        for (what, part), (flavour, version, make) in product(parts.items(), makers):
            fmus[what, flavour, version] = folder / f"{what}.{flavour}.{version}.fmu"
            fmus[what, flavour, version].write_bytes(make(part.model, part.values))
        in_c(folder, {key: path for key, path in fmus.items() if key[2] == "2.0"})
        print("\n".join(hosts.checked(fmus)), flush=True)


def in_c(folder: Path, fmus: dict) -> None:
    """A line for each FMU in the C host; Python FMUs run without and with the README's three lines."""
    try:
        host = hosts.built(folder)
    except CompilerMissing as missing:
        print(f"| host in C | | not run here: {missing} |")
        return
    shown = {}
    for (what, flavour, version), path in fmus.items():
        with contextlib.closing(Fmu(path)) as fmu:
            ways = {"": ""} | ({" after the three lines": hosts.three_lines()} if flavour == "Python" else {})
            if flavour == "Python" and (reason := hosts.no_libpython()):
                ways = {"": ""}
                print(f"| host in C, after the three lines | {what}, {flavour} | not run here: {reason} |")
            for way, lines in ways.items():
                done = hosts.in_c(host, fmu, lines)
                last = done.stderr.strip().split(": ", 1)[-1]
                if done.returncode == 0:
                    last = "same bits" if shown.setdefault(what, done.stdout) == done.stdout else "OTHER BITS"
                print(f"| host in C{way} | {what}, {flavour}, FMI {version} | {done.returncode}: {last} |", flush=True)


def main():
    parts = [PLANT, ParameterSet(CONTROLLER)]
    right = alone()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flavours = ["python", "native"]
        try:
            files = exported(parts, flavours, flat=True)
        except CompilerMissing as missing:
            print(f"native flavour skipped: {missing}\n")
            flavours = ["python"]
            files = exported(parts, flavours, flat=True)
        for path, content in files.items():
            (folder / path).write_bytes(content if isinstance(content, bytes) else content.encode())
        print("| importer | flavour | plant alone | loop | loop twice in a process | flavours |\n|---|---|---|---|---|---|")
        for importer, kind in IMPORTERS.items():
            if interpreter(importer) == sys.executable and find_spec(kind.package) is None:
                print(f"| {importer} | | skipped: {kind.package} is not installed | | | |")
                continue
            ends, expected = [], {"alone": right, "loop": loops(WANTED)}
            for flavour in flavours:
                cells, shown = row(importer, flavour, folder, expected)
                ends.append(shown)
                same = "" if len(ends) < 2 or None in ends else "same bits" if ends[0] == ends[1] else "DIFFER"
                print(f"| {importer} | {flavour} | {' | '.join(cells)} | {same} |", flush=True)
        print()
        for flavour in flavours:
            suffix = "" if flavour == "python" else ".native"
            print(f"start as OMSimulator orders it, {flavour}: {start(folder / f'VppLoop{suffix}.ssp')}")
    print()
    not_python(flavours)
    print()
    for importer, kind in IMPORTERS.items():
        print(f"{importer}: {kind.__doc__}")
    print()
    for importer, why in NOT_RUN.items():
        print(f"not run: {importer}: {why}")


if sys.argv[1:] == ["exporter"]:
    exporter.main()
else:
    main()
