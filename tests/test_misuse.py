"""Calls out of order and with bad arguments: both flavours refuse them in the same words, and no process crashes."""

import misuse
import pytest
from builders import MODELS, native, needs_compiler

from vpp_fmu.export import python_fmu

pytestmark = needs_compiler


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Outcomes of all cases by flavour."""
    folder, outcomes = tmp_path_factory.mktemp("misuse"), {}
    for flavour, make in (("native", native), ("python", lambda name: python_fmu(*MODELS[name]))):
        paths = {name: folder / f"{name}.{flavour}.fmu" for name in MODELS}
        for name, path in paths.items():
            path.write_bytes(make(name))
        outcomes[flavour] = misuse.outcomes(paths)
    return outcomes


def test_no_process_dies(found):
    assert {flavour: len(cases) for flavour, cases in found.items()} == dict.fromkeys(found, len(misuse.CASES))


@pytest.mark.parametrize("number", range(len(misuse.CASES)), ids=[case.name for case in misuse.CASES])
def test_both_flavours_answer_alike(found, number):
    assert not misuse.verdict(misuse.CASES[number], found["native"][number], found["python"][number])
