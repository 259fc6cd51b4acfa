import json
import operator
from dataclasses import replace
from functools import reduce
from importlib.resources import files

import pytest

from hil.devices.calibration import read_calibration, to_json
from vpp_fmu.errors import BadInput

SHIPPED = files("hil.emulator") / "calibration.json"


@pytest.fixture
def content():
    return json.loads(SHIPPED.read_text())


def read(tmp_path, content):
    path = tmp_path / "calibration.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return read_calibration(path)


def within(content, place):
    """What is at a place of the file."""
    return reduce(operator.getitem, place, content)


def change(content, place, value):
    within(content, place[:-1])[place[-1]] = value


@pytest.fixture
def calibration():
    return read_calibration(SHIPPED)


def test_the_shipped_file_is_what_its_source_says(calibration):
    """10 kg at 10 mV, amplified 500 times, 4.096 V over 32768 counts; 0.8 V without load."""
    volts = 4.096 / 32768
    assert calibration.newton_per_count == pytest.approx(10.0 * 9.80665 / (0.010 * 500) * volts)
    assert calibration.zero * volts == pytest.approx(0.8)
    assert SHIPPED.read_text() == to_json(calibration)


def test_thrust_is_counts_from_the_tare_on(calibration):
    assert calibration.thrust(6400.0, 6400.0) == 0.0
    assert calibration.thrust(7400.0, 6300.0) == pytest.approx(1100.0 * 0.0024516625)
    assert replace(calibration, newton_per_count=-0.002).thrust(5000.0, 6000.0) == pytest.approx(2.0)


@pytest.mark.parametrize("falling", [False, True])
def test_pitch_is_straight_between_the_tables_points_both_ways(tmp_path, content, falling):
    pitches = [-12.0, -2.0, 0.0, 12.0]
    content["pitch"]["table"]["pulse"]["values"] = [0.0001, 0.0003, 0.0005, 0.0009]
    content["pitch"]["table"]["pitch"]["values"] = pitches[::-1] if falling else pitches
    calibration = read(tmp_path, content)
    sign = -1.0 if falling else 1.0
    points = {0.0001: -12.0, 0.0002: -7.0, 0.0003: -2.0, 0.0004: -1.0, 0.0007: 6.0, 0.0009: 12.0}
    if falling:
        points = {0.0001: 12.0, 0.0002: 6.0, 0.0003: 0.0, 0.0004: -1.0, 0.0007: -7.0, 0.0009: -12.0}
    for pulse, pitch in points.items():
        assert calibration.pitch(pulse) == pytest.approx(pitch)
        if abs(pitch) <= 10.0:
            assert calibration.lac_pulse(pitch) == pytest.approx(pulse)
    for k in range(201):
        pitch = -10.0 + 0.1 * k
        assert calibration.pitch(calibration.lac_pulse(pitch)) == pytest.approx(pitch, abs=1e-9)
    assert calibration.pitch(0.0) == -12.0 * sign  # the rod is at its stop
    assert calibration.pitch(0.001) == 12.0 * sign
    assert calibration.lac_idle == pytest.approx(calibration.lac_pulse(0.0))


def test_a_pitch_beyond_the_limits_has_no_pulse(calibration):
    for pitch in (-10.001, 10.001, float("nan")):
        with pytest.raises(ValueError, match="not within -10 to 10 deg"):
            calibration.lac_pulse(pitch)


def test_the_hash_is_of_the_numbers_and_of_nothing_else(tmp_path, content, calibration):
    content["source"] = {"who": "someone else"}
    content["load_cell"] = dict(reversed(content["load_cell"].items()))
    content["esc"]["idle_pulse"]["value"] = 1e-3
    content["load_cell"]["zero"]["value"] = 6400
    content["load_cell"]["rate"] = 860.0
    assert read(tmp_path, content).sha256 == calibration.sha256
    assert len(calibration.sha256) == 64
    seen = {calibration.sha256}
    for place in (
        ("load_cell", "force_per_count", "value"),
        ("load_cell", "zero", "value"),
        ("esc", "period", "value"),
        ("esc", "idle_pulse", "value"),
        ("esc", "max_pulse", "value"),
        ("pitch", "period", "value"),
        ("pitch", "minimum", "value"),
        ("pitch", "maximum", "value"),
        ("pitch", "table", "pulse", "values", 3),
        ("pitch", "table", "pitch", "values", 3),
    ):
        other = json.loads(SHIPPED.read_text())
        inwards = place[:2] in (("pitch", "minimum"), ("pitch", "maximum"))
        change(other, place, within(other, place) * (1.0 - 1e-12 if inwards else 1.0 + 1e-12))
        seen.add(read(tmp_path, other).sha256)
    assert len(seen) == 11


