"""The quantity and the unit of each column of a foreign log: proposed, mapped, or refused."""

import numpy as np
import pytest
from import_logs import stand, table
from import_zoo import PLAIN, text, truth

from identification.logs.mapping import propose, read_sections
from identification.logs.pairs import named_values
from identification.logs.raw_table import RawTable, plain, split_unit
from identification.logs.units import QUANTITIES, factor_of
from vpp_fmu.campaign import read_static
from vpp_fmu.record import read_record


@pytest.fixture
def vpp(printed):
    """Import a log, which must succeed, and return the output."""
    return lambda *words: printed("import", "csv", *words)


@pytest.fixture
def refused(refused):
    """Import a log, which must be refused, and return the line."""
    return lambda *words: refused("import", "csv", *words)


# Units and names


@pytest.mark.parametrize(
    ("quantity", "unit", "factor"),
    [
        ("thrust", "g", 9.80665e-3),
        ("thrust", "0.0123 N", 0.0123),
        ("omega", "RPM", 1.0),
        ("omega", "deg/s", 1.0 / 6.0),
        ("omega", "erpm/7", 1.0 / 7.0),
        ("time", "MS", 1e-3),
        ("time", "4 ms", 4e-3),
        ("torque", "Nm", 1.0),
        ("torque", "N.cm", 0.01),
        ("torque", "mNm", 1e-3),
        ("torque", "ozf.in", 4.4482216152605 / 16 * 0.0254),
        ("power", "kW", 1e3),
        ("signal", "us", 1.0),
        ("signal", "ms", 1e3),
        ("signal", "%", 0.01),
        ("signal", "1", 1.0),
        ("signal", "", 1.0),
        ("samples", "1", 1.0),
        ("run", " - ", 1.0),
        ("ct", "", 1.0),
        ("beta", "Grad", 1.0),
        ("beta_ref", "grad", 1.0),
        ("beta", "-1 grados", -1.0),
        ("omega", "tr/min", 1.0),
        ("omega", "UPM", 1.0),
        ("thrust", "gr", 9.80665e-3),
        ("current", "Amps", 1.0),
        ("torque", "N-m", 1.0),
        ("torque", "oz-in", 28.349523125e-3 * 9.80665 * 25.4e-3),  # an ounce is 28.349523125 g, an inch 25.4 mm
    ],
)
def test_units_by_their_definitions(quantity, unit, factor):
    assert factor_of(QUANTITIES[quantity], unit) == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    ("quantity", "unit"),
    [
        ("thrust", ""),
        ("omega", "1"),
        ("beta", ""),
        ("omega", "N"),
        ("omega", "erpm"),
        ("omega", "erpm/0"),
        ("thrust", ")("),
        ("samples", "rpm"),
        ("ct", "%"),
    ],
)
def test_a_unit_of_something_else_is_none(quantity, unit):
    assert factor_of(QUANTITIES[quantity], unit) is None


def test_random_text_is_a_unit_or_none():
    rng = np.random.default_rng(1)
    alphabet = list("NgfrpmsVA19.-+*/^()[]{}%°µ² _\\'\",;:#!=<>~?&|\t\x00é")
    for length in rng.integers(1, 9, 3000):
        unit = "".join(rng.choice(alphabet, length))
        for name in ("thrust", "time", "signal"):
            factor = factor_of(QUANTITIES[name], unit)
            assert factor is None or np.isfinite(factor)
    assert factor_of(QUANTITIES["time"], "9**9**9**9 s") is None


@pytest.mark.parametrize(
    ("header", "parts"),
    [
        ("Thrust (gf)", ("Thrust", "gf")),
        ("Fz [N]", ("Fz", "N")),
        ("n / rpm", ("n", "rpm")),
        ("Zeit, ms", ("Zeit", "ms")),
        ("thrust", ("thrust", "")),
        ("Torque (N·m)", ("Torque", "N·m")),
    ],
)
def test_a_header_is_a_name_and_a_unit(header, parts):
    assert split_unit(header) == parts


@pytest.mark.parametrize(
    ("cell", "decimal", "number"),
    [
        ("1.234,5", ",", "1234.5"),
        ("1.234", ",", "1234"),
        ("12,5", ",", "12.5"),
        ("1,234.5", ".", "1234.5"),
        ("1'234", ".", "1234"),
        ("\u22123", ".", "-3"),
        ("n/a", ".", ""),
    ],
)
def test_numbers_in_foreign_notation_are_read(cell, decimal, number):
    assert plain(cell, decimal) == number


# The mapping


def test_a_proposal_writes_nothing_and_what_it_saves_imports_the_same(tmp_path, vpp, refused):
    path = table(tmp_path / "log.csv", stand())
    out = vpp(path, "--propose", "-o", tmp_path / "out")
    assert "signal     <- ESC (us)" in out
    assert "sure" in out
    assert not (tmp_path / "out").exists()
    vpp(path, "--propose", tmp_path / "mine.toml")
    refused(path, "--propose", tmp_path / "mine.toml")  # the file exists
    told = read_sections(tmp_path / "mine.toml")
    assert told["open_loop"]["columns"] == {
        "time": "Time (s):s",
        "omega": "RPM:rpm",
        "thrust": "Thrust (gf):gf",
        "signal": "ESC (us):us",
    }
    vpp(path, "--map", tmp_path / "mine.toml", "-o", tmp_path / "a")
    vpp(path, "-o", tmp_path / "b")
    assert (tmp_path / "a" / "open_loop.csv").read_bytes() == (tmp_path / "b" / "open_loop.csv").read_bytes()
    vpp(path, "--map", tmp_path / "a" / "import.toml", "-o", tmp_path / "c", "--as", "validation")
    assert (tmp_path / "c" / "validation.csv").read_bytes() == (tmp_path / "b" / "open_loop.csv").read_bytes()


