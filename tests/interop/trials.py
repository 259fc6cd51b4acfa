"""One importer, one case, one FMU flavour, run in a separate process because an importer may crash.

python tests/interop/trials.py IMPORTER CASE FLAVOUR FOLDER prints the plant's outputs at the end as JSON, for `twice` those of
both runs.
"""

import csv
import json
import os
import stat
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

STEP, BEFORE, STEPS = 0.004, 1, 250  # s; communication steps at rest, then under the commands
COMMANDS = {"omega_ref": 5000.0, "beta_ref": 3.0}
OUTPUTS = ("thrust", "omega", "beta", "torque", "power", "efficiency")
REFERENCES = [2 + k for k in range(len(OUTPUTS))]
"""Value references of the outputs, after those of the two inputs."""

LOOP_STEPS, WANTED = 500, 7.6  # N: halfway, as `vpp export` sets it in a loop


class Fmpy:
    """In the loop it runs its own SSP simulation, which knows no parameter sets; thrust is wanted by the system's input."""

    package = "fmpy"

    def alone(self, folder, suffix):
        import fmpy
        import numpy as np

        change = BEFORE * STEP
        table = [(0.0, 0.0, 0.0), (change, 0.0, 0.0), (change, *COMMANDS.values())]
        held = np.array(table, dtype=[(name, float) for name in ("time", *COMMANDS)])
        stop = (BEFORE + STEPS) * STEP
        path = str(folder / f"VppPlant{suffix}.fmu")
        return [float(fmpy.simulate_fmu(path, input=held, stop_time=stop, output_interval=STEP)[n][-1]) for n in OUTPUTS]

    def loop(self, folder, suffix):
        from fmpy.ssp.simulation import simulate_ssp

        path, stop = str(folder / f"VppLoop{suffix}.ssp"), LOOP_STEPS * STEP
        result = simulate_ssp(path, stop_time=stop, step_size=STEP, input={"thrust_set": lambda t: WANTED})
        return [float(result[name][-1]) for name in OUTPUTS]


class Libcosim:
    """It counts time in nanoseconds: steps are off by a rounding."""

    package = "libcosimpy"

    def alone(self, folder, suffix):
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimSlave import CosimLocalSlave

        execution = CosimExecution.from_step_size(int(STEP * 1e9))
        index = execution.add_local_slave(CosimLocalSlave(str(folder / f"VppPlant{suffix}.fmu"), "plant"))
        observer, manipulator = self._watch(execution)
        execution.step(BEFORE)
        manipulator.slave_real_values(index, [0, 1], list(COMMANDS.values()))
        execution.step(STEPS)
        return observer.last_real_values(index, REFERENCES)

    def loop(self, folder, suffix):
        from libcosimpy.CosimExecution import CosimExecution

        execution = CosimExecution.from_ssp_file(str(folder / f"VppLoop{suffix}.flat.ssp"), int(STEP * 1e9))
        observer, _ = self._watch(execution)
        execution.step(LOOP_STEPS)
        return observer.last_real_values(execution.slave_index_from_instance_name("VppPlant"), REFERENCES)

    def _watch(self, execution):
        from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
        from libcosimpy.CosimManipulator import CosimManipulator
        from libcosimpy.CosimObserver import CosimObserver

        log_output_level(CosimLogLevel.ERROR)
        observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
        execution.add_observer(observer)
        execution.add_manipulator(manipulator)
        return observer, manipulator


class Ecos:
    """Under Python."""

    package = "ecospy"

    def alone(self, folder, suffix):
        from ecospy import EcosSimulation, EcosSimulationStructure

        structure = EcosSimulationStructure()
        structure.add_model("plant", str(folder / f"VppPlant{suffix}.fmu"))
        with EcosSimulation(structure=structure, step_size=STEP) as simulation:
            simulation.init()
            simulation.step(BEFORE)
            for name, value in COMMANDS.items():
                simulation.set_real(f"plant::{name}", value)
            simulation.step(STEPS)
            found = [simulation.get_real(f"plant::{name}") for name in OUTPUTS]
            simulation.terminate()
        return found

    def loop(self, folder, suffix):
        from ecospy import EcosSimulation

        with EcosSimulation(ssp_path=str(folder / f"VppLoop{suffix}.flat.ssp"), step_size=STEP) as simulation:
            simulation.init(parameter_set="VppLoop")
            simulation.step(LOOP_STEPS)
            found = [simulation.get_real(f"VppPlant::{name}") for name in OUTPUTS]
            simulation.terminate()
        return found


class EcosCommand:
    """A host without Python: Python FMUs can't be loaded. Alone the plant stands still; results have six decimals."""

    package = "ecospy"

    def alone(self, folder, suffix):
        return self._run(folder / f"VppPlant{suffix}.fmu", "instance")

    def loop(self, folder, suffix):
        return self._run(folder / f"VppLoop{suffix}.flat.ssp", "VppPlant", "--parameterSet", "VppLoop")

    def _run(self, path, instance, *more):
        shipped = Path(find_spec("ecospy").origin).parent / "binaries" / ("ecos.exe" if os.name == "nt" else "ecos")
        program = Path.cwd() / shipped.name  # the installed file may not be executable
        program.write_bytes(shipped.read_bytes())
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
        options = ["--path", path, "--stepSize", STEP, "--stopTime", (LOOP_STEPS + 0.5) * STEP, "-l", "err", *more]
        done = subprocess.run([str(x) for x in (program, "simulate", *options)], check=False, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"exit code {done.returncode}")
        with open(f"{path.stem}.csv", newline="") as file:
            rows = [[cell.strip() for cell in row] for row in csv.reader(file)]
        at = {name: rows[0].index(f"{instance}::{name}[REAL]") for name in OUTPUTS}
        return [float(rows[-1][at[name]]) for name in OUTPUTS]


