"""The reader of JSON and TOML, and every kind of file that it reads: damaged, nested, duplicate, huge, or of wrong types."""

import gzip
import json
import time

import pytest
from builders import refusal
from studies.fuzz import bomb

from hil.devices.calibration import read_calibration
from hil.safety.limits import read_limits
from hil.twin.band import read_band
from identification.assessment.information import read_knowledge, read_noise
from identification.logs.mapping import read_sections
from identification.logs.speed_map import read_speed_map
from vpp_fmu import files
from vpp_fmu.files import read_bytes
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet, check_same_model, read_parameters
from vpp_fmu.rig import read_rig
from vpp_fmu.structured import DEEPEST, LARGEST_JSON, LARGEST_TOML, LONGEST_LINE, read_toml

READERS = {
    "parameters.json": lambda path: read_parameters(path, plant),
    "identification.json, its covariance": read_knowledge,
    "identification.json, its noise": read_noise,
    "identification.json, its band": read_band,
    "identification.json, its model": lambda path: check_same_model(path, ParameterSet(plant()), "parameters.json"),
    "rig.json": read_rig,
    "calibration.json": read_calibration,
    "limits.json": read_limits,
    "speed_map.json": read_speed_map,
}
JSON = {
    "nested lists": ("[" * 100_000, f"more than {DEEPEST} deep"),
    "nested objects": ('{"a":' * 60 + "1" + "}" * 60, f"more than {DEEPEST} deep"),
    "in a list of wide lists": ("[" + "[1]," * 1000 + "[" * 60 + "]" * 61, f"more than {DEEPEST} deep"),
    "twice": ('{"effects": [], "effects": []}', '"effects": found this name more than once'),
    "twice, within": ('{"x": [{"a": 1, "b": 2, "a": 3}]}', '"a": found this name more than once'),
    "NaN": ('{"x": NaN}', "x: found NaN, expected finite numbers"),
    "infinite": ('{"x": -Infinity}', "x: found -Infinity, expected finite numbers"),
    "beyond all floats": ('{"x": 1e999}', "x: found Infinity, expected finite numbers"),
    "beyond all floats, whole": (f'{{"x": {"9" * 5000}}}', "expected finite numbers"),
    "half a character": ('{"x": "\\ud800"}', "found half a character"),
    "half a character, as a name": ('{"\\udfff": 1}', "found half a character"),
    "cut off": ('{"x": [1, 2', "found no JSON from column"),
    "empty": ("", "found no JSON from column"),
    "no JSON": ("time,thrust", "found no JSON from column"),
    "huge": ('{"x": "' + "y" * LARGEST_JSON + '"}', f"{LARGEST_JSON} at most"),
}


def refusal_of(read, path):
    """The line that refuses a file; it names the file and is short."""
    said = refusal(read, path)
    assert said.startswith(str(path))
    assert len(said) < 500
    return said


@pytest.mark.parametrize(
    ("reader", "what"), [*(("rig.json", what) for what in JSON), *((reader, "nested objects") for reader in READERS)]
)
def test_every_reader_refuses_damaged_json_in_the_same_words(reader, what, tmp_path):
    text, words = JSON[what]
    (tmp_path / "x.json").write_text(text)
    assert words in refusal_of(READERS[reader], tmp_path / "x.json")


@pytest.mark.parametrize("found", [[], None])
@pytest.mark.parametrize("reader", READERS)
def test_every_reader_of_json_refuses_other_types_than_objects(reader, found, tmp_path):
    (tmp_path / "x.json").write_text(json.dumps(found))
    assert "an object in braces" in refusal_of(READERS[reader], tmp_path / "x.json")


TOML = {
    "nested lists": ("x = " + "[" * 4000, f"more than {DEEPEST} deep"),
    "nested tables": ("x" + ".x" * 60 + " = 1", f"more than {DEEPEST} deep"),
    "nested by its header": ("[x" + ".x" * 60 + "]", f"more than {DEEPEST} deep"),
    "a long key": ("x" + ".x" * LONGEST_LINE + " = 1", f"{LONGEST_LINE} at most"),
    "many long keys": ("\n".join(f"[k{k}]\nx{'.x' * 2000} = 1" for k in range(4)), f"more than {DEEPEST} deep"),
    "twice": ("x = 1\nx = 2", "no TOML (Cannot overwrite a value"),
    "huge": ("x = 1\n" * LARGEST_TOML, f"{LARGEST_TOML} at most"),
    "a whole number that is too long": (f"x = {'9' * 4090}\n", "expected finite numbers"),
    "an infinite number": ("x = inf", "expected finite numbers"),
    "no date": ("x = 2026-02-31", "no TOML"),
    "cut off": ('x = "', "no TOML"),
}


@pytest.mark.parametrize(("read", "what"), [*((read_toml, what) for what in TOML), (read_sections, "nested lists")])
def test_damaged_toml_is_refused_without_long_computation(read, what, tmp_path):
    text, words = TOML[what]
    (tmp_path / "x.toml").write_text(text)
    began = time.process_time()
    assert words in refusal_of(read, tmp_path / "x.toml")
    assert time.process_time() - began < 30.0


def test_a_gzip_bomb_is_refused_without_being_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "x.csv.gz"
    path.write_bytes(bomb(300))
    size = path.stat().st_size
    assert size < 2**19
    held = []
    whole = gzip.GzipFile.read
    monkeypatch.setattr(gzip.GzipFile, "read", lambda self, n=-1: held.append(n) or whole(self, n))
    assert f"{files.RATIO} times its size and 1 MB at most" in refusal_of(read_bytes, path)
    assert held == [files.RATIO * size + 2**20 + 1]


@pytest.mark.parametrize("name", ["x.csv", "x.csv.gz"])
def test_a_file_above_the_limit_of_size_is_refused(name, tmp_path, monkeypatch):
    monkeypatch.setattr(files, "LARGEST", 2**20)
    content = bytes(range(256)) * 4096
    for extra in (b"", b"x"):
        data = content + extra
        (tmp_path / name).write_bytes(gzip.compress(data) if name.endswith("gz") else data)
        if extra:
            assert "expected 1 MB at most" in refusal_of(read_bytes, tmp_path / name)
        else:
            assert read_bytes(tmp_path / name) == data
