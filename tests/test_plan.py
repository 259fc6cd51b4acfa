"""The next experiment: within the rig's range, better than the paper's, with a correct forecast of the uncertainty."""

import json

import numpy as np
import pytest
from builders import refusal, simulator

from identification.assessment.information import Information
from identification.fit.problem import Prior, Problem
from identification.fit.refine import BASE_PARAMETERS, independent_readings
from identification.plan.plan import plan
from vpp_fmu.app import cli
from vpp_fmu.kernel.plant import BASE, FINE_TUNED
from vpp_fmu.parameters import ParameterSet, to_json
from vpp_fmu.record import read_record
from vpp_fmu.rig import Rig

SORTED = FINE_TUNED | {"tau_beta_1": 0.374, "tau_beta_2": 0.207}
"""The paper's values, the slower constant of each channel first, as a fit orders them."""

NARROW = Rig(speed=(2500.0, 5000.0), pitch=(-2.0, 8.0), speed_slew=6000.0, pitch_slew=45.0)


@pytest.fixture(scope="module")
def planned():
    """A plan of 20 s for the paper's plant."""
    return plan(BASE, SORTED, Rig(), 20.0, 0.3, evaluations=200)


@pytest.fixture(scope="module")
def narrow():
    """A plan of 12 s within narrow limits."""
    return plan(BASE, SORTED, NARROW, 12.0, 0.3, seed=3, evaluations=50, step=0.005)


def test_it_beats_the_paper_s_plan(planned, narrow):
    """Steps every 0.2 to 0.8 s on both channels cut the error of tau_beta_1 and of the weakest direction to a third (notes)."""
    assert planned.gain > 2.0
    assert planned.after.typical < 0.5 * planned.paper.typical
    taus = [planned.after.names.index(f"tau_beta_{k}") for k in (1, 2)]
    assert (planned.after.relative[taus] < 0.5 * planned.paper.relative[taus]).all()
    assert narrow.gain > 1.3
    assert narrow.after.typical < 0.75 * narrow.paper.typical


def test_a_rig_ten_times_as_slow_gets_the_same_plan_ten_times_as_slowly():
    """Time has no other scale than the rig's: the same draws, shares of the ranges, and information per reading."""
    slow_values = {name: 10.0 * value if name.startswith("tau") else value for name, value in SORTED.items()}
    fast, slow = (
        plan(BASE, values, Rig().timed(unit), 20.0 * unit, 0.3, evaluations=20)
        for unit, values in ((0.5, SORTED), (5.0, slow_values))
    )
    assert (fast.step, slow.step) == (0.004, 0.04)
    np.testing.assert_allclose(slow.commands.time, 10.0 * fast.commands.time, atol=1e-9)
    for name in ("omega_ref", "beta_ref"):
        np.testing.assert_array_equal(slow.commands[name], fast.commands[name])
    np.testing.assert_allclose(slow.after.relative, fast.after.relative, rtol=1e-6)


def test_information_on_a_coefficient_is_the_closed_form():
    """Thrust is linear in c20: information is the sum of (15 N w^2 c20 / noise)^2."""
    commands = np.column_stack([np.full(400, 5000.0), np.full(400, 3.0)])
    for step, readings in ((0.004, 1.0), (0.02, 5.0)):
        told = Information(BASE, {}, ("c20", "c12"), 0.2, 0.004).of(commands, step)
        wanted = 400 * readings * (15.0 * (5000.0 / 6000.0) ** 2 * 0.355 / 0.2) ** 2
        assert told[0, 0] == pytest.approx(wanted, rel=1e-12)


def test_the_forecast_is_the_scatter_of_refits(planned):
    """60 records of the planned commands with noise, each fitted: per parameter, and all of them together."""
    truth, rng, count = BASE.values(SORTED), np.random.default_rng(1), 60
    record = planned.commands
    thrust = simulator(BASE).simulate(truth, *record.run)[:, 0]
    np.testing.assert_allclose(planned.thrust, thrust, rtol=1e-12)
    found = []
    for _ in range(count):
        noisy = record.with_columns(thrust=thrust + rng.normal(0.0, 0.3, len(record)))
        problem = Problem(BASE, independent_readings([noisy], truth, ("thrust",)), truth, BASE_PARAMETERS)
        values = problem.coordinates.values(problem.solve(truth).value)
        found.append([values[name] for name in planned.after.names])
    error = np.array(found) - planned.after.values
    ratio = np.sqrt(np.mean(error**2, axis=0)) / planned.after.std
    assert np.abs(ratio - 1.0).max() < 4.0 / np.sqrt(2 * count), dict(zip(planned.after.names, ratio, strict=True))
    distances = np.einsum("ki,ij,kj->", error, np.linalg.inv(planned.after.covariance), error)
    assert distances == pytest.approx(error.size, abs=4.0 * np.sqrt(2 * error.size))
    inside = (planned.after.intervals[:, 0] <= np.array(found)) & (np.array(found) <= planned.after.intervals[:, 1])
    assert inside.mean() == pytest.approx(0.95, abs=0.04)


