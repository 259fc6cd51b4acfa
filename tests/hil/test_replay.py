import json

import numpy as np
import pytest
from rigs import setup, step_profile

from hil.replay import replay
from hil.run import run_on_rig, write_run
from vpp_fmu.app.cli import main
from vpp_fmu.plants import FmuController, KernelController


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return run_on_rig(setup(), KernelController(), step_profile(hold=1.0), tmp_path_factory.mktemp("replay")).record


def test_the_fmu_gives_the_loops_commands_to_the_bit(run, fmu_files):
    controller = FmuController(fmu_files["controller"])
    found = replay(run, controller)
    controller.close()
    assert found.first_difference is None
    np.testing.assert_array_equal(found.record["omega_ref"], run["omega_wanted"])
    np.testing.assert_array_equal(found.record["beta_ref"], run["beta_wanted"])
    assert np.ptp(found.record["omega_ref"]) > 1000.0  # its commands move


def test_one_bit_of_thrust_is_detected(run):
    thrust, wanted = run["thrust"].copy(), run["omega_wanted"]
    row = int(np.flatnonzero((wanted > 2000.0) & (wanted < 6000.0))[50])  # at a limit the command would be the same
    thrust[row] = np.nextafter(thrust[row], 100.0)
    found = replay(run.with_columns(thrust=thrust), KernelController())
    assert found.first_difference == row


@pytest.fixture
def words(tmp_path, fmu_files):
    """The command that replays run.csv with the controller's FMU."""
    return ["hil", "replay", tmp_path / "run.csv", fmu_files["controller"], "-o", tmp_path / "out"]


def test_the_command_compares_a_file(run, tmp_path, capsys, words):
    write_run(tmp_path / "run.csv", run)
    assert main([*map(str, words)]) == 0
    said = capsys.readouterr()
    assert f"on the {len(run)} rows" in said.out
    assert "the same commands to the bit" in said.out
    assert said.err == ""
    assert json.loads((tmp_path / "out" / "replay.json").read_text())["same_to_the_bit"] is True


def test_the_command_says_where_another_controller_differs(run, tmp_path, printed, words):
    thrust = run["thrust"].copy()
    thrust[100] += 0.5
    write_run(tmp_path / "run.csv", run.with_columns(thrust=thrust))
    assert "other commands from 0.400 s on" in printed(*words)
