"""Logs of RCbenchmark stands: reading, rows left out, and the map from ESC signal to speed."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders import refusal
from import_zoo import lagged

from identification.gate.zero import resting
from identification.logs.sampling import REMEMBERED
from identification.logs.speed_map import (
    RANGES,
    SpeedMap,
    SteadyPoints,
    fit_speed_map,
    read_speed_map,
    said_of_fit,
    steady_points,
    turning_from,
)
from vpp_fmu.campaign import read_static
from vpp_fmu.errors import BadInput
from vpp_fmu.record import read_record

LOGS = Path(__file__).resolve().parents[2] / "shared" / "data" / "sar_motor"
FIRST, SECOND = (LOGS / f"TimeConstant_Test_{day}.csv" for day in ("2023-12-13_130935", "2023-12-16_130840"))
real = pytest.mark.skipif(not FIRST.exists(), reason="the real logs are not here: ../shared/data/sar_motor")

FIRST_WORDS = ("import", "rcbenchmark")
OFFSET, GRAM = -0.3, 9.80665e-3
COEFFICIENTS = (-300.0, 24000.0, -15000.0, 9000.0)
NOMINAL = 22.0
HEADERS = {
    "time": "Time (s)",
    "signal": "ESC signal",
    "thrust": "Thrust (gf)",
    "voltage": "Voltage (V)",
    "current": "Current (A)",
    "electrical": "Motor Electrical Speed (rad/s)",
    "optical": "Motor Optical Speed (rad/s)",
    "torque": "Torque (N·m)",
    "power": "Electrical Power (W)",
}


def truth(signals=(0, 200, 600, 1000, 1500, 1900, 800, 0), held=2.0, seed=1) -> dict[str, np.ndarray]:
    """A log in a record's units: steps of the signal, a motor without lag, a battery that sags."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.007, 0.011, int(len(signals) * held / 0.009)))
    signal = np.array(signals, float)[np.minimum((time / held).astype(int), len(signals) - 1)]
    voltage = 23.0 - signal / 2047.0 - 0.01 * time
    x = signal / 2047.0 * voltage / NOMINAL
    speed = np.where(signal > 0, np.polyval(COEFFICIENTS[::-1], x), 0.0)
    thrust = 12.0 * (speed / 20000.0) ** 2 + OFFSET + 0.01 * rng.normal(size=len(time))
    return {"time": time, "signal": signal, "thrust": thrust, "voltage": voltage, "current": signal / 100.0, "optical": speed}


def write(path, columns, headers=HEADERS) -> Path:
    """A log as the stand writes it: byte-order mark, CRLF, a comma at each line's end; NaN is an empty cell."""
    factors = {"thrust": 1.0 / GRAM, "optical": np.pi / 30.0, "electrical": np.pi / 30.0}
    names = [name for name in headers if name in columns]
    lines = [",".join(headers[name] for name in names) + ",App message,"]
    for row in zip(*(np.asarray(columns[name], float) * factors.get(name, 1.0) for name in names), strict=True):
        lines.append(",".join("" if np.isnan(value) else repr(float(value)) for value in row) + ",,")
    path.write_bytes(("\ufeff" + "\r\n".join(lines) + "\r\n").encode())
    return path


@pytest.fixture
def imported(tmp_path, printed):
    """Import a log as a record: (the record, the output)."""

    def run(path, *words):
        said = printed(path, *words, "--as", "open_loop", "--replace", "-o", tmp_path / "imported")
        return read_record(tmp_path / "imported" / "open_loop.csv", holes=("thrust", "omega")), said

    return run


@pytest.fixture
def log(tmp_path, imported):
    """Write a log of `truth`, with columns exchanged, and import it."""

    def made(*words, headers=HEADERS, **columns):
        return imported(write(tmp_path / "log.csv", truth() | columns, headers), *words)

    return made


def gapped(columns, rows, gap=0.09):
    """The time column with a stall of the logger before each of `rows`."""
    time = columns["time"].copy()
    for row in rows:
        time[row:] += gap
    return time


# Reading


