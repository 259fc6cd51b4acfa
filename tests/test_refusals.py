"""The table of refusals (python -m tests.studies refusals): each row is refused as required, for the right reason."""

import os
import tempfile
from pathlib import Path

import pytest
from studies.refusals import refusals

REASONS = {
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
    assert len(found) > 50
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
