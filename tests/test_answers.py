"""The answer of each verb: an object that its schema describes, a sentence in the first line, --quiet; its report as seen."""

import base64
import io
import json
import math
import re
import shlex
import shutil
import sys
from functools import cache, partial
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from builders import shorten_tuning
from jsonschema import Draft202012Validator
from test_allocation import points
from test_rcbenchmark import truth, write

from hil.emulator.rig import CALIBRATION
from identification.diagnose.diagnose import diagnose
from tests.browser import browser as opened
from vpp_fmu.app.cli import VERBS, main, parser_of
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.campaign import read_campaign, write_static
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import LIBRARY

SCHEMAS = {path.name.removesuffix(".json"): json.loads(path.read_text()) for path in files("vpp_fmu.app.cli.schemas").iterdir()}
FEW = ("--effects", "pitch_command_deadband,pitch_backlash")
SHORT = ("--parts", "static", "validation", "--points", "2", "--samples", "20", "--validation-seconds", "5")

CALLS = {
    "check": ("check", "campaign", "-o", "checked"),
    "check, template": ("check", "--template", "template"),
    "identify": ("identify", "campaign", "--starts", "1", "-o", "identified"),
    "diagnose": ("diagnose", "campaign", *FEW, "-o", "out"),
    "diagnose, fleet": ("diagnose", "campaign", "campaign", *FEW, "--workers", "1", "-o", "fleet"),
    "simulate": ("simulate", "campaign", "--parameters", "out", "-o", "predicted"),
    "compare": ("compare", "campaign/validation.csv", "predicted", "-o", "compared"),
    "export": ("export", "--parameters", "out", "--twin", "out", "-o", "fmus"),
    "cosim": ("cosim", "fmus", "fmus", "--twin", "fmus", "--profile", "step.csv", "-o", "loop"),
    "tune": ("tune", "--parameters", "identified", "--assume", "tau_beta_2=0.05", "-o", "tuned"),
    "cosim, tuned": ("cosim", "fmus", "fmus", "--profile", "tuned", "-o", "loop_tuned"),
    "plan": ("plan", "--parameters", "identified", "--seconds", "20", "-o", "next"),
    "learn": ("learn", "out", "--generations", "3", "--plants", "4", "--gains", "tuned", "--knowledge", "out", "-o", "learned"),
    "identify, power": ("identify", "power", "-o", "powered"),
    "allocate": ("allocate", "--parameters", "powered", "--points", "5", "-o", "pairs"),
    "effects": ("effects",),
    "check-effect": ("check-effect", "my_effect.py"),
    "cache": ("cache",),
    "import-csv": ("import", "csv", "log.csv", "-o", "mine", "--as", "open_loop"),
    "import-rcbenchmark": ("import", "rcbenchmark", "stand.csv", "-o", "stand"),
    "export, policy": ("export", "--parameters", "out", "--policy", "learned", "--gains", "tuned", "-o", "laws"),
    "hil-run": ("hil", "run", "--parameters", "out", "--twin", "out", "--profile", "step.csv", "--virtual", "-o", "run"),
    "hil-run, fmu": ("hil", "run", "--rig", "fmu", "fmus", "--controller", "fmus", "--profile", "step.csv", "-o", "run_fmu"),
    "hil-campaign": ("hil", "campaign", "--virtual", *SHORT, "-o", "measured"),
    "hil-calibrate": ("hil", "calibrate", "--virtual", "--parts", "pitch", "--answers", "answers.txt", "-o", "calibrated"),
    "hil-selftest": ("hil", "selftest", "--virtual", "--seconds", "1", "-o", "tested"),
    "hil-report": ("hil", "report", "RUN"),
    "hil-replay": ("hil", "replay", "run", "fmus", "-o", "replayed"),
    "twin": ("twin", "day", "--virtual", "--rounds", "1", "--policy", "fixed", "--parameters", "out"),
    "demo": ("demo", "-o", "demo"),
}
"""Words by schema, in an order in which each call finds the files of earlier ones."""

ALARMED = {"hil-run"}
"""Calls that end with the exit code of an alarm: the emulated rig is another one than that of the campaign."""

SAME = {
    "check": "checked/check.json",
    "identify": "identified/identification.json",
    "diagnose": "out/diagnosis.json",
    "compare": "compared/comparison.json",
    "tune": "tuned/tuning.json",
    "plan": "next/plan.json",
    "learn": "learned/learning.json",
    "allocate": "pairs/allocation.json",
    "hil-run, fmu": "run_fmu/hil.json",
    "hil-campaign": "measured/hil.json",
    "hil-calibrate": "calibrated/calibration.json",
    "hil-selftest": "tested/hil.json",
    "hil-replay": "replayed/replay.json",
    "twin": "day/day.json",
}
"""Files with the same object."""