def test_a_log_is_read_in_the_units_of_a_record(log):
    t, (record, said) = truth(), log()
    np.testing.assert_allclose(record.time, t["time"] - t["time"][0], atol=1e-8)
    for name, column in (("omega", "optical"), ("voltage", "voltage"), ("current", "current")):
        np.testing.assert_allclose(record[name], t[column], rtol=1e-8, atol=1e-8)
    assert f"time 0 is {t['time'][0]:.15g} s of the log" in said
    at_rest = resting(record)  # the thrust is tared by the rest
    tare = float(said.split("tare: ")[1].split(" N taken off")[0])
    assert tare == pytest.approx(OFFSET, abs=4 * 0.01 / np.sqrt(at_rest.sum()))
    assert f"the mean of {at_rest.sum()} readings at rest (spread 0.0" in said
    assert abs(record["thrust"][at_rest].mean()) < 1e-8
    assert np.ptp(record["thrust"] - t["thrust"]) < 1e-7


def test_empty_cells_hold_the_signal_and_stay_empty_in_the_thrust(log):
    t = truth()
    signal, thrust, voltage = t["signal"].copy(), t["thrust"].copy(), t["voltage"].copy()
    signal[[0, 1, 300, 301]] = thrust[1::2] = voltage[700] = np.nan
    record, said = log(signal=signal, thrust=thrust, voltage=voltage)
    assert len(set(record["omega_ref"])) == len(set(t["signal"]))
    assert record["omega_ref"][298] == record["omega_ref"][297]
    assert "2 rows before the first command, left out" in said
    np.testing.assert_array_equal(np.isnan(record["thrust"]), np.arange(len(record)) % 2)
    assert record["voltage"][698] == pytest.approx(t["voltage"][699])


def test_a_speed_sensor_that_never_moves_is_not_taken(log):
    t = truth()
    record, said = log(electrical=t["optical"], optical=np.zeros(len(t["time"])))
    assert f"omega <- {HEADERS['electrical']}" in said
    np.testing.assert_allclose(record["omega"], t["optical"], rtol=1e-8, atol=1e-6)


@pytest.mark.parametrize(
    ("header", "low", "kind"), [("ESC signal", 0, "DShot"), ("ESC signal (µs)", 1000, "PWM"), ("ESC signal", 1000, "PWM")]
)
def test_the_kind_of_signal_is_recognised_by_its_unit_or_its_values(tmp_path, log, header, low, kind):
    log(headers=HEADERS | {"signal": header}, signal=low + truth()["signal"] / 2.0)
    assert read_speed_map(tmp_path / "imported" / "speed_map.json").signal == RANGES[kind]


# Readings that are left out


def test_rows_after_a_stall_of_the_logger_are_emptied_unless_they_are_kept(log):
    t, rows = truth(), (400, 1000)
    columns = {"time": gapped(t, rows), "torque": 1e-9 * t["optical"] ** 2, "power": t["voltage"] * t["current"]}
    record, said = log(**columns)
    assert "stalls: 2 gaps of 9" in said
    behind = np.concatenate([np.arange(row, row + REMEMBERED) for row in rows])
    for names, empty in ((("omega", "thrust", "torque"), behind), (("current", "power"), rows)):
        for name in names:
            np.testing.assert_array_equal(np.flatnonzero(np.isnan(record[name])), empty)
    np.testing.assert_allclose(record["voltage"][list(rows)], t["voltage"][np.array(rows) - 1], rtol=1e-8)
    assert np.isfinite(record["voltage"]).all()
    kept, _ = log("--keep-stalls", **columns)
    np.testing.assert_allclose(kept["omega"], t["optical"], rtol=1e-8, atol=1e-6)
    assert all(np.isfinite(kept[name]).all() for name in ("thrust", "voltage", "current"))


