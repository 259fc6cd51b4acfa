"""The motor's supply: wired by the calibration, read through a second ADC, logged, and ramped down beyond its limits."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from rigs import CALIBRATION, transitions

from hil.devices.calibration import read_calibration, to_json
from hil.devices.supply import Input
from hil.emulator import i2c
from hil.emulator.rig import EmulatedRig as Emulated
from hil.emulator.world import AMBIENT, HEATS, WARMS, LoadCell, World
from hil.loop.session import Setup
from hil.physics.rig_model import POWERTRAIN
from hil.results.outcome import energy
from hil.run import run_on_rig
from hil.safety.faults import FaultKind
from hil.safety.limits import Limits
from hil.safety.plausibility import SupplyLimits
from vpp_fmu.campaign import read_campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.plants import KernelController
from vpp_fmu.record import Record, write_record

pytestmark = pytest.mark.usefixtures("short_waits")

RPM, K = 2.0 * np.pi / 60.0, 30.0 / (np.pi * 550.0)
"""rad/s of one rpm; N.m/A of the paper's motor, 550 rpm/V."""

WIRED = {
    "voltage": Input("AIN0", 0.0, 11.0),  # a divider of 100 and 10 kOhm
    "current": Input("AIN1", -25.0, 50.0),  # a Hall sensor, 0.5 V without current
    "temperature": Input("AIN2", -50.0, 100.0),  # 10 mV a degree, 0.5 V at 0
}
RIG = replace(CALIBRATION, supply=WIRED)
PROFILE = Record({"time": np.array([0.0, 4.0]), "thrust_set": np.array([8.0, 8.0])}, "hold")


def run(tmp_path, calibration=RIG, **limits):
    tmp_path.mkdir(exist_ok=True)
    setup = Setup(calibration, Limits(**limits), Emulated(seed=3), virtual=True)
    return run_on_rig(setup, KernelController(), PROFILE, tmp_path)


def test_the_emulated_supply_sags_and_the_motor_warms_up_by_a_lag():
    """24 V less the drop of leads of 25 mOhm; under constant current the temperature approaches its end as exp(-t / 60 s)."""
    world = World(POWERTRAIN, {}, lambda: (0.4, 3.0), LoadCell(0.0, 1.0))
    world.advance(5.0)
    current, first = world.current, world.temperature
    assert current > 1.0
    assert world.voltage == pytest.approx(24.0 - 0.025 * current)
    for k in range(1, 301):
        world.advance(5.0 + 0.1 * k)
    assert world.current == pytest.approx(current, rel=1e-3)
    end = AMBIENT + HEATS * (current / 0.4) ** 2
    assert world.temperature == pytest.approx(end + (first - end) * np.exp(-30.0 / WARMS), rel=1e-3)


def test_each_input_reads_its_quantity_to_a_count(tmp_path):
    """At standstill; in the run the mean drop of the voltage is the leads' resistance times the mean current."""
    log = run(tmp_path).log
    idle = log.time < 1.0
    for name, value in (("voltage", 24.0), ("current", 0.0), ("temperature", AMBIENT)):
        assert np.nanmax(np.abs(log[name][idle] - value)) <= 125e-6 * WIRED[name].per_volt
    driven = (log["throttle"] > 0.3) & (log.time > log.time[-1] - 4.0)
    assert log["current"][driven].mean() > 2.0
    assert 24.0 - log["voltage"][driven].mean() == pytest.approx(0.025 * log["current"][driven].mean(), rel=0.25)
    assert log["temperature"][-1] > AMBIENT + 1.0


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"voltage_min": 23.9}, "voltage: found 23.5 V, expected at least 23.9 V"),
        ({"voltage_max": 20.0}, "voltage: found 23.5 V, expected at most 20 V"),
        ({"current_max": 2.0}, "current: found 3.0 A, expected at most 2 A"),
        ({"power_max": 40.0}, "power: found 70.5 W, expected at most 40 W"),
        ({"temperature_max": 20.5}, "temperature: found 20.6 degC, expected at most 20.5 degC"),
    ],
)
def test_each_quantity_has_its_limits(limits, words):
    checks, values = SupplyLimits(Limits(**limits)), {"voltage": 23.5, "current": 3.0, "temperature": 20.6}
    assert checks.check(values, tuple(values)) is None
    assert words in str(checks.check(values, tuple(values)))
    assert SupplyLimits(Limits()).check(values, tuple(values)) is None


def test_a_limit_exceeded_ramps_down(tmp_path):
    done = run(tmp_path, current_max=2.0)
    rig = done.session.rig
    assert next(fault.kind for fault in rig.states.faults) is FaultKind.SUPPLY
    assert re.search(r"current: found \d+\.\d A, expected at most 2 A", done.ended)
    assert "ramp down" in [state for _, state, _ in transitions(rig)]
    assert done.log["throttle"][-1] < 0.01


