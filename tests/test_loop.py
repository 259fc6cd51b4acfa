"""The control loop: the paper's figures of merit, FMUs against kernel, and the record of a run."""

import numpy as np
import pytest
from builders import FAST_PITCH, native

from vpp_fmu.errors import CompilerMissing, SimulationFailed
from vpp_fmu.export import native_fmu
from vpp_fmu.fmu import FmuInstance
from vpp_fmu.kernel.controller import SPEED_ONLY
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.loop import run
from vpp_fmu.plants import FmuController, FmuPlant, KernelController, KernelPlant, Sample
from vpp_fmu.record import Record

COLUMNS = ["time", "thrust_set", "omega_ref", "beta_ref", "thrust", "omega", "beta"]


def profile(*rows):
    """A record from rows of time [s] and the set-point [N] from then on; the last row ends the run."""
    time, wanted = zip(*rows, strict=True)
    return Record({"time": np.array(time, float), "thrust_set": np.array(wanted, float)}, "test")


UP_AND_DOWN = profile((0.0, 1.5), (5.0, 12.0), (9.0, 1.5), (13.0, 1.5))


def kernel_pair(gains):
    return KernelPlant(parameters=FAST_PITCH), KernelController(gains)


@pytest.fixture(scope="module")
def closed_loops(fmu_files):
    """Steps up and down through FMUs: with both actuators, and with speed alone at 10 deg."""
    runs = {}
    for name, gains in (("dual", {}), ("speed only", SPEED_ONLY)):
        plant, controller = FmuPlant(fmu_files["fast_pitch"]), FmuController(fmu_files["controller"], gains)
        runs[name] = run(plant, controller, UP_AND_DOWN)
        plant.close()
        controller.close()
    return runs


def step_of(record, start, end, before, after):
    """(settling time to 2 % of the step [s], overshoot as a share of the step) of a change at `start`."""
    rows = (record.time >= start) & (record.time < end)
    missing = (after - record["thrust"][rows]) / (after - before)
    settled = np.flatnonzero(np.abs(missing) > 0.02)[-1] + 1
    return record.time[rows][settled] - start, max(0.0, -missing.min())


def test_dual_step_up_is_as_the_paper_has_it(closed_loops):
    """'From 0.1 to 0.8 of the normalised thrust the setpoint was reached in approximately 0.5 s', 'without any overshoots'."""
    settling, overshoot = step_of(closed_loops["dual"], 5.0, 9.0, 1.5, 12.0)
    assert 0.40 <= settling <= 0.50
    assert overshoot <= 0.01
    settling, overshoot = step_of(closed_loops["speed only"], 5.0, 9.0, 1.5, 12.0)
    assert 0.40 <= settling <= 0.50
    assert overshoot <= 0.001


def test_dual_step_down_is_superior(closed_loops):
    """'A superior response, especially for the step down, when both inputs are utilized'; speed held to 2000-6000 rpm."""
    dual, _ = step_of(closed_loops["dual"], 9.0, 13.0, 12.0, 1.5)
    speed_only, _ = step_of(closed_loops["speed only"], 9.0, 13.0, 12.0, 1.5)
    assert dual == pytest.approx(0.34, abs=0.02)
    assert speed_only == pytest.approx(0.59, abs=0.02)


@pytest.mark.parametrize("name", ["dual", "speed only"])
def test_kernel_and_fmus_close_the_same_loop_to_the_bit(closed_loops, name):
    by_kernel = run(*kernel_pair(SPEED_ONLY if name == "speed only" else {}), UP_AND_DOWN)
    assert list(by_kernel.columns) == list(closed_loops[name].columns)
    for column in COLUMNS:
        np.testing.assert_array_equal(by_kernel[column], closed_loops[name][column], err_msg=column)


@pytest.mark.parametrize("name", ["dual", "speed only"])
def test_the_record_is_a_record_of_the_loop(closed_loops, name):
    record = closed_loops[name]
    assert list(record.columns) == COLUMNS
    assert len(record) == 13.0 / 0.004 + 1
    np.testing.assert_array_equal(record.time, np.arange(3251) * 0.004)
    assert ((record["omega_ref"] >= 2000.0) & (record["omega_ref"] <= 6000.0)).all()
    assert ((record["beta_ref"] >= -5.0) & (record["beta_ref"] <= 10.0)).all()
    if name == "speed only":
        assert (record["beta_ref"] == 10.0).all()
    for end, wanted in ((5.0, 1.5), (9.0, 12.0), (13.0, 1.5)):
        assert record["thrust"][round(end / 0.004)] == pytest.approx(wanted, abs=1e-3)


