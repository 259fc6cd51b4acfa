"""python -m tests.benchmarks.native: what a step of the native FMUs costs, beside a C slave that does nothing.

Machines differ and are noisy, so the ratios are what to look at; every time is the best of several runs.
"""

import ctypes
import tempfile
import time
import zipfile
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

from vpp_fmu.export import native_fmu
from vpp_fmu.export.archive import archive
from vpp_fmu.export.c_text import c_text
from vpp_fmu.export.toolchain import binaries
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.loop import run
from vpp_fmu.plants import FmuController, FmuPlant
from vpp_fmu.record import Record

STEP = 0.004


def best(work, count, repeats=15):
    """Seconds for one of `count` calls of `work()`, the best of `repeats` runs."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        for _ in range(count):
            work()
        times.append((time.perf_counter() - began) / count)
    return min(times)


def empty_fmu(plant: Path) -> bytes:
    """The plant's FMU with a doStep that returns at once."""
    description = fmpy.read_model_description(str(plant))
    text = c_text(BASE, BASE.values(), description.guid)
    begin = text.index("FMI(fmi2Status, DoStep)")
    body = "FMI(fmi2Status, DoStep)(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no) { return fmi2OK; }\n"
    text = text[:begin] + body + text[text.index("#define READABLE") :]
    with zipfile.ZipFile(plant) as packed:
        kept = {"modelDescription.xml": packed.read("modelDescription.xml")}
    return archive(kept | binaries(BASE.name, text, "host"))


def started(path):
    """An FMU instance under fmpy's own wrapper, ready to step."""
    description = fmpy.read_model_description(str(path))
    identifier = description.coSimulation.modelIdentifier
    slave = FMU2Slave(
        guid=description.guid, unzipDirectory=fmpy.extract(str(path)), modelIdentifier=identifier, instanceName="benchmark"
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave


def do_steps(*paths):
    """For each FMU (seconds of a doStep through fmpy's wrapper, through a call bound once); taken in turn, for fairness."""
    slaves = [started(path) for path in paths]
    found = [[float("inf"), float("inf")] for _ in slaves]
    for _ in range(5):
        for slave, times in zip(slaves, found, strict=True):
            bound = slave.dll["fmi2DoStep"]
            arguments = ctypes.c_void_p(slave.component), ctypes.c_double(0.0), ctypes.c_double(STEP), ctypes.c_int(1)
            times[0] = min(times[0], best(lambda s=slave: s.doStep(0.0, STEP), 5000, 3))
            times[1] = min(times[1], best(lambda b=bound, a=arguments: b(*a), 5000, 3))
    return found


def loop(plant_path, controller_path, short=200, long=600):
    """Seconds of a communication step of `vpp_fmu.loop.run`; what a run costs once falls out of the difference."""
    plant, controller = FmuPlant(plant_path, dt=STEP), FmuController(controller_path, dt=STEP)

    def whole(count):
        profile = Record({"time": np.array([0.0, count * STEP]), "thrust_set": np.array([5.0, 5.0])}, "constant")
        return best(lambda: run(plant, controller, profile), 1, 150)

    return (whole(long) - whole(short)) / (long - short)


def foreign_calls(plant_path, controller_path, count=1000):
    """Seconds of the same communication step's six foreign calls alone, the controller's outputs being the plant's inputs."""
    pair = FmuPlant(plant_path, dt=STEP), FmuController(controller_path, dt=STEP)
    for part, values in zip(pair, ((0.0, 0.0), (5.0, 0.0)), strict=True):
        part.start(*values)
    (plant, p), (controller, c) = ((part._instance, part._instance._slave.dll) for part in pair)
    at, timing = ctypes.c_double(0.0), (ctypes.c_double(STEP), ctypes.c_int(1))
    (to_plant, shown), (to_controller, given) = ((*part._writes, *part._reads) for part in (plant, controller))
    written, read, feedback = to_plant.arguments, (*given.arguments[:2], to_plant.values), to_controller.arguments
    set_c, step_c, get_c = c["fmi2SetReal"], c["fmi2DoStep"], c["fmi2GetReal"]
    set_p, step_p, get_p = p["fmi2SetReal"], p["fmi2DoStep"], p["fmi2GetReal"]
    at_c, at_p = controller._component, plant._component

    def work():
        for _ in range(count):
            to_controller.values[1] = shown.values[0]
            set_c(at_c, *feedback)
            step_c(at_c, at, *timing)
            get_c(at_c, *read)
            set_p(at_p, *written)
            step_p(at_p, at, *timing)
            get_p(at_p, *shown.arguments)
            at.value += STEP

    return best(work, 1, 60) / count


def main():
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder, f"{name}.fmu") for name in ("plant", "controller", "empty")}
        paths["plant"].write_bytes(native_fmu(BASE))
        paths["controller"].write_bytes(native_fmu(CONTROLLER))
        paths["empty"].write_bytes(empty_fmu(paths["plant"]))
        ours, theirs = do_steps(paths["plant"], paths["empty"])
        for way, mine, empty in zip(("fmpy's wrapper", "bound call"), ours, theirs, strict=True):
            say(f"doStep of the native plant FMU, {way}", mine * 1e6, "us", "an empty C slave", empty * 1e6)
        here, floor = loop(paths["plant"], paths["controller"]), foreign_calls(paths["plant"], paths["controller"])
        say("closed loop of native FMUs, one communication step", here * 1e6, "us", "its foreign calls", floor * 1e6)


def say(what, ours, unit, yardstick, theirs):
    print(f"{what:50} {ours:10.3g} {unit:8} {yardstick} {theirs:.3g}, ratio {ours / theirs:.3g}")


if __name__ == "__main__":
    main()
