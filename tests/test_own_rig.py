"""The README's commands on rigs other than the paper's: no written file has the paper's limits."""

import functools
import io
import json
import re
import shlex
import shutil
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from builders import shorten_tuning
from scipy.signal import lfilter

from identification.diagnose import diagnose as diagnosing
from identification.plan import plan as planning
from vpp_fmu.app import cli
from vpp_fmu.kernel.controller import CONTROLLER, DUAL
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet, read_parameters, to_json
from vpp_fmu.rig import Rig

DATA = Path(__file__).parent / "data"
README = (Path(__file__).parents[1] / "README.md").read_text()
COMMANDS = [shlex.split(line, comments=True) for line in re.findall(r"^\.venv/bin/vpp (.*)$", README, flags=re.M)]

RIGS = {
    "rig_e": {"speed": (833.33333, 2500.0), "pitch": (0.0, 25.0), "period": 0.008},
    "rig_h": {"speed": (2269.5, 5519.1), "pitch": (4.0, 4.0), "period": 0.004},
    "log": {"speed": (2500.0, 5500.0), "pitch": (0.0, 0.0), "period": 0.02},
}
"""Commanded ranges of the files, and the period of their rows; the log's speeds are those of `write_log`."""

SHORTER = {
    "diagnose": ["--effects", "pitch_backlash", "--workers", "1"],
    "learn": ["--generations", "2", "--plants", "2"],
    "twin": ["--rounds", "1", "--policy", "fixed"],
}
"""Options that only save time."""

BEYOND_THE_EMULATOR = "rig_e"

of_each_rig = pytest.mark.sampled("written")


@pytest.fixture(scope="module", params=RIGS)
def written(request, tmp_path_factory):
    """(rig, folder, by verb: exit code and text): all commands of the README on it, in order."""
    rig, folder = request.param, tmp_path_factory.mktemp(request.param)
    with pytest.MonkeyPatch.context() as quick:
        quick.chdir(folder)
        quick.setattr("vpp_fmu.app.api.diagnose.diagnosed", functools.partial(diagnosing.diagnose, thorough=False))
        shorten_tuning(quick.setattr)
        quick.setattr("identification.plan.plan.DRAWS", 1)
        quick.setattr("vpp_fmu.app.api.plan.planned", functools.partial(planning.plan, evaluations=20))
        if rig == "log":
            write_log(Path("LOG.csv"))
        else:
            shutil.copytree(DATA / rig, "mine")
        Path("my_effect.py").write_text(re.search(r"```python\n(from vpp_fmu import Effect.*?)```", README, flags=re.S)[1])
        found = {}
        for verb, *words in COMMANDS:
            if verb == "import" and rig != "log":
                continue
            if "--effects-from" in words or verb in ("effects", "allocate") or "2026-0*/" in words:
                continue  # the same on any rig, or needs power: test_own_effects, test_allocation, test_fleet
            if verb == "export":
                _profile(rig)
            more = {"import": ["--yes"], "learn": ["--gains", "gains"] if Path("gains/gains.json").exists() else []}
            found[verb] = _ran(quick, [verb, *words, *SHORTER.get(verb, []), *more.get(verb, [])])
    return rig, folder, found


def write_log(path):
    """Rows of 20 ms of a fixed pitch: a speed of 1000 rpm and 50 for each per cent of throttle, behind a lag of 0.25 s."""
    throttle = np.repeat([50.0, 30.0, 70.0, 45.0, 90.0, 60.0, 35.0, 80.0], 200)
    kept, goal = np.exp(-0.02 / 0.25), 1000.0 + 50.0 * throttle
    speed = goal[0] + lfilter([0.0, 1.0 - kept], [1.0, -kept], goal - goal[0])
    grams = 3.2e-5 * speed**2 + np.random.default_rng(1).normal(0.0, 4.0, len(throttle))
    rows = zip(20 * np.arange(len(throttle)), throttle, grams.round(1), speed.round(), strict=True)
    path.write_text("\n".join(["time_ms,throttle_%,thrust_g,rpm", *(",".join(map(str, row)) for row in rows)]) + "\n")


def _profile(rig):
    """step.csv: a quarter of the rig's largest thrust, and then half of it."""
    parameters = read_parameters("out/parameters.json", plant)
    low, high = (share * parameters.rig.thrust[1] for share in (0.25, 0.5))
    Path("step.csv").write_text(f"time,thrust_set\n0,{low}\n2,{high}\n5,{high}\n")


def _ran(quick, words):
    out, err = io.StringIO(), io.StringIO()
    quick.setattr("sys.stdout", out)
    quick.setattr("sys.stderr", err)
    code = cli.main(words)
    return code, out.getvalue() + err.getvalue()


@of_each_rig
def test_every_command_succeeds_or_suggests_a_remedy(written):
    rig, _, found = written
    for verb, (code, said) in found.items():
        refused = {"hil", "twin"} if rig == BEYOND_THE_EMULATOR else {"twin"}
        if verb in refused:
            assert code == 2, (verb, said)
            assert "Try: vpp cosim, which closes" in said if rig == BEYOND_THE_EMULATOR else "one moving channel" in said
        else:
            assert code == 0, (verb, said)
    assert {"check", "diagnose", "export", "cosim", "tune", "plan", "hil", "twin", "check-effect"} <= set(found)


def limits_in(values):
    return tuple(values[f"omega_{end}"] for end in ("min", "max")), tuple(values[f"beta_{end}"] for end in ("min", "max"))