def given(folder):
    """The files of a user."""
    (folder / "step.csv").write_text("time,thrust_set\n0,1.5\n2,12\n4,12\n")
    rows = [f"{4 * k},{4000 + 500 * (k // 500)},{5 + (k // 250) % 2},{6 + 0.1 * math.sin(k)}" for k in range(2000)]
    (folder / "log.csv").write_text("\n".join(["t [ms],cmd [rpm],pitch [deg],Fz [N]", *rows, ""]))
    write(folder / "stand.csv", truth())
    readme = (files("vpp_fmu") / ".." / "README.md").read_text()
    (folder / "my_effect.py").write_text(re.search(r"file: my_effect.py -->\s+```python\n(.*?)```", readme, re.S)[1])
    pitches = [f"{pitch:g}" for pitch in json.loads(CALIBRATION.read_text())["pitch"]["table"]["pitch"]["values"]]
    (folder / "answers.txt").write_text("\n".join(["", "", *pitches, *reversed(pitches), ""]))


class Said:
    """All calls of CALLS, run once: exit code, standard output and error, and the answer."""

    def __init__(self, folder):
        self.folder, self.calls, self.answers = folder, {}, {}

    def run(self, name, monkeypatch):
        words = [str(next((self.folder / "run").rglob("log.csv*")).parent) if w == "RUN" else w for w in CALLS[name]]
        out, err = io.StringIO(), io.StringIO()
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", out)
            patch.setattr(sys, "stderr", err)
            patch.setattr(Answer, "printed", self._kept(name, Answer.printed))
            code = main([*words, "--json"])
        self.calls[name] = code, out.getvalue(), err.getvalue()

    def _kept(self, name, printed):
        def kept(answer, options):
            self.answers[name] = answer
            return printed(answer, options)

        return kept


@pytest.fixture(scope="module")
def said(short_campaign, short_waits, tmp_path_factory):
    found = Said(tmp_path_factory.mktemp("answers"))
    given(found.folder)
    shutil.copytree(short_campaign, found.folder / "campaign")
    library = tuple(e for e in LIBRARY if e.off is None or e.name in FEW[1])
    quick = partial(diagnose, library=library, thorough=False)
    diagnosed = cache(lambda folder: quick(read_campaign(folder), workers=1))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(found.folder)
        patch.setenv("SOURCE_DATE_EPOCH", "0")
        (found.folder / "power").mkdir()
        write_static(OutputFolder(found.folder / "power"), points())
        shorten_tuning(patch.setattr)
        patch.setattr("identification.demo.example_folder", lambda: found.folder / "campaign")
        patch.setattr("vpp_fmu.app.cli.demo.example_folder", lambda: found.folder / "campaign")
        for command in ("vpp_fmu.app.api.diagnose.diagnosed", "identification.demo.diagnose"):
            patch.setattr(command, lambda campaign, *_, **__: diagnosed(campaign.folder.resolve()))
        patch.setattr("vpp_fmu.app.api.rounds.diagnose", quick)
        patch.setattr("vpp_fmu.app.day.MISSION", 6.0)
        for name in CALLS:
            found.run(name, patch)
    return found


@pytest.mark.parametrize("name", CALLS)
def test_json_is_one_object_that_its_schema_describes(said, name):
    code, out, err = said.calls[name]
    assert (code, "Traceback" in err) == (3 * (name in ALARMED), False), err
    found = json.loads(out)
    Draft202012Validator(SCHEMAS[name.partition(",")[0]]).validate(found)
    assert found.pop("sentence") == said.answers[name].text
    if name in SAME:
        assert found == json.loads((said.folder / SAME[name]).read_text())


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_schema_is_valid_and_has_a_call(name):
    Draft202012Validator.check_schema(SCHEMAS[name])
    assert name in {call.partition(",")[0] for call in CALLS} | {"error"}  # its calls are below
    assert SCHEMAS[name]["title"].startswith(f"vpp {name.replace('-', ' ') if name != 'check-effect' else name}: ")


def test_every_verb_has_a_schema_but_the_one_that_prints_a_script():
    own = {name if name == "check-effect" else name.partition("-")[0] for name in SCHEMAS}
    assert set(VERBS) - own == {"completion"}


@pytest.mark.parametrize("name", sorted({*CALLS} - {"effects"}))  # its answer is a list
def test_the_first_line_is_a_sentence(said, name):
    text = said.answers[name].text
    assert "\n" not in text
    assert text.endswith(".") or name == "cache"
    assert not re.search(r"\bnan\b|None|inf\b", text)
    assert 15 < len(text) < 400


