"""One sentence for each mistake that users made: swapped files, another separator, settings that changed, no measurement."""

import re

import numpy as np
import pytest

from hil.emulator.rig import effects_to_hide
from hil.physics.rig_model import library
from vpp_fmu.app.cli import main
from vpp_fmu.app.report.sentences import clause
from vpp_fmu.errors import RecordWarning
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.plants import Sample
from vpp_fmu.reach import thrust_range, warn_beyond_reach
from vpp_fmu.record import Record

FILES = {
    "p.csv": "time,thrust_set\n0,2\n0.5,5\n1,5\n",
    "semicolons.csv": "time;thrust_set\n0;2\n1;5\n",
    "empty.json": "{}",
    "alone.json": '{"format": "vpp-parameters/1", "parameters": {}}',
}

REFUSED = {
    "swapped FMUs": (
        "cosim CONTROLLER PLANT --profile p.csv -o out",
        ["role: found a controller FMU", "expected a plant FMU", "Try: the two FMUs in the other order"],
    ),
    "a plant for the controller": (
        "cosim PLANT PLANT --profile p.csv -o out",
        ["role: found a plant FMU", "expected a controller FMU"],
    ),
    "a semicolon profile": (
        "cosim PLANT CONTROLLER --profile semicolons.csv -o out",
        ["semicolons.csv: header: found cells separated by semicolons, expected cells separated by commas"],
    ),
    "an empty calibration": (
        "hil run --virtual --profile p.csv --calibration empty.json -o out",
        ["empty.json: file: found an empty object, expected a calibration", "Try: vpp hil calibrate"],
    ),
    "a twin without its identification": (
        "export --parameters alone.json --twin -o out",
        ["identification.json: file: found no such file", "Try: vpp identify"],
    ),
    "an unknown effect": (
        "hil run --virtual --profile p.csv --hide wobble -o out",
        ["--hide: found wobble", "Try: --hide ? for sizes"],
    ),
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("what", REFUSED)
def test_each_mistake_has_its_sentence(what, folder, fmu_files, capsys):
    words, sentences = REFUSED[what]
    fmus = {"PLANT": str(fmu_files["plain"]), "CONTROLLER": str(fmu_files["controller"])}
    assert main([fmus.get(word, word) for word in words.split()]) == 2
    said = capsys.readouterr().err
    assert [sentence for sentence in sentences if sentence not in said] == []
    assert [*(folder / "out").glob("**/*")] == []


def test_the_list_of_effects_has_sizes_and_ends_well(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["hil", "run", "--hide", "?"])
    assert ended.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == effects_to_hide()
    names = [effect.name for effect in library(commanded=False) if effect.off is not None]
    assert [line.partition(":")[0] for line in lines] == names
    assert all(re.search(r"=[0-9.]+ \(", line) for line in lines)


class Square:
    """A plant that starts at rest: its thrust is speed^2 / 1e6 times a parabola of the pitch with its top at 5 deg."""

    dt = 0.1

    def start(self, omega_ref, beta_ref):
        return Sample(0.0, 0.0, 0.0)

    def step(self, omega_ref, beta_ref):
        return Sample(omega_ref**2 / 1e6 * (10.0 - (beta_ref - 5.0) ** 2 / 10.0), omega_ref, beta_ref)

    def close(self):
        pass


LIMITS = {"omega_ref": (1000.0, 2000.0), "beta_ref": (0.0, 10.0)}


@pytest.mark.parametrize(
    ("time_constant", "said"), [(0.0, "a time constant of 0 s (at once)"), (0.5, "a time constant of 0.5 s")]
)
def test_a_parameter_at_its_limit_form_is_said_in_words(time_constant, said):
    (sag,) = [e for e in LIBRARY if e.name == "supply_sag"]
    values = {sag.full(p.name): p.default for p in sag.parameters} | {"supply_sag.time_constant": time_constant}
    assert clause(sag, values).endswith(said)


def test_the_range_of_thrust_includes_a_blade_that_stalls():
    assert thrust_range(Square(), LIMITS) == pytest.approx((7.5, 40.0))


@pytest.mark.parametrize(("wanted", "beyond"), [(39.9, False), (41.5, True), (7.6, False), (5.0, True)])
def test_a_profile_beyond_reach_is_named(wanted, beyond, recwarn):
    profile = Record({"time": np.array([0.0, 2.0]), "thrust_set": np.array([20.0, wanted])}, "p.csv")
    warn_beyond_reach(profile, Square(), LIMITS)
    said = [str(w.message) for w in recwarn if w.category is RecordWarning]
    assert len(said) == beyond
    sentence = f"p.csv: thrust_set: {wanted:g} N at 2 s is out of reach: the plant's model gives 7.5 to 40 N"
    assert not beyond or sentence in said[0]