@pytest.mark.parametrize(
    "names",
    [
        ("time (s)", "speed setpoint (rpm)", "speed (rpm)", "load cell (N)"),
        ("Zeit (s)", "Soll (1/min)", "Ist (1/min)", "Kraft (N)"),
    ],
)
def test_columns_with_unclear_names_are_mapped_by_their_units(tmp_path, vpp, names):
    """A "load cell" is no battery cell; a setpoint in rpm is a speed."""
    t = truth()
    path = table(tmp_path / "log.csv", dict(zip(names, (t[n] for n in ("time", "omega_ref", "omega", "thrust")), strict=True)))
    vpp(path, "-o", tmp_path / "out")
    record = read_record(tmp_path / "out" / "open_loop.csv")
    for name in ("omega_ref", "omega", "thrust"):
        np.testing.assert_allclose(record[name], t[name], rtol=1e-8)


@pytest.mark.parametrize(
    "names",
    [
        {"time": "t", "omega_ref": "speed_cmd", "beta_ref": "pitch_cmd", "thrust": "force"},
        {"time": "t_s", "omega_ref": "n_soll_rpm", "omega": "n_ist_rpm", "thrust": "force_n"},
    ],
)
def test_guessed_units_need_the_option_yes(tmp_path, vpp, refused, names):
    """The n in "force_n" is no speed; it may mean newton."""
    t = truth()
    path = table(tmp_path / "log.csv", {header: t[name] for name, header in names.items()})
    err = refused(path, "-o", tmp_path / "out")
    assert f"{names['thrust']} as thrust in N" in err
    assert "Try: --yes to take these units" in err
    words = err.split("--map ")[1].split()
    for folder, accept in (("a", ("--map", *words)), ("b", ("--yes",))):
        vpp(path, *accept, "-o", tmp_path / folder)
        record = read_record(tmp_path / folder / "open_loop.csv")
        for name in names:
            np.testing.assert_allclose(record[name], t[name], rtol=1e-8)


def test_an_unambiguous_unit_at_the_end_of_a_name_is_accepted(tmp_path, vpp):
    t = truth()
    names = {"time": "t_s", "omega_ref": "n_soll_rpm", "beta_ref": "pitch_cmd_deg", "omega": "esc_rpm", "thrust": "F_N"}
    path = table(tmp_path / "log.csv", {header: t[name] for name, header in names.items()} | {"ticks": t["time"]})
    out = vpp(path, "-o", tmp_path / "out")
    assert "not used: ticks\n" in out
    record = read_record(tmp_path / "out" / "open_loop.csv")
    for name in names:
        np.testing.assert_allclose(record[name], t[name], rtol=1e-8)


@pytest.mark.parametrize(
    ("header", "quantity"),
    [
        ("ESC speed", "omega"),
        ("esc_status.rpm", "omega"),
        ("esc_voltage", "voltage"),
        ("ESC current (A)", "current"),
        ("ESC signal", "signal"),
        ("ESC throttle (%)", "signal"),
        ("esc", "signal"),
        ("Electrical Power (W)", "power"),
        ("P_elec [W]", "power"),
        ("Mz [Nm]", "torque"),
        ("Q [N.m]", "torque"),
        ("T [N]", "thrust"),
        ("load_cell_kg", "thrust"),
        ("theta_cmd [deg]", "beta_ref"),
    ],
)
def test_a_column_is_mapped_to_its_quantity_by_name_and_unit(header, quantity):
    table = RawTable("log.csv", {header: np.linspace(1.0, 99.0, 50)}, np.arange(50))
    assert list(propose(table)) == [quantity]


@pytest.mark.parametrize("header", ["Mechanical Power (W)", "T motor (C)", "roll [deg]", "fan", "servo_cmd", "adc force"])
def test_columns_of_no_known_quantity_are_not_proposed(header):
    table = RawTable("log.csv", {header: np.linspace(1.0, 99.0, 50)}, np.arange(50))
    assert not propose(table)


def test_of_an_optical_and_an_electrical_speed_the_optical_one_is_taken():
    names = ("Motor Electrical Speed (RPM)", "Motor Optical Speed (RPM)")
    table = RawTable("log.csv", {name: np.linspace(1.0, 99.0, 50) for name in names}, np.arange(50))
    assert propose(table)["omega"].name == names[1]


def test_a_speed_named_omega_is_proposed_in_radians_per_second_unless_no_rotor_is_as_fast():
    slow, fast = np.linspace(100.0, 600.0, 50), np.linspace(1000.0, 6000.0, 50)
    for values, unit in ((slow, "rad/s"), (fast, "rpm")):
        assert propose(RawTable("log.csv", {"omega_cmd": values}, np.arange(50)))["omega_ref"].unit == unit


@pytest.mark.parametrize("header", ["load cell (mV)", "loadcell_raw", "force counts"])
def test_a_load_cell_in_counts_needs_two_calibration_points(tmp_path, vpp, refused, header):
    t = truth()
    names = {"time": "t [s]", "omega_ref": "speed cmd [rpm]", "beta_ref": "pitch cmd [deg]"}
    raw = np.round(84213.0 - t["thrust"] / 0.0021)
    path = table(tmp_path / "log.csv", {h: t[n] for n, h in names.items()} | {header: raw})
    for words in ((), ("--yes",)):
        err = refused(path, *words, "-o", tmp_path / "out")
        assert f"thrust: found {header}, thrust by its name, from {raw.min():g} to {raw.max():g}" in err
    points = err.split("--map 'thrust=")[1].split("'")[0].replace("@A=0,B=10", "@84213=0,79213=10.5")
    vpp(path, "--map", f"thrust={points}", "-o", tmp_path / "out")
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["thrust"], t["thrust"], atol=0.0011)