def test_a_zero_that_jumps_is_taken_off_on_each_side(tmp_path, printed):
    t = truth(held=3.0)
    path = write(tmp_path / "log.csv", t | {"thrust": t["thrust"] + np.where(t["time"] > 13.0, 0.9, 0.0)})
    said = printed(path, "-o", tmp_path / "out")
    assert "zero: jumps by +0.9" in said
    assert "zero_jump" not in said
    thrust = read_record(tmp_path / "out" / "record.csv", holes=("thrust",))["thrust"]
    np.testing.assert_allclose(thrust, t["thrust"] - OFFSET, atol=0.006)
    assert f"thrust {thrust.min():.3g} to {thrust.max():.3g} N" in said.splitlines()[0]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("Voltage (V)", "Volts", "column Voltage: found only Time (s)"),
        ("Thrust (gf)", "Thrust", "thrust=Thrust: found no unit, in the log or behind the column"),
        ("Optical Speed (rad/s)", "Optic (m)", "found a signal and no measured speed"),
        ("\n", "\nx", "Time (s), line 2: found 'x"),
    ],
)
def test_a_bad_log_is_refused_in_one_line(tmp_path, refused, old, new, told):
    path = write(tmp_path / "log.csv", truth())
    path.write_text(path.read_text(encoding="utf-8-sig").replace(old, new))
    assert told in refused(path, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


# The map from signal to speed


def test_the_map_is_that_of_the_steady_parts(tmp_path, log):
    (record, _), signal = log(), truth()["signal"]
    found = read_speed_map(tmp_path / "imported" / "speed_map.json")
    assert found.points == 6
    # A mean of a curve is not the curve at the mean: the sag of 0.01 V/s leaves that much.
    at_nominal = [c * (found.nominal_voltage / NOMINAL) ** k for k, c in enumerate(COEFFICIENTS)]
    np.testing.assert_allclose(found.coefficients, at_nominal, rtol=1e-3)
    assert found.rms < 1.0
    assert (found.turns_from, found.fitted_to) == (200.0, 1900.0)
    omega_ref = record["omega_ref"]  # which depends on the signal alone
    assert len(np.unique(omega_ref)) == len(np.unique(signal))
    np.testing.assert_array_equal(omega_ref[signal < 200.0], 0.0)
    expected = np.polyval(COEFFICIENTS[::-1], 1000.0 / 2047.0 * found.nominal_voltage / NOMINAL)
    assert omega_ref[signal == 1000.0][0] == pytest.approx(expected, rel=1e-3)


def test_speeds_behind_a_stall_do_not_enter_the_map(tmp_path, log):
    t = truth()
    row = int(np.argmax(t["time"] > 7.3))  # in the second half of a hold
    late, maps = t["optical"].copy(), []
    late[row : row + REMEMBERED] *= 0.97
    for speed in (t["optical"], late):
        log(time=gapped(t, (row,)), optical=speed)
        maps.append(read_speed_map(tmp_path / "imported" / "speed_map.json"))
    assert maps[0] == maps[1]


def test_parts_that_are_short_or_unsteady_make_no_point():
    """A motor that stutters is at rest half of the time; a motor at a short hold turns."""
    time = np.arange(0.0, 6.0, 0.01)
    signal = np.select([time < 2.0, time < 2.8, time < 4.0], [100.0, 200.0, 300.0], 400.0)
    speed = np.where(time < 2.0, 1000.0 * (np.arange(len(time)) % 3 == 0), 10.0 * signal)
    usable = time < 5.5
    speed[~usable] = 1e9
    points = steady_points(time, signal, speed, np.full(len(time), 20.0), usable)
    np.testing.assert_array_equal(points.signal, [300.0, 400.0])
    np.testing.assert_allclose(points.speed, [3000.0, 4000.0])
    assert points.turns_from == 200.0


def coasting(levels, held, tau, step=0.01):
    """(time, signal, speed) of a motor that turns 10 rpm a unit of signal from 100 on, behind one lag."""
    signal = np.repeat(np.array(levels, float), [round(h / step) for h in held])
    return step * np.arange(len(signal)), signal, lagged(np.where(signal >= 100.0, 10.0 * signal, 0.0), step, tau)


@pytest.mark.parametrize(
    ("levels", "held", "turns_from"),
    [
        ((0, 500, 0, 400, 120), (2.0, 2.0, 0.3, 2.0, 0.4), 120.0),  # coasting at no throttle; slowing down at 120, which turns
        ((500, 60, 400, 50), (2.0, 3.0, 2.0, 0.3), 400.0),  # at 60 it came to rest, so at 50 it coasts
        ((0, 500), (2.0, 0.5), 500.0),  # starting is no rest
        ((0, 0), (2.0, 2.0), np.nan),
    ],
)
def test_a_coasting_rotor_is_not_taken_for_a_driven_one(levels, held, turns_from):
    time, signal, speed = coasting(levels, held, 0.3)
    assert turning_from(time, signal, speed, 0.0) == pytest.approx(turns_from, nan_ok=True)


def test_shorter_parts_complete_a_map_where_they_are_settled():
    levels = (300, 400, 500, 600, 700, 150, 650, 200)
    time, signal, speed = coasting(levels, (2.0,) * 5 + (0.9,) * 3, 0.05)
    points = steady_points(time, signal, speed, np.ones(len(time)), np.isfinite(speed))
    np.testing.assert_array_equal(points.signal, [300.0, 400.0, 500.0, 600.0, 700.0, 150.0, 200.0])
    np.testing.assert_allclose(points.speed, 10.0 * points.signal, rtol=1e-3)
    slow = coasting(levels, (4.0,) * 5 + (0.9,) * 3, 0.6)
    points = steady_points(*slow, np.ones(len(slow[0])), np.isfinite(slow[2]))
    assert set(points.signal) == {300.0, 400.0, 500.0, 600.0, 700.0}


def cubic_points(signals) -> SteadyPoints:
    signals = np.array(signals, float)
    voltage = 23.0 - signals / 1000.0
    return SteadyPoints(signals, voltage, np.polyval(COEFFICIENTS[::-1], signals / 2047.0 * voltage / NOMINAL), signals.min())


@pytest.mark.parametrize(("wrong", "factor"), [(11, 2.0), (0, 2.0), (5, 0.5)])
def test_a_part_of_doubled_or_halved_speed_does_not_change_the_map(wrong, factor):
    points = cubic_points(np.linspace(150, 1900, 12))
    speed, keep = points.speed + np.random.default_rng(2).normal(0.0, 10.0, 12), np.arange(12) != wrong
    others = SteadyPoints(points.signal[keep], points.voltage[keep], speed[keep], points.turns_from)
    spoiled = replace(points, speed=np.where(keep, 1.0, factor) * speed)
    found, expected = (fit_speed_map(p, RANGES["DShot"], NOMINAL, "log.csv") for p in (spoiled, others))
    np.testing.assert_allclose(found.coefficients, expected.coefficients, rtol=1e-9)
    assert found.points == 11
    said = said_of_fit(spoiled, found)
    assert "; 1 more are off by a factor and left out" in said
    assert float(said.split("at most ")[1].split(" rpm")[0]) < 50.0


def test_too_few_signals_a_falling_speed_or_points_off_every_curve_make_no_map():
    points = cubic_points([100, 400, 800, 1200, 1400, 1900])
    for wrong, told in (
        (cubic_points([100, 400, 400, 800, 1200]), r"4 different ESC signals.*--speed-map"),
        (replace(points, speed=points.speed[::-1]), "don't increase"),
        (replace(points, speed=points.speed * np.array([1, 1, 2, 1, 1, 1])), r"off the best map.*at most 5 %.*--speed-from"),
    ):
        with pytest.raises(BadInput, match=told):
            fit_speed_map(wrong, RANGES["DShot"], NOMINAL, "log.csv")


SPAN = {"kind": "PWM", "minimum": 5, "maximum": 6, "turns_from": 1, "fitted_to": 2}


def test_a_bad_speed_map_is_refused_in_one_line(tmp_path):
    good = json.loads(SpeedMap(COEFFICIENTS, NOMINAL, RANGES["DShot"], 100.0, 1900.0, 1.0, 9, "log.csv").to_json())
    path = tmp_path / "speed_map.json"
    for told, change in {
        "format: found": {"format": "vpp-parameters/1"},
        "coefficients: found [1.0, 2.0], expected a list of 4": {"coefficients": [1.0, 2.0]},
        'coefficients, 3: found "x", expected a number': {"coefficients": [1.0, 2.0, "x", 3.0]},
        "nominal_voltage: found 0, expected a number above 0": {"nominal_voltage": 0},
        'signal, kind: found "OneShot", expected one of DShot': {"signal": SPAN | {"kind": "OneShot"}},
        "signal, maximum: found 5": {"signal": SPAN | {"maximum": 5}},
        "signal, minimum: found nothing": {"signal": {"kind": "PWM"}},
    }.items():
        path.write_text(json.dumps(good | change))
        assert told in refusal(read_speed_map, path)


# The verb


def test_another_log_takes_the_map_over_unchanged(tmp_path, printed, refused):
    write(tmp_path / "monday.csv", truth())
    t = truth((0, 500, 1200, 1700), seed=2)
    write(tmp_path / "tuesday.csv", t | {"optical": t["optical"] + np.where(t["optical"] > 0, 250.0, 0.0)})
    printed(tmp_path / "monday.csv", "-o", tmp_path / "monday")
    saved = tmp_path / "monday" / "speed_map.json"
    said = printed(tmp_path / "tuesday.csv", "--speed-map", saved, "-o", tmp_path / "tuesday")
    assert (tmp_path / "tuesday" / "speed_map.json").read_bytes() == saved.read_bytes()
    assert "taken over from monday.csv" in said
    assert 248.0 < float(said.split("; here rms ")[1].split(" rpm")[0]) < 252.0
    pwm = write(tmp_path / "pwm.csv", t | {"signal": 1000.0 + t["signal"] / 3.0})
    assert "signal, kind: found DShot, expected a map for PWM" in refused(pwm, "--speed-map", saved, "-o", tmp_path / "pwm")


def test_rows_that_are_averages_give_a_map_and_no_record(tmp_path, printed):
    points = cubic_points([100, 300, 600, 1000, 1400, 1800])
    time = np.array([1.2404, 1.2392, 6.7, 12.2, 17.8, 23.3])
    columns = {"time": time, "signal": points.signal, "thrust": points.speed / 1e4, "voltage": points.voltage}
    said = printed(write(tmp_path / "points.csv", columns | {"optical": points.speed}), "-o", tmp_path / "out")
    assert "tare: none, the log has no rest" in said
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["import.toml", "speed_map.json", "static.csv"]
    static = read_static(tmp_path / "out" / "static.csv")
    np.testing.assert_allclose(static.omega, points.speed, rtol=1e-8)
    np.testing.assert_allclose(static.thrust, points.speed / 1e4, rtol=1e-8)
    assert static.thrust_std.max() == static.thrust_std.min()
    nominal = float(np.median(points.voltage))
    expected = [c * (nominal / NOMINAL) ** k for k, c in enumerate(COEFFICIENTS)]
    np.testing.assert_allclose(read_speed_map(tmp_path / "out" / "speed_map.json").coefficients, expected, rtol=1e-9)


def test_a_log_of_eight_rows_a_second_is_of_averages(tmp_path, printed):
    t = truth(held=4.0)
    row = (t["time"] * 8.0).astype(int)
    means = {n: [c[row == k][-1] if n == "signal" else c[row == k].mean() for k in np.unique(row)] for n, c in t.items()}
    path = write(tmp_path / "slow.csv", means)
    assert "so steady points and no record" in printed(path, "-o", tmp_path / "out")
    held = [np.mean(t["optical"][(t["time"] > 4.0 * k + 2.0) & (t["time"] < 4.0 * k + 3.9)]) for k in range(8)]
    np.testing.assert_allclose(read_static(tmp_path / "out" / "static.csv").omega, held, atol=3.0)  # rpm: the battery sags
    assert "lags from them are wrong by as much" in printed(path, "-o", tmp_path / "forced", "--as", "open_loop")
    assert read_record(tmp_path / "forced" / "open_loop.csv").period == pytest.approx(0.125, rel=0.02)


def test_a_map_of_another_log_reaches_down_to_where_this_one_turns(tmp_path, printed):
    write(tmp_path / "monday.csv", truth())
    write(tmp_path / "tuesday.csv", truth((0, 500, 1200, 100, 300), seed=2))
    printed(tmp_path / "monday.csv", "-o", tmp_path / "stand", "--as", "open_loop")
    said = printed(tmp_path / "tuesday.csv", "-o", tmp_path / "stand", "--as", "validation")
    assert "here the rotor turns from signal 100 on, there from 200" in said
    record = read_record(tmp_path / "stand" / "validation.csv", holes=("thrust", "omega"))
    assert not np.any((record["omega_ref"] == 0.0) & (np.nan_to_num(record["omega"]) > 0.0))
    nominal = read_speed_map(tmp_path / "stand" / "speed_map.json").nominal_voltage
    expected = np.polyval(COEFFICIENTS[::-1], 100.0 / 2047.0 * nominal / NOMINAL)
    assert record["omega_ref"][record["omega_ref"] > 0.0].min() == pytest.approx(expected, rel=2e-3)


def test_the_measured_speed_as_command_is_interpolated_where_it_is_late_or_doubled(tmp_path, printed):
    t = truth((0, 200, 600, 1000, 1500, 1900, 800, 400, 1200, 300, 1700, 0))
    time, late = gapped(t, (400,)), np.arange(len(t["time"])) - 400
    late, doubled = (late >= 0) & (late < REMEMBERED), (t["time"] > 9.0) & (t["time"] < 13.5)
    speed = np.where(late, 0.9, np.where(doubled, 2.0, 1.0)) * t["optical"]
    path = write(tmp_path / "log.csv", t | {"time": time, "optical": speed})
    told = f"{doubled.sum()} readings are 2 times what the command and their neighbours say"
    assert told in printed(path, "-o", tmp_path / "signal")
    printed(path, "--speed-from", "measured", "-o", tmp_path / "out")
    record = read_record(tmp_path / "out" / "record.csv", holes=("thrust",))
    good = ~late & ~doubled
    expected = np.interp(time, time[good], t["optical"][good])
    np.testing.assert_allclose(record["omega_ref"], expected, rtol=1e-8, atol=1e-6)
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["import.toml", "record.csv"]


def test_thrust_that_was_logged_backwards_is_turned_by_the_option_that_the_finding_names(tmp_path, printed):
    t = truth()
    path = write(tmp_path / "log.csv", t | {"thrust": -t["thrust"]})
    assert "import rcbenchmark --backwards" in printed(path, "-o", tmp_path / "first")
    assert "thrust_sign" not in printed(path, "--backwards", "-o", tmp_path / "again")
    printed(path, "--map", tmp_path / "again" / "import.toml", "-o", tmp_path / "saved")
    printed(write(tmp_path / "right.csv", t), "-o", tmp_path / "right")
    read = {n: read_record(tmp_path / n / "record.csv", holes=("thrust",))["thrust"] for n in ("again", "saved", "right")}
    np.testing.assert_allclose(read["again"], read["right"], atol=1e-9)
    np.testing.assert_array_equal(read["saved"], read["again"])


# The real logs


def cells(path, header):
    """A column (n,) of a real log, by the csv module; NaN for an empty cell."""
    with open(path, encoding="utf-8-sig") as file:
        rows = [row for row in csv.reader(file) if len(row) == 22]
    return np.array([float(row[rows[0].index(header)] or "nan") for row in rows[1:]])


@real
@pytest.mark.parametrize(("path", "start", "offset"), [(FIRST, "0", -0.245), (SECOND, "10.85363", -0.005)])
def test_real_logs_are_cleaned(imported, path, start, offset):
    record, said = imported(path)
    assert f"time 0 is {start}" in said
    assert "omega <- Motor Optical Speed (rad/s)" in said
    thrust = cells(path, "Thrust (gf)")
    filled = thrust[np.isfinite(thrust)]
    again = np.sum(filled[1:] == filled[:-1])
    assert f"thrust: {again} of {len(filled)} cells repeat" in said
    assert 0.30 < again / len(filled) < 0.34  # a third
    assert 0.02 < np.mean(np.isnan(record["omega"])) < 0.035  # rows behind stalls
    assert float(said.split("tare: ")[1].split(" N taken off")[0]) == pytest.approx(offset, abs=0.003)
