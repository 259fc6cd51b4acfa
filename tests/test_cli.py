"""The command line: loops, comparisons, misspelt words, progress, and the sentences about steps."""

import json

import numpy as np
import pytest

from vpp_fmu.app.cli import VERBS, main, parser_of
from vpp_fmu.app.report.pages.loop import sentence
from vpp_fmu.record import Record, read_record
from vpp_fmu.response import steps


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


def test_cosim_writes_the_paper_s_step(exported, tmp_path, printed):
    """The paper's step 0.1 -> 0.8 settles in 0.40 to 0.50 s, through both FMUs and from the shell."""
    profile = tmp_path / "profile.csv"
    profile.write_text("time,thrust_set\n0,1.5\n3.32,12\n6,12\n")
    files = [str(exported / name) for name in ("VppPlant.fmu", "VppController.fmu")]
    said = printed("cosim", *files, "--profile", profile, "-o", tmp_path / "out")
    settled = float(said.split("has settled after ")[1].split(" s")[0])
    assert 0.40 <= settled <= 0.50
    run = read_record(tmp_path / "out" / "run.csv", ("time", "thrust_set", "thrust", "omega_ref", "beta_ref", "omega", "beta"))
    assert run["thrust"][-1] == pytest.approx(12.0, abs=0.02 * 10.5)
    assert "<figure>" in (tmp_path / "out" / "report.html").read_text()


def test_prediction_compares_equal_with_itself(exported, tmp_path, printed):
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
    assert "replaced in" in printed("compare", prediction, record, "-o", out)


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["identfy", "mine"], "Did you mean identify?"),
        (["plan", "--parm", "out"], "Did you mean --parameters?"),
        (["hil", "run", "--profil-e", "step.csv"], "Did you mean --profile?"),
        (["hil", "campain"], "Did you mean campaign?"),
        (["diagnose", "mine", "--effects", "pitch_backlsh"], "Did you mean pitch_backlash?"),
        (["hil", "campaign", "--virtual", "--hide", "rod_stuk"], "Did you mean rod_stuck?"),
    ],
)
def test_a_misspelt_word_is_refused_with_the_nearest_one(words, meant, refused):
    assert meant in refused(*words)


@pytest.mark.parametrize("verb", ["tune", "export", "plan", "simulate", "diagnose", "twin", "hil run", "hil campaign"])
def test_a_folder_of_parameters_stands_for_its_parameters_json(verb, tmp_path):
    (tmp_path / "parameters.json").touch()
    more = {"simulate": ["r.csv"], "diagnose": ["mine"], "twin": ["day"], "hil run": ["--profile", "p.csv"]}.get(verb, [])
    verb, *what = verb.split()
    options = parser_of(verb)[0].parse_args([*what, *more, "--parameters", str(tmp_path)])
    assert options.parameters == str(tmp_path / "parameters.json")


LIMITS = {"omega_ref": (0.0, 5573.0), "beta_ref": (0.5, 13.6)}


def stepped(omega, beta, thrust):
    """A run of 10 s whose set-point goes from 2 to 12 N at 2 s."""
    time = np.arange(101) / 10.0
    wanted = np.where(time < 2.0, 2.0, 12.0)
    columns = {"omega_ref": omega, "beta_ref": beta, "thrust": thrust}
    own = {name: np.broadcast_to(value(time), time.shape) for name, value in columns.items()}
    return Record({"time": time, "thrust_set": wanted, **own}, "a step")


def rises_to(level, tau):
    return lambda time: np.where(time < 2.0, 2.0, level - (level - 2.0) * np.exp(-np.maximum(time - 2.0, 0.0) / tau))


@pytest.mark.parametrize(
    ("omega", "thrust", "said"),
    [
        (5573.0, rises_to(11.2, 0.3), ": the set-point of 12 N is out of reach: 11.2 N at 5573 rpm, 13.6 deg"),
        (5000.0, rises_to(11.2, 0.3), " has not settled by the end of the run"),  # the speed has room
        (5573.0, rises_to(12.0, 5.0), " has not settled by the end of the run"),  # the thrust is on its way
        (5573.0, rises_to(12.0, 0.3), " has settled after 1.2 s"),
    ],
)
def test_a_set_point_out_of_reach_is_reported_with_the_thrust_reached(omega, thrust, said):
    """Out of reach: both commands on a limit, and the thrust at rest beside the set-point."""
    (step,) = steps(stepped(lambda time: omega, lambda time: 13.6, thrust), limits=LIMITS)
    assert sentence(step).startswith(f"The step from 2 to 12 N at 2 s{said}")
