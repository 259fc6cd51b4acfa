import importlib.util
import json
from dataclasses import asdict, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from builders import refusal

from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import FINE_TUNED, LIBRARY, plant
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.kernel.types import BOOLEAN, REAL
from vpp_fmu.parameters import Estimate, ParameterSet, read_parameters, to_json, to_ssv
from vpp_fmu.units import base_unit, display_units

SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
SSC = "{http://ssp-standard.org/SSP1/SystemStructureCommon}"


def controller(effects):
    return CONTROLLER


def content(**changes):
    entries = {"tau_omega_1": {"value": 0.2, "std": 0.01, "unit": "s"}, "pitch_delay.delay": {"value": 0.05, "unit": "s"}}
    return {
        "format": "vpp-parameters/1",
        "parameters": entries,
        "effects": ["pitch_delay"],
        "source": {"file": "open_loop.csv"},
        **changes,
    }


def entry(name="c20", **changes):
    return content(parameters={name: {"value": 0.3, "std": None, "unit": "1", **changes}})


def written(folder, what):
    path = folder / "parameters.json"
    path.write_text(what if isinstance(what, str) else json.dumps(what))
    return path


def test_read_parameters(tmp_path):
    parameters = read_parameters(written(tmp_path, content()), plant)
    assert parameters.model.optional == ("pitch_delay",)
    assert parameters.estimates == {"tau_omega_1": Estimate(0.2, 0.01, "s"), "pitch_delay.delay": Estimate(0.05, None, "s")}
    assert parameters.source == {"file": "open_loop.csv"}
    assert parameters.values == {**plant(["pitch_delay"]).values(), "tau_omega_1": 0.2, "pitch_delay.delay": 0.05}


def test_parameters_not_in_the_file_keep_their_defaults(tmp_path):
    parameters = read_parameters(written(tmp_path, '{"format": "vpp-parameters/1"}'), plant)
    assert parameters.model.optional == ()
    assert {name: parameters.values[name] for name in FINE_TUNED} == FINE_TUNED


BAD = {
    "no JSON": ('{\n"format": "vpp-parameters/1",\n}', "line 3: found no JSON from column 1 on"),
    "no format": ({"parameters": {}}, 'format: found null, expected "vpp-parameters/1"'),
    "other format": (content(format="vpp-parameters/2"), 'format: found "vpp-parameters/2", expected "vpp-parameters/1"'),
    "unknown field": (content(parameter={}), '"parameter": found an unknown field, expected format, parameters, '),
    "parameters no object": (content(parameters=[1]), "parameters: found [1], expected an object in braces"),
    "effects no list": (content(effects="pitch_delay"), 'effects: found "pitch_delay", expected a list of effects'),
    "effects no names": (content(effects=[1]), "effects: found [1], expected a list of effects"),
    "unknown effect": (content(effects=["pitch_dellay"]), 'effects: found "pitch_dellay", expected pitch_delay'),
    "effect always on": (content(effects=["thrust_map"]), 'effects: found "thrust_map", expected '),
    "near name": (
        entry("tau_omga_1"),
        'parameters, "tau_omga_1": found a name that VppPlant does not have, expected tau_omega_1',
    ),
    "far name": (entry("zzz"), 'parameters, "zzz": found a name that VppPlant does not have, expected one of '),
    "line break": (entry("a\nb"), r'parameters, "a\nb": found a name that VppPlant does not have, expected '),
    "no entry": (content(parameters={"c20": 0.3}), "parameters, c20: found 0.3, expected an object in braces"),
    "unknown key": (entry(sigma=1), 'parameters, c20, "sigma": found an unknown field, expected value, std, unit'),
    "no value": (content(parameters={"c20": {"unit": "1"}}), "parameters, c20, value: found nothing, expected a value and its"),
    "no unit": (content(parameters={"c20": {"value": 1}}), "parameters, c20, unit: found nothing, expected a value and its"),
    "other unit": (entry("tau_beta_1", unit="ms"), 'parameters, tau_beta_1, unit: found "ms", expected "s"'),
    "text": (entry(value="0.3"), 'parameters, c20, value: found "0.3", expected a number from -10 to 10'),
    "truth": (entry(value=True), "parameters, c20, value: found true, expected a number from -10 to 10"),
    "NaN": (entry(value=float("nan")), "parameters, c20, value: found NaN, expected finite numbers"),
    "too small": (
        entry("tau_beta_2", value=0.0, unit="s"),
        "parameters, tau_beta_2, value: found 0.0, expected a number from 0.001 to 30 s",
    ),
    "too large": (entry(value=10.5), "parameters, c20, value: found 10.5, expected a number from -10 to 10"),
    "std negative": (entry(std=-0.1), "parameters, c20, std: found -0.1, expected a number from 0, or null"),
    "std text": (entry(std="small"), 'parameters, c20, std: found "small", expected a number from 0, or null'),
}


@pytest.mark.parametrize(("what", "message"), BAD.values(), ids=BAD)
def test_bad_files(tmp_path, what, message):
    path = written(tmp_path, what)
    said = refusal(read_parameters, path, plant)
    assert said.startswith(f"{path}: {message}")
    assert ", expected " in said


