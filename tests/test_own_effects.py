"""Effects and verbs from outside the package, by a file or by an entry point, and the checks of them."""

import json
import re
import sys
from pathlib import Path

import pytest
from builders import refusal

import vpp_fmu as vpp
from identification.tune.objective import closed_loop
from vpp_fmu.app.cli import main
from vpp_fmu.errors import BadInput
from vpp_fmu.invariants import INVARIANTS, Broken, Trial
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.own_effects import library_with
from vpp_fmu.parameters import ParameterSet

FILE = Path(__file__).with_name("own_effect.py")
SOURCE = FILE.read_text()

BROKEN = {
    "declares itself": SOURCE.replace('probe={"tau": 0.05}', 'probe={"tau": 0.5}'),
    "off is the model without it": SOURCE.replace(
        "reading = ops.where(p.tau > 0.0, reading, s.thrust)", "reading = 1.001 * reading"
    ),
    "C is Python": SOURCE.replace("    return", "    reading = reading + 0.1 * isinstance(p.tau, float)\n    return"),
    "the probe shows": SOURCE.replace('probe={"tau": 0.05}', 'probe={"tau": 1e-6}'),
    "finite at every bound": SOURCE.replace(
        "reading = ops.where", "reading = reading / (0.3 - p.tau)\n    reading = ops.where"
    ),
    "free of the communication step": SOURCE.replace("s.thrust)\n    return", "s.thrust) + p.tau * dt * 1e3\n    return"),
    "sensitivities are differences": None,
}
"""A file that each invariant refuses; a user can't write a wrong tangent."""


def test_the_effect_of_the_readme_keeps_every_invariant(printed):
    assert printed("check-effect", FILE).count("  yes  ") == len(INVARIANTS)


def test_every_invariant_has_a_file_that_it_catches():
    assert list(BROKEN) == list(INVARIANTS)


@pytest.mark.parametrize("name", [name for name, source in BROKEN.items() if source][1:])
def test_an_effect_that_breaks_an_invariant_is_refused(name, tmp_path):
    path = tmp_path / "broken.py"
    path.write_text(BROKEN[name])
    assert BROKEN[name] != SOURCE
    library = library_with([path])
    with pytest.raises((Broken, ZeroDivisionError)):
        INVARIANTS[name](Trial(next(e for e in library if e.name == "cell_lag"), library))


def test_a_broken_effect_is_refused_in_one_line(tmp_path, refused, capsys):
    path = tmp_path / "broken.py"
    path.write_text(BROKEN["declares itself"])  # it is refused when it is read
    assert f"{path}: EFFECT: found tau = 0.5, outside 0 to 0.3, expected" in refused("check-effect", path)
    path.write_text(BROKEN["the probe shows"])
    assert main(["check-effect", str(path)]) == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert re.search(r"  the probe shows +NO ", said.out)


@pytest.mark.parametrize(
    ("word", "other", "says"),
    [
        ("parameters=(Parameter", "parameters=(print, Parameter", "EFFECT, parameters: found (<built-in function print>"),
        ("states=tuple(", "states=list(", "EFFECT, states: found [State("),
        ('"tau", "s", 0.0, 0.0', '"tau", "s", "0.0", 0.0', "EFFECT, 'tau', default: found '0.0', expected float"),
        ('State(n, "N"', "State(n, print", "EFFECT, 'reading', unit: found <built-in function print>, expected str"),
        ('"tau", "s", 0.0', '"tau", "0.0", 0.0', "EFFECT, tau, unit: found '0.0' is no unit that pint knows, expected 1"),
        ('State(n, "N"', 'State(n, "blub"', "EFFECT, reading, unit: found 'blub' is no unit that pint knows, expected 1, s"),
        (
            'probe={"tau": 0.05}',
            'probe={"tau": 0.0}',
            "EFFECT: found off {'tau': 0.0} and probe {'tau': 0.0}, which are the same",
        ),
        ('probe={"tau": 0.05}', 'probe={"lag": 0.05}', "EFFECT: found off ['tau'] and probe ['lag'] of the parameters ['tau']"),
        (
            'probe={"tau": 0.05}',
            'probe={"tau": None}',
            "EFFECT, probe: found {'tau': None}, expected the numbers of parameters",
        ),
        ('reading="thrust"', 'says="slow by {lag}"', "EFFECT, says: found 'slow by {lag}' ('lag'), expected a sentence with"),
        ('reading="thrust"', 'says="slow by {"', "EFFECT, says: found 'slow by {' ("),
    ],
)
def test_invalid_parts_of_an_effect_are_refused(word, other, says, tmp_path):
    path = tmp_path / "wrong.py"
    path.write_text(SOURCE.replace(word, other))
    assert refusal(library_with, [path]).startswith(f"{path}: {says}")


