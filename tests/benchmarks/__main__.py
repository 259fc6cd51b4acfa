"""python -m tests.benchmarks: time of an FMU step and of a fit, each beside a reference timed in the same run.

Machines differ and are noisy, so compare the ratios; every time is the best of several runs.
"""

import itertools
import tempfile
from pathlib import Path

from pythonfmu import FmuBuilder

from identification.demo import example_folder
from identification.fit.refine import refine
from tests.benchmarks.native import STEP, best, do_steps, say, started, whole
from vpp_fmu.campaign import read_campaign
from vpp_fmu.export import python_fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.native import Simulator


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


def main():
    with tempfile.TemporaryDirectory() as folder:
        plant, controller = Path(folder, "VppPlant.fmu"), Path(folder, "VppController.fmu")
        plant.write_bytes(python_fmu(BASE))
        controller.write_bytes(python_fmu(CONTROLLER))
        flat = FmuBuilder.build_FMU(Path(__file__).parent / "flat_slave.py", dest=folder)
        for way, ours, theirs in zip(("fmpy's wrapper", "bound call"), *do_steps(plant, flat), strict=True):
            say(f"doStep of the Python plant FMU, {way}", ours * 1e6, "us", "a hand-written slave", theirs * 1e6)
        theirs, here = loop_in_fmpy(plant, controller), whole(plant, controller, repeats=7)
        say("closed loop of Python FMUs, one communication step", here * 1e6, "us", "fmpy's wrapper", theirs * 1e6)

    simulation, held = Simulation(BASE), {"omega_ref": 5000.0, "beta_ref": 5.0}
    python = 1.0 / best(lambda: simulation.advance(held, STEP), 2000)
    record = read_campaign(example_folder()).open_loop
    simulator = Simulator(BASE)
    native = len(record) / best(lambda: simulator.simulate({}, *record.run), 20)
    say("kernel, compiled", native, "steps/s", "its functions as they stand", python)
    fit = best(lambda: refine(BASE, [record], AVERAGED, channels=("thrust",)), 1)
    print(f"{f'refine nine parameters on {len(record)} samples':50} {fit:10.3g} s")


main()