def test_two_load_cells_of_one_rotor_are_added_or_stop_the_import(tmp_path, vpp, refused):
    t = truth()
    names = {"time": "t [s]", "omega_ref": "speed cmd [rpm]", "beta_ref": "pitch cmd [deg]"}
    columns = {h: t[n] for n, h in names.items()} | {"F left [N]": 0.25 * t["thrust"], "F right [N]": 0.75 * t["thrust"]}
    path = table(tmp_path / "log.csv", columns)
    err = refused(path, "-o", tmp_path / "out")
    assert "F left [N], F right [N], and one speed, expected one thrust" in err
    out = vpp(path, "--map", "thrust=F left+F right", "-o", tmp_path / "out")
    assert "not used" not in out
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["thrust"], t["thrust"], rtol=1e-8)
    vpp(path, "--map", tmp_path / "out" / "import.toml", "-o", tmp_path / "again")
    vpp(path, "--rotor", "left", "-o", tmp_path / "left")
    np.testing.assert_allclose(read_record(tmp_path / "left" / "open_loop.csv")["thrust"], 0.25 * t["thrust"], rtol=1e-8)


@pytest.mark.parametrize(
    ("names", "scale"), [(("stamp.sec", "stamp.nanosec"), 1e-9), (("tv_sec", "tv_usec"), 1e-6), (("secs", "nsecs"), 1e-9)]
)
def test_seconds_and_their_fraction_in_two_columns_are_one_time(tmp_path, vpp, names, scale):
    t = truth()
    whole = np.floor(t["time"])
    columns = dict(zip(names, (1.7e9 + whole, np.round((t["time"] - whole) / scale)), strict=True))
    columns |= {"speed cmd [rpm]": t["omega_ref"], "pitch cmd [deg]": t["beta_ref"], "Fz [N]": t["thrust"]}
    path = table(tmp_path / "log.csv", columns)
    out = vpp(path, "-o", tmp_path / "out")
    assert f"time is {names[0]} + {names[1]}" in out
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv").time, t["time"], atol=1e-6)


def test_minutes_and_seconds_are_unwrapped_after_an_hour(tmp_path, vpp):
    t = truth()
    stamps = [f"{s // 60 % 60:02.0f}:{s % 60:06.3f}" for s in 3598.5 + t["time"]]
    columns = {"Elapsed": stamps, "speed cmd [rpm]": t["omega_ref"], "pitch cmd [deg]": t["beta_ref"], "Fz [N]": t["thrust"]}
    out = vpp(table(tmp_path / "log.csv", columns), "-o", tmp_path / "out")
    assert "each after 3600 s (an hour): unwrapped" in out
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv").time, t["time"], atol=1e-9)


def test_unsorted_rows_are_refused_and_not_taken_for_runs(tmp_path, refused):
    t = truth()
    order = np.arange(len(t["time"]))
    names = {"time": "t [s]", "omega_ref": "speed cmd [rpm]", "beta_ref": "pitch cmd [deg]", "thrust": "Fz [N]"}
    order[200:208] = order[[204, 205, 206, 207, 200, 201, 202, 203]]
    path = table(tmp_path / "log.csv", {h: t[n][order] for n, h in names.items()})
    err = refused(path, "-o", tmp_path / "out")
    assert "Try: sort the rows by their time" in err


def test_error_words_of_loggers_are_empty_cells_and_other_text_is_refused(tmp_path, vpp, refused):
    t = truth()
    thrust = [f"{v:.5f}" for v in t["thrust"]]
    thrust[50], thrust[60], thrust[70] = "ERR", "timeout", "#DIV/0!"
    columns = {"t [s]": t["time"], "speed cmd [rpm]": t["omega_ref"], "pitch cmd [deg]": t["beta_ref"], "Fz [N]": thrust}
    vpp(table(tmp_path / "log.csv", columns), "-o", tmp_path / "out")
    found = read_record(tmp_path / "out" / "open_loop.csv", holes=("thrust",))["thrust"]
    assert np.flatnonzero(np.isnan(found)).tolist() == [50, 60, 70]
    thrust[80] = "12.3.4"
    err = refused(table(tmp_path / "log.csv", columns), "-o", tmp_path / "other")
    assert "Fz [N], line 82: found 12.3.4, expected a number" in err.replace("'", "")


def test_a_log_of_names_alone_has_no_numbers(tmp_path, refused):
    path = tmp_path / "log.csv"
    path.write_text("t [s],speed cmd [rpm],pitch cmd [deg],Fz [N]\n")
    err = refused(path, "-o", tmp_path / "out")
    assert "found 1 line without numbers" in err


