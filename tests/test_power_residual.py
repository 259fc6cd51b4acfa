"""Dynamic effects of power: named with their true size, none if nothing is hidden, no section without power."""

import json
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from power_rig import PowerRig, truth

from identification.power.diagnose import diagnose_power
from identification.power.effects import HEATING, Signals
from identification.power.records import respond
from vpp_fmu.campaign import write_static
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import ADDS_POWER
from vpp_fmu.kernel.power import EFFECTS as POWER_EFFECTS
from vpp_fmu.record import write_record


def clear(seed, kind):
    """A rig whose hidden effect is far above its noise."""
    rig = PowerRig(seed, kind)
    rig.drawn.update(noise=0.01, strength=1.0, seconds=90.0, rate=125.0, time_constant=12.0, slow=False, torque=True)
    return rig


@pytest.mark.parametrize("seed", range(2))
def test_nothing_hidden_is_no_effect(seed):
    found = PowerRig(seed, "none").diagnosed()
    assert [e.name for e in found.effects] == [], found.summary()
    assert found.verdict == "none", found.summary()["lack_of_fit"]


@pytest.mark.parametrize(
    "kind", ["resistance_heating", "servo_load rate", "servo_load rate and thrust", "power_drift", "supply_sag"]
)
def test_a_hidden_effect_is_named_with_its_size(kind):
    rig = clear(7, kind)
    found = rig.diagnosed()
    name, _, form = kind.partition(" ")
    assert [(e.name, e.form) for e in found.effects] == [(name, form or "only")], found.summary()["candidates"]
    for (effect, parameter), value in truth(rig, found).items():
        own = found.parameters[effect][parameter]
        assert own["value"] == pytest.approx(value, abs=3.5 * own["std"], rel=1e-3)
        low, high = own["interval"]
        assert low - 0.5 * (high - low) < value < high + 0.5 * (high - low)
    assert found.errors[1] <= found.errors[0]


def test_supply_sag_is_not_offered_without_voltage_and_current():
    rig = PowerRig(8, "servo_load rate")
    rig.drawn.update(columns="power", noise=0.003)
    found = rig.diagnosed().summary()
    assert "supply_sag" not in {c["name"] for c in found["candidates"]}
    assert list(found["not_identifiable"]) == ["supply_sag"]


def test_the_winding_warms_up_as_the_closed_form():
    """Constant load u: with gain g and feedback f, h = u / (1 - u g f) (1 - exp(-t (1 - u g f) / tau)), and g u h is added."""
    step, u, gain, tau, feedback = 0.01, 0.8, 6.0, 5.0, 1.0 / 25.0
    time = step * np.arange(3000)
    one = np.full(len(time), u)
    signals = Signals(time, one, one, one, one, one, step, feedback)
    share = 1.0 - u * gain * feedback
    expected = gain * u * u / share * -np.expm1(-time * share / tau)
    np.testing.assert_allclose(HEATING.response(signals, {"gain": gain, "time_constant": tau}), expected, atol=2e-3 * gain)


def test_rates_are_those_of_the_lags():
    """Two lags after a step of 1: exp(-t / a) and exp(-t / b) over a - b, in closed form."""
    rig = PowerRig(3, "none")
    values = rig.parameters.values
    record = rig.record(np.random.default_rng(0))
    columns = {n: record[n][:400] for n in ("time", "omega_ref", "beta_ref", "thrust")}
    columns["omega_ref"] = np.where(columns["time"] < columns["time"][50], 3000.0, 4000.0)
    _, rates, _ = respond(rig.parameters, type(record)(columns, "step"))
    a, b, t = values["tau_omega_1"], values["tau_omega_2"], np.maximum(columns["time"] - columns["time"][50], 0.0)
    expected = 1000.0 * (np.exp(-t / a) - np.exp(-t / b)) / (a - b)
    np.testing.assert_allclose(rates[:, 0], expected, atol=3e-3 * expected.max())


def test_a_plant_or_a_record_without_power_has_no_diagnosis():
    rig = PowerRig(3, "none")
    record = rig.record(np.random.default_rng(0))
    bare = type(record)({n: c for n, c in record.columns.items() if n not in ("power", "voltage", "current")}, "bare")
    assert diagnose_power({"open_loop": bare}, None, rig.parameters, 0.02) is None


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A campaign of a rig whose servo takes power, and the same without any power."""
    folder = tmp_path_factory.mktemp("rig")
    rig, rng = clear(11, "servo_load rate"), np.random.default_rng(5)
    rig.drawn.update(columns="power", seconds=60.0)
    for name in ("with", "without"):
        there = OutputFolder(folder / name)
        write_static(there, rig.points if name == "with" else replace(rig.points, further={}))
    for record in ("open_loop", "validation"):
        rows = rig.record(rng)
        write_record(OutputFolder(folder / "with"), f"{record}.csv", rows)
        bare = {n: c for n, c in rows.columns.items() if n != "power"}
        write_record(OutputFolder(folder / "without"), f"{record}.csv", replace(rows, columns=bare))
    return folder


def test_a_diagnosis_has_the_power_beside_an_unchanged_thrust(campaign, monkeypatch, printed):
    monkeypatch.chdir(campaign)
    found, text = {}, {}
    for name in ("with", "without"):
        text[name] = printed("diagnose", name, "--effects", "pitch_backlash", "-o", f"out_{name}")
        found[name] = json.loads((campaign / f"out_{name}" / "diagnosis.json").read_text())
    power = found["with"].pop("power")
    assert found["with"] == found["without"]
    schema = json.loads((files("vpp_fmu.app.cli.schemas") / "diagnose.json").read_text())
    Draft202012Validator(schema).validate(found["with"] | {"power": power, "sentence": "as printed"})
    (effect,) = power["effects"]
    low, high = effect["parameters"]["load"]["interval"]
    assert (power["verdict"], effect["name"], effect["form"]) == ("attributed", "servo_load", "rate")
    assert low < 0.3 < high
    assert power["before"]["from"] == "validation"
    assert power["after"]["rmse_power"]["value"] < power["before"]["rmse_power"]["value"]
    line = "The pitch servo takes"
    pages = {name: (campaign / f"out_{name}" / "report.html").read_text() for name in found}
    assert [f"Power: {line}" in text[name] and line in pages[name] for name in ("with", "without")] == [True, False]
    assert [">Power</h2>" in pages[name] for name in ("with", "without")] == [True, False]


def test_a_plant_knows_the_effects_of_power_without_importing_them():
    assert {e.name for e in POWER_EFFECTS} == ADDS_POWER