def approx(rig):
    return pytest.approx(RIGS[rig]["speed"], rel=1e-3), pytest.approx(RIGS[rig]["pitch"], rel=1e-3)


@of_each_rig
def test_every_controller_that_is_written_has_the_rigs_limits_and_sampling(written):
    rig, folder, found = written
    starts = []
    with zipfile.ZipFile(folder / "fmus" / "VppController.fmu") as packed:
        variables = ElementTree.fromstring(packed.read("modelDescription.xml")).iter("ScalarVariable")
        starts.append(
            {v.get("name"): float(v[0].get("start", "nan").replace("true", "1").replace("false", "0")) for v in variables}
        )
    for name in ("gains", "gains_speed_only"):
        if (file := folder / "gains" / f"{name}.json").exists():
            starts.append({n: entry["value"] for n, entry in json.loads(file.read_text())["parameters"].items()})
    assert len(starts) >= 2
    for own in starts:
        assert limits_in(own) == approx(rig)
        assert own["sample_time"] == pytest.approx(RIGS[rig]["period"])
    if rig != BEYOND_THE_EMULATOR:
        told = next((folder / "run").rglob("hil.json"))
        assert limits_in(json.loads(told.read_text())["controller"]["parameters"]) == approx(rig)
    said = re.search(r"within (\S+) to (\S+) rpm", found["export"][1]).groups()
    assert tuple(map(float, said)) == approx(rig)[0]


PAPERS = re.compile(r"(?<![\w.,])(6000(\.0)?|2000(\.0)?|20000? to 6000)(?![\w.])")
"""The paper's speeds; the other numbers of its rig are too common to search for."""


def texts(folder):
    """(name, text) of the written files, with archives opened; of a page its visible text, of a table of numbers nothing."""
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".fmu", ".ssp"):
            yield from _packed(path.name, path.read_bytes())
        elif path.suffix in (".json", ".ssv", ".toml"):
            yield str(path.relative_to(folder)), path.read_text()
        elif path.suffix == ".html":
            page = re.sub(r"<(script|style|svg)\b.*?</\1>", " ", path.read_text(), flags=re.S)
            yield str(path.relative_to(folder)), re.sub(r"<[^>]*>", " ", page)


def _packed(name, data):
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        for inner in packed.namelist():
            if inner.endswith((".fmu", ".ssp")):
                yield from _packed(f"{name}/{inner}", packed.read(inner))
            elif inner.endswith((".xml", ".ssd", ".ssv")):
                yield f"{name}/{inner}", packed.read(inner).decode()


@of_each_rig
def test_no_number_of_the_papers_rig_is_in_what_is_written(written):
    rig, folder, found = written
    scaled = rig == BEYOND_THE_EMULATOR  # the others have the paper's size, and its scales
    told = {name: text for name, text in texts(folder) if not name.startswith("mine")}
    assert len(told) > 10
    for name, text in [*told.items(), *((verb, said) for verb, (_, said) in found.items() if verb not in ("hil", "twin"))]:
        pattern = PAPERS if scaled else re.compile(r"(?<![\w.,])2000(\.0)?(?![\w.])|2000 to 6000|-5 to 10 deg")
        for hit in pattern.finditer(text):
            raise AssertionError((name, text[max(0, hit.start() - 80) : hit.end() + 40]))


CAMPAIGN = dict.fromkeys(("speed", "pitch", "thrust"), "the campaign")
WIDE = Rig("wide", (0.0, 5573.0), (-4.0, 12.0), (0.0, 15.0), origin=CAMPAIGN)
"""A rig of the paper's size whose blades go beyond the calibration of the emulated rig."""


@pytest.fixture
def wide(tmp_path):
    (tmp_path / "parameters.json").write_text(to_json(ParameterSet(plant(), source={"rig": WIDE.summary()})))
    return tmp_path


def test_the_suggested_remedy_works(tmp_path, printed, refused):
    """A rig of the paper's size that turns faster than the emulated one, with the option that the message suggests."""
    fast = Rig("fast", (2000.0, 9000.0), (-5.0, 10.0), (0.0, 15.0), origin=CAMPAIGN)
    (tmp_path / "parameters.json").write_text(to_json(ParameterSet(plant(), source={"rig": fast.summary()})))
    (tmp_path / "step.csv").write_text("time,thrust_set\n0,2\n1,4\n2,4\n")
    narrower = {"format": "vpp-rig/1", "speed": {"min": 2000, "max": 6500, "unit": "rpm"}}
    (tmp_path / "RIG.json").write_text(json.dumps(narrower))
    words = ["hil", "run", "--virtual", "--parameters", str(tmp_path), "--profile", str(tmp_path / "step.csv")]
    words += ["-o", str(tmp_path / "run")]
    assert "Try: --rig emulated RIG.json, which declares narrower ranges" in refused(*words)
    assert "within 2000 to 6500 rpm" in printed(*words, "--rig", "emulated", tmp_path / "RIG.json")


def test_gains_beyond_the_limits_of_the_rig_are_not_exported(wide, refused):
    gains = ParameterSet(CONTROLLER).replaced({**DUAL, "omega_max": 6000.0})
    (wide / "gains.json").write_text(to_json(gains))
    said = refused("export", "--parameters", wide, "--gains", wide / "gains.json", "-o", wide / "fmus")
    assert "omega_max: found 6000 rpm, expected 0 to 5573 rpm (the campaign)" in said
    assert not (wide / "fmus" / "VppController.fmu").exists()
