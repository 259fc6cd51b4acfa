"""Commands of the project's pages parse, links lead somewhere, and the README's script and demo run."""

import contextlib
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from vpp_fmu.app.cli import parser_of
from vpp_fmu.structured import read_toml

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


IN_COPY = """
import sys
from functools import partial
from pathlib import Path

import identification.demo as job
from vpp_fmu.app.cli import main
from vpp_fmu.kernel.plant import LIBRARY

few = tuple(e for e in LIBRARY if e.off is None or e.name in ("pitch_command_deadband", "pitch_backlash"))
job.diagnose = partial(job.diagnose, library=few)
out = Path(sys.argv[1])
loop = out / "VppPlant.fmu", out / "VppController.fmu", "--profile", out / "profile.csv"
for words in ("demo",), ("export", "--parameters", out, "--flavour", "both"), ("cosim", *loop):
    assert main([*map(str, words), "-o", str(out / words[0] if words[1:] else out)]) == 0
own = [m for name, m in sys.modules.items() if name.partition(".")[0] in ("fmu_src", "hil", "identification", "vpp_fmu")]
assert all(Path(m.__file__).is_relative_to(Path.cwd()) for m in own if m.__file__)  # not where the project is installed
"""


def test_demo_does_the_whole_job_without_what_it_does_not_need(short_campaign, tmp_path):
    """In a copy without the modules that the contract of the main way forbids, with a short campaign and a small library; the
    script diagnoses the example with the whole one."""
    copy, out = tmp_path / "copy", tmp_path / "out"
    for package in ("fmu_src", "identification", "vpp_fmu"):
        shutil.copytree(ROOT / package, copy / package)
    shutil.rmtree(copy / "identification" / "example")
    shutil.copytree(short_campaign, copy / "identification" / "example")
    contracts = read_toml(ROOT / "pyproject.toml")["tool"]["importlinter"]["contracts"]
    (unneeded,) = (c["forbidden_modules"] for c in contracts if c["name"].startswith("the main way"))
    for module in set(unneeded) - {"hil"}:
        path = copy / module.replace(".", "/")
        shutil.rmtree(path) if path.is_dir() else path.with_suffix(".py").unlink()
    done = subprocess.run([sys.executable, "-c", IN_COPY, out], cwd=copy, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    before, after = map(float, re.search(r"FMU in fmpy: ([\d.]+) → ([\d.]+) N", done.stdout).groups())
    floor = float(re.search(r"noise ([\d.]+) N", done.stdout)[1])
    assert floor < after < before < 2 * floor  # what the example's model lacks is about as large as the noise
    for name in (
        *("parameters.json", "parameters.ssv", "parameters_base.json", "identification.json", "diagnosis.json", "report.html"),
        *("VppPlant.fmu", "VppPlant_base.fmu", "VppController.fmu", "VppLoop.ssp", "gains.json", "run_dual.csv"),
    ):
        assert (out / name).stat().st_size > 0
    assert 0 < (out / "report.html").read_text(encoding="utf-8").count("<figure") <= 10
    found = json.loads((out / "diagnosis.json").read_text())
    for shown, entry in ((before, found["before"]), (after, found["after"])):
        assert shown == pytest.approx(entry["rmse_thrust"], abs=5.1e-4)  # three digits are printed
