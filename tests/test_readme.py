"""What the pages of the project claim can be run, found and cited."""

import re
import shlex
from pathlib import Path

import pytest

from vpp_fmu import __version__
from vpp_fmu.app.cli import parser_of

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "tests/README.md", "identification/README.md", "fmu_src/README.md", "CONTRIBUTING.md", "CHANGELOG.md")
README = (ROOT / "README.md").read_text()
COMMANDS = re.findall(r"^\.venv/bin/vpp (.*)$", "".join((ROOT / page).read_text() for page in PAGES), flags=re.M)


def test_the_readme_is_short():
    assert README.count("\n") < 130


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_one_that_there_is(command):
    verb, *options = shlex.split(command, comments=True)
    parser_of(verb)[0].parse_args(options)


@pytest.mark.parametrize("page", PAGES)
def test_every_link_leads_somewhere(page):
    for link in re.findall(r"\]\((?!http)([^)#]+)\)", (ROOT / page).read_text()):
        assert ((ROOT / page).parent / link).exists(), link


def test_the_script_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(re.search(r"```python\n(import vpp_fmu as vpp\n.*?)```", README, flags=re.S)[1], {})
    said = capsys.readouterr().out
    assert "verdict: attributed" in said
    before, after = map(float, re.search(r"no fit saw: (\S+) → (\S+) N", said).groups())
    told = re.search(r"is (\S+) N off before and (\S+) N after", README.replace("\n", " "))
    assert (f"{before:.3f}", f"{after:.3f}") == told.groups()
    assert "LoopResult(1.5 → 12 N: " in said


def test_the_citation_has_the_version():
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text()