def test_prior_knowledge_adds_to_the_information_and_steers_the_search():
    """Gaussian knowledge: inverse covariances add. If the map is known, the search concentrates on the time constants."""
    names = BASE_PARAMETERS[4:]
    mean = np.array([SORTED[n] for n in names])
    knowledge = Prior(names, mean, np.diag((1e-3 * mean) ** 2))
    found = plan(BASE, SORTED, Rig(), 12.0, 0.3, knowledge, evaluations=50)
    information = Information(BASE, SORTED, BASE_PARAMETERS, 0.3, 0.004)
    commands = np.column_stack([found.commands["omega_ref"], found.commands["beta_ref"]])
    alone = information.of(commands, 0.004) / np.outer(information.size, information.size)
    alone[4:, 4:] += np.linalg.inv(knowledge.covariance)
    np.testing.assert_allclose(found.after.covariance, np.linalg.inv(alone), rtol=1e-4, atol=1e-9)
    assert found.before.relative[4:] == pytest.approx(np.full(5, 1e-3), rel=1e-6)
    assert (found.before.relative[:4] > 1e3).all()
    without = plan(BASE, SORTED, Rig(), 12.0, 0.3, evaluations=50)
    taus = information.of(np.column_stack([without.commands[n] for n in ("omega_ref", "beta_ref")]), 0.004)
    told = information.forecast(taus + information.known(knowledge))
    assert np.sum(found.after.relative[:4] ** 2) < np.sum(told.relative[:4] ** 2)


BAD = [
    (lambda: plan(BASE, {}, Rig().timed(5.0), 20.0), "seconds: found 20 s, expected 50 to 36000 s"),
    (lambda: plan(BASE, {}, Rig(), step=0.1), "step: found 0.1 s, expected 0.0001 to 0.05 s"),
    (lambda: plan(BASE, {}, Rig(), step=float("nan")), "step"),
    (lambda: plan(BASE, {}, Rig(), noise_std=0.0), "noise of thrust"),
    (lambda: plan(BASE, {}, Rig(), omega_std=float("inf")), "noise of speed"),
]


@pytest.mark.parametrize(("call", "says"), BAD)
def test_impossible_arguments_are_refused_in_one_line(call, says):
    assert says in refusal(call)


MEASURED = Rig(speed=(2100.0, 5800.0), pitch=(-5.0, 10.0), origin={"speed": "the campaign", "pitch": "the campaign"})
SOURCE = {"rig": MEASURED.summary(), "sample_period": 0.005}


@pytest.fixture
def parameters(tmp_path):
    """A parameter file, and an identification.json beside it."""
    path = tmp_path / "parameters.json"
    path.write_text(to_json(ParameterSet(BASE, source=SOURCE).replaced(SORTED)))
    fitted = {name: {"value": SORTED[name], "std": 0.1 * abs(SORTED[name])} for name in BASE_PARAMETERS}
    correlation = {"names": list(BASE_PARAMETERS), "matrix": np.eye(9).tolist()}
    content = {
        "parameters": fitted,
        "correlation": correlation,
        "noise_floor_thrust": 0.3,
        "noise_floor_thrust_from": "scatter within steady holds",
        "inflation_by_coloured_residuals": dict.fromkeys(fitted, 4.0),
    }
    (tmp_path / "identification.json").write_text(json.dumps(content))
    return path


