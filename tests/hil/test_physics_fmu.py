"""The physical rig as an FMU of both flavours: in the loop with the controller, and equal to the kernel."""

import numpy as np
import pytest

from hil.physics import rig_model
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.loop import run
from vpp_fmu.plants import FmuController, FmuPlant, KernelController, KernelPlant
from vpp_fmu.record import Record

HIDDEN = ("linkage_play", "lac_command_delay", "blade_torsion")
ON = {"linkage_play.half_gap": 0.4, "lac_command_delay.delay": 0.0413, "blade_torsion.compliance": 0.05}
GAINS = {"kp_omega": 3.0, "ki_omega": 20.0, "kd_omega": 0.05, "kp_beta": 2.0, "ki_beta": 15.0, "kd_beta": 0.05}
PROFILE = Record({"time": np.array([0.0, 0.2, 1.0, 1.5]), "thrust_set": np.array([3.0, 10.0, 5.0, 5.0])}, source="test")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with an FMU of each flavour, and the controller's."""
    folder, hidden = tmp_path_factory.mktemp("rig"), rig_model.rig_model(HIDDEN)
    made = {"python": python_fmu(hidden, ON), "native": native_fmu(hidden, ON), "controller": python_fmu(CONTROLLER, GAINS)}
    for name, content in made.items():
        (folder / f"{name}.fmu").write_bytes(content)
    return folder


def looped(plant, controller):
    try:
        return run(plant, controller, PROFILE, start=(2000.0, 0.0))
    finally:
        plant.close()
        controller.close()


@pytest.fixture(scope="module")
def in_kernel():
    return looped(KernelPlant(rig_model.rig_model(HIDDEN), ON), KernelController(GAINS))


@pytest.mark.parametrize("flavour", ["python", "native"])
def test_the_loop_runs_on_the_fmu_as_it_runs_on_the_kernel(flavour, files, in_kernel):
    record = looped(FmuPlant(files / f"{flavour}.fmu"), FmuController(files / "controller.fmu"))
    for name in ("omega_ref", "beta_ref", "thrust", "omega", "beta"):
        np.testing.assert_array_equal(record[name], in_kernel[name])
    assert np.ptp(in_kernel["omega"]) > 1000.0
    assert in_kernel["thrust"][in_kernel.time < 1.0][-1] == pytest.approx(10.0, abs=1.0)
