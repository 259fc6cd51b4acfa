"""The whole job on one campaign: identify, diagnose, augment, export, simulate before and after in fmpy, close the loop."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path

import numpy as np

from identification.assessment.prediction import rmse
from identification.diagnose.diagnose import diagnose
from identification.diagnose.diagnosis import Diagnosis
from identification.tune.profile import step_profile
from vpp_fmu.campaign import Campaign
from vpp_fmu.commands import idle
from vpp_fmu.export.toolchain import host
from vpp_fmu.files import OutputFolder
from vpp_fmu.fmu import simulate_in_fmpy
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.loop import run as run_loop
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import FmuController, FmuPlant
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

STEP = 0.004

Export = Callable[[Sequence[ParameterSet], str], Mapping[str, bytes | str]]
"""(plant's parameters, and controller's if there is one; flavour) -> contents of files by name."""


@dataclass(frozen=True)
class Demo:
    """Result of the job. `thrust`: predictions of validation.csv through the FMUs (rows,) N, by "before" and "after"; `loops`:
    runs of the augmented plant's FMU by controller."""

    diagnosis: Diagnosis
    flavour: str
    thrust: Mapping[str, np.ndarray]
    loops: Mapping[str, Record]

    @property
    def validation(self) -> Record:
        """The validation record, which no fit uses."""
        return self.diagnosis.campaign.validation

    @property
    def rmse(self) -> dict[str, float]:
        """Thrust error of the FMUs on the validation record, N."""
        return {name: rmse(thrust - self.validation["thrust"]) for name, thrust in self.thrust.items()}


def example_folder() -> Path:
    """The campaign that ships with the project."""
    return Path(str(files("identification") / "example"))


def local_flavour() -> str:
    """ "python" if pythonfmu has a library for this machine, else "native"."""
    libraries = Path(str(distribution("pythonfmu").locate_file("pythonfmu/resources/binaries")))
    return "python" if (libraries / host()).is_dir() else "native"


def demo(campaign: Campaign, folder: OutputFolder, export: Export, workers: int, stage: Callable[[str], None]) -> Demo:
    """Run the job on a campaign with a validation record and write the FMUs; `stage` receives the name of each stage."""
    found, flavour = diagnose(campaign, workers=workers, stage=stage), local_flavour()
    stage("export")
    gains = ParameterSet(CONTROLLER, source={"made_by": "the paper's gains"}).replaced(DUAL)
    suffix = "" if flavour == "python" else ".native"
    before = export([found.parameters(found.base)], flavour)[f"VppPlant{suffix}.fmu"]
    paths = {"before": folder.write(f"VppPlant_base{suffix}.fmu", before)}
    for name, content in export([found.parameters(found.final), gains], flavour).items():
        paths[name] = folder.write(name, content)
    plant, controller = (paths[f"{name}{suffix}.fmu"] for name in ("VppPlant", "VppController"))
    stage("simulate in fmpy")
    thrust = {
        name: simulate_in_fmpy(path, campaign.validation) for name, path in (("before", paths["before"]), ("after", plant))
    }
    stage("close the loop")
    return Demo(found, flavour, thrust, {name: _loop(plant, controller, g, found.rig) for name, g in _GAINS.items()})


_GAINS = {"dual": DUAL, "speed only": SPEED_ONLY}


def _loop(plant: Path, controller: Path, gains: Mapping[str, float], rig: Rig) -> Record:
    """The step profile through both FMUs."""
    parts = FmuPlant(plant, dt=STEP), FmuController(controller, gains, dt=STEP)
    done = run_loop(*parts, step_profile(rig), idle(rig))
    for part in parts:
        part.close()
    return done
