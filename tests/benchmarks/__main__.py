"""python -m tests.benchmarks: time of an FMU step and of a fit, each beside a reference timed in the same run.

Machines differ and are noisy, so compare the ratios; every time is the best of several runs.
"""

import ctypes
import itertools
import tempfile
import time
from functools import partial
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from pythonfmu import FmuBuilder

from identification.demo import example_folder
from identification.fit.refine import refine
from tests.benchmarks.native import best_step, one_step
from vpp_fmu.campaign import read_campaign
from vpp_fmu.export import python_fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.loop import run
from vpp_fmu.native import Simulator
from vpp_fmu.plants import FmuController, FmuPlant
from vpp_fmu.record import Record

STEP = 0.004


def best(work, count, repeats=7):
    """Seconds for one of `count` calls of `work()`, the best of `repeats` runs."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        for _ in range(count):
            work()
        times.append((time.perf_counter() - began) / count)
    return min(times)


def started(path):
    """An FMU instance under fmpy's own wrapper, ready to step."""
    description = fmpy.read_model_description(str(path))
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=fmpy.extract(str(path)),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="benchmark",
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave, {v.name: v.valueReference for v in description.modelVariables}


def do_step(path):
    """(seconds of a doStep through fmpy's wrapper, through a call bound once)."""
    slave, _ = started(path)
    call = partial(one_step, slave.dll["fmi2DoStep"], ctypes.c_void_p(slave.component))
    return best_step(slave, lambda at: slave.doStep(at.value, STEP)), best_step(slave, call)


def loop_in_fmpy(plant_path, controller_path, count=10000):
    """Seconds of a communication step of the closed loop written with fmpy's wrapper."""
    plant, p = started(plant_path)
    controller, c = started(controller_path)
    p_in, p_out = [p["omega_ref"], p["beta_ref"]], [p["thrust"], p["omega"], p["beta"]]
    c_in, c_out = [c["thrust_set"], c["thrust"]], [c["omega_ref"], c["beta_ref"]]

    points = itertools.count()

    def work():
        thrust = 0.0
        for k in itertools.islice(points, count):
            controller.setReal(c_in, [5.0, thrust])
            controller.doStep(k * STEP, STEP)
            plant.setReal(p_in, controller.getReal(c_out))
            plant.doStep(k * STEP, STEP)
            thrust = plant.getReal(p_out)[0]

    return best(work, 1) / count


def loop_here(plant_path, controller_path, count=10000):
    """Seconds of a communication step of `vpp_fmu.loop.run`."""
    profile = Record({"time": np.array([0.0, count * STEP]), "thrust_set": np.array([5.0, 5.0])}, "constant")
    plant, controller = FmuPlant(plant_path, dt=STEP), FmuController(controller_path, dt=STEP)
    return best(lambda: run(plant, controller, profile), 1) / count


def main():
    with tempfile.TemporaryDirectory() as folder:
        plant, controller = Path(folder, "VppPlant.fmu"), Path(folder, "VppController.fmu")
        plant.write_bytes(python_fmu(BASE))
        controller.write_bytes(python_fmu(CONTROLLER))
        flat = FmuBuilder.build_FMU(Path(__file__).parent / "flat_slave.py", dest=folder)
        for way, ours, theirs in zip(("fmpy's wrapper", "bound call"), do_step(plant), do_step(flat), strict=True):
            say(f"doStep of the Python plant FMU, {way}", ours * 1e6, "us", "a hand-written slave", theirs * 1e6)
        theirs, here = loop_in_fmpy(plant, controller), loop_here(plant, controller)
        say("closed loop of Python FMUs, one communication step", here * 1e6, "us", "fmpy's wrapper", theirs * 1e6)

    simulation, held = Simulation(BASE), {"omega_ref": 5000.0, "beta_ref": 5.0}
    python = 1.0 / best(lambda: simulation.advance(held, STEP), 2000)
    record = read_campaign(example_folder()).open_loop
    simulator = Simulator(BASE)
    native = len(record) / best(lambda: simulator.simulate({}, *record.run), 20)
    say("kernel, compiled", native, "steps/s", "its functions as they stand", python)
    fit = best(lambda: refine(BASE, [record], AVERAGED, channels=("thrust",)), 1)
    print(f"{f'refine nine parameters on {len(record)} samples':50} {fit:10.3g} s")


def say(what, ours, unit, yardstick, theirs):
    print(f"{what:50} {ours:10.3g} {unit:8} {yardstick} {theirs:.3g}, ratio {ours / theirs:.3g}")


main()
