"""Wrong options and files: exit code 2, one line with the found and the allowed value, nothing written, the right reason.

Options of every verb, folders and files that cannot be used.
"""

import contextlib
import io
import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from vpp_fmu.app.cli import main as vpp
from vpp_fmu.export import python_fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.parameters import ParameterSet, to_json

NOBODY = 65534

RECORD = "time,omega_ref,beta_ref,thrust\n0,4000,5,5\n0.004,4000,5,5.1\n0.008,4100,5,5.2\n"


@dataclass(frozen=True)
class Refusal:
    """A command's `words`, `what` is wrong with them, the `code` it exited with, what it `said`, the files that it `wrote`."""

    what: str
    words: tuple[str, ...]
    code: int
    said: str
    wrote: tuple[str, ...] = ()

    @property
    def in_order(self) -> bool:
        """Exit code 2, one line with what was found and what is allowed, nothing written."""
        is_one_line = self.said.count("\n") == 1 and "found" in self.said and "expected" in self.said
        return self.code == 2 and is_one_line and "Traceback" not in self.said and not self.wrote


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


def refusals(folder: Path) -> Iterator[Refusal]:
    """Every case, with `folder` to make files in."""
    out = folder / "out"
    for words in OPTIONS:
        yield refused("an option", words, out)
    files = given(folder)
    yield from folders(files, folder, out)
    # test_archive has all other faults of FMUs
    yield refused("FMU: nowhere", ("cosim", "none.fmu", str(files["controller"]), "--profile", str(files["profile"])), out)


def given(folder: Path) -> dict[str, Path]:
    """Good files, by their role."""
    texts = {
        "record": ("record.csv", RECORD),
        "profile": ("profile.csv", "time,thrust_set\n0,1.5\n0.1,1.5\n"),
        "parameters": ("parameters.json", to_json(ParameterSet(BASE))),
        "plant": ("VppPlant.fmu", python_fmu(BASE)),
        "controller": ("VppController.fmu", python_fmu(CONTROLLER)),
    }
    for path, text in ((folder / name, text) for name, text in texts.values()):
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return {what: folder / name for what, (name, _) in texts.items()}


def folders(files: dict[str, Path], folder: Path, out: Path) -> Iterator[Refusal]:
    """Folders and files that cannot be read or written, or that belong to another model."""
    simulate = ("simulate", str(files["record"]), "--parameters", str(files["parameters"]))
    yield refused("output: a file", simulate, files["record"])
    yield refused("output: below a file", simulate, files["record"] / "out")
    yield refused("output: even root may not", simulate, Path("/proc/vpp"))
    yield refused("output: a device", simulate, Path("/dev/full"))
    taken = folder / "taken"
    (taken / "prediction.csv").mkdir(parents=True)
    yield refused("output: a folder in the file's place", simulate, taken)
    yield refused("campaign: a file", ("identify", str(files["record"])), out)
    yield refused("campaign: nowhere", ("identify", str(folder / "nowhere")), out)
    yield refused("campaign: empty", ("identify", str(_made(folder / "empty", 0o755))), out)
    yield refused("record: a folder", ("simulate", str(folder), "--parameters", str(files["parameters"])), out)
    yield refused("record: not UTF-8", ("simulate", str(files["plant"]), "--parameters", str(files["parameters"])), out)
    knows = folder / "identification.json"
    knows.write_text(json.dumps(_identification(c20=0.5)))
    plan = ("plan", "--parameters", str(files["parameters"]), "--knowledge", str(knows))
    yield refused("knowledge of another model", plan, out)
    yield refused("profile: none", ("cosim", str(files["plant"]), str(files["controller"]), "--profile", "none.csv"), out)
    if hasattr(os, "geteuid"):
        locked, closed = _made(folder / "locked", 0o555), _made(folder / "closed", 0o000)
        free = _made(folder / "free", 0o777)
        secret = folder / "secret.csv"
        secret.write_text(RECORD)
        secret.chmod(0o000)
        with someone_else():
            yield refused("output: no permission", simulate, locked)
            yield refused("output: no permission, below", simulate, closed / "out")
            yield refused("campaign: no permission", ("identify", str(closed)), free)
            yield refused("campaign: no permission, below", ("identify", str(closed / "campaign")), free)
            words = ("simulate", str(secret), "--parameters", str(files["parameters"]))
            yield refused("record: no permission", words, free)
            words = ("cosim", str(closed / "a.fmu"), str(files["controller"]), "--profile", str(files["profile"]))
            yield refused("FMU: no permission", words, free)


def _identification(**values: float) -> dict:
    """The part of an identification.json that `plan` reads."""
    known = {name: {"value": value, "std": 0.1} for name, value in values.items()}
    return {"parameters": known, "correlation": {"names": list(known), "matrix": [[1.0]]}}


def _made(path: Path, mode: int) -> Path:
    path.mkdir()
    path.chmod(mode)
    return path


@contextlib.contextmanager
def someone_else() -> Iterator[None]:
    """Act as another user, since permissions do not restrict root."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(before)


def refused(what: str, words: Sequence[str], out: Path) -> Refusal:
    """Run `vpp` with these words here."""
    before = _files(out)
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        code = vpp([*words, "-o", str(out)])
    return Refusal(what, tuple(words), code, said.getvalue(), tuple(sorted(_files(out) - before)))


def _files(folder: Path) -> set[str]:
    try:
        return {str(path) for path in folder.rglob("*") if path.is_file()}
    except OSError:
        return set()


REASONS = {
    "output: a file": "output folder: found a file",
    "output: below a file": "not a directory",
    "output: even root may not": "output folder: found not writable",
    "output: a folder in the file's place": "prediction.csv: output file: found not writable (is a directory)",
    "knowledge of another model": '"c20": found 0.5, expected 0.355, the value in',
    "record: not UTF-8": "the byte 0x",
}
NO_PERMISSION = {
    "output: no permission": "output folder: found not writable (permission denied)",
    "output: no permission, below": "output folder: found not writable (permission denied)",
    "campaign: no permission": "campaign folder: found not readable (permission denied)",
    "campaign: no permission, below": "campaign folder: found not readable (permission denied)",
    "record: no permission": "secret.csv: file: found not readable (permission denied)",
    "FMU: no permission": "a.fmu: FMU: found not readable (permission denied)",
}


@pytest.fixture(scope="module")
def found():
    """Every row, in a folder that other users may enter."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        return list(refusals(Path(name)))


def test_every_row_is_refused_as_required(found):
    assert len(found) > 25
    assert [(each.what, each.code, each.said, each.wrote) for each in found if not each.in_order] == []


@pytest.mark.parametrize("what", REASONS)
def test_the_reason_is_the_right_one(found, what):
    (said,) = [each.said for each in found if each.what == what]
    assert REASONS[what] in said


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no users on this system")
@pytest.mark.parametrize("what", NO_PERMISSION)
def test_missing_permission_is_the_reason_given(found, what):
    (said,) = [each.said for each in found if each.what == what]
    assert NO_PERMISSION[what] in said