@pytest.mark.parametrize("verb", ["check-effect {}", "effects --effects-from {}", "diagnose {} --effects-from {}"])
def test_python_that_cannot_be_traced_is_refused_by_every_verb_with_its_line(verb, tmp_path, refused):
    path = tmp_path / "branches.py"
    path.write_text(SOURCE.replace("ops.where(p.tau > 0.0, reading, s.thrust)", "reading if p.tau > 0.0 else s.thrust"))
    line = SOURCE[: SOURCE.index("reading = ops.where(p.tau")].count("\n") + 1
    said = f"{path}: effect cell_lag, step, branches.py line {line}: found if, which can't be traced, expected ops.where"
    assert said in refused(*(word.format(path) for word in verb.split()))


def test_the_readme_shows_the_file_that_is_tested():
    body = SOURCE.partition("\n\n")[2].strip()
    assert body in (FILE.parents[1] / "README.md").read_text()


@pytest.fixture
def parameters(tmp_path):
    """A parameter file with the effect, and its file's folder."""
    model = vpp.read_parameters(_written(tmp_path, []), [FILE]).model
    assert not model.optional
    return _written(tmp_path, ["cell_lag"])


def _written(folder, effects):
    base = ParameterSet(library_model(())).to_dict()
    tau = {"cell_lag.tau": {"value": 0.04, "std": None, "unit": "s"}} if effects else {}
    path = folder / f"parameters{len(effects)}.json"
    path.write_text(json.dumps(base | {"effects": effects, "parameters": base["parameters"] | tau}))
    return path


def library_model(effects):
    """The plant with effects of the file."""
    from vpp_fmu.kernel.plant import plant

    return plant(effects, library_with([FILE]))


def test_verbs_take_the_file(parameters, tmp_path, refused):
    record, out = str(vpp.example_campaign() / "validation.csv.gz"), str(tmp_path / "out")
    call = ["simulate", record, "--parameters", str(parameters), "-o", out]
    assert "cell_lag" in refused(*call)
    assert main([*call, "--effects-from", str(FILE)]) == 0
    rig = tmp_path / "rig.json"
    ranges = {"speed": {"min": 2000, "max": 6000}, "pitch": {"min": -5, "max": 10}, "thrust": {"min": 0, "max": 15}}
    rig.write_text(json.dumps({"format": "vpp-rig/1", **ranges}))
    call = ["plan", "--parameters", str(parameters), "--rig", str(rig), "--seconds", "8", "-o", out]
    assert main([*call, "--effects-from", str(FILE)]) == 0
    told = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert told["seconds"] == 8.0
    assert "cell_lag.tau" in told["after"]["parameters"]


def test_the_loop_that_gains_are_tuned_on_has_the_effect(parameters):
    assert "cell_lag.tau" in [p.name for p in closed_loop(("cell_lag",), (str(FILE),)).models[0].parameters]
    held = vpp.read_parameters(parameters, [FILE])
    with pytest.raises(BadInput, match="effects_from: found nothing, expected the file of cell_lag"):
        vpp.tune(held)


def test_a_diagnosis_tries_a_user_defined_effect(short_campaign):
    found = vpp.diagnose(short_campaign, effects=["cell_lag", "pitch_command_deadband"], effects_from=[FILE], budget=0.0)
    assert {"cell_lag", "pitch_command_deadband"} <= {
        str(c.get("name", c.get("effects"))) for c in found.to_dict()["candidates"]
    }
    assert found.effects == ("pitch_command_deadband",)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Puts a package with entry points (group, name, value) and modules (source by name) onto the path."""

    def install(entries, modules):
        info = tmp_path / "a_plugin-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: a-plugin\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text("".join(f"[{group}]\n{name} = {value}\n" for group, name, value in entries))
        for name, source in modules.items():
            (tmp_path / f"{name}.py").write_text(source)
            monkeypatch.delitem(sys.modules, name, raising=False)
        monkeypatch.syspath_prepend(tmp_path)

    return install


@pytest.mark.parametrize("value", ["a_plugin_effect", "a_plugin_effect:EFFECT"])
def test_an_installed_package_brings_effects(installed, value):
    installed([("vpp.effects", "cell", value)], {"a_plugin_effect": SOURCE})
    assert [e.name for e in library_with(())] == [*(e.name for e in LIBRARY), "cell_lag"]


def test_a_broken_package_is_refused_in_one_line(installed):
    installed([("vpp.effects", "cell", "a_broken_effect")], {"a_broken_effect": "1 / 0"})
    with pytest.raises(BadInput, match=r"entry point cell of vpp.effects: a_broken_effect: found ZeroDivisionError"):
        library_with(())


VERB = 'EXAMPLE = "vpp greet"\n\n\ndef configure(parser):\n    pass\n\n\ndef run(options):\n    print("hello")\n'


def test_an_installed_package_brings_verbs(installed, printed, capsys):
    installed([("vpp.verbs", "greet", "a_plugin_verb")], {"a_plugin_verb": VERB})
    assert printed("greet") == "hello\n"
    with pytest.raises(SystemExit):
        main(["--help"])
    assert re.search(r"greet +of a-plugin", capsys.readouterr().out)
