"""FMUs that end or hang their process are refused in one line, because another process tries them first."""

import zipfile

import pytest

from vpp_fmu import fmu
from vpp_fmu.app.cli import main
from vpp_fmu.errors import BadInput
from vpp_fmu.plants import FmuController

ENDS = {
    "imported": ("import ctypes; ctypes.string_at(0)", "SIGSEGV", "it was instantiated"),
    "left": ("import os; os._exit(0)", "exit code 0", "it was instantiated"),
    "started": ("GeneratedSlave.exit_initialization_mode = lambda self: os.abort()", "SIGABRT", "it was started"),
    "stepped": ("GeneratedSlave.do_step = lambda *given: os.kill(os.getpid(), 9)", "SIGKILL", "it made its first step"),
}


@pytest.fixture
def changed(fmu_files, tmp_path):
    """Makes the controller's FMU with lines added at the end of its module."""

    def make(lines):
        path = tmp_path / "changed.fmu"
        with zipfile.ZipFile(fmu_files["controller"]) as good, zipfile.ZipFile(path, "w") as made:
            module = f"resources/{good.read('resources/slavemodule.txt').decode()}.py"
            for name in good.namelist():
                made.writestr(name, good.read(name) + (f"\nimport os\n{lines}\n".encode() if name == module else b""))
        return path

    return make


@pytest.fixture
def profile(tmp_path):
    path = tmp_path / "profile.csv"
    path.write_text("time,thrust_set\n0,1.5\n0.1,1.5\n")
    return str(path)


@pytest.mark.parametrize("ends", ENDS)
def test_an_fmu_that_ends_its_process_is_refused(ends, changed, fmu_files, profile, tmp_path, capfd):
    lines, how, stage = ENDS[ends]
    bad = str(changed(lines))
    verbs = [("cosim", str(fmu_files["plain"]), bad)]
    if ends == "stepped":  # which verb it is makes no difference to how it ends
        verbs += [
            ("hil", "run", *rig, "--controller", bad) for rig in (["--virtual"], ["--rig", "fmu", str(fmu_files["plain"])])
        ]
    for words in verbs:
        assert main([*words, "--profile", profile, "-o", str(tmp_path / "out")]) == 2
        said = capfd.readouterr().err
        assert said.count("\n") == 1
        assert f"{bad}: FMU: found the end of the process ({how}) as {stage}, expected" in said
    assert not list((tmp_path / "out").rglob("*.csv"))


def test_an_fmu_that_hangs_is_refused(changed, monkeypatch):
    monkeypatch.setattr(fmu, "PATIENCE", 2.0)
    with pytest.raises(BadInput, match="found no end of its first step within 2 s"):
        FmuController(changed("while True: pass"))


def test_output_of_an_fmu_and_the_current_folder_are_no_failure(changed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    FmuController(changed("print('it was loaded'); os.write(1, b'x' * 100_000)")).close()
