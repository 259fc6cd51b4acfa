"""Completion in real shells, and the suggestion of the next command if no verb is given."""

import shutil
import subprocess

import pytest

from vpp_fmu.app.cli import VERBS, main


@pytest.fixture
def script(tmp_path, capsys):
    def written(shell):
        if not shutil.which(shell):
            pytest.skip(f"{shell} is not installed")
        assert main(["completion", shell]) == 0
        path = tmp_path / f"vpp.{shell}"
        path.write_text(capsys.readouterr().out)
        return path

    return written


def ran(shell, *words):
    return subprocess.run([shell, *words], capture_output=True, text=True, check=True, timeout=60).stdout


@pytest.mark.parametrize(
    ("line", "offered"),
    [("dia", ["diagnose"]), ("tune --rob", ["--robust"]), ("tune --robust ", ["mean", "worst"]), ("hil self", ["selftest"])],
)
def test_bash_completes_verbs_options_and_choices(script, line, offered):
    words = ["vpp", *line.split(" ")]
    told = " ".join(f"'{word}'" for word in words)
    asked = f"COMP_WORDS=({told}); COMP_CWORD={len(words) - 1}; _shtab_vpp; echo ${{COMPREPLY[@]}}"
    assert sorted(ran("bash", "-c", f"source {script('bash')}; {asked}").split()) == offered


def test_fish_completes_every_verb(script):
    offered = ran("fish", "-c", f"source {script('fish')}; complete -C 'vpp '").splitlines()
    assert set(VERBS) <= {line.partition("\t")[0] for line in offered}


def test_an_unknown_shell_is_refused_in_one_line(refused):
    refused("completion", "ksh")


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ((), "vpp demo"),
        (("flight.csv",), "vpp import csv flight.csv"),
        (("static.csv", "open_loop.csv.gz"), "vpp diagnose . -o out (a campaign is here: open_loop, static)"),
        (("monday/open_loop.csv",), "vpp diagnose monday"),
        (("parameters.json", "open_loop.csv"), "vpp export --parameters ."),
        (("VppPlant.fmu", "VppController.fmu", "profile.csv"), "vpp cosim VppPlant.fmu VppController.fmu"),
    ],
)
def test_without_a_verb_the_next_command_is_suggested(tmp_path, monkeypatch, refused, files, told):
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    assert refused().startswith(f"vpp: no verb. Next: {told}")