def test_repeated_readings_of_one_conversion_count_once(tmp_path, vpp):
    """80 conversions a second in 200 rows; noise of 50 digits. Readings frozen for 0.5 s are left to the quality gate."""
    rng, rows = np.random.default_rng(3), np.arange(4000)
    fresh = np.append(True, np.diff(rows * 80 // 200) > 0)
    speed, pitch = np.repeat(rng.integers(2000, 6000, 40), 100).astype(float), np.repeat(rng.uniform(-4.0, 9.0, 20), 200)
    thrust = np.round(12.0 * (speed / 6000.0) ** 2 + 0.3 * pitch + rng.normal(0.0, 0.05, 4000), 3)
    held = thrust[np.maximum.accumulate(np.where(fresh, rows, 0))]
    stuck = slice(2050, 2150)
    held[stuck] = held[stuck.start]
    columns = {"t [s]": 0.005 * rows, "speed cmd [rpm]": speed, "pitch cmd [deg]": pitch, "Fz [N]": held}
    out = vpp(table(tmp_path / "log.csv", columns), "-o", tmp_path / "out")
    assert "a new one comes every 12." in out
    found = read_record(tmp_path / "out" / "open_loop.csv", holes=("thrust",))["thrust"]
    new = np.append(True, np.diff(held) != 0.0)
    new[stuck] = True
    np.testing.assert_array_equal(np.isfinite(found), new)
    single = {**columns, "Fz [N]": np.round(thrust, 1)}  # half a digit of noise: neighbours are equal by chance
    assert "repeats are emptied" not in vpp(table(tmp_path / "log.csv", single), "-o", tmp_path / "single")


def test_a_pitch_of_less_than_a_degree_is_proposed_in_radians(tmp_path, vpp, refused):
    t = truth()
    names = {"time": "t (s)", "omega_ref": "rpm_cmd (rpm)", "beta_ref": "pitch_cmd", "thrust": "Fz (N)"}
    path = table(tmp_path / "log.csv", {h: np.radians(t[n]) if n == "beta_ref" else t[n] for n, h in names.items()})
    err = refused(path, "-o", tmp_path / "out")
    assert "pitch_cmd as beta_ref in rad" in err
    vpp(path, "--yes", "-o", tmp_path / "out")
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["beta_ref"], t["beta_ref"], rtol=1e-8)


@pytest.mark.parametrize(("header", "known"), [("theta_cmd [deg]", True), ("vane setpoint [deg]", True), ("xi [deg]", False)])
def test_a_moving_angle_is_the_pitch_or_must_be_mapped(tmp_path, vpp, refused, header, known):
    t = truth()
    names = {"time": "t [s]", "omega_ref": "speed cmd [rpm]", "thrust": "Fz [N]"}
    path = table(tmp_path / "log.csv", {h: t[n] for n, h in names.items()} | {header: t["beta_ref"]})
    words = path, "-o", tmp_path / "out"
    if not known:
        angle = f"{header}, an angle that moves from {t['beta_ref'].min():g} to {t['beta_ref'].max():g} deg"
        assert angle in refused(*words)
    vpp(*words, *(() if known else ("--map", f"beta_ref={header}")))
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["beta_ref"], t["beta_ref"], atol=1e-12)
    vpp(path, "--map", "beta_ref=-", "--fixed", "beta_ref=3:deg", "-o", tmp_path / "fixed")


def test_timestamps_of_the_arduino_serial_monitor_are_the_time(tmp_path, vpp):
    t, rows = truth(), []
    for k in range(len(t["time"])):
        rows.append(f"23:59:{58.25 + t['time'][k]:06.3f} -> set:{t['omega_ref'][k]:g} rpm  thrust:{t['thrust'][k]:.6f} N")
        if k == 70:
            rows.append("23:59:58.955 -> set:40thrust:1.2")
    path = tmp_path / "serial.txt"
    path.write_text("\n".join(rows[:150]) + "\n")
    out = vpp(path, "--map", "omega_ref=set", "-o", tmp_path / "out")
    assert "lines without these values 1\n" in out
    record = read_record(tmp_path / "out" / "open_loop.csv")
    for name in ("time", "omega_ref", "thrust"):
        np.testing.assert_allclose(record[name], t[name][:149], atol=1e-6)


def test_a_long_name_without_a_value_is_tried_once():
    """Each of its 60 parts could be split in two ways, so that a search over all splits would not end."""
    assert named_values([(1, "_".join(60 * "a") + " b"), (2, "1 2")], 400) is None


def test_one_run_is_taken_of_a_log_whose_time_starts_again(tmp_path, vpp, refused):
    t = truth()
    names = {"time": "t [s]", "omega_ref": "speed cmd [rpm]", "omega": "speed [rpm]", "thrust": "Fz [N]"}
    twice = np.append(np.arange(150), np.arange(150))
    columns = {h: t[n][twice] if n == "time" else t[n][:300] for n, h in names.items()}
    path = table(tmp_path / "log.csv", columns)
    err = refused(path, "-o", tmp_path / "out")
    assert "--run 1 for the first of 2 runs" in err
    for run, rows in ((1, slice(0, 150)), (2, slice(150, 300))):
        out = vpp(path, "--run", run, "-o", tmp_path / str(run))
        assert f"run {run} of 2 is taken" in out
        record = read_record(tmp_path / str(run) / "open_loop.csv")
        np.testing.assert_allclose(record.time, t["time"][:150], atol=1e-9)
        np.testing.assert_allclose(record["thrust"], t["thrust"][rows], rtol=1e-8)
    err = refused(path, "--run", 3, "-o", tmp_path / "out")
    assert "--run: found 3, expected 1 to 2" in err
    assert not (tmp_path / "out").exists()


