"""python -m tests.benchmarks.native: time of a step of the native FMUs, beside an empty C slave.

Machines differ and are noisy, so compare the ratios; every time is the best of several runs.
"""

import ctypes
import tempfile
import time
import zipfile
from functools import partial
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

from vpp_fmu.export import native_fmu
from vpp_fmu.export.archive import archive
from vpp_fmu.export.c_text import c_text
from vpp_fmu.export.toolchain import binaries
from vpp_fmu.fmu import FmuInstance
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.types import Model
from vpp_fmu.loop import run
from vpp_fmu.native.closed_loop import ClosedLoop, Course
from vpp_fmu.native.master import run_together
from vpp_fmu.plants import FmuController, FmuPlant
from vpp_fmu.record import Record

STEP = 0.004
SIZE = ctypes.c_double(STEP), ctypes.c_int(1)


def best(work, count, repeats=7):
    """Seconds for one of `count` calls of `work()`, the best of `repeats` runs."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        for _ in range(count):
            work()
        times.append((time.perf_counter() - began) / count)
    return min(times)


def empty_fmu(fmu: Path, model: Model) -> bytes:
    """The model's FMU with a doStep that returns at once."""
    description = fmpy.read_model_description(str(fmu))
    text = c_text(model, model.values(), description.guid)
    begin, end = text.index("FMI(fmi2Status, DoStep)"), text.index("SETTER(set_booleans")
    body = "FMI(fmi2Status, DoStep)(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no) { return fmi2OK; }\n"
    with zipfile.ZipFile(fmu) as packed:
        kept = {"modelDescription.xml": packed.read("modelDescription.xml")}
    return archive(kept | binaries(model.name, text[:begin] + body + text[end:], "host"))


def started(path):
    """(an FMU instance under fmpy's own wrapper, ready to step; its value references by name)."""
    description = fmpy.read_model_description(str(path))
    identifier = description.coSimulation.modelIdentifier
    slave = FMU2Slave(
        guid=description.guid, unzipDirectory=fmpy.extract(str(path)), modelIdentifier=identifier, instanceName="benchmark"
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave, {v.name: v.valueReference for v in description.modelVariables}


def best_step(slave, step, count=5000, repeats=15):
    """Seconds of `step(time)`, each at the next communication point, since an FMU refuses any other; the best run."""
    kept, times = slave.getFMUstate(), []
    points = [ctypes.c_double(k * STEP) for k in range(count)]
    for _ in range(repeats):
        began = time.perf_counter()
        for point in points:
            step(point)
        times.append((time.perf_counter() - began) / count)
        slave.setFMUstate(kept)
    return min(times)


def one_step(bound, component, at):
    bound(component, at, *SIZE)


def do_steps(*paths):
    """For each FMU seconds of a doStep through a call bound once; measured in turn, for fairness."""
    slaves = [started(path)[0] for path in paths]
    found = [float("inf")] * len(slaves)
    for _ in range(5):
        for k, slave in enumerate(slaves):
            bound, component = slave.dll["fmi2DoStep"], ctypes.c_void_p(slave.component)
            found[k] = min(found[k], best_step(slave, partial(one_step, bound, component), 5000, 3))
    return found


def loop(plant_path, controller_path, short, long):
    """Seconds of a communication step of `vpp_fmu.loop.run`, from two run lengths, without the constant cost of a run."""
    plant, controller = FmuPlant(plant_path, dt=STEP), FmuController(controller_path, dt=STEP)

    def whole(count):
        profile = Record({"time": np.array([0.0, count * STEP]), "thrust_set": np.array([5.0, 5.0])}, "constant")
        return best(lambda: run(plant, controller, profile), 1, 150)

    return (whole(long) - whole(short)) / (long - short)


def masters(*pairs, count=5000):
    """Seconds of a communication step of the compiled master for each pair of plant and controller, and last those of the same
    models in one C function without FMI; all are measured in turn, for fairness."""
    pairs = [(FmuPlant(plant, dt=STEP), FmuController(controller, dt=STEP)) for plant, controller in pairs]
    wanted, bare = np.full(count, 5.0), ClosedLoop(BASE)
    sets, course = bare.vectors({}, {}, {}), Course(wanted, np.zeros(count), STEP, 15.0)
    found = [float("inf")] * (len(pairs) + 1)
    for _ in range(300):
        for i, pair in enumerate([*pairs, None]):
            if pair:
                plant, controller = pair
                controller.start(5.0, plant.start(0.0, 0.0).thrust)
                entries = controller.instance.entry(), plant.instance.entry()
            began = time.perf_counter()
            if pair:
                run_together(*entries, wanted, STEP, lambda share: None)
            else:
                bare.rows(sets, course)
            found[i] = min(found[i], (time.perf_counter() - began) / count)
    return found


def whole(plant_path, controller_path, count=10_000, repeats=60):
    """Seconds per step of `vpp_fmu.loop.run`, including the constant cost of a run."""
    plant, controller = FmuPlant(plant_path, dt=STEP), FmuController(controller_path, dt=STEP)
    profile = Record({"time": np.array([0.0, count * STEP]), "thrust_set": np.array([5.0, 5.0])}, "constant")
    return best(lambda: run(plant, controller, profile), 1, repeats) / count


def foreign_calls(plant_path, controller_path, count=1000):
    """Seconds of the six foreign calls of such a step alone; the controller's outputs are the plant's inputs."""
    pair = FmuPlant(plant_path, dt=STEP), FmuController(controller_path, dt=STEP)
    for part, values in zip(pair, ((0.0, 0.0), (5.0, 0.0)), strict=True):
        part.start(*values)
    (plant, p), (controller, c) = ((part.instance, part.instance._slave.dll) for part in pair)
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
        paths = {name: Path(folder, f"{name}.fmu") for name in ("plant", "controller", "empty plant", "empty controller")}
        for name, model in (("plant", BASE), ("controller", CONTROLLER)):
            paths[name].write_bytes(native_fmu(model))
            paths[f"empty {name}"].write_bytes(empty_fmu(paths[name], model))
        ours, theirs = do_steps(paths["plant"], paths["empty plant"])
        say("doStep of the native plant FMU, bound call", ours * 1e6, "us", "an empty C slave", theirs * 1e6)
        pair, empty = (paths["plant"], paths["controller"]), (paths["empty plant"], paths["empty controller"])
        ours, floor, bare = masters(pair, empty)
        say("compiled master of native FMUs, one communication step", ours * 1e6, "us", "two empty C slaves", floor * 1e6)
        say("the same", ours * 1e6, "us", "the models in one C function, without FMI", bare * 1e6)
        FmuInstance.entry = lambda self: None  # as on a machine without a compiler
        here, floor = loop(*pair, 200, 600), foreign_calls(*pair)
        say("the same, call by call from Python", here * 1e6, "us", "its foreign calls", floor * 1e6)


def say(what, ours, unit, yardstick, theirs):
    print(f"{what:50} {ours:10.3g} {unit:8} {yardstick} {theirs:.3g}, ratio {ours / theirs:.3g}")


if __name__ == "__main__":
    main()