class Container:
    """The loop packed as one FMU, which fmpy runs; from rules, since its reading of SSP knows no values."""

    package = "fmu_manipulation_toolbox"

    def loop(self, folder, suffix):
        import fmpy

        plant, controller = f"VppPlant{suffix}.fmu", f"VppController{suffix}.fmu"
        rules = ["rule;from_fmu;from_port;to_fmu;to_port", f"FMU;{plant};;;", f"FMU;{controller};;;"]
        rules += [f"LINK;{controller};{name};{plant};{name}" for name in COMMANDS]
        rules += [f"LINK;{plant};thrust;{controller};thrust", f"INPUT;;thrust_set;{controller};thrust_set"]
        rules += [f"OUTPUT;{plant};{name};;{name}" for name in OUTPUTS]
        Path("container.csv").write_text("\n".join(rules) + "\n")
        for fmu in (plant, controller):
            Path(fmu).write_bytes((folder / fmu).read_bytes())
        command = [Path(sys.executable).parent / "fmucontainer", "-container", f"container.csv:{STEP}", "-fmu-directory", "."]
        subprocess.run([str(x) for x in command], check=True, capture_output=True, text=True)
        values = {"thrust_set": WANTED}
        stop = LOOP_STEPS * STEP
        result = fmpy.simulate_fmu("container.fmu", start_values=values, stop_time=stop, output_interval=STEP, validate=False)
        return [float(result[name][-1]) for name in OUTPUTS]


class Pathsim:
    """Blocks that are stepped by scheduled events: each sees what the other showed before."""

    package = "pathsim_fmi"

    def alone(self, folder, suffix):
        from pathsim.blocks import Source

        rest, change = dict.fromkeys(COMMANDS, 0.0), (BEFORE - 0.5) * STEP
        sources = [Source(lambda t, name=name: rest[name] if t < change else COMMANDS[name]) for name in COMMANDS]
        plant = self._fmu(folder / f"VppPlant{suffix}.fmu")
        return self._run([(source, 0, plant, i) for i, source in enumerate(sources)], plant, BEFORE + STEPS)

    def loop(self, folder, suffix):
        from pathsim.blocks import Constant

        plant, controller = (self._fmu(folder / f"{name}{suffix}.fmu") for name in ("VppPlant", "VppController"))
        wires = [(Constant(WANTED), 0, controller, 0), (plant, 0, controller, 1), *((controller, i, plant, i) for i in (0, 1))]
        return self._run(wires, plant, LOOP_STEPS)

    def _fmu(self, path):
        from pathsim_fmi import CoSimulationFMU

        return CoSimulationFMU(str(path), instance_name=path.stem, dt=STEP)

    def _run(self, wires, plant, steps):
        from pathsim import Connection, Simulation

        blocks = list({id(block): block for source, _, sink, _ in wires for block in (source, sink)}.values())
        connections = [Connection(source[i], sink[j]) for source, i, sink, j in wires]
        simulation = Simulation(blocks, connections, dt=STEP, log=False)
        simulation.run((steps - 1.5) * STEP)  # it takes one more, to pass the end
        return [float(x) for x in plant.outputs.to_array()]


class CoFmuPy:
    """Its master alone, Jacobi's way."""

    package = "cofmupy"

    def alone(self, folder, suffix):
        master = self._master({"plant": folder / f"VppPlant{suffix}.fmu"}, {})
        for k in range(BEFORE + STEPS):
            values = dict.fromkeys(COMMANDS, 0.0) if k < BEFORE else COMMANDS
            self._step(master, k, {"plant": {name: [value] for name, value in values.items()}})
        return self._shown(master)

    def loop(self, folder, suffix):
        paths = {"plant": folder / f"VppPlant{suffix}.fmu", "controller": folder / f"VppController{suffix}.fmu"}
        wires = {("controller", name): [("plant", name)] for name in COMMANDS} | {
            ("plant", "thrust"): [("controller", "thrust")]
        }
        master = self._master(paths, wires)
        for k in range(LOOP_STEPS):
            self._step(master, k, {"controller": {"thrust_set": [WANTED]}})
        return self._shown(master)

    def _master(self, paths, wires):
        from cofmupy.master.default_master import DefaultMaster

        listed = [{"id": name, "path": str(path), "initialization": {}} for name, path in paths.items()]
        return DefaultMaster(listed, wires, [list(paths)], cosim_method="jacobi")

    def _step(self, master, k, values):
        if k == 0:
            master.init_simulation(values)
        master.do_step(STEP, values)

    def _shown(self, master):
        return [float(master.get_results()["plant", name][-1]) for name in OUTPUTS]


IMPORTERS = {
    "fmpy": Fmpy,
    "libcosim": Libcosim,
    "Ecos": Ecos,
    "ecos command": EcosCommand,
    "fmucontainer": Container,
    "pathsim-fmi": Pathsim,
    "CoFmuPy": CoFmuPy,
}

NOT_RUN = {
    "OMSimulator": "its package fetches the program from elsewhere; how it orders the start is tried above",
    "OMEdit, Dymola, Simulink, Simcenter Amesim": "not in the package registries",
    "PyFMI": "its package is source that needs FMI Library and Assimulo built before",
}


def main(importer, case, suffix, folder):
    trial = IMPORTERS[importer]()
    if case == "twice":
        return [trial.loop(Path(folder), suffix), trial.loop(Path(folder), suffix)]
    return getattr(trial, case)(Path(folder), suffix)


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], sys.argv[2], {"python": "", "native": ".native"}[sys.argv[3]], sys.argv[4])))