def test_a_throttle_in_per_cent_by_its_name_is_accepted_by_yes(tmp_path, vpp, refused):
    log = stand()
    columns = {"time_ms": 1e3 * log["Time (s)"], "throttle_%": log["ESC (us)"] / 10.0 - 100.0}
    path = table(tmp_path / "log.csv", columns | {"thrust_g": log["Thrust (gf)"], "rpm": log["RPM"]})
    err = refused(path, "-o", tmp_path / "out")
    assert "throttle_% as signal in %" in err
    vpp(path, "--yes", "-o", tmp_path / "out")
    record = read_record(tmp_path / "out" / "open_loop.csv")
    np.testing.assert_allclose(record["thrust"], 9.80665e-3 * log["Thrust (gf)"], rtol=1e-8)
    x = log["ESC (us)"] - 1000.0
    np.testing.assert_allclose(record["omega_ref"], 200.0 + 9.5 * x - 0.0025 * x**2, atol=3.0)


@pytest.mark.parametrize(("pairs", "also"), [(7, "7 pole pairs?"), (6, "6 pole pairs, or deg/s?")])
def test_a_measured_speed_that_is_electrical_is_named_with_its_mapping(tmp_path, vpp, refused, pairs, also):
    t = truth()
    headers = {"time": "t (s)", "omega_ref": "speed cmd (rpm)", "omega": "speed (rpm)", "thrust": "Fz (N)"}
    path = table(tmp_path / "log.csv", {h: t[n] * (pairs if n == "omega" else 1.0) for n, h in headers.items()})
    for words in ((), ("--yes",), ("--map", "omega=speed (rpm):rpm")):
        err = refused(path, *words, "-o", tmp_path / "out")
        assert f"times the commanded speed (electrical speed of a motor with {also}" in err
    assert f"omega=speed (rpm):erpm/{pairs}" in vpp(path, "--propose")
    assert not (tmp_path / "out").exists()
    vpp(path, "--map", f"omega=speed (rpm):erpm/{pairs}", "-o", tmp_path / "out")
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["omega"], t["omega"], rtol=1e-8)
    vpp(path, "--force", "-o", tmp_path / "forced")


@pytest.mark.parametrize("header", ["eRPM", "Motor speed (erpm)"])
def test_an_electrical_speed_beside_a_signal_needs_the_pole_pairs(tmp_path, vpp, refused, header):
    log = stand()
    log[header] = 7.0 * log.pop("RPM")
    path = table(tmp_path / "log.csv", log)
    err = refused(path, "--yes", "-o", tmp_path / "out")
    assert f"omega={header}:erpm/7" in err
    vpp(path, "--map", f"omega={header}:erpm/7", "-o", tmp_path / "out")
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["omega"], log[header] / 7.0, rtol=1e-8)


def test_a_motor_at_its_commanded_speed_is_not_electrical(tmp_path, vpp):
    t = truth()
    headers = {"time": "t (s)", "omega_ref": "speed cmd (rpm)", "omega": "speed (rpm)", "thrust": "Fz (N)"}
    path = table(tmp_path / "log.csv", {h: t[n] * (1.5 if n == "omega" else 1.0) for n, h in headers.items()})
    vpp(path, "-o", tmp_path / "out")


@pytest.mark.parametrize("header", ["Pitch Servo (us)", "servo pwm", "pitch_us"])
def test_a_pitch_in_pulses_must_be_calibrated_or_fixed(tmp_path, vpp, refused, header):
    t = truth()
    pulses = np.round(1000.0 + (t["beta_ref"] + 5.0) / 0.015)  # -5 deg at 1000 us, 10 deg at 2000 us
    headers = {"time": "t (s)", "omega_ref": "speed cmd (rpm)", "thrust": "Fz (N)"}
    path = table(tmp_path / "log.csv", {h: t[n] for n, h in headers.items()} | {header: pulses})
    for words in ((), ("--yes",), ("--map", "thrust=Fz (N):N")):
        err = refused(path, *words, "-o", tmp_path / "out")
        assert f"{header}, pitch by its name" in err
        assert f"beta_ref={header}:us@{pulses.min():g}=A,{pulses.max():g}=B" in err
    assert header in vpp(path, "--propose").split("beta_ref: ")[1]
    vpp(path, "--map", f"beta_ref={header}:us@1000=-5,2000=10", "-o", tmp_path / "a")
    record = read_record(tmp_path / "a" / "open_loop.csv")
    np.testing.assert_allclose(record["beta_ref"], 0.015 * pulses - 20.0, atol=1e-9)
    vpp(path, "--map", tmp_path / "a" / "import.toml", "-o", tmp_path / "b")
    assert (tmp_path / "a" / "open_loop.csv").read_bytes() == (tmp_path / "b" / "open_loop.csv").read_bytes()
    vpp(path, "--fixed", "beta_ref=2:deg", "-o", tmp_path / "c")
    np.testing.assert_array_equal(read_record(tmp_path / "c" / "open_loop.csv")["beta_ref"], 2.0)


def test_a_servo_that_is_not_connected_and_a_pitch_rate_are_no_pitch(tmp_path, vpp):
    t = truth()
    headers = {"time": "t (s)", "omega_ref": "speed cmd (rpm)", "thrust": "Fz (N)"}
    more = {"Servo 1": np.full(400, np.nan), "Servo 2 (us)": np.zeros(400), "Pitch rate (deg/s)": t["beta_ref"]}
    path = table(tmp_path / "log.csv", {h: t[n] for n, h in headers.items()} | more)
    out = vpp(path, "-o", tmp_path / "out")
    assert "fixed pitch of 0 deg" in out


@pytest.mark.parametrize(
    "unit", ["us@1000=-5,1000=10", "us@1000=-5,2000=-5", "us@1000=-5", "us@1.2.3=1,2=3", "us@1000=-5,2000=10,3000=20"]
)
def test_a_calibration_that_is_no_line_is_refused(tmp_path, refused, unit):
    text(PLAIN)(tmp_path / "log.csv", truth())
    err = refused(tmp_path / "log.csv", "--map", f"beta_ref=beta_ref:{unit}", "-o", tmp_path / "out")
    assert "two points of a calibration" in err


