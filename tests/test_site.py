"""The documentation site: commands on its pages are run or have a reason why not, and included files exist."""

import ast
import re
import shlex
from pathlib import Path

import pytest

from docs.site import included, verbs
from tests.site.blocks import page, pages
from tests.site.run import Failed, run
from vpp_fmu.app.cli import VERBS, parser_of

ROOT = Path(__file__).parents[1]
PAGES = pages()
BLOCKS = [block for found in PAGES for block in found.blocks]
COMMANDS = sorted({command for block in BLOCKS for command in block.vpp})
QUICK = ("reference/files.md", "how-to/learn-in-your-own-loop.md")
"""Pages that are run here; `make docs-test` runs all."""


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_parses(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.json").touch()  # --rig refuses a file that is not there
    verb, *options = shlex.split(re.split(r" (?:\|\|?|>) ", command)[0], comments=True)
    parser_of(verb)[0].parse_args(options)


@pytest.mark.parametrize("name", [found.name for found in PAGES])
def test_every_block_is_run_or_has_a_reason_why_not(name):
    found = page(name)
    typed = [block for block in found.blocks if block.typed or block.file]
    to_run = [block for block in typed if not block.skipped]
    assert not to_run or found.seconds > 0, f"{name}: nobody knows how long this takes: {to_run[0].text}"
    for block in typed:
        if block.run_by:
            assert (ROOT / block.run_by).exists(), block.run_by
        if block.kind == "python" or block.file.endswith(".py"):
            ast.parse(block.text)


@pytest.mark.parametrize("name", QUICK)
def test_the_commands_of_a_page_print_what_it_shows(name, tmp_path):
    run(page(name), tmp_path, {})


def test_a_page_with_wrong_output_fails(tmp_path, monkeypatch):
    (tmp_path / "wrong.md").write_text("---\nseconds: 1\n---\n```sh\necho 1.70 deg\n```\n\n```text\n1.71 deg\n```\n")
    monkeypatch.setattr("tests.site.blocks.DOCS", tmp_path)
    with pytest.raises(Failed, match=r"1\.71 deg"):
        run(page("wrong.md"), tmp_path, {})


@pytest.mark.parametrize("name", [found.name for found in PAGES])
def test_every_link_has_a_target(name):
    """The build checks anchors, and treats warnings as errors."""
    made = {*verbs.pages(), verbs.INDEX, "reference/api.md", "reference/effects.md"}
    folder = included.DOCS / Path(name).parent
    text = included.with_included(name, (included.DOCS / name).read_text())
    for bang, link in re.findall(r"(!?)\[[^]]*\]\((?!http|#)([^)#]+)(?:#[^)]*)?\)", text):
        target = (folder / link).resolve()
        there = target.relative_to(included.DOCS).as_posix()
        assert target.exists() or there in made or bang, link
        if bang:
            assert there in {included.picture(file) for file in included.pictures()}, link


def test_every_verb_has_a_page_with_its_options():
    made = verbs.pages()
    assert set(made) == {f"reference/verbs/{verb}.md" for verb in VERBS}
    assert "| `--overshoot X` | largest overshoot in % of a step (default: 1) |" in made["reference/verbs/tune.md"]
    assert "## vpp hil replay" in made["reference/verbs/hil.md"]