def test_the_answer_of_a_diagnosis_is_the_effect_and_the_errors_of_its_file(said):
    found = json.loads((said.folder / "out" / "diagnosis.json").read_text())
    (effect,), before, after = found["effects"], found["before"]["rmse_thrust"], found["after"]["rmse_thrust"]
    width, noise = effect["parameters"]["half_width"]["value"], found["noise_floor_thrust"]
    errors = f"Unseen thrust error {before:.3f} -> {after:.3f} N; noise {noise:.3f} N."
    wanted = f"The pitch servo ignores changes below {width:.2f} deg (dead band). {errors}"
    assert said.answers["diagnose"].text == wanted
    assert wanted.replace("->", "→") in _page(said, "out")
    unseen = json.loads((said.folder / "identified" / "identification.json").read_text())["rmse_thrust"]["validation"]
    assert said.answers["identify"].text.startswith(f"Unseen thrust error {unseen:.3f} N on validation; noise ")
    assert said.answers["identify"].text.replace("->", "→") in _page(said, "identified")


def _page(said, folder):
    """The text of a report; on the page numbers do not break from their units."""
    return (said.folder / folder / "report.html").read_text().replace("\xa0", " ")


NUMBERS = {
    "simulate": ("rmse_thrust",),
    "cosim": ("steps", 0, "settling"),
    "allocate": ("best_fixed_pitch", "value"),
    "learn": ("held_out", "policy", "squared_error_mean"),
    "tune": ("controllers", "dual", "tuned", "cost"),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_the_first_line_shows_the_number_of_the_json_object(said, name):
    found = json.loads(said.calls[name][1])
    for key in NUMBERS[name]:
        found = found[key]
    shown = [float(x) for x in re.findall(r"\d+\.?\d*", said.answers[name].text)]
    assert any(x == pytest.approx(found, rel=6e-3) for x in shown)


NOWHERE = {"file": "nowhere.csv", "field": "file", "found": "no such file", "expected": "a file that exists", "try": None}
SEED = {"file": "command line", "field": "--seed", "found": "-1", "expected": "a whole number from 0 to 4294967295"}


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("compare", "nowhere.csv", "nowhere.csv"), NOWHERE),
        (("hil", "run", "--profile", "nowhere.csv"), NOWHERE),
        (("identify", "mine", "--seed", "-1"), SEED | {"try": "vpp identify --help"}),
        (("nothing",), {"file": "command line", "field": "VERB", "expected": None, "try": "vpp --help"}),
        (("cosim", "a.fmu"), {"found": "the following arguments are required: CONTROLLER, --profile"}),
        (("check", "--template", "a/b"), {"file": "a/b", "field": "output folder"}),
    ],
)
def test_an_error_with_json_is_an_object_of_its_parts(words, parts, tmp_path, monkeypatch, capsys):
    """Before and after the options are parsed, and from the system."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").touch()
    assert main([*words, "--json"]) == 2
    out, err = capsys.readouterr()
    Draft202012Validator(SCHEMAS["error"]).validate(found := json.loads(out))
    assert parts.items() <= found["error"].items()
    assert err == found["sentence"] + "\n"
    assert main([*words]) == 2
    assert capsys.readouterr() == ("", err)


SILENT = ("effects", "check-effect", "cache")
"""Calls that write no file."""


@pytest.mark.parametrize("name", sorted({*CALLS} - {*SILENT}))
def test_each_verb_ends_with_a_next_command_that_reads_its_files(said, name, monkeypatch):
    monkeypatch.chdir(said.folder)
    assert said.answers[name].written[-1].startswith("next: ")
    first, *words = shlex.split(said.answers[name].written[-1].removeprefix("next: "))
    if first == "vpp":
        parser_of(words[0])[0].parse_args(words[1:])
    else:
        assert (first, words[0]) in {("fmpy", "simulate"), ("python", "-m")}
    output = words[words.index("-o") + 1] if "-o" in words else None
    read = [word for word in words if word != output and ("/" in word or Path(word).is_dir())]
    assert read
    assert all(Path(word).exists() for word in read)


FOLLOWED = ("check, template", "simulate", "tune", "demo", "plan", "allocate", "import-csv", "hil-calibrate")


@pytest.mark.parametrize("name", FOLLOWED)
def test_the_next_command_succeeds(said, name, monkeypatch, tmp_path):
    monkeypatch.chdir(said.folder)
    first, *words = shlex.split(said.answers[name].written[-1].removeprefix("next: "))
    if "-o" in words:
        words[words.index("-o") + 1] = str(tmp_path / "next")
    assert (first, main(words)) == ("vpp", 0)


SMALL = ("compare", "campaign/validation.csv", "predicted", "-o", "again")


def test_quiet_prints_the_answer_alone(said, monkeypatch, capsys):
    monkeypatch.chdir(said.folder)
    for words in (("--quiet", *SMALL), (*SMALL, "--quiet"), ("hil", "--quiet", *CALLS["hil-run, fmu"][1:])):
        assert main([*words]) == 0
        out, err = capsys.readouterr()
        assert (out.count("\n"), err) == (1, "")


REPORTS = {name for name in CALLS if "-o" in CALLS[name]} - {"check", "simulate", "export", "import-csv", "import-rcbenchmark"}
REPORTS = sorted(REPORTS - {"export, policy", "cosim, tuned"} | {"twin"})
"""Calls that write a report."""


def report(said, name):
    words = CALLS[name]
    return said.folder / (words[words.index("-o") + 1] if "-o" in words else words[1]) / "report.html"


def figures(path) -> list[dict]:
    """The figures of a report, as `draw` receives them."""
    found = [json.loads(text) for text in re.findall(r"<script>draw\('figure-\d+',(.*)\)</script>", path.read_text())]
    arrays = [np.frombuffer(base64.b64decode(text), np.float32) for spec in found for text in spec["arrays"]]
    for spec in found:
        for mark in spec["marks"]:
            mark |= {side: arrays[mark[side]] for side in "xy" if isinstance(mark[side], int)}
    return found


@pytest.mark.parametrize("name", REPORTS)
def test_every_axis_names_its_quantity_and_unit(said, name):
    for spec in figures(report(said, name)):
        titles = [axis["title"] for axis in spec["axes"].values() if axis["kind"] != "category"]  # whose labels are names
        assert all(re.search(r"\w.*\[.+\]$", title) for title in titles), titles


def test_a_report_has_few_figures_and_is_small(said):
    for name, most in (("demo", 10), ("diagnose", 7)):
        assert 4 <= len(figures(report(said, name))) <= most
    assert max(report(said, name).stat().st_size for name in REPORTS) < 1.5e6


def test_all_times_of_a_run_count_from_the_start_of_its_profile(said):
    for spec in figures(report(said, "hil-run")):
        times = np.concatenate([mark["x"] for mark in spec["marks"]])
        assert (times.min(), times.max()) == (0.0, pytest.approx(4.0, abs=0.1))


READERS = {"phone": (390, 844), "desk": (1100, 900)}
FAULTS, CONTRAST = (Path(__file__).with_name(f"page_{what}.js").read_text() for what in ("faults", "contrast"))


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with opened(tmp_path_factory.mktemp("profile")) as tab:
        yield tab


@pytest.mark.parametrize("name", REPORTS)
def test_nothing_overlaps_is_cut_off_or_empty_and_all_can_be_read(said, browser, name):
    for reader in READERS.values():
        browser.show(report(said, name), *reader, dark=False)
        assert browser.run(FAULTS) == []
        light = browser.run(CONTRAST)
        browser.scheme(dark=True)
        dark = browser.run(CONTRAST)
        assert (light["ground"] > 0.9, dark["ground"] < 0.05) == (True, True)
        for seen in (light, dark):
            assert seen["text"] > 4.5
            assert seen["labels"] is None or seen["labels"] > 4.5
            assert seen["lines"] is None or seen["lines"] > 1.5  # faint lines are still visible
        assert browser.problems == []


def test_faults_that_are_planted_are_found(said, browser):
    browser.show(report(said, "diagnose"), *READERS["phone"], dark=False)
    browser.run("document.querySelector('.sheet .tick').after(document.querySelector('.sheet .tick').cloneNode(true))")
    browser.run("document.querySelectorAll('#figure-2 .mark').forEach((mark) => mark.remove())")
    browser.run("document.querySelector('h1').style.width = '500px'")
    faults = " / ".join(browser.run(FAULTS))
    for wanted in ("overlap in figure-1", "empty panel: figure-2", "beyond the page: H1", "the page is"):
        assert wanted in faults


def test_a_name_of_the_legend_hides_its_line_and_dragging_zooms(said, browser):
    browser.show(report(said, "cosim"), *READERS["desk"], dark=False)
    count = "document.querySelectorAll('#figure-1 .mark').length"
    before = browser.run(count)
    browser.run("document.querySelector('#figure-1 .key').click()")
    assert browser.run(count) < before
    browser.run("document.querySelector('#figure-2').scrollIntoView()")
    box = browser.run("document.querySelector('#figure-2 .ground').getBoundingClientRect().toJSON()")
    ticks = "[...document.querySelectorAll('#figure-2 .tick[text-anchor=middle]')].map((text) => +text.textContent)"
    whole = browser.run(ticks)
    across = [box["x"] + share * box["width"] for share in (0.25, 0.5)]
    browser.drag(across[0], across[1], box["y"] + 30)
    zoomed = browser.run(ticks)
    assert (min(whole), max(whole)) == (0.0, 4.0)
    assert 0.9 < min(zoomed) < max(zoomed) < 2.1  # a quarter to a half of 4 s
    assert "N" in browser.run("document.querySelector('#figure-2 .tip').textContent")