@pytest.mark.parametrize(("labels", "second"), [(("1", "2"), "2"), (("left", "right"), "right")])
def test_a_second_rotor_is_reported_and_imported_on_request(tmp_path, vpp, refused, labels, second):
    t = truth()
    names = {"omega_ref": "rpm_cmd", "beta_ref": "pitch_cmd", "thrust": "thrust", "omega": "rpm"}
    columns = {"time (s)": t["time"]}
    for label, gain in zip(labels, (1.0, 0.9), strict=True):
        columns |= {f"{header}_{label}": gain * t[n] for n, header in names.items()}
    path = table(tmp_path / "log.csv", columns)
    out = vpp(path, "--yes", "-o", tmp_path / "a")
    assert f"rotor {labels[0]} is taken, with rpm_cmd_{labels[0]}," in out
    assert f"--rotor {second} takes the other" in out
    vpp(path, "--yes", "--rotor", second, "-o", tmp_path / "b")
    vpp(path, "--yes", "--map", f"thrust=thrust_{second}:N", "-o", tmp_path / "c")  # the other columns are of the same rotor
    for folder, gain in (("a", 1.0), ("b", 0.9), ("c", 0.9)):
        record = read_record(tmp_path / folder / "open_loop.csv")
        for name in names:
            np.testing.assert_allclose(record[name], gain * t[name], rtol=1e-8)
    assert f"--rotor: found 7, expected one of {', '.join(labels)}" in refused(path, "--rotor", "7")


def test_coefficients_become_the_thrust_of_a_propeller(tmp_path, vpp, refused):
    """T = CT rho n^2 D^4: 0.1 * 1.225 * 100^2 * 0.25^4 = 4.785 N at 6000 rpm."""
    table(tmp_path / "ct.txt", {"RPM": [6000, 3000, 6000], "CT": [0.1, 0.08, 0.05], "CP": [0.05] * 3, "J": [0.0, 0.0, 0.4]})
    words = (tmp_path / "ct.txt", "--as", "static")
    assert "--diameter D" in refused(*words, "-o", tmp_path / "out")
    assert "--as static" in refused(tmp_path / "ct.txt", "--diameter", "0.25", "-o", tmp_path / "out")
    out = vpp(*words, "--diameter", "0.25", "-o", tmp_path / "out")
    assert "rho = 1.225 kg/m^3" in out
    assert "advance ratio: 1 rows above 0 are not static, left out" in out
    static = read_static(tmp_path / "out" / "static.csv")
    np.testing.assert_allclose(static.thrust, [4.78515625, 0.8 * 4.78515625 / 4.0], rtol=1e-8)
    np.testing.assert_allclose(static.omega, [6000.0, 3000.0])
    vpp(*words, "--diameter", "0.25", "--density", "1.1", "-o", tmp_path / "thin")
    thin = read_static(tmp_path / "thin" / "static.csv").thrust
    np.testing.assert_allclose(thin, static.thrust * 1.1 / 1.225, rtol=1e-8)


def test_a_mapping_on_the_command_line_completes_the_proposal(tmp_path, vpp):
    t = truth()
    headers = {"time": "t (s)", "omega_ref": "speed cmd (rpm)", "beta_ref": "pitch cmd (deg)", "omega": "speed (rpm)"}
    path = table(tmp_path / "log.csv", {h: t[n] for n, h in headers.items()} | {"channel 7": t["thrust"], "u": t["voltage"]})
    out = vpp(path, "--map", "thrust=channel 7:N", "-o", tmp_path / "a")
    assert "u: not taken as voltage" in out
    record = read_record(tmp_path / "a" / "open_loop.csv")
    assert "voltage" not in record
    for name in (*headers, "thrust"):
        np.testing.assert_allclose(record[name], t[name], rtol=1e-8)
    vpp(path, "--map", "thrust=channel 7:N", "omega=-", "--yes", "-o", tmp_path / "b")
    record = read_record(tmp_path / "b" / "open_loop.csv")
    assert "omega" not in record
    np.testing.assert_allclose(record["voltage"], t["voltage"], rtol=1e-8)