def test_the_verb_writes_a_record_that_can_be_run(parameters, tmp_path, capsys):
    out, known = tmp_path / "out", str(tmp_path / "identification.json")
    limits = ["--seconds", "8", "--omega", "2500", "5000", "--pitch", "-2", "8", "--omega-slew", "6000", "--pitch-slew", "45"]
    assert cli.main(["plan", "--parameters", str(parameters), "--knowledge", known, *limits, "-o", str(out)]) == 0
    record = read_record(out / "plan.csv")
    assert list(record.columns) == ["time", "omega_ref", "beta_ref"]
    assert len(record) == 1601  # as the parameters' campaign was sampled
    assert np.abs(np.diff(record["omega_ref"])).max() <= 30.0 * (1 + 1e-9)
    said = json.loads((out / "plan.json").read_text())
    for when in ("before", "after", "paper_plan"):
        assert set(said[when]["parameters"]) == set(BASE_PARAMETERS)
        for entry in said[when]["parameters"].values():
            assert entry["interval"] == pytest.approx([entry["value"] + k * 1.959964 * entry["std"] for k in (-1, 1)])
    assert said["before"]["parameters"]["c11"]["std"] == pytest.approx(0.1 * 0.064)
    assert said["after"]["weakest_direction"]["relative_std"] < said["before"]["weakest_direction"]["relative_std"]
    assert "The next experiment" in (out / "report.html").read_text()
    told = capsys.readouterr().out
    assert "gain over the paper's plan" in told
    assert "--noise 1.2" in told  # residuals were coloured, four times as wide
    assert "noise of a thrust reading 0.3 N (scatter within steady holds)" in told
    assert "speed 2500 to 5000 rpm (as asked, within 2100 to 5800 of the campaign)" in told
    assert "slew of speed 6000 rpm/s (as asked)" in told
    assert said["rig"]["origin"]["pitch_slew"] == "as asked"


def ranges(record):
    return record["omega_ref"].min(), record["omega_ref"].max(), record["beta_ref"].min(), record["beta_ref"].max()


def test_a_plan_stays_in_the_measured_ranges_unless_a_rig_json_widens_them(parameters, tmp_path, printed, capsys, refused):
    words = ["plan", "--parameters", str(parameters), "--seconds", "8", "-o", str(tmp_path)]
    assert cli.main(words) == 0
    low, high, *pitch = ranges(read_record(tmp_path / "plan.csv"))
    assert (low >= 2100.0, high <= 5800.0) == (True, True)
    assert (min(pitch) >= -5.0, max(pitch) <= 10.0) == (True, True)
    assert "commands within speed 2100 to 5800 rpm (the campaign), pitch -5 to 10 deg (the campaign)" in capsys.readouterr().out
    said = refused(*words, "--omega", "2100", "6000")
    assert "--omega: found 2100 to 6000 rpm, expected within 2100 to 5800 rpm" in said
    rig = {"format": "vpp-rig/1", "speed": {"min": 2100, "max": 6500}, "thrust": {"min": 0, "max": 4}, "slew": {"speed": 9000}}
    (tmp_path / "rig.json").write_text(json.dumps(rig))
    words += ["--rig", str(tmp_path / "rig.json")]
    told = printed(*words, "--omega", "5900", "6500")
    assert "speed 5900 to 6500 rpm (as asked, within 2100 to 6500 of rig.json)" in told
    assert "the rig is declared for 0 to 4 N" in told
    low, high, *pitch = ranges(read_record(tmp_path / "plan.csv"))
    assert (low >= 5900.0, high <= 6500.0, min(pitch) >= -5.0, max(pitch) <= 10.0) == (True,) * 4
    said = refused(*words, "--omega-slew", "9001")
    assert "--omega-slew: found 9001 rpm/s, expected more than 0 and at most 9000" in said


def test_bad_calls_are_refused_in_one_line(parameters, tmp_path, refused):
    broken = tmp_path / "broken.json"
    broken.write_text(json.dumps({"parameters": {}, "correlation": {"names": ["c11"], "matrix": [[1.0]]}}))
    singular = tmp_path / "singular.json"
    entry = {"value": 1.0, "std": 0.1}
    both = {"names": ["c11", "c20"], "matrix": [[1.0, 1.0], [1.0, 1.0]]}
    singular.write_text(json.dumps({"parameters": {"c11": entry, "c20": entry}, "correlation": both}))
    calls = [
        (["--pitch", "10", "-5"], "--pitch"),
        (["--rig", str(broken)], "broken.json"),
        (["--knowledge", str(parameters)], "parameters.json"),
        (["--knowledge", str(broken)], "broken.json"),
        (["--knowledge", str(singular)], "singular.json"),
    ]
    for arguments, says in calls:
        said = refused("plan", "--parameters", parameters, *arguments, "-o", tmp_path / "bad")
        for word in (says, "found", "expected"):
            assert word in said
    assert not (tmp_path / "bad" / "plan.csv").exists()
