"""Wrong options and files: exit code 2, one line with the found and the allowed value, nothing written, the right reason.

Options of every verb, folders and files that cannot be used. test_archive has all other faults of FMUs.
"""

import contextlib
import json
import os
import tempfile
from pathlib import Path

import pytest

from vpp_fmu.export import python_fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.parameters import ParameterSet, to_json

NOBODY = 65534

RECORD = "time,omega_ref,beta_ref,thrust\n0,4000,5,5\n0.004,4000,5,5.1\n0.008,4100,5,5.2\n"

OPTIONS = [
    ("identify", "x", "--seed", "-1"),
    ("identify", "x", "--starts", "1e9"),
    ("diagnose", "x", "--workers", "many"),
    ("diagnose", "x", "--seed", "0.5"),
    ("demo", "--workers", "-1"),
    ("tune", "--noise", "nan"),
    ("tune", "--workers", "0"),
    ("tune", "--assume", "tau_beta_2=inf"),
    ("plan", "--parameters", "x", "--seconds", "inf"),
    ("plan", "--parameters", "x", "--omega", "2000", "1e9"),
    ("cosim", "x", "y", "--profile", "z", "--step", "0"),
    ("hil", "campaign", "--points", "1"),
    ("hil", "selftest", "--load", "65"),
    ("hil", "run", "--profile", "z", "--seed", "-1"),
]


@pytest.fixture
def folder():
    """A folder that other users may enter, with good files."""
    knowledge = {"c20": {"value": 0.5, "std": 0.1}}
    content = {
        "record.csv": RECORD,
        "step.csv": "time,thrust_set\n0,1.5\n0.1,1.5\n",
        "parameters.json": to_json(ParameterSet(BASE)),
        "identification.json": json.dumps({"parameters": knowledge, "correlation": {"names": ["c20"], "matrix": [[1.0]]}}),
        "VppPlant.fmu": python_fmu(BASE),
        "VppController.fmu": python_fmu(CONTROLLER),
    }
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        for file, data in content.items():
            (Path(name) / file).write_bytes(data if isinstance(data, bytes) else data.encode())
        yield Path(name)


@pytest.fixture
def refuses(refused):
    """Run a command, whose words are separated by blanks; it must be refused for a reason, and write nothing."""

    def run(words, out, reason=""):
        before = files(out)
        told = refused(*words.split(), "-o", out)
        assert "found" in told
        assert "expected" in told
        assert reason in told
        assert files(out) == before

    return run


def files(folder: Path) -> set[Path]:
    try:
        return {path for path in folder.rglob("*") if path.is_file()}
    except OSError:
        return set()


@pytest.mark.parametrize("words", OPTIONS, ids=" ".join)
def test_a_bad_option_is_refused(words, tmp_path, refuses):
    refuses(" ".join(words), tmp_path / "out")


def test_files_and_folders_that_cannot_be_used_are_refused(folder, refuses):
    simulate = f"simulate {folder}/record.csv --parameters {folder}/parameters.json"
    (folder / "taken" / "prediction.csv").mkdir(parents=True)
    (folder / "empty").mkdir()
    refuses(simulate, folder / "record.csv", "output folder: found a file")
    refuses(simulate, folder / "record.csv" / "out", "not a directory")
    refuses(simulate, Path("/proc/vpp"), "output folder: found not writable")  # even root may not
    refuses(simulate, Path("/dev/full"))
    refuses(simulate, folder / "taken", "prediction.csv: output file: found not writable (is a directory)")
    for place in ("record.csv", "nowhere", "empty"):
        refuses(f"identify {folder}/{place}", folder / "out")
    refuses(f"simulate {folder} --parameters {folder}/parameters.json", folder / "out")
    refuses(f"simulate {folder}/VppPlant.fmu --parameters {folder}/parameters.json", folder / "out", "the byte 0x")
    plan = f"plan --parameters {folder}/parameters.json --knowledge {folder}/identification.json"
    refuses(plan, folder / "out", '"c20": found 0.5, expected 0.355, the value in')
    refuses(f"cosim {folder}/VppPlant.fmu {folder}/VppController.fmu --profile none.csv", folder / "out")
    refuses(f"cosim none.fmu {folder}/VppController.fmu --profile {folder}/step.csv", folder / "out")


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no users on this system")
def test_missing_permission_is_the_reason_given(folder, refuses):
    for name, mode in (("locked", 0o555), ("closed", 0o000), ("free", 0o777)):
        (folder / name).mkdir()
        (folder / name).chmod(mode)
    (folder / "secret.csv").write_text(RECORD)
    (folder / "secret.csv").chmod(0o000)
    model, why = f"--parameters {folder}/parameters.json", "not readable (permission denied)"
    with someone_else():
        for out in (folder / "locked", folder / "closed" / "out"):
            refuses(f"simulate {folder}/record.csv {model}", out, "output folder: found not writable (permission denied)")
        for place in ("closed", "closed/campaign"):
            refuses(f"identify {folder}/{place}", folder / "free", f"campaign folder: found {why}")
        refuses(f"simulate {folder}/secret.csv {model}", folder / "free", f"secret.csv: file: found {why}")
        cosim = f"cosim {folder}/closed/a.fmu {folder}/VppController.fmu --profile {folder}/step.csv"
        refuses(cosim, folder / "free", f"a.fmu: FMU: found {why}")


@contextlib.contextmanager
def someone_else():
    """Act as another user, since permissions do not restrict root."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(before)