def test_a_fault_takes_two_readings_beyond_a_limit():
    limits, values = SupplyLimits(Limits(current_max=30.0)), {"voltage": 24.0, "current": 31.0, "temperature": 20.0}
    assert limits.check(values, ("current",)) is None
    assert limits.check(values, ("voltage",)) is None  # of another quantity
    assert limits.check({**values, "current": 1.0}, ("current",)) is None
    assert limits.check(values, ("current",)) is None
    assert limits.check(values, ()) is None  # the same reading, held
    assert "current: found 31.0 A" in str(limits.check(values, ("current",)))


def test_a_second_adc_that_is_not_there_is_found_before_arming(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.emulator.i2c.attached", lambda path, clock, _, whole=i2c.attached: whole(path, clock))
    with pytest.raises(Exception, match="supply adc: not ready"):
        run(tmp_path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.update(address=0x48), r"supply, address.*73 or 74 or 75"),
        (lambda s: s.pop("address"), "supply, address.*nothing"),
        (lambda s: s["current"].update(channel="AIN0"), "supply.*AIN0, AIN0"),
        (lambda s: s["current"].update(channel="AIN0-AIN1"), "supply, current, channel"),
        (lambda s: s["voltage"]["per_volt"].update(value=0.0), "supply, voltage, per_volt.*but 0"),
        (lambda s: s["temperature"]["zero"].update(unit="K"), "supply, temperature, zero, unit"),
        (lambda s: s.update(power={}), 'supply, "power"'),
        (lambda s: [s.pop(name) for name in WIRED], "supply.*no quantity"),
    ],
)
def test_a_wrong_wiring_is_named(tmp_path, change, words):
    content = json.loads(to_json(RIG))
    change(content["supply"])
    path = tmp_path / "c.json"
    path.write_text(json.dumps(content))
    with pytest.raises(BadInput, match=words):
        read_calibration(path)


def test_energy_is_the_integral_of_voltage_times_current_held_until_the_next_reading():
    nan = float("nan")
    columns = {"time": [0.0, 1.0, 2.0, 4.0], "voltage": [nan, 24.0, 23.0, 22.0], "current": [nan, 2.0, 4.0, 9.0]}
    found = energy(Record({name: np.array(column) for name, column in columns.items()}, "run"))
    mean = (48.0 * 1.0 + 92.0 * 2.0) / 3.0
    assert found == pytest.approx({"value": 4.0 * mean, "unit": "J", "mean_power": mean, "peak_power": 198.0})
    assert energy(PROFILE) is None


def test_a_run_and_a_campaign_measure_power_where_it_is_asked_for(tmp_path, printed):
    """The shaft's power is below that of the supply, and the loss in the winding is most of the difference."""
    write_record(OutputFolder(tmp_path), "profile.csv", PROFILE)
    said = printed("hil", "run", "--virtual", "--power", "--profile", tmp_path / "profile.csv", "-o", tmp_path / "run")
    assert re.search(r"energy from the supply: \d+ J, \d+\.?\d* W in the mean", said)
    (folder,) = (tmp_path / "run" / "runs").iterdir()
    facts = json.loads((folder / "hil.json").read_text())
    assert facts["energy"]["value"] == pytest.approx(facts["energy"]["mean_power"] * 4.0, rel=0.01)
    assert "energy from the supply" in (folder / "report.html").read_text()
    small = ["--parts", "static", "--points", "3", "--samples", "500", "--settle", "2.0"]
    printed("hil", "campaign", "--virtual", "--power", *small, "-o", tmp_path / "c")
    static = read_campaign(tmp_path / "c").static
    electrical = static.further["voltage"] * static.further["current"]
    shaft = (static.further["torque"] + 0.0104 + 1.8e-5 * static.omega * RPM) * static.omega * RPM
    assert np.all(shaft < electrical)
    copper = (static.further["torque"] + 0.0104 + 1.8e-5 * static.omega * RPM) ** 2 / K**2 * 0.045
    np.testing.assert_allclose(shaft + copper, electrical, rtol=0.05, atol=1.0)


def test_power_of_a_rig_without_its_sensors_is_refused(tmp_path, refused):
    path = tmp_path / "c.json"
    path.write_text(to_json(replace(CALIBRATION, supply={"voltage": WIRED["voltage"]})))
    said = refused("hil", "campaign", "--virtual", "--power", "--calibration", path, "-o", tmp_path / "c")
    assert "supply: found no current" in said
    assert not (tmp_path / "c").exists()
