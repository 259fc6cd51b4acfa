"""The linear plant of a result against closed forms, the compiled simulator, and other tools."""

import sys

import numpy as np
import pytest
from scipy.io import loadmat

from vpp_fmu.app.report.pages.diagnosis import DiagnoseResult
from vpp_fmu.app.report.pages.identification import IdentifyResult
from vpp_fmu.errors import BadInput, ExtraMissing
from vpp_fmu.kernel.plant import plant
from vpp_fmu.linear import Linearisable, linearised
from vpp_fmu.parameters import ParameterSet

SPEEDS, PITCHES = (2500.0, 4000.0, 5800.0), (-4.0, 1.0, 9.0)
POINTS = [(omega, beta) for omega in SPEEDS for beta in PITCHES]


class Found(Linearisable):
    def __init__(self, *effects):
        self.held = ParameterSet(plant(effects)).replaced({"tau_omega_1": 0.21, "tau_beta_2": 0.13, "c12": -0.2})

    @property
    def parameters(self):
        return self.held


def thrust(v, omega, beta):
    """The paper's eq. 8 in N."""
    w, b = omega / v["omega_scale"], (beta + v["beta_offset"]) / v["beta_scale"]
    terms = v["c20"] * w**2 + v["c11"] * w * b + v["c21"] * w**2 * b + v["c12"] * w * b**2 + v["c30"] * w**3
    return v["thrust_scale"] * terms


@pytest.mark.parametrize(("omega", "beta"), POINTS)
def test_the_frequency_response_is_two_lags_times_the_slope_of_the_map(omega, beta):
    found, v = Found(), Found().parameters.values
    at = np.geomspace(0.01, 300.0, 50)
    h = {"omega": 1e-2, "beta": 1e-4}
    slopes = {
        "omega": (thrust(v, omega + h["omega"], beta) - thrust(v, omega - h["omega"], beta)) / (2.0 * h["omega"]),
        "beta": (thrust(v, omega, beta + h["beta"]) - thrust(v, omega, beta - h["beta"])) / (2.0 * h["beta"]),
    }
    system = found.to_scipy(omega, beta)
    for k, (u, slope) in enumerate(slopes.items()):
        lags = 1.0 / ((1.0 + 1j * at * v[f"tau_{u}_1"]) * (1.0 + 1j * at * v[f"tau_{u}_2"]))
        response = [(system.C @ np.linalg.solve(1j * each * np.eye(4) - system.A, system.B[:, k]))[0] for each in at]
        np.testing.assert_allclose(response, slope * lags, rtol=1e-6)
    assert linearised(v, omega, beta).thrust == pytest.approx(thrust(v, omega, beta), rel=1e-12)


def test_python_control_has_the_same_system_with_names():
    control = pytest.importorskip("control", reason="python-control is not installed")
    found = Found()
    system, other = found.to_control(4000.0, 2.0), found.to_scipy(4000.0, 2.0)
    assert isinstance(system, control.StateSpace)
    assert (system.input_labels, system.output_labels) == (["omega_ref", "beta_ref"], ["thrust"])
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(system, name), getattr(other, name))
    gain = other.C @ np.linalg.solve(-other.A, other.B)
    np.testing.assert_allclose(system.dcgain(), gain)


def test_without_python_control_one_line_says_what_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ExtraMissing, match=r"Try: pip install 'vpp-fmu\[control\]'"):
        Found().to_control(4000.0, 2.0)


def test_a_mat_file_has_the_matrices_the_parameters_and_their_units(tmp_path):
    found = Found()
    path = found.save_mat(tmp_path / "rig.mat", 4000.0, 2.0)
    held, system = loadmat(path, simplify_cells=True), found.to_scipy(4000.0, 2.0)
    for name in "ABCD":
        np.testing.assert_array_equal(np.atleast_2d(held[name]), getattr(system, name))
    values = found.parameters.values
    assert held["coefficients"] == {name: values[name] for name in ("c20", "c11", "c21", "c12", "c30")}
    assert {*held["scales"]} == {"omega_scale", "beta_scale", "beta_offset", "thrust_scale"}
    assert (held["parameters"]["tau_beta_2"], held["units"]["tau_beta_2"]) == (values["tau_beta_2"], "s")
    assert held["point"]["thrust"] == pytest.approx(thrust(values, 4000.0, 2.0))
    script = (tmp_path / "rig.m").read_text()
    assert script.startswith("% Not run")
    assert "load('rig.mat')" in script
    with pytest.raises(BadInput, match="name: found my rig"):
        found.save_mat(tmp_path / "my rig.mat", 4000.0, 2.0)


def test_results_of_identify_and_diagnose_can_be_linearised():
    assert issubclass(IdentifyResult, Linearisable)
    assert issubclass(DiagnoseResult, Linearisable)