def random_set(model):
    rng = np.random.default_rng(3)
    scales = replace(PAPER, omega_scale=2513.0, beta_offset=-6.2, thrust_scale=171.3)
    model = model.sized(scales)
    values = {p.name: rng.uniform(p.minimum, p.maximum) for p in model.parameters[::2] if p.kind == REAL}
    values |= {p.name: 1.0 for p in model.parameters if p.kind == BOOLEAN}
    values |= {name: value for name, value in asdict(scales).items() if name != "time_scale"}
    return ParameterSet(model, source={"by": "µ", "files": ["a"]}).replaced(
        values, {n: rng.random() for n in list(values)[::2]}
    )


@pytest.mark.parametrize("build", [plant, controller])
def test_json_reads_back_to_the_bit(tmp_path, build):
    model = build(()) if build is controller else plant(e.name for e in LIBRARY if e.off is not None)
    parameters = random_set(model)
    text = to_json(parameters)
    path = tmp_path / "parameters.json"
    path.write_text(text, encoding="utf-8")
    back = read_parameters(path, build)
    assert back.values == parameters.values
    assert back.source == parameters.source
    assert back.model.optional == model.optional
    assert {name: back.estimates[name] for name in parameters.estimates} == dict(parameters.estimates)
    assert to_json(back) == text


MODELS = {"plant": plant(e.name for e in LIBRARY if e.off is not None), "controller": CONTROLLER}
each_model = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


@each_model
def test_ssv_holds_every_parameter(model):
    parameters = random_set(model)
    text = to_ssv(parameters, 'rig "a" & b')
    assert text.startswith('<?xml version="1.0" encoding="UTF-8"?>\n<ssv:ParameterSet ')
    assert text == to_ssv(parameters, 'rig "a" & b')
    root = ElementTree.fromstring(text.encode())
    assert root.tag == f"{SSV}ParameterSet"
    assert root.attrib == {"version": "1.0", "name": 'rig "a" & b'}
    assert [child.tag for child in root] == [f"{SSV}Parameters", f"{SSV}Units"]
    units = {unit.get("name"): unit for unit in root.find(f"{SSV}Units")}
    assert len(units) == len(root.find(f"{SSV}Units"))
    found = {}
    for element in root.find(f"{SSV}Parameters"):
        assert element.tag == f"{SSV}Parameter"
        (typed,) = element
        found[element.get("name")] = (typed.tag.removeprefix(SSV), float(json.loads(typed.get("value"))), typed.get("unit"))
        assert typed.get("unit") in {None, *units}
    expected = {p.name: (p.kind, parameters.values[p.name], p.unit if p.kind == REAL else None) for p in model.parameters}
    assert found == expected
    assert all(unit.tag == f"{SSC}Unit" and unit[0].tag == f"{SSC}BaseUnit" for unit in units.values())


@pytest.mark.skipif(importlib.util.find_spec("lxml") is None, reason="lxml is not installed")
@each_model
def test_ssv_obeys_the_standard_s_schema(model):
    from lxml import etree

    schema = Path(importlib.util.find_spec("fmpy").origin).parent / "ssp" / "schema" / "SystemStructureParameterValues.xsd"
    etree.XMLSchema(etree.parse(str(schema))).assertValid(etree.fromstring(to_ssv(ParameterSet(model), "a").encode()))


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("1", {}),
        ("s", {"s": "1"}),
        ("1/s", {"s": "-1"}),
        ("N", {"kg": "1", "m": "1", "s": "-2"}),
        ("N/s", {"kg": "1", "m": "1", "s": "-3"}),
        ("V/A", {"kg": "1", "m": "2", "s": "-3", "A": "-2"}),
        ("deg/s/s", {"rad": "1", "s": "-2", "factor": np.pi / 180.0}),
        ("rpm", {"rad": "1", "s": "-1", "factor": np.pi / 30.0}),
        ("rpm.s/deg", {"factor": 6.0}),
        ("m/s2", {"m": "1", "s": "-2"}),
        ("furlong", {"m": "1", "factor": 201.16840233680466}),
        ("degC", {"K": "1", "offset": "273.15"}),
    ],
)
def test_base_units(unit, expected):
    found = base_unit(unit)
    assert float(found.pop("factor", 1.0)) == pytest.approx(expected.pop("factor", 1.0), rel=1e-15)
    assert found == expected


@pytest.mark.parametrize("value", [0.37, -1, 2])
def test_a_switch_must_be_0_or_1(tmp_path, value):
    path = tmp_path / "gains.json"
    content = {"format": "vpp-parameters/1", "parameters": {"speed_only": {"value": value, "unit": "1"}}}
    path.write_text(json.dumps(content))
    with pytest.raises(BadInput, match=f"speed_only, value: found {value}, expected 0 or 1"):
        read_parameters(path, controller)


@pytest.mark.parametrize(
    ("unit", "shown", "factor"),
    [
        ("s", "ms", 1e3),
        ("rpm", "rad/s", np.pi / 30.0),
        ("rad/s", "rpm", 30.0 / np.pi),
        ("deg", "rad", np.pi / 180.0),
        ("rad", "deg", 180.0 / np.pi),
        ("N", "gf", 1e3 / 9.80665),
        ("N", "kgf", 1.0 / 9.80665),
    ],
)
def test_display_units_have_their_factors(unit, shown, factor):
    """FMI 2.0, section 2.2.2: display value = factor * value in the unit."""
    assert float(display_units(unit)[shown]["factor"]) == pytest.approx(factor, rel=1e-14)
