"""The adaptive twin of an identified rig: its values, one update per tick, and `vpp export|cosim|hil run --twin`."""

import json
import zipfile

import numpy as np
import pytest
from scipy.stats import t

from hil.twin.adaptive import CERTAIN, Adaptive, adaptable, adaptive
from hil.twin.band import Band
from vpp_fmu.app.cli import main
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.twin import DAILY, sums, threshold
from vpp_fmu.parameters import ParameterSet

BAND = Band(0.12, 0.05, 0.15, 0.1, 0.04, 20.0)
DT = 0.004


@pytest.fixture(scope="module")
def identified():
    return ParameterSet(plant()).replaced({"tau_beta_2": 0.3, "c20": 0.36}, {"tau_beta_2": 0.01, "c20": 0.002})


@pytest.fixture(scope="module")
def results(identified, tmp_path_factory):
    """A folder with the results of `vpp identify` for such a plant."""
    folder = tmp_path_factory.mktemp("identified")
    identified.save(folder)
    error = {"steady": 0.1, "moving": 0.04, "freedom": 20}
    fitted = {name: {"value": e.value} for name, e in identified.estimates.items()}
    content = {"noise_floor_thrust": 0.13, "model_error": error, "effects": [], "parameters": fitted}
    (folder / "identification.json").write_text(json.dumps(content))
    (folder / "profile.csv").write_text("time,thrust_set\n0,2\n1,6\n3,4\n4,4\n")
    return folder


def test_values_come_from_the_band_and_the_identification(identified):
    values = adaptive(adaptable(identified, "here"), BAND).values
    steady = 0.1 * t.isf(0.025, 20.0) / 1.96
    assert values["steady"] == pytest.approx(steady)
    assert (values["white"], values["slow"], values["moving"]) == (0.12, 0.05, 0.04)
    assert values["threshold"] == threshold(0.01, sums(3), DT)
    assert values["change.sensor_drift.offset"] == 0.1
    assert values["change.tau_beta_2"] == values["prior.tau_beta_2"] == pytest.approx(0.15)
    chosen = adaptive(adaptable(identified, "here"), BAND, ["c20"]).values
    assert chosen["prior.c20"] == 0.002


def test_the_plants_effects_keep_their_places():
    wider = adaptable(ParameterSet(plant(["pitch_backlash", "pitch_offset"])), "here").model
    assert [e.name for e in wider.effects] == [
        e.name for e in plant(["pitch_backlash", *(n.split(".")[0] for n in DAILY)]).effects
    ]


def test_missed_ticks_are_simulated_with_the_last_inputs(identified):
    twin = adaptive(adaptable(identified, "here"), BAND)
    one, other = Adaptive(twin, DT), Adaptive(twin, DT)
    for each in (one, other):
        each.start(0.0, 3000.0, 0.0, 2.0, 3000.0)
        each.update(DT, 5000.0, 4.0, 2.0, 3000.0)
    for k in range(2, 8):
        one.update(k * DT, 5000.0, 4.0, 2.0, 3000.0)
    assert one.update(8 * DT, 4000.0, 2.0, 3.0, 3500.0) == other.update(8 * DT, 4000.0, 2.0, 3.0, 3500.0)


def test_export_and_cosim(results, tmp_path, printed):
    """Beside the plant of which it is made, the twin has no residual and no alarm, in both flavours."""
    printed("export", "--parameters", results / "parameters.json", "--twin", "--flavour", "both", "-o", tmp_path / "fmus")
    runs = []
    for flavour in ("", ".native"):
        plant_fmu, controller, twin = (tmp_path / "fmus" / f"Vpp{n}{flavour}.fmu" for n in ("Plant", "Controller", "Twin"))
        loop = ["--twin", twin, "--profile", results / "profile.csv", "-o", tmp_path / f"run{flavour}"]
        printed("cosim", plant_fmu, controller, *loop)
        runs.append((tmp_path / f"run{flavour}" / "run.csv").read_bytes())
        assert "Adapted parameters" in (tmp_path / f"run{flavour}" / "report.html").read_text()
    assert runs[0] == runs[1]
    columns = np.genfromtxt(tmp_path / "run" / "run.csv", delimiter=",", names=True, deletechars="")
    assert not np.any(columns["residual"])
    assert not np.any(columns["alarm"])
    with zipfile.ZipFile(tmp_path / "fmus" / "VppTwin.fmu") as packed:
        assert "acknowledge" in packed.read("modelDescription.xml").decode()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["export", "--twin"], "--parameters"),
        (["export", "--adapt", "c20"], "--twin"),
        (["export", "--parameters", "{}/parameters.json", "--twin", "--adapt", "tau_gamma"], "tau_gamma"),
        (["export", "--parameters", "{}/parameters.json", "--twin", "{}/profile.csv"], "profile.csv"),
        (["hil", "run", "--rig", "emulated", "--virtual", "--profile", "{}/profile.csv", "--adapt", "c20"], "--twin"),
    ],
    ids=["no parameters", "nothing to adapt", "no such parameter", "no identification", "hil without a twin"],
)
def test_bad_input_is_one_clear_line(words, said, results, tmp_path, refused):
    assert said in refused(*(word.format(results) for word in words), "-o", tmp_path / "out")


def test_it_runs_in_the_loop_of_a_rig(results, tmp_path, capsys):
    rig = ["--rig", "emulated", "--virtual", "--parameters", str(results / "parameters.json"), "--twin"]
    assert main(["hil", "run", *rig, "--profile", str(results / "profile.csv"), "-o", str(tmp_path)]) in (0, 3)
    (folder,) = (tmp_path / "runs").iterdir()
    assert "adaptive twin: " in capsys.readouterr().out
    head, *rows = (folder / "log.csv").read_text().splitlines()
    names, last = head.split(","), [row.split(",") for row in rows]
    at = names.index("twin.adapted.sensor_gain.gain")
    shown = [float(row[at]) for row in last if row[at]]
    assert len(shown) == pytest.approx(4.0 / DT, abs=2)
    assert 0.5 < shown[-1] < 1.5
    content = json.loads((folder / "hil.json").read_text())
    assert content["adaptive_twin"]["microseconds"] > 0.0
    assert content["adaptive_twin"]["certain"] == CERTAIN
    adapted = content["adaptive_twin"]["adapted"]
    assert [f"twin.adapted.{name}" for name in adapted] == [name for name in names if name.startswith("twin.adapted.")]
    lag = adapted["tau_beta_2"]
    assert (lag["start"], lag["change"], lag["unit"]) == (0.3, pytest.approx(0.15), "s")
    assert "Adapted parameters" in (folder / "report.html").read_text()
