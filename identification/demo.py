"""The whole job on one campaign: identify, export, simulate in fmpy, close the loop."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from identification.identify import Identification, identify
from identification.quality import rmse
from vpp_fmu.campaign import read_campaign
from vpp_fmu.export import Experiment, python_fmu
from vpp_fmu.files import OutputFolder
from vpp_fmu.fmu import simulate_in_fmpy
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.loop import run as run_loop
from vpp_fmu.parameters import ParameterSet, to_ssv
from vpp_fmu.plants import FmuController, FmuPlant
from vpp_fmu.record import Record

STEP = 0.004

IDLE = (2000.0, 0.0)
"""Commands that the loop starts from, rpm and deg: the lowest speed of the operating region."""


@dataclass(frozen=True)
class Demo:
    """What the job gave. `fmu_thrust` (rows of validation.csv,) N: the exported FMU's prediction through fmpy."""

    identification: Identification
    fmu_thrust: np.ndarray
    loops: dict[str, Record]

    @property
    def fmu_rmse(self) -> float:
        """Thrust error of the exported FMU on the validation record, N."""
        return rmse(self.fmu_thrust - self.identification.campaign.validation["thrust"])


def example_folder() -> Path:
    """The campaign that ships with the project."""
    return Path(str(files("identification") / "example"))


def step_profile(thrust_scale: float = 15.0) -> Record:
    """Thrust 0.1 -> 0.8 -> 0.1 of the scale, as the paper's tests; `time` [s], `thrust_set` [N]."""
    levels = np.array([0.1, 0.8, 0.1, 0.1]) * thrust_scale
    return Record({"time": np.array([0.0, 3.0, 6.0, 9.0]), "thrust_set": levels}, "step profile")


def demo(folder: OutputFolder, stage: Callable[[str], None]) -> Demo:
    """Run the job on the example campaign and write the FMUs; `stage` is told what begins."""
    stage("identify")
    found = identify(read_campaign(example_folder()))
    stage("export")
    gains = ParameterSet(CONTROLLER, source={"made_by": "the paper's gains"}).replaced(DUAL)
    experiment = Experiment(stop=float(found.campaign.validation.time[-1]), step=STEP)
    paths = {}
    for part in (found.parameters, gains):
        name = part.model.name
        paths[name] = folder.write(f"{name}.fmu", python_fmu(part.model, part.values, experiment))
        folder.write(f"{name}.ssv", to_ssv(part, name))
    stage("simulate in fmpy")
    thrust = simulate_in_fmpy(paths["VppPlant"], found.campaign.validation)
    stage("close the loop")
    loops = {}
    for name, gains in (("dual", DUAL), ("speed only", SPEED_ONLY)):
        plant, controller = FmuPlant(paths["VppPlant"], dt=STEP), FmuController(paths["VppController"], gains, dt=STEP)
        loops[name] = run_loop(plant, controller, step_profile(), IDLE)
        plant.close()
        controller.close()
    return Demo(found, thrust, loops)
