"""From the files of a campaign to parameters: the records that are fitted, those that are only predicted, and the output."""

import json

import numpy as np
import pytest
from studies.synthetic import NOISE, TRUTH, commands, measured

from identification.assessment.reading_noise import REPEATS
from identification.diagnose.initial_model import from_identification
from identification.gate.gate import passed
from identification.identify import identify
from vpp_fmu.app.cli import main
from vpp_fmu.campaign import read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BASE, LIBRARY, plant
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record, write_record

SECTION = 8.0
"""Seconds of each part of a record."""


def steady(rng) -> Record:
    """Raw samples of a grid of steady points: 4 s at 50 Hz each."""
    omega, beta = (axis.ravel() for axis in np.meshgrid(np.linspace(2000, 6000, 5), np.linspace(-5, 10, 5)))
    rows = 200
    columns = {"time": np.arange(rows * 25) * 0.02, "omega_ref": np.repeat(omega, rows), "beta_ref": np.repeat(beta, rows)}
    record = Record(columns, "static_raw.csv")
    thrust = Simulator(BASE).simulate(TRUTH, columns, record.steps)[:, 0]
    return record.with_columns(thrust=thrust + NOISE * rng.standard_normal(len(record)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A campaign without steps and without means of steady points, and a further record beside it."""
    path, rng = tmp_path_factory.mktemp("campaign"), np.random.default_rng(0)
    orders = commands(rng, SECTION)
    records = {"open_loop": measured(orders, rng), "repeat": measured(orders, rng), "static_raw": steady(rng)}
    records["validation"] = measured(commands(rng, SECTION), rng)
    for name, record in records.items():
        write_record(OutputFolder(path), f"{name}.csv", record)
    write_record(OutputFolder(path / "more"), "open_loop.csv", measured(commands(rng, SECTION), rng))
    write_record(OutputFolder(path / "more"), "tuesday.csv.gz", measured(commands(rng, SECTION), rng))
    return path


@pytest.fixture(scope="module")
def found(folder):
    """The unchanged campaign, identified."""
    return identify(read_campaign(folder), starts=2)


def test_raw_samples_are_the_prior_of_effects_that_change_the_map(folder):
    """Such an effect is fitted to the points together with the map: they must be there, as means are."""
    campaign = read_campaign(folder)
    at = from_identification(campaign, passed(campaign), LIBRARY, seed=0)
    model = plant(["map_terms"])
    free = [*at.names, "map_terms.c22"]
    assert "map_terms.c22" in at.knowledge(model, model.values(at.values), free).names


def near_truth(found):
    return [abs(found.refinement.values[n] - TRUTH[n]) < 4.5 * s for n, s in found.refinement.std.items()]


def test_records_of_a_campaign_are_fitted_together_and_the_other_only_predicted(found):
    assert found.fitted == ("open_loop", "repeat")
    assert tuple(found.predictions) == ("open_loop", "repeat", "validation")
    assert found.campaign.missing == ("steps.csv",)
    assert all(near_truth(found))
    assert found.noise.std == pytest.approx(NOISE, rel=0.05)
    assert found.noise.source == REPEATS


def test_the_prediction_band_has_its_coverage_on_the_validation_record(found):
    # Six thousand white readings: their share is known to 0.3 %.
    assert found.coverage["validation"] == pytest.approx(0.95, abs=0.01)


def test_command_fits_further_records_and_says_what_it_did(folder, tmp_path, capsys):
    taken = str(folder / "more" / "open_loop.csv")
    further = ["--record", str(folder / "more" / "tuesday.csv.gz"), "--record", taken]
    assert main(["identify", str(folder), *further, "--starts", "1", "-o", str(tmp_path), "--verbose"]) == 0
    said = json.loads((tmp_path / "identification.json").read_text())
    assert said["fitted"] == ["open_loop", "repeat", "tuesday", taken]
    assert list(said["rmse_thrust"]) == [*said["fitted"], "validation"]
    assert said["missing"] == ["steps.csv"]
    assert said["static_map"]["points"] == 25
    assert {p["interval_from"] for p in said["parameters"].values()} <= {"covariance", "profile likelihood"}
    for name, p in said["parameters"].items():
        assert p["interval"][0] < p["value"] < p["interval"][1], name
    page = (tmp_path / "report.html").read_text()
    assert "Fitted together: open_loop, repeat, tuesday" in page
    assert "not used to fit" in capsys.readouterr().out


@pytest.mark.parametrize(("text", "says"), [(None, "no such file"), ("time,omega_ref,beta_ref\n0,1,1\n", "column thrust")])
def test_a_further_record_that_cannot_be_read_is_refused_in_one_line(folder, tmp_path, refused, text, says):
    path = tmp_path / "further.csv"
    if text is not None:
        path.write_text(text)
    said = refused("identify", folder, "--record", path, "-o", tmp_path)
    assert str(path) in said
    assert says in said
    assert not (tmp_path / "parameters.json").exists()