@pytest.mark.parametrize(
    ("header", "pair", "contradicts"),
    [
        ("Fz (gf)", "thrust=Fz (gf):N", True),
        ("Fz (gf)", "thrust=Fz (gf):kgf", True),
        ("Fz (V)", "thrust=Fz (V):N", True),
        ("Fz (gf)", "thrust=Fz (gf):-1 gf", False),
        ("Fz (g)", "thrust=Fz (g):gf", False),
        ("Fz (V)", "thrust=Fz (V):12.3 N", False),
        ("Fz (raw)", "thrust=Fz (raw):N", False),
    ],
)
def test_a_unit_that_contradicts_the_header_needs_the_option_force(tmp_path, vpp, refused, header, pair, contradicts):
    t = truth()
    path = table(tmp_path / "log.csv", {"t (s)": t["time"], "speed cmd (rpm)": t["omega_ref"], header: t["thrust"]})
    said = (refused if contradicts else vpp)(path, "--yes", "--map", pair, "-o", tmp_path / "out")
    assert ("whose header says" in said) == contradicts
    vpp(path, "--map", pair, "--force", "-o", tmp_path / "forced")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--map", "thurst=Fz:N"), "--map: found 'thurst=Fz:N'"),
        (("--map", "thrust=thrust:N", "thrust=omega:N"), "--map thrust: found thrust twice"),
        (("--map", "a.toml", "b.toml"), "--map: found a.toml b.toml"),
        (("--fixed", "thrust=3:N"), "--fixed: found 'thrust=3:N'"),
        (("--fixed", "beta_ref=8:N"), "--fixed: found 'beta_ref=8:N'"),
        (("--encoding", "utf-99"), "--encoding: found utf-99"),
        (("--delimiter", "ab"), "--delimiter: found 'ab'"),
        (("--map", "nowhere.toml"), "nowhere.toml: file: found no such file"),
    ],
)
def test_bad_options_are_refused_in_one_line(tmp_path, refused, words, told):
    text(PLAIN)(tmp_path / "log.csv", truth())
    err = refused(tmp_path / "log.csv", *words, "-o", tmp_path / "out")
    assert told in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "content",
    [
        "no toml [",
        'format = "x"',
        'format = "vpp-mapping/1"',
        'format = "vpp-mapping/1"\n[static]\nlog = "a"',
        'format = "vpp-mapping/1"\n[static.columns]\ntime = 3',
    ],
)
def test_a_bad_mapping_file_is_refused_in_one_line(tmp_path, refused, content):
    text(PLAIN)(tmp_path / "log.csv", truth())
    (tmp_path / "m.toml").write_text(content)
    err = refused(tmp_path / "log.csv", "--map", tmp_path / "m.toml", "-o", tmp_path / "out")
    assert "m.toml" in err


# Forms of common tools: names of channels, rotors, axes and messages


def clean(**more):
    """A log of sure units, without a pitch."""
    t = truth()
    return {"t [s]": t["time"], "speed cmd [rpm]": t["omega_ref"], "speed [rpm]": t["omega"], "Fz [N]": t["thrust"]} | more


def test_columns_of_two_sides_are_never_mixed_and_the_side_that_turns_is_taken(tmp_path, vpp):
    """Side A is not connected: its cell has noise alone, its command is constant."""
    log, noise = stand(), np.random.default_rng(1).normal(0.0, 0.02, 6000)
    columns = {"Time (s)": log["Time (s)"], "ESC A (us)": np.full(6000, 1000.0), "ESC B (us)": log["ESC (us)"]}
    columns |= {"Thrust A (gf)": noise, "Thrust B (gf)": log["Thrust (gf)"]}
    columns |= {"Motor Optical Speed A (RPM)": np.zeros(6000), "Motor Optical Speed B (RPM)": log["RPM"]}
    path = table(tmp_path / "log.csv", columns)
    for words in ((), ("--rotor", "B")):
        assert "rotor b is taken" in vpp(path, *words, "-o", tmp_path / "out", "--replace")
        record = read_record(tmp_path / "out" / "open_loop.csv")
        np.testing.assert_allclose(record["thrust"], 9.80665e-3 * log["Thrust (gf)"], rtol=1e-8)
        np.testing.assert_array_equal(record["omega"], log["RPM"])


@pytest.mark.parametrize("axis", ["x", "z"])
def test_of_three_forces_the_one_that_varies_most_is_the_thrust(tmp_path, vpp, axis):
    rng, log = np.random.default_rng(1), clean()
    forces = {f"Force {a.upper()} [N]": rng.normal(9.0, 0.05, 400) for a in "xyz"}
    forces[f"Force {axis.upper()} [N]"] = log.pop("Fz [N]")
    vpp(table(tmp_path / "log.csv", log | forces), "--fixed", "beta_ref=2:deg", "-o", tmp_path / "out")
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["thrust"], truth()["thrust"], rtol=1e-8)


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        (("current_motor", "current_in"), {"current": "current_in"}),
        (("d_axis_voltage", "input_voltage"), {"voltage": "input_voltage"}),
        (("tachometer", "erpm"), {"omega": "erpm"}),
        (("eRPM", "RPM"), {"omega": "RPM"}),
        (("ESC.Err", "ESC.Curr"), {"current": "ESC.Curr"}),
        (("esc[0].esc_rpm", "esc[0].esc_errorcount"), {"omega": "esc[0].esc_rpm"}),
        (("Roll(rad)", "pitch(rad)"), {}),
        (("imu/pitch_deg", "imu/roll_deg"), {}),
        (("1-3[N]", "P-1[r/s]"), {"thrust": "1-3[N]", "omega": "P-1[r/s]"}),
    ],
)
def test_of_similar_channels_the_one_of_the_supply_or_the_rotor_is_proposed(headers, expected):
    table = RawTable("log.csv", {h: np.linspace(1.0, 99.0, 50) for h in headers}, np.arange(50))
    assert {q: c.name for q, c in propose(table).items()} == expected


def test_an_index_in_brackets_is_no_unit():
    assert split_unit("motor[0]") == ("motor[0]", "")
    assert split_unit("throttle [1]") == ("throttle", "1")


@pytest.mark.parametrize("header", ["eRPM[0]", "eRPM(/100)[0]"])
def test_an_electrical_speed_in_hundreds_is_mapped_by_the_commands_of_the_messages(tmp_path, vpp, refused, header):
    log = stand()
    log[header] = np.round(0.07 * log.pop("RPM"))  # hundreds of 7 pole pairs
    path, unit = table(tmp_path / "log.csv", log), None
    for _ in range(3):
        err = refused(path, *(("--map", f"omega={header}:{unit}") if unit else ()), "-o", tmp_path / "out")
        unit = err.split(f"--map 'omega={header}:")[1].split("'")[0]
        if unit == "100 erpm/7":
            break
    vpp(path, "--map", f"omega={header}:{unit}", "-o", tmp_path / "out")
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["omega"], 100.0 * log[header] / 7.0, rtol=1e-8)


