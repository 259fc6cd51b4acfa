"""The Python FMU in a folder of any name, and the memory that its instances keep."""

import shutil
import string
import subprocess
import sys
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import pytest

import fmu_src
from vpp_fmu.export import python_fmu
from vpp_fmu.export.location import CODE, decoding
from vpp_fmu.kernel.plant import BASE

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pythonfmu's binary for Linux is changed")

SIGNS = "".join(sign for sign in map(chr, range(1, 127)) if sign != "/") + "üß漢🚁é"
"""Every ASCII character that a file system allows in a name, and others of two, three and four bytes."""

NAMES = [SIGNS[:48], SIGNS[48:96], SIGNS[96:], "a%20b", "%2B", "%", "%%41%", "100%2", "a%zzb", " ", "file:"]

SIMULATE = """
import sys
import fmpy

for folder in sys.argv[2:]:
    unpacked = fmpy.extract(sys.argv[1], unzipdir=folder)
    found = fmpy.simulate_fmu(unpacked, stop_time=0.1, output_interval=0.01, validate=False)
    assert found["time"][-1] == 0.1, found
"""


def ran(text, *words):
    return subprocess.run([sys.executable, "-c", text, *map(str, words)], capture_output=True, text=True, check=False)


@pytest.fixture
def plant(tmp_path):
    path = tmp_path / "plant.fmu"
    path.write_bytes(python_fmu(BASE))
    return path


def test_it_runs_in_a_folder_of_any_name(plant, tmp_path):
    assert set(string.punctuation) - {"/"} <= set(SIGNS)
    done = ran(SIMULATE, plant, *(tmp_path / name for name in NAMES))
    assert done.returncode == 0, done.stderr


def test_the_machine_code_is_that_of_its_source(tmp_path):
    if not (shutil.which("as") and shutil.which("objcopy")):
        pytest.skip("no assembler")
    source = Path(fmu_src.__file__).parent / "location.s"
    assembled = subprocess.run(
        ["as", "--64", source, "-o", "location.o"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    if assembled.returncode:
        pytest.skip(f"an assembler of another machine: {assembled.stderr}")
    subprocess.run(["objcopy", "-O", "binary", "-j", ".text", "location.o", "location.bin"], cwd=tmp_path, check=True)
    assert (tmp_path / "location.bin").read_bytes() == CODE


def binary() -> bytes:
    """pythonfmu's own."""
    (path,) = Path(distribution("pythonfmu").locate_file("pythonfmu")).glob("resources/binaries/linux64/*.so")
    return path.read_bytes()


def test_the_packed_binary_is_the_changed_one(plant):
    with zipfile.ZipFile(plant) as packed:
        assert packed.read("binaries/linux64/VppPlant.so") == decoding(binary()) != binary()
