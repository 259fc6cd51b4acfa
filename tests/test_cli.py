"""The command: the whole job from the shell, and one line for whatever is wrong."""

import json
import re

import numpy as np
import pytest

from vpp_fmu.cli import VERBS, main
from vpp_fmu.record import read_record

GOOD = "time,omega_ref,beta_ref,thrust\n0,4000,5,5\n0.004,4000,5,5.1\n0.008,4100,5,5.2\n"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A folder with both FMUs of the paper's model and the parameters they came from."""
    folder = tmp_path_factory.mktemp("exported")
    parameters = folder / "parameters.json"
    entry = {"value": 0.05, "std": None, "unit": "s"}
    content = {"format": "vpp-parameters/1", "parameters": {"tau_beta_2": entry}, "effects": [], "source": {}}
    parameters.write_text(json.dumps(content))
    assert main(["export", "--parameters", str(parameters), "-o", str(folder)]) == 0
    return folder


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_every_verb_has_an_example(verb, capsys):
    with pytest.raises(SystemExit) as left:
        main([verb, "--help"])
    assert left.value.code == 0
    assert f"vpp {verb}" in capsys.readouterr().out.split("example:")[1]


HEADER, ROW_1, ROW_2, ROW_3 = GOOD.splitlines()
BAD_RECORDS = [
    ("column beta_ref", GOOD.replace("beta_ref", "pitch"), "beta_ref"),
    ("line 3", GOOD.replace("0.004,4000,5,", "0.004,nan,5,"), "omega_ref"),
    ("goes back", "\n".join([HEADER, ROW_1, ROW_3, ROW_2, ""]), "time"),
    ("-90 to 90 deg", GOOD.replace("4000,5,5\n", "4000,500,5\n"), "beta_ref"),
    ("an empty file", "", "file"),
]


@pytest.mark.parametrize(("says", "text", "field"), BAD_RECORDS)
def test_bad_record_is_one_line_and_exit_2(says, text, field, exported, tmp_path, capsys):
    record = tmp_path / "record.csv"
    record.write_text(text)
    capsys.readouterr()
    code = main(["simulate", str(record), "--parameters", str(exported / "parameters.json"), "-o", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert code == 2
    assert said.count("\n") == 1
    for word in (str(record), field, says, "found", "allowed"):
        assert word in said
    assert not (tmp_path / "out" / "prediction.csv").exists()


def bad_calls(exported, tmp_path):
    parameters = json.loads((exported / "parameters.json").read_text())
    unknown = tmp_path / "unknown.json"
    unknown.write_text(json.dumps(parameters | {"parameters": {"tau_gamma": {"value": 1.0, "std": None, "unit": "s"}}}))
    not_fmu = tmp_path / "not.fmu"
    not_fmu.write_text("no zip")
    profile = tmp_path / "profile.csv"
    profile.write_text("time,thrust_set\n0,1.5\n0.1,1.5\n")
    wall = tmp_path / "wall"
    wall.write_text("a file where a folder is wanted")
    plant, controller = str(exported / "VppPlant.fmu"), str(exported / "VppController.fmu")
    loop = ["--profile", str(profile)]
    return {
        "unknown parameter": (["export", "--parameters", str(unknown), "-o", str(tmp_path)], ("unknown.json", "tau_gamma")),
        "not an FMU": (["cosim", str(not_fmu), controller, *loop, "-o", str(tmp_path)], ("not.fmu", "FMI 2.0")),
        "roles swapped": (["cosim", controller, plant, *loop, "-o", str(tmp_path)], ("VppController.fmu", "omega_ref")),
        "no such file": (["cosim", "nowhere.fmu", controller, *loop, "-o", str(tmp_path)], ("nowhere.fmu", "no such file")),
        "step": (["cosim", plant, controller, *loop, "--step", "0", "-o", str(tmp_path)], ("--step", "1e-06 to 1 s")),
        "unwritable": (["export", "-o", str(wall / "below")], ("wall", "output folder")),
        "no campaign": (["identify", str(tmp_path / "none"), "-o", str(tmp_path)], ("none", "campaign folder")),
    }


CALLS = ("unknown parameter", "not an FMU", "roles swapped", "no such file", "step", "unwritable", "no campaign")


@pytest.mark.parametrize("case", CALLS)
def test_bad_call_is_one_line_and_exit_2(case, exported, tmp_path, capsys):
    arguments, words = bad_calls(exported, tmp_path)[case]
    capsys.readouterr()
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for word in (*words, "found", "allowed"):
        assert word in said


def test_cosim_writes_the_paper_s_step(exported, tmp_path, capsys):
    """The paper's step 0.1 -> 0.8 settles in 0.40 to 0.50 s, through both FMUs and from the shell."""
    profile = tmp_path / "profile.csv"
    profile.write_text("time,thrust_set\n0,1.5\n3.32,12\n6,12\n")
    files = [str(exported / name) for name in ("VppPlant.fmu", "VppController.fmu")]
    assert main(["cosim", *files, "--profile", str(profile), "-o", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    settled = float(said.split("has settled after ")[1].split(" s")[0])
    assert 0.40 <= settled <= 0.50
    run = read_record(tmp_path / "out" / "run.csv", ("time", "thrust_set", "thrust", "omega_ref", "beta_ref", "omega", "beta"))
    assert run["thrust"][-1] == pytest.approx(12.0, abs=0.02 * 10.5)
    assert "<figure>" in (tmp_path / "out" / "report.html").read_text()


def test_prediction_compares_equal_with_itself(exported, tmp_path, capsys):
    record = tmp_path / "record.csv"
    time = np.arange(500) * 0.004
    rows = [f"{t:.3f},{4000 + 500 * (t > 1):.0f},5" for t in time]
    record.write_text("time,omega_ref,beta_ref\n" + "\n".join(rows) + "\n")
    out = tmp_path / "out"
    assert main(["simulate", str(record), "--parameters", str(exported / "parameters.json"), "-o", str(out)]) == 0
    prediction = str(out / "prediction.csv")
    assert main(["compare", prediction, prediction, "-o", str(out)]) == 0
    figures = json.loads((out / "comparison.json").read_text())["columns"]
    assert figures["thrust"] == {"rms": 0.0, "mean": 0.0, "largest": 0.0}
    assert main(["compare", prediction, str(record), "-o", str(out)]) == 0
    assert "replaced in" in capsys.readouterr().out


def test_demo_does_the_whole_job(tmp_path, capsys):
    assert main(["demo", "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    before, after = map(float, re.search(r"FMU in fmpy: ([\d.]+) → ([\d.]+) N", said).groups())
    floor = float(said.split("noise of one reading ")[1].split(" N")[0])
    assert floor < after < before < 2 * floor  # the example's model lacks something, but not more than the noise itself
    for name in (
        *("parameters.json", "parameters.ssv", "parameters_base.json", "identification.json", "diagnosis.json", "report.html"),
        *("VppPlant.fmu", "VppPlant_base.fmu", "VppController.fmu", "VppLoop.ssp", "gains.json", "run_dual.csv"),
    ):
        assert (tmp_path / name).stat().st_size > 0
    found = json.loads((tmp_path / "diagnosis.json").read_text())
    for told, entry in ((before, found["before"]), (after, found["after"])):
        assert told == pytest.approx(entry["rmse_thrust"], abs=5.1e-4)  # three digits are printed