def test_an_electrical_speed_in_hundreds_beside_a_command_is_refused(tmp_path, refused):
    log = clean()
    log["eRPM"] = 0.07 * log.pop("speed [rpm]")
    assert "electrical speed, by its name" in refused(table(tmp_path / "log.csv", log), "-o", tmp_path / "out")


@pytest.mark.parametrize("header", ["RCOU.C2", "CH6(us)", "output[1]"])
def test_a_command_that_thrust_follows_is_the_pitch_or_must_be_mapped(tmp_path, vpp, refused, header):
    """Beside it: a step counter, a temperature and the command again, which say nothing of the thrust."""
    t, rng = truth(), np.random.default_rng(4)
    pulses = np.round(1000.0 + (t["beta_ref"] + 5.0) / 0.015)
    more = {"step": np.arange(400) // 25, "temp [degC]": np.round(rng.normal(35.0, 0.1, 400)), "RPM set": t["omega_ref"]}
    path = table(tmp_path / "log.csv", clean(**more, **{header: pulses}))
    err = refused(path, "-o", tmp_path / "out")
    assert f"{header}, an unused command from {pulses.min():g} to {pulses.max():g} that thrust follows" in err
    vpp(path, "--map", f"beta_ref={header}:us@1000=-5,2000=10", "-o", tmp_path / "out")
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["beta_ref"], 0.015 * pulses - 20.0, atol=1e-9)
    steady = 12.0 * (t["omega"] / 6000.0) ** 2 + rng.normal(0.0, 0.05, 400)
    path = table(tmp_path / "steady.csv", clean(**more, **{header: pulses, "Fz [N]": steady}))
    vpp(path, "-o", tmp_path / "steady")  # the pitch is fixed, and the servo turns something else


def test_messages_in_rows_of_their_own_are_joined_at_the_rows_with_thrust(tmp_path, vpp):
    """Commands 4 ms before, speed 2 ms before and after each reading of thrust, on a ramp. A second without it is empty."""
    t, rows = truth(), []
    speed = 3000.0 + 100.0 * t["time"]
    for k, now in enumerate(t["time"]):
        rows.append((now, t["omega_ref"][k], t["beta_ref"][k], np.nan, np.nan))
        if not 200 <= k < 300:
            rows.append((now + 0.002, np.nan, np.nan, speed[k] + 0.2, np.nan))
        rows.append((now + 0.004, np.nan, np.nan, np.nan, t["thrust"][k]))
    names = ("__time [s]", "/cmd/speed [rpm]", "/cmd/pitch [deg]", "/esc/speed [rpm]", "/load_cell/force [N]")
    out = vpp(table(tmp_path / "log.csv", dict(zip(names, np.array(rows).T, strict=True))), "-o", tmp_path / "out")
    assert "joined at the 400 of 1100 rows with thrust" in out
    record = read_record(tmp_path / "out" / "open_loop.csv", holes=("omega",))
    for name in ("time", "omega_ref", "beta_ref", "thrust"):
        np.testing.assert_allclose(record[name], t[name], atol=1e-6)
    known = np.isfinite(record["omega"])
    np.testing.assert_allclose(record["omega"][known], speed[known] + 0.4, atol=1e-6)
    assert np.flatnonzero(~known).tolist() == [*range(199, 300), 399]


@pytest.mark.parametrize("rate", [1, 2])
def test_channels_with_clocks_of_their_own_are_imported_if_the_clocks_agree(tmp_path, vpp, refused, rate):
    t, names = truth(), {"omega_ref": "Speed cmd", "beta_ref": "Pitch cmd", "omega": "Speed", "thrust": "Force"}
    clocks = [t["time"] * (rate if name == "Speed" else 1) for name in names.values()]
    head = ["***End_of_Header***", "Y_Unit_Label\trpm\t\tdeg\t\trpm\t\tN\t", "X_Dimension\tTime\t\tTime\t\tTime\t\tTime\t"]
    head.append("\t".join([part for name in names.values() for part in ("X_Value", name)] + ["Comment"]))
    cells = [column for clock, name in zip(clocks, names, strict=True) for column in (clock, t[name])]
    lines = ["\t".join(f"{v:.10g}" for v in row) for row in zip(*cells, strict=True)]
    (tmp_path / "log.lvm").write_text("\n".join([*head, *lines]))
    if rate > 1:
        assert "time: found several, of which X_Value.5 differs" in refused(tmp_path / "log.lvm", "-o", tmp_path / "out")
        return
    vpp(tmp_path / "log.lvm", "-o", tmp_path / "out")
    record = read_record(tmp_path / "out" / "open_loop.csv")
    for name in ("time", *names):
        np.testing.assert_allclose(record[name], t[name], rtol=1e-8, atol=1e-9)


def test_a_clock_of_another_name_is_offered_as_the_time(tmp_path, vpp, refused):
    log = clean()
    columns = {"count": np.arange(400.0), "ms_today": 50587250.0 + 1e3 * log.pop("t [s]")} | log
    path = table(tmp_path / "log.csv", columns)
    assert "Try: --map time=ms_today:ms" in refused(path, "--fixed", "beta_ref=2:deg", "-o", tmp_path / "out")
    empty = table(tmp_path / "empty.csv", {"X_Value": np.full(400, np.nan)} | log)
    assert "Try: --map time=COLUMN:UNIT, or time=row:4ms" in refused(empty, "-o", tmp_path / "out")