NUMBERS = ("load_cell", "force_per_count"), ("load_cell", "zero"), ("esc", "period"), ("esc", "idle_pulse")
NUMBERS += ("esc", "max_pulse"), ("pitch", "period"), ("pitch", "minimum"), ("pitch", "maximum"), ("pitch", "rest")


@pytest.mark.parametrize("place", NUMBERS, ids="-".join)
@pytest.mark.parametrize("value", [None, "1", True, [], 1e9, -1e9, 10**400], ids=str)
def test_every_number_is_checked(tmp_path, content, place, value):
    change(content, (*place, "value"), value)
    with pytest.raises(BadInput) as raised:
        read(tmp_path, content)
    assert raised.value.field == f"{', '.join(place)}, value"
    assert "a number from" in raised.value.allowed or raised.value.allowed == "finite numbers"
    assert "\n" not in str(raised.value)


WRONG = [
    (("format",), "vpp-calibration/2", "format", '"vpp-calibration/1"'),
    (("colour",), "red", '"colour"', "format, load_cell, esc, pitch, source"),
    (("esc",), [], "esc", "an object in braces"),
    (("source",), "me", "source", "an object in braces"),
    (("esc", "sound"), 1, 'esc, "sound"', "period, idle_pulse, max_pulse"),
    (("load_cell", "channel"), "AIN4", "load_cell, channel", '"AIN0"'),
    (("load_cell", "full_scale"), 4.0, "load_cell, full_scale", "4.096"),
    (("load_cell", "full_scale"), True, "load_cell, full_scale", "4.096"),
    (("load_cell", "rate"), 250, "load_cell, rate", "475 or 860"),
    (("load_cell", "force_per_count", "value"), 0.0, "load_cell, force_per_count", "1e-06 N or more, of either sign"),
    (("esc", "idle_pulse", "value"), 0.0, "esc, idle_pulse", "more than 0 s"),
    (("esc", "idle_pulse", "value"), 0.002, "esc, max_pulse", "more than idle_pulse, 0.002 s"),
    (("esc", "period", "value"), 0.002, "esc, period", "more than max_pulse, 0.002 s"),
    (("pitch", "period", "value"), 0.0008, "pitch, period", "0.0009 s, or more"),
    (("pitch", "minimum", "value"), -13.0, "pitch, minimum", "-12 deg, or more"),
    (("pitch", "maximum", "value"), 12.5, "pitch, maximum", "12 deg, or less"),
    (("pitch", "maximum", "value"), -10.0, "pitch, maximum", "more than minimum, -10 deg"),
    (("pitch", "rest", "value"), 11.0, "pitch, rest", "a pitch from minimum to maximum"),
    (("pitch", "table", "pulse", "values"), {}, "pitch, table, pulse, values", "a list of numbers"),
    (("pitch", "table", "pulse", "values"), [], "pitch, table, pulse", "2 or more"),
    (("pitch", "table", "pulse", "values"), [0.0, 1e-4], "pitch, table, pitch", "2, as many as pulse has"),
    (("pitch", "table", "pulse", "values", 2), 2e-4, "pitch, table, pulse", "values that rise"),
    (("pitch", "table", "pulse", "values", 2), 0.03, "pitch, table, pulse, values, 3", "0 to 0.025 s"),
    (("pitch", "table", "pitch", "values", 2), 9.0, "pitch, table, pitch", "values that only rise or only fall"),
    (("pitch", "table", "pitch", "values", 2), "x", "pitch, table, pitch, values, 3", "-45 to 45 deg"),
    (("pitch", "table", "pitch", "unit"), "rad", "pitch, table, pitch, unit", '"deg"'),
]


@pytest.mark.parametrize(("place", "value", "field", "allowed"), WRONG, ids=[f"{w[2]}-{w[1]}" for w in WRONG])
def test_what_is_wrong_is_named(tmp_path, content, place, value, field, allowed):
    change(content, place, value)
    with pytest.raises(BadInput) as raised:
        read(tmp_path, content)
    assert raised.value.field == field
    assert allowed in raised.value.allowed
    assert str(tmp_path) in raised.value.where


@pytest.mark.parametrize("missing", [("load_cell",), ("esc", "idle_pulse"), ("pitch", "table"), ("load_cell", "zero", "unit")])
def test_what_is_missing_is_named(tmp_path, content, missing):
    del within(content, missing[:-1])[missing[-1]]
    with pytest.raises(BadInput, match="found nothing") as raised:
        read(tmp_path, content)
    assert raised.value.field == ", ".join(missing)