class Echo:
    """A plant whose thrust is the last commanded speed; it records its calls."""

    def __init__(self, dt):
        self.dt, self.asked = dt, []

    def start(self, omega_ref, beta_ref):
        self.asked.append(("start", omega_ref, beta_ref))
        return Sample(omega_ref, omega_ref, beta_ref)

    def step(self, omega_ref, beta_ref):
        self.asked.append(("step", omega_ref, beta_ref))
        return Sample(omega_ref, omega_ref, beta_ref)

    def close(self):
        raise AssertionError("the loop was handed the plant, it is not its to close")


class Follow:
    """A controller that commands the set-point as speed and the measured thrust as pitch."""

    def start(self, thrust_set, thrust):
        self.started = thrust_set, thrust

    def step(self, thrust_set, thrust):
        return thrust_set, thrust

    def close(self):
        raise AssertionError("the loop was handed the controller, it is not its to close")


def test_a_profile_is_held_from_row_to_row():
    """A row between communication points acts from the next point on; a row on a point from that point on, despite rounding."""
    rows = profile((0.0, 1.0), (0.012, 2.0), (0.0139, 3.0), (0.0141, 4.0), (0.3 * 0.1, 5.0), (0.04, 6.0))
    record = run(Echo(0.004), Follow(), rows)
    assert record["thrust_set"].tolist() == [1, 1, 1, 2, 4, 4, 4, 4, 5, 5, 6]
    assert record["omega_ref"].tolist() == record["thrust_set"].tolist()
    as_written = profile(*((round(k * 0.009, 3), k) for k in range(1001)))  # half of these lie a rounding after the grid
    assert run(Echo(0.009), Follow(), as_written)["thrust_set"].tolist() == list(range(1001))


def test_commands_act_until_the_next_point_and_the_controller_sees_what_stands():
    plant, controller, shares = Echo(0.5), Follow(), []
    record = run(plant, controller, profile((0.0, 3.0), (1.0, 4.0), (1.5, 4.0)), start=(7.0, 2.0), progress=shares.append)
    assert controller.started == (3.0, 7.0)
    assert plant.asked == [("start", 7.0, 2.0), ("step", 3.0, 7.0), ("step", 3.0, 3.0), ("step", 4.0, 3.0)]
    assert record["thrust"].tolist() == [7.0, 3.0, 3.0, 4.0]
    assert record["beta_ref"].tolist() == [7.0, 3.0, 3.0, 4.0]
    assert record["beta"].tolist() == [2.0, 7.0, 3.0, 3.0]
    assert shares
    assert all(0.0 <= share <= 1.0 for share in shares)


@pytest.fixture(scope="module")
def native_files(tmp_path_factory):
    """Native FMUs of the pair."""
    folder = tmp_path_factory.mktemp("native")
    try:
        files = {"plant": native_fmu(BASE, FAST_PITCH), "controller": native("controller")}
    except CompilerMissing as missing:
        pytest.skip(f"native FMUs: {missing}")
    for name, content in files.items():
        (folder / f"{name}.fmu").write_bytes(content)
    return [folder / f"{name}.fmu" for name in files]


def run_both_ways(native_files, monkeypatch, references, dt=0.004):
    """The loop of native FMUs through the compiled master, and call by call from Python."""
    found = []
    for compiled in (True, False):
        if not compiled:
            monkeypatch.setattr(FmuInstance, "entry", lambda self: None)
        plant, controller = (kind(path, dt=dt) for kind, path in zip((FmuPlant, FmuController), native_files, strict=True))
        told = []
        try:
            found.append((run(plant, controller, references, progress=told.append), told))
        except SimulationFailed as failure:
            found.append((str(failure), told))
        plant.close()
        controller.close()
    return found


def test_the_compiled_master_gives_the_same_bits(native_files, monkeypatch):
    (compiled, told), (interpreted, told_too) = run_both_ways(native_files, monkeypatch, UP_AND_DOWN)
    for name in COLUMNS:
        np.testing.assert_array_equal(compiled[name], interpreted[name], err_msg=name)
    assert len(told) == len(told_too) == 4
    plant, controller = kernel_pair({})
    np.testing.assert_array_equal(compiled["thrust"], run(plant, controller, UP_AND_DOWN)["thrust"])


def test_both_masters_report_a_failure_in_the_same_words(native_files, monkeypatch):
    """An invalid set-point within a run: the message names the FMU, the time and the reason."""
    references = profile((0.0, 1.5), (5.0, np.nan), (9.0, 1.5))
    (compiled, _), (interpreted, _) = run_both_ways(native_files, monkeypatch, references)
    assert compiled == interpreted
    assert "controller.fmu: the step at 5 s with inputs [nan, " in compiled
    assert "thrust_set: found nan" in compiled
