"""The table of degenerate campaigns in short: the quickest rows of `python -m tests.studies degenerate`."""

import json

import numpy as np
import pytest
from studies.degenerate import LONG, NEEDED, Row, judged, line, rows, show, valid
from studies.incomplete_campaigns import CASES

from identification.assessment.prediction import Prediction
from identification.assessment.reading_noise import reading_noise
from identification.fit.noise import noise_from
from vpp_fmu.app.cli import VERBS
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.record import Record, read_record

IDENTIFIED = (
    *("fixed pitch", "one move only", "static map only", "steps only", "raw steady samples only", "validation only"),
    *(
        "no move at all",
        "no move beside map and steps",
        "thrust of a section empty",
        "speed all empty",
        "static of one point",
        "static of zeros",
        "gaps",
        "no noise",
    ),
)
REFUSED = {
    "no move of a rotor at rest": "no identifiable parameter",
    "raw samples that never rest": "steady stretches",
    "steps without a step": "it is constant at 2400 rpm while omega runs from",
    "dead load cell": "look at the load cell",
}
FEW = {"diagnose": ("--effects", "pitch_delay,sensor_drift"), "identify": ("--starts", "1")}
"""Options that save time: a diagnosis among two effects, an identification from one start."""


def checked(names, verbs, folder) -> list[Row]:
    found = list(rows(names, verbs, folder, FEW))
    assert not [line(row) for row in found if row.fault]
    return found


@pytest.mark.parametrize("name", IDENTIFIED)
def test_identify_writes_its_files_and_names_parameters_that_are_not_identifiable(name, tmp_path):
    found = checked([name], ("identify", "simulate", "compare"), tmp_path)
    assert [row.verb for row in found][:1] == ["identify"]
    assert "told" in found[0].outcome
    assert all(not row.outcome.startswith("exit") for row in found)


def test_a_record_at_rest_is_not_called_a_poor_fit(tmp_path):
    """One thrust at one point is known as well as the mean of the readings; there is no response that a fit could miss."""
    checked(["no move at all"], ("identify",), tmp_path)
    (folder,) = tmp_path.iterdir()
    found = json.loads((folder / "identify" / "identification.json").read_text())
    assert {f["code"] for f in found["quality"]} == {"no_move", "thin"}
    records = [read_record(folder / f"{name}.csv") for name in ("open_loop", "repeat")]
    (c20,) = found["parameters"].values()
    shares = [r["thrust"] - r["thrust"].mean() for r in records]
    mean = np.std(np.concatenate(shares)) / np.sqrt(sum(map(len, shares)))  # N, of white noise
    w = records[0]["omega_ref"][0] / 6000.0
    assert c20["std"] == pytest.approx(mean / (15.0 * w**2), rel=0.15)


@pytest.mark.parametrize("method", ["gradient-descent", "adjoint"])
def test_every_method_writes_its_files(method, tmp_path):
    options = {"identify": ("--starts", "1", "--method", method)}
    (found,) = rows(["fixed pitch"], ("identify",), tmp_path, options)
    assert not found.fault
    told = found.outcome.partition("not ")[2].partition(";")[0].split(", ")
    assert sorted(told) == ["c12", "c21", "tau_beta_1", "tau_beta_2"]


@pytest.mark.parametrize("name", REFUSED)
def test_a_campaign_without_information_is_refused_in_one_line(name, tmp_path):
    found = checked([name], ("identify", "diagnose"), tmp_path)
    assert [row.verb for row in found] == ["identify", "diagnose"]
    assert all(row.outcome.startswith("exit 2: ") for row in found)
    assert REFUSED[name] in found[0].outcome


@pytest.mark.parametrize("name", ["one move only", "no move at all", "record of 2 s", "static map only"])
def test_diagnose_writes_its_files_or_is_refused_in_one_line(name, tmp_path):
    (found,) = checked([name], ("diagnose",), tmp_path)
    assert found.outcome.startswith(
        "exit 2: " if name == "static map only" else ("none", "unexplained", "partly", "attributed")
    )


def test_readings_that_repeat_to_the_last_digit_have_the_noise_of_that_digit():
    time = np.arange(1000) * 0.004
    thrust = np.round(5.0 + np.sin(time), 2)
    record = Record({"time": time, "omega_ref": time, "beta_ref": time, "thrust": thrust}, "made up")
    shown = Prediction(record, thrust, time, time)
    assert reading_noise([shown, shown], None, BASE.values()).std == pytest.approx(0.01 / np.sqrt(12.0))
    noise = noise_from(record, [np.zeros(1000)] * 2, [], 0.016, 10.0, 0.0, verified=True)
    assert np.isfinite(noise.colour.whiten(np.linspace(0.0, 1.0, 50))).all()
    assert noise.slow > 0.0


def test_the_table_has_rows_of_every_size_and_verbs_that_exist():
    assert len(CASES) >= 25
    assert set(NEEDED) - {"check"} <= set(VERBS)
    assert {case.size for case in CASES.values()} == {"micro", "paper", "big"}


def test_the_table_detects_every_kind_of_fault(tmp_path, monkeypatch, capsys):
    """A verb that crashes, warns, writes NaN, prints two lines or omits a file."""
    import studies.degenerate as table

    def verb(does):
        def run(arguments):
            folder = tmp_path / arguments[-1]
            folder.mkdir(exist_ok=True)
            return does(folder)

        monkeypatch.setattr(table, "vpp", run)
        return judged("compare", "made up", ["A", "B"], tmp_path / does.__name__)

    def crashes(folder):
        raise KeyError("thrust")

    def warns(folder):
        return int(np.nanmean([np.nan]))

    def nan(folder):
        (folder / "comparison.json").write_text('{"rms": NaN}')
        (folder / "report.html").write_text("")
        return 0

    def leaves_out(folder):
        (folder / "comparison.json").write_text("{}")
        return 0

    def silent(folder):
        return 2

    found = {does.__name__: verb(does) for does in (crashes, warns, nan, leaves_out, silent)}
    assert found["crashes"].fault == found["warns"].fault == "traceback"
    assert "KeyError" in found["crashes"].outcome
    assert found["nan"].fault == "invalid JSON: comparison.json"
    assert found["leaves_out"].fault == "no report.html"
    assert found["silent"].fault == "exit 2 with 0 lines"
    show(list(found.values()))
    said = capsys.readouterr().out
    assert "tracebacks 2" in said
    assert "invalid JSON 1" in said
    good = tmp_path / "good.json"
    good.write_text(json.dumps(dict.fromkeys(LONG)))
    assert valid(good)
