"""Commands of the project's pages parse, links lead somewhere, and the README's script and demo run."""

import contextlib
import io
import json
import re
import shlex
from functools import partial
from pathlib import Path

import pytest

from identification.diagnose.diagnose import diagnose
from vpp_fmu.app.cli import parser_of
from vpp_fmu.kernel.plant import LIBRARY

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "tests/README.md", "identification/README.md", "fmu_src/README.md", "CONTRIBUTING.md", "CHANGELOG.md")
README = (ROOT / "README.md").read_text()
COMMANDS = re.findall(r"^\.venv/bin/vpp (.*)$", "".join((ROOT / page).read_text() for page in PAGES), flags=re.M)


def test_the_readme_is_short():
    assert README.count("\n") < 130


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_parses(command):
    verb, *options = shlex.split(command, comments=True)
    parser_of(verb)[0].parse_args(options)


@pytest.mark.parametrize("page", PAGES)
def test_every_link_has_a_target(page):
    for link in re.findall(r"\]\((?!http)([^)#]+)\)", (ROOT / page).read_text()):
        assert ((ROOT / page).parent / link).exists(), link


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    """The README's script, run: (what it printed, its names)."""
    names, said = {}, io.StringIO()
    with pytest.MonkeyPatch.context() as there, contextlib.redirect_stdout(said):
        there.chdir(tmp_path_factory.mktemp("script"))
        exec(re.search(r"```python\n(import vpp_fmu as vpp\n.*?)```", README, flags=re.S)[1], names)
    return said.getvalue(), names


@pytest.mark.slow
def test_the_script_runs(script):
    said, _ = script
    assert "verdict: attributed" in said
    before, after = map(float, re.search(r"no fit saw: (\S+) → (\S+) N", said).groups())
    told = re.search(r"is (\S+) N off before and (\S+) N after", README.replace("\n", " "))
    assert (f"{before:.3f}", f"{after:.3f}") == told.groups()
    assert "LoopResult(1.5 → 12 N: " in said


def test_demo_does_the_whole_job(tmp_path, printed, monkeypatch):
    """With a small library; the script diagnoses the same campaign with the whole one."""
    few = tuple(e for e in LIBRARY if e.off is None or e.name in ("pitch_command_deadband", "pitch_backlash"))
    monkeypatch.setattr("identification.demo.diagnose", partial(diagnose, library=few))
    said = printed("demo", "-o", tmp_path)
    before, after = map(float, re.search(r"FMU in fmpy: ([\d.]+) → ([\d.]+) N", said).groups())
    floor = float(re.search(r"noise ([\d.]+) N", said)[1])
    assert floor < after < before < 2 * floor  # what the example's model lacks is about as large as the noise
    for name in (
        *("parameters.json", "parameters.ssv", "parameters_base.json", "identification.json", "diagnosis.json", "report.html"),
        *("VppPlant.fmu", "VppPlant_base.fmu", "VppController.fmu", "VppLoop.ssp", "gains.json", "run_dual.csv"),
    ):
        assert (tmp_path / name).stat().st_size > 0
    found = json.loads((tmp_path / "diagnosis.json").read_text())
    for shown, entry in ((before, found["before"]), (after, found["after"])):
        assert shown == pytest.approx(entry["rmse_thrust"], abs=5.1e-4)  # three digits are printed
