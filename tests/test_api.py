"""`import vpp_fmu as vpp`: every public name has an example that runs; results can be shown and saved; frames are converted
both ways."""

import doctest
import functools
import inspect
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from builders import refusal

import vpp_fmu as vpp
from identification.diagnose import diagnose as diagnosing
from vpp_fmu import frames
from vpp_fmu.errors import BadInput, ExtraMissing
from vpp_fmu.record import Record

CLASSES_OF_DATA = ("Effect", "Model", "Parameter", "Signal", "State", "Rig", "BadInput", "VppError")
"""Documented by the functions that take them; every other name has an example."""

EXAMPLES = [name for name in vpp.__all__ if name not in CLASSES_OF_DATA]


@pytest.fixture(autouse=True)
def _somewhere(tmp_path, monkeypatch):
    """Examples write into the current folder."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def identified():
    return vpp.identify(vpp.example_campaign(), starts=1)


@pytest.fixture(scope="module")
def checked():
    return vpp.check(vpp.example_campaign())


@pytest.mark.parametrize("name", vpp.__all__)
def test_every_public_name_is_documented(name):
    assert (inspect.getdoc(getattr(vpp, name)) or "").strip()
    assert name in dir(vpp)


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_of_every_public_name_runs(name, identified, checked, short_search, monkeypatch):
    for verb, found in (("identify", identified), ("check", checked)):  # the fixtures have called them as the examples do
        own = getattr(vpp, verb)
        told = functools.wraps(own)(lambda campaign, starts=1, found=found: found)
        monkeypatch.setattr(vpp, verb, told, raising=False)
    monkeypatch.setattr("vpp_fmu.app.api.diagnose.diagnosed", functools.partial(diagnosing.diagnose, thorough=False))
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    found = doctest.DocTestFinder().find(getattr(vpp, name), name, globs={"vpp": vpp})
    assert any(test.examples for test in found), f"{name} has no example"
    runner = doctest.DocTestRunner(optionflags=flags)
    said: list[str] = []
    for test in found:
        runner.run(test, out=said.append)
    assert runner.failures == 0, "".join(said)


def test_the_import_is_lazy():
    """Also that of `vpp --help`."""
    code = "import sys, vpp_fmu.app.cli; print(sorted({'numpy', 'scipy', 'plotly', 'fmpy', 'tqdm'} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_an_unknown_public_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'identifi'"):
        _ = vpp.identifi


def test_the_stub_and_the_module_have_the_same_names():
    stub = Path(vpp.__file__).with_suffix(".pyi").read_text().splitlines()
    assert {line.rsplit(" as ", 1)[1] for line in stub if line.startswith("from")} == set(vpp.__all__)


def test_results_show_themselves(identified):
    assert repr(identified).startswith("IdentifyResult(thrust error, open_loop: ")
    assert len(repr(identified)) < 500
    assert "<td>thrust error, open_loop</td>" in identified._repr_html_()
    assert json.loads(json.dumps(identified.to_dict(), allow_nan=False))["fitted"] == ["open_loop", "repeat"]
    assert "Thrust error" in identified.plot().layout.title.text
    with pytest.raises(BadInput, match="figure: found 99, expected 1 to"):
        identified.plot(99)
    campaign = vpp.read_campaign(vpp.example_campaign())
    assert "100 points" in campaign._repr_html_()
    assert "<td>thrust</td><td>N</td>" in campaign.open_loop._repr_html_()
    assert "tau_beta_1" in identified.parameters._repr_html_()


def test_verbs_take_paths_and_objects_alike(identified, tmp_path):
    path = vpp.example_campaign() / "validation.csv.gz"
    record = vpp.read_record(path)
    identified.save(tmp_path)
    by_path = vpp.simulate(path, tmp_path / "parameters.json")
    for given in (record, record.columns):
        for parameters in (identified, identified.parameters):
            found = vpp.simulate(given, parameters)
            np.testing.assert_array_equal(found.record["thrust"], by_path.record["thrust"])
    assert by_path.rmse_thrust == pytest.approx(identified.to_dict()["rmse_thrust"]["validation"], rel=1e-6)
    assert by_path.save(tmp_path / "out").joinpath("prediction.csv").exists()
    assert by_path.to_dict()["rmse_thrust"] == by_path.rmse_thrust


def test_a_loop_of_fmus_is_the_loop_of_their_parameters(identified, tmp_path):
    files = vpp.export_fmu(identified, tmp_path)
    profile = {"time": [0.0, 0.4, 2.0], "thrust_set": [2.0, 8.0, 8.0]}
    by_fmu = vpp.run_loop(files["VppPlant.fmu"], files["VppController.fmu"], profile, start=(2000.0, 0.0))
    by_kernel = vpp.run_loop(identified, {}, profile, start=(2000.0, 0.0))
    np.testing.assert_array_equal(by_fmu.record["thrust"], by_kernel.record["thrust"])
    assert "The step from 2 to 8 N" in by_fmu.plot().layout.title.text
    assert by_kernel.to_dict()["steps"][0]["after"] == 8.0


def test_a_plan_uses_the_knowledge_of_a_result(identified, tmp_path):
    blind = vpp.plan(identified.parameters, seconds=8)
    told = vpp.plan(identified, seconds=8)
    assert blind.to_dict()["before"] is None
    assert told.to_dict()["before"] is not None
    assert told.found.noise_std == identified.found.noise.std
    assert told.save(tmp_path).joinpath("plan.csv").exists()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda found: vpp.simulate({"time": [0.0]}, found), "column omega_ref"),
        (lambda found: vpp.simulate(3, found), "a int"),
        (lambda found: vpp.simulate({"time": [], "omega_ref": [], "beta_ref": []}, found), "no rows"),
        (lambda found: vpp.simulate({"time": [0.0, 1.0], "omega_ref": [1.0], "beta_ref": [1.0, 2.0]}, found), r"shape \(1,\)"),
        (lambda found: vpp.simulate({"time": [0.0], "omega_ref": [np.nan], "beta_ref": [5.0]}, found), "omega_ref, row 0"),
        (lambda found: vpp.simulate({"time": [0.0], "omega_ref": [4000.0], "beta_ref": [500.0]}, found), "-90 to 90 deg"),
        (lambda found: vpp.tune(found, assume={"tau_gamma": 1.0}), "tau_gamma"),
        (lambda found: vpp.tune(found, robust="best"), "None, worst or mean"),
        (lambda found: vpp.diagnose(vpp.example_campaign(), effects=["gust"]), "effects: found gust"),
        (lambda found: vpp.diagnose(vpp.example_campaign(), parameters=3), "a int"),
        (lambda found: vpp.check(vpp.example_campaign(), accept=["nothing"]), "found nothing"),
        (lambda found: vpp.export_fmu(found, "fmus", flavour="native", fmi="4.0"), "2.0 or 3.0"),
        (lambda found: vpp.export_fmu(found, "fmus", platforms="all"), "all with --flavour python"),
        (lambda found: vpp.run_loop("no.fmu", {}, {"time": [0.0, 1.0], "thrust_set": [1.0, 2.0]}), "no such file"),
        (lambda found: vpp.run_loop(found, {"kp": 1.0}, {"time": [0.0, 1.0], "thrust_set": [1.0, 2.0]}), "kp_omega"),
        (lambda found: vpp.run_loop(found, {}, {"time": [0.0, 1.0], "thrust_set": [1.0, 2.0]}, dt=0.0), "dt: found 0 s"),
        (lambda found: vpp.plan(found, seconds=0.1), "seconds"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(call, says, identified):
    assert re.search(says, refusal(call, identified))


RECORD = Record(
    {
        "time": np.array([0.0, 0.004, 0.008]),
        "omega_ref": np.array([4000.0, 4000.0, 4100.0]),
        "beta_ref": np.array([5.0, 5.0, 5.5]),
        "thrust": np.array([6.1, np.nan, 6.2]),
    },
    "three rows",
)


@pytest.mark.parametrize("name", ["pandas", "polars", "xarray"])
def test_a_record_comes_back_from_a_frame_as_it_went(name):
    pytest.importorskip(name)
    back = Record.from_frame(getattr(RECORD, f"to_{name}")())
    assert set(back.columns) == set(RECORD.columns)
    for column, values in RECORD.columns.items():
        np.testing.assert_array_equal(back[column], values)


@pytest.mark.parametrize("name", ["pandas", "polars", "xarray"])
def test_a_missing_frame_library_is_refused_in_one_line(name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ExtraMissing, match=f"^{name}: found no library, .* Try: pip install {name}") as said:
        getattr(RECORD, f"to_{name}")()
    assert "\n" not in str(said.value)
    assert frames.EXTRA in str(said.value)
