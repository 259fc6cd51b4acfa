"""python -m tests.benchmarks.gym: plant steps a second of the vectorised environment on one core, beside the FMU under fmpy.

Machines differ and are noisy, so the ratio is what to look at; every time is the best of several runs. The actions are drawn
beforehand. An environment's step has readings with noise, reward and limits; `hold` plant steps belong to one action.
"""

import tempfile
import time
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.gym import VppThrustVectorEnv
from vpp_fmu.kernel.plant import BASE

STEP, ENVIRONMENTS, SECONDS = 0.004, 4096, 0.5


def rate(work, steps, repeats=5):
    """Plant steps a second of `work()`, which makes `steps` of them: the best of `repeats` runs of SECONDS each."""
    best = 0.0
    for _ in range(repeats):
        count, began = 0, time.perf_counter()
        while (passed := time.perf_counter() - began) < SECONDS:
            work()
            count += 1
        best = max(best, count * steps / passed)
    return best


def under_fmpy(fmu: bytes, folder: Path) -> float:
    """Plant steps a second of an FMU under fmpy: two inputs set, a step, three outputs read."""
    path = folder / "plant.fmu"
    path.write_bytes(fmu)
    description = fmpy.read_model_description(str(path))
    at = {v.name: v.valueReference for v in description.modelVariables}
    identifier = description.coSimulation.modelIdentifier
    slave = FMU2Slave(guid=description.guid, unzipDirectory=fmpy.extract(str(path)), modelIdentifier=identifier)
    slave.instantiate()
    slave.setupExperiment()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    inputs, outputs = [at["omega_ref"], at["beta_ref"]], [at["thrust"], at["omega"], at["beta"]]
    steps = 0

    def step():
        nonlocal steps
        slave.setReal(inputs, (4000.0, 5.0))
        slave.doStep(steps * STEP, STEP)
        slave.getReal(outputs)
        steps += 1

    try:
        return rate(step, 1)
    finally:
        slave.terminate()
        slave.freeInstance()


def main():
    found = {}
    for hold in (1, 5):
        env = VppThrustVectorEnv(ENVIRONMENTS, seconds=60.0, noise=(0.13, 5.0), hold=hold, dt=STEP)
        env.reset(seed=0)
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (ENVIRONMENTS, 2))
        found[f"{ENVIRONMENTS} environments, {hold} plant step{'s' * (hold > 1)} an action"] = rate(
            lambda env=env, actions=actions: env.step(actions), ENVIRONMENTS * hold
        )
    with tempfile.TemporaryDirectory() as folder:
        for name, make in (("native", native_fmu), ("Python", python_fmu)):
            found[f"the {name} FMU under fmpy"] = under_fmpy(make(BASE), Path(folder))
    slowest = found["the native FMU under fmpy"]
    for name, steps in found.items():
        print(
            f"{name:44} {steps / 1e6:9.3f} million plant steps a second, {steps / slowest:7.3g} x the native FMU's under fmpy"
        )


if __name__ == "__main__":
    main()
