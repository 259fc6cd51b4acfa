"""The quantity and the unit of each column of a foreign log: proposed, mapped, or refused."""

import numpy as np
import pytest
from import_logs import HEADERS, T, named, stand, table

from identification.logs.delimited import without_names
from identification.logs.mapping import propose, read_sections
from identification.logs.raw_table import RawTable, plain, split_unit
from identification.logs.units import QUANTITIES, factor_of
from vpp_fmu.record import read_record

FIRST_WORDS = ("import", "csv")


@pytest.fixture
def log(tmp_path):
    """Write a log of these columns; its path."""
    return lambda columns: table(tmp_path / "log.csv", columns)


@pytest.fixture
def imported(tmp_path, printed):
    """Import a log, which must succeed, into a folder; its record."""

    def run(path, *words, to="out", **options):
        printed(path, *words, "-o", tmp_path / to)
        return read_record(tmp_path / to / "open_loop.csv", **options)

    return run


def check(record, *names, **options):
    """The record has these columns of the zoo's log."""
    for name in names:
        np.testing.assert_allclose(record[name], T[name], **({"rtol": 1e-8, "atol": 1e-9} | options), err_msg=name)


# Units and names

UNITS = {
    "time": {"MS": 1e-3, "4 ms": 4e-3},
    "omega": {"RPM": 1.0, "deg/s": 1.0 / 6.0, "erpm/7": 1.0 / 7.0, "tr/min": 1.0, "UPM": 1.0},
    "thrust": {"g": 9.80665e-3, "gr": 9.80665e-3, "0.0123 N": 0.0123},
    "beta": {"Grad": 1.0, "-1 grados": -1.0},
    "beta_ref": {"grad": 1.0},
    "torque": {"Nm": 1.0, "N-m": 1.0, "N.cm": 0.01, "mNm": 1e-3, "ozf.in": 4.4482216152605 / 16 * 0.0254}
    | {"oz-in": 28.349523125e-3 * 9.80665 * 25.4e-3},  # an ounce is 28.349523125 g, an inch 25.4 mm
    "power": {"kW": 1e3},
    "current": {"Amps": 1.0},
    "signal": {"us": 1.0, "ms": 1e3, "%": 0.01, "1": 1.0, "": 1.0},
    "samples": {"1": 1.0},
    "run": {" - ": 1.0},
}
OTHERS = {"omega": ("1", "N", "erpm", "erpm/0"), "thrust": ("", ")("), "beta": ("",), "samples": ("rpm",)}


@pytest.mark.parametrize("quantity", UNITS)
def test_units_by_their_definitions(quantity):
    found = {unit: factor_of(QUANTITIES[quantity], unit) for unit in UNITS[quantity]}
    assert found == pytest.approx(UNITS[quantity], rel=1e-12)


@pytest.mark.parametrize("quantity", OTHERS)
def test_a_unit_of_something_else_is_none(quantity):
    for unit in OTHERS[quantity]:
        assert factor_of(QUANTITIES[quantity], unit) is None, unit


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
        ("motor[0]", ("motor[0]", "")),  # an index
        ("throttle [1]", ("throttle", "1")),
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


def test_a_proposal_writes_nothing_and_what_it_saves_imports_the_same(tmp_path, log, printed, refused):
    path = log(stand())
    out = printed(path, "--propose", "-o", tmp_path / "out")
    assert "signal     <- ESC (us)" in out
    assert "sure" in out
    assert not (tmp_path / "out").exists()
    printed(path, "--propose", tmp_path / "mine.toml")
    refused(path, "--propose", tmp_path / "mine.toml")  # the file exists
    told = read_sections(tmp_path / "mine.toml")
    assert told["open_loop"]["columns"] == {
        "time": "Time (s):s",
        "omega": "RPM:rpm",
        "thrust": "Thrust (gf):gf",
        "signal": "ESC (us):us",
    }
    printed(path, "--map", tmp_path / "mine.toml", "-o", tmp_path / "a")
    printed(path, "-o", tmp_path / "b")
    assert (tmp_path / "a" / "open_loop.csv").read_bytes() == (tmp_path / "b" / "open_loop.csv").read_bytes()
    printed(path, "--map", tmp_path / "a" / "import.toml", "-o", tmp_path / "c", "--as", "validation")
    assert (tmp_path / "c" / "validation.csv").read_bytes() == (tmp_path / "b" / "open_loop.csv").read_bytes()


@pytest.mark.parametrize(
    "names",
    [
        {"time": "time (s)", "omega_ref": "speed setpoint (rpm)", "omega": "speed (rpm)", "thrust": "load cell (N)"},
        {"time": "Zeit (s)", "omega_ref": "Soll (1/min)", "omega": "Ist (1/min)", "thrust": "Kraft (N)"},
        {"time": "t_s", "omega_ref": "n_soll_rpm", "beta_ref": "pitch_cmd_deg", "omega": "esc_rpm", "thrust": "F_N"},
    ],
)
def test_columns_with_unclear_names_are_mapped_by_their_units(tmp_path, log, printed, names):
    """A "load cell" is no battery cell; a setpoint in rpm is a speed; a unit may be the end of a name."""
    out = printed(log({header: T[name] for name, header in names.items()} | {"ticks": T["time"]}), "-o", tmp_path / "out")
    assert "not used: ticks\n" in out
    check(read_record(tmp_path / "out" / "open_loop.csv"), *names)


@pytest.mark.parametrize(
    "names",
    [
        {"time": "t", "omega_ref": "speed_cmd", "beta_ref": "pitch_cmd", "thrust": "force"},
        {"time": "t_s", "omega_ref": "n_soll_rpm", "omega": "n_ist_rpm", "thrust": "force_n"},
    ],
)
def test_guessed_units_need_the_option_yes(tmp_path, log, imported, refused, names):
    """The n in "force_n" is no speed; it may mean newton."""
    path = log({header: T[name] for name, header in names.items()})
    err = refused(path, "-o", tmp_path / "out")
    assert f"{names['thrust']} as thrust in N" in err
    assert "Try: --yes to take these units" in err
    words = err.split("--map ")[1].split()
    for folder, accept in (("a", ("--map", *words)), ("b", ("--yes",))):
        check(imported(path, *accept, to=folder), *names)


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        (("ESC speed",), {"omega": "ESC speed"}),
        (("esc_status.rpm",), {"omega": "esc_status.rpm"}),
        (("esc_voltage",), {"voltage": "esc_voltage"}),
        (("ESC current (A)",), {"current": "ESC current (A)"}),
        (("ESC signal",), {"signal": "ESC signal"}),
        (("ESC throttle (%)",), {"signal": "ESC throttle (%)"}),
        (("esc",), {"signal": "esc"}),
        (("Electrical Power (W)",), {"power": "Electrical Power (W)"}),
        (("P_elec [W]",), {"power": "P_elec [W]"}),
        (("Mz [Nm]",), {"torque": "Mz [Nm]"}),
        (("Q [N.m]",), {"torque": "Q [N.m]"}),
        (("T [N]",), {"thrust": "T [N]"}),
        (("load_cell_kg",), {"thrust": "load_cell_kg"}),
        (("theta_cmd [deg]",), {"beta_ref": "theta_cmd [deg]"}),
        # of no known quantity
        (("Mechanical Power (W)", "T motor (C)", "roll [deg]"), {}),
        (("fan", "servo_cmd", "adc force"), {}),
        (("Roll(rad)", "pitch(rad)"), {}),
        (("imu/pitch_deg", "imu/roll_deg"), {}),
        # of similar channels that of the supply or the rotor
        (("Motor Electrical Speed (RPM)", "Motor Optical Speed (RPM)"), {"omega": "Motor Optical Speed (RPM)"}),
        (("current_motor", "current_in"), {"current": "current_in"}),
        (("d_axis_voltage", "input_voltage"), {"voltage": "input_voltage"}),
        (("tachometer", "erpm"), {"omega": "erpm"}),
        (("eRPM", "RPM"), {"omega": "RPM"}),
        (("ESC.Err", "ESC.Curr"), {"current": "ESC.Curr"}),
        (("esc[0].esc_rpm", "esc[0].esc_errorcount"), {"omega": "esc[0].esc_rpm"}),
        (("1-3[N]", "P-1[r/s]"), {"thrust": "1-3[N]", "omega": "P-1[r/s]"}),
    ],
)
def test_a_column_is_mapped_to_its_quantity_by_name_and_unit(headers, expected):
    assert {quantity: column.name for quantity, column in proposed(headers).items()} == expected


def proposed(headers, low=1.0, high=99.0):
    """The proposal for a log whose columns have values in this range."""
    values = np.linspace(low, high, 50)
    return propose(RawTable("log.csv", dict.fromkeys(headers, values), np.arange(50)))


def test_a_speed_named_omega_is_proposed_in_radians_per_second_unless_no_rotor_is_as_fast():
    assert proposed(["omega_cmd"], 100.0, 600.0)["omega_ref"].unit == "rad/s"
    assert proposed(["omega_cmd"], 1000.0, 6000.0)["omega_ref"].unit == "rpm"


@pytest.mark.parametrize("header", ["load cell (mV)", "loadcell_raw", "force counts"])
def test_a_load_cell_in_counts_needs_two_calibration_points(tmp_path, log, imported, refused, header):
    raw = np.round(84213.0 - T["thrust"] / 0.0021)
    path = log(named("time", "omega_ref", "beta_ref", **{header: raw}))
    for words in ((), ("--yes",)):
        err = refused(path, *words, "-o", tmp_path / "out")
        assert f"thrust: found {header}, thrust by its name, from {raw.min():g} to {raw.max():g}" in err
    points = err.split("--map 'thrust=")[1].split("'")[0].replace("@A=0,B=10", "@84213=0,79213=10.5")
    check(imported(path, "--map", f"thrust={points}"), "thrust", rtol=0, atol=0.0011)


def test_two_load_cells_of_one_rotor_are_added_or_stop_the_import(tmp_path, log, imported, printed, refused):
    cells = {"F left [N]": 0.25 * T["thrust"], "F right [N]": 0.75 * T["thrust"]}
    path = log(named("time", "omega_ref", "beta_ref", **cells))
    err = refused(path, "-o", tmp_path / "out")
    assert "F left [N], F right [N], and one speed, expected one thrust" in err
    assert "not used" not in printed(path, "--map", "thrust=F left+F right", "-o", tmp_path / "out")
    check(imported(path, "--map", tmp_path / "out" / "import.toml", to="again"), "thrust")
    left = imported(path, "--rotor", "left", to="left")
    np.testing.assert_allclose(left["thrust"], 0.25 * T["thrust"], rtol=1e-8)


@pytest.mark.parametrize(
    ("names", "scale"), [(("stamp.sec", "stamp.nanosec"), 1e-9), (("tv_sec", "tv_usec"), 1e-6), (("secs", "nsecs"), 1e-9)]
)
def test_seconds_without_their_fraction_in_another_column_are_no_time(tmp_path, log, refused, names, scale):
    whole = np.floor(T["time"])
    parts = dict(zip(names, (1.7e9 + whole, np.round((T["time"] - whole) / scale)), strict=True))
    said = refused(log(parts | named("omega_ref", "beta_ref", "thrust")), "-o", tmp_path / "out")
    assert f"time: found whole seconds in {names[0]}, beside {names[1]}" in said
    assert "--map time=COLUMN:s" in said


def test_minutes_and_seconds_are_unwrapped_after_an_hour(tmp_path, log, printed):
    stamps = [f"{s // 60 % 60:02.0f}:{s % 60:06.3f}" for s in 3598.5 + T["time"]]
    out = printed(log({"Elapsed": stamps} | named("omega_ref", "beta_ref", "thrust")), "-o", tmp_path / "out")
    assert "each after 3600 s (an hour): unwrapped" in out
    check(read_record(tmp_path / "out" / "open_loop.csv"), "time")


def test_unsorted_rows_are_refused_and_not_taken_for_runs(tmp_path, log, refused):
    order = np.arange(len(T["time"]))
    order[200:208] = order[[204, 205, 206, 207, 200, 201, 202, 203]]
    path = log({header: T[name][order] for name, header in HEADERS.items()})
    assert "Try: sort the rows by their time" in refused(path, "-o", tmp_path / "out")


def test_error_words_of_loggers_are_empty_cells_and_other_text_is_refused(tmp_path, log, imported, refused):
    thrust = [f"{v:.5f}" for v in T["thrust"]]
    thrust[50], thrust[60], thrust[70] = "ERR", "timeout", "#DIV/0!"
    columns = named("time", "omega_ref", "beta_ref", **{"Fz [N]": thrust})
    found = imported(log(columns), holes=("thrust",))["thrust"]
    assert np.flatnonzero(np.isnan(found)).tolist() == [50, 60, 70]
    thrust[80] = "overload"
    err = refused(log(columns), "-o", tmp_path / "other")
    assert "Fz [N], line 82: found overload, expected a number" in err.replace("'", "")


def test_a_log_of_names_alone_has_no_numbers(tmp_path, refused):
    path = tmp_path / "log.csv"
    path.write_text("t [s],speed cmd [rpm],pitch cmd [deg],Fz [N]\n")
    assert "found 1 line without numbers" in refused(path, "-o", tmp_path / "out")


def test_repeated_readings_of_one_conversion_count_once(tmp_path, log, printed):
    """80 conversions a second in 200 rows; noise of 50 digits. Readings frozen for 0.5 s are left to the quality gate."""
    rng, rows = np.random.default_rng(3), np.arange(4000)
    fresh = np.append(True, np.diff(rows * 80 // 200) > 0)
    speed, pitch = np.repeat(rng.integers(2000, 6000, 40), 100).astype(float), np.repeat(rng.uniform(-4.0, 9.0, 20), 200)
    thrust = np.round(12.0 * (speed / 6000.0) ** 2 + 0.3 * pitch + rng.normal(0.0, 0.05, 4000), 3)
    held = thrust[np.maximum.accumulate(np.where(fresh, rows, 0))]
    stuck = slice(2050, 2150)
    held[stuck] = held[stuck.start]
    columns = {"t [s]": 0.005 * rows, "speed cmd [rpm]": speed, "pitch cmd [deg]": pitch, "Fz [N]": held}
    assert "a new one comes every 12." in printed(log(columns), "-o", tmp_path / "out")
    found = read_record(tmp_path / "out" / "open_loop.csv", holes=("thrust",))["thrust"]
    new = np.append(True, np.diff(held) != 0.0)
    new[stuck] = True
    np.testing.assert_array_equal(np.isfinite(found), new)
    single = {**columns, "Fz [N]": np.round(thrust, 1)}  # half a digit of noise: neighbours are equal by chance
    assert "repeats are emptied" not in printed(log(single), "-o", tmp_path / "single")


def test_a_pitch_of_less_than_a_degree_is_proposed_in_radians(tmp_path, log, imported, refused):
    path = log(named("time", "omega_ref", "thrust", pitch_cmd=np.radians(T["beta_ref"])))
    assert "pitch_cmd as beta_ref in rad" in refused(path, "-o", tmp_path / "out")
    check(imported(path, "--yes"), "beta_ref")


@pytest.mark.parametrize(
    ("header", "known"),
    [("theta_cmd [deg]", True), ("vane setpoint [deg]", True), ("servo_deg", True), ("xi [deg]", False), ("xi_deg", False)],
)
def test_a_moving_angle_is_the_pitch_or_must_be_mapped(tmp_path, log, imported, printed, refused, header, known):
    """A constant pitch of the body is none."""
    path = log(named("time", "omega_ref", "thrust", body_pitch_deg=np.full(400, 0.5), **{header: T["beta_ref"]}))
    if not known:
        angle = f"{header}, an angle that moves from {T['beta_ref'].min():g} to {T['beta_ref'].max():g} deg"
        assert angle in refused(path, "-o", tmp_path / "out")
    check(imported(path, *(() if known else ("--map", f"beta_ref={header}:deg"))), "beta_ref")
    printed(path, "--map", "beta_ref=-", "--fixed", "beta_ref=3:deg", "-o", tmp_path / "fixed")


def test_timestamps_of_the_arduino_serial_monitor_are_the_time(tmp_path, printed):
    t, rows = T, []
    for k in range(len(t["time"])):
        rows.append(f"23:59:{58.25 + t['time'][k]:06.3f} -> set:{t['omega_ref'][k]:g} rpm  thrust:{t['thrust'][k]:.6f} N")
        if k == 70:
            rows.append("23:59:58.955 -> set:40thrust:1.2")
    path = tmp_path / "serial.txt"
    path.write_text("\n".join(rows[:150]) + "\n")
    out = printed(path, "--map", "omega_ref=set", "-o", tmp_path / "out")
    assert "lines without these values 1\n" in out
    record = read_record(tmp_path / "out" / "open_loop.csv")
    for name in ("time", "omega_ref", "thrust"):
        np.testing.assert_allclose(record[name], t[name][:149], atol=1e-6)


def test_a_long_name_without_a_value_is_tried_once():
    """Each of its 60 parts could be split in two ways, so that a search over all splits would not end."""
    assert without_names([(1, "_".join(60 * "a") + " b"), (2, "1 2")]) == []


def test_one_run_is_taken_of_a_log_whose_time_starts_again(tmp_path, log, printed, refused):
    columns = {header: column[:300] for header, column in named("omega_ref", "omega", "thrust").items()}
    path = log({"t [s]": np.tile(T["time"][:150], 2)} | columns)
    assert "--run 1 for the first of 2 runs" in refused(path, "-o", tmp_path / "out")
    for run, rows in ((1, slice(0, 150)), (2, slice(150, 300))):
        out = printed(path, "--run", run, "-o", tmp_path / str(run))
        assert f"run {run} of 2 is taken" in out
        record = read_record(tmp_path / str(run) / "open_loop.csv")
        np.testing.assert_allclose(record.time, T["time"][:150], atol=1e-9)
        np.testing.assert_allclose(record["thrust"], T["thrust"][rows], rtol=1e-8)
    err = refused(path, "--run", 3, "-o", tmp_path / "out")
    assert "--run: found 3, expected 1 to 2" in err
    assert not (tmp_path / "out").exists()


def test_a_throttle_in_per_cent_by_its_name_is_accepted_by_yes(tmp_path, log, imported, refused):
    given = stand()
    columns = {"time_ms": 1e3 * given["Time (s)"], "throttle_%": given["ESC (us)"] / 10.0 - 100.0}
    path = log(columns | {"thrust_g": given["Thrust (gf)"], "rpm": given["RPM"]})
    assert "throttle_% as signal in %" in refused(path, "-o", tmp_path / "out")
    record = imported(path, "--yes")
    np.testing.assert_allclose(record["thrust"], 9.80665e-3 * given["Thrust (gf)"], rtol=1e-8)
    x = given["ESC (us)"] - 1000.0
    np.testing.assert_allclose(record["omega_ref"], 200.0 + 9.5 * x - 0.0025 * x**2, atol=3.0)


@pytest.mark.parametrize(("pairs", "also"), [(7, "7 pole pairs?"), (6, "6 pole pairs, or deg/s?")])
def test_a_measured_speed_that_is_electrical_is_named_with_its_mapping(tmp_path, log, imported, printed, refused, pairs, also):
    path = log(named("time", "omega_ref", "thrust", **{"speed (rpm)": pairs * T["omega"]}))
    for words in ((), ("--yes",), ("--map", "omega=speed (rpm):rpm")):
        err = refused(path, *words, "-o", tmp_path / "out")
        assert f"times the commanded speed (electrical speed of a motor with {also}" in err
    assert f"omega=speed (rpm):erpm/{pairs}" in printed(path, "--propose")
    assert not (tmp_path / "out").exists()
    check(imported(path, "--map", f"omega=speed (rpm):erpm/{pairs}"), "omega")
    printed(path, "--force", "-o", tmp_path / "forced")


@pytest.mark.parametrize("header", ["eRPM", "Motor speed (erpm)"])
def test_an_electrical_speed_beside_a_signal_needs_the_pole_pairs(tmp_path, log, imported, refused, header):
    columns = stand()
    columns[header] = 7.0 * columns.pop("RPM")
    path = log(columns)
    assert f"omega={header}:erpm/7" in refused(path, "--yes", "-o", tmp_path / "out")
    found = imported(path, "--map", f"omega={header}:erpm/7")
    np.testing.assert_allclose(found["omega"], columns[header] / 7.0, rtol=1e-8)


@pytest.mark.parametrize(("name", "unit", "factor"), [("omega", "rad/s", np.pi / 30.0), ("omega_ref", "Hz", 1.0 / 60.0)])
def test_a_speed_in_another_unit_than_its_command_is_refused_as_an_electrical_one_is(
    tmp_path, log, imported, printed, refused, name, unit, factor
):
    headers = {"omega": "speed", "omega_ref": "speed cmd"}
    path = log(named("time", "thrust") | {headers[n]: T[n] * (factor if n == name else 1.0) for n in headers})
    maps = ("--map", "omega=speed:rpm", "omega_ref=speed cmd:rpm")
    assert f"({name} in {unit}?)" in (err := refused(path, *maps, "-o", tmp_path / "out"))
    assert f"--map '{name}={headers[name]}:{unit}'" in err
    told = printed(path, *maps, "--force", "-o", tmp_path / "forced")
    assert told.count("error") == 1  # no other finding on the same fault
    assert "% of a move" not in told
    check(imported(path, "--map", *(f"{n}={headers[n]}:{unit if n == name else 'rpm'}" for n in headers)), name)


def test_a_few_absurd_cells_of_a_sensor_are_emptied_and_most_are_a_wrong_unit(tmp_path, log, imported, refused):
    speed = np.tile(T["omega"], 2)
    spoiled = speed.copy()
    spoiled[[50, 400, 401]] = 5e5, -3e4, 2e6
    time = np.append(T["time"], T["time"] + T["time"][-1] + 0.01)
    columns = {"t [s]": time} | {n: np.tile(c, 2) for n, c in named("omega_ref", "beta_ref", "thrust").items()}
    record = imported(log(columns | {"speed [rpm]": spoiled}))
    assert np.flatnonzero(np.isnan(record["omega"])).tolist() == [50, 400, 401]
    kept = np.isfinite(record["omega"])
    np.testing.assert_allclose(record["omega"][kept], speed[kept], rtol=1e-8)
    err = refused(log(columns | {"speed [rpm]": 100.0 * speed}), "--force", "-o", tmp_path / "out")
    assert "rows beyond the range" in err


def test_a_motor_at_its_commanded_speed_is_not_electrical(log, imported):
    imported(log(named("time", "omega_ref", "thrust", **{"speed (rpm)": 1.5 * T["omega"]})))


PULSES = np.round(1000.0 + (T["beta_ref"] + 5.0) / 0.015)
"""us: -5 deg at 1000, 10 deg at 2000."""


@pytest.mark.parametrize("header", ["Pitch Servo (us)", "servo pwm", "pitch_us"])
def test_a_pitch_in_pulses_must_be_calibrated_or_fixed(tmp_path, log, imported, printed, refused, header):
    path = log(named("time", "omega_ref", "thrust", **{header: PULSES}))
    for words in ((), ("--yes",), ("--map", "thrust=Fz [N]:N")):
        err = refused(path, *words, "-o", tmp_path / "out")
        assert f"{header}, pitch by its name" in err
        assert f"beta_ref={header}:us@{PULSES.min():g}=A,{PULSES.max():g}=B" in err
    assert header in printed(path, "--propose").split("beta_ref: ")[1]
    record = imported(path, "--map", f"beta_ref={header}:us@1000=-5,2000=10", to="a")
    np.testing.assert_allclose(record["beta_ref"], 0.015 * PULSES - 20.0, atol=1e-9)
    printed(path, "--map", tmp_path / "a" / "import.toml", "-o", tmp_path / "b")
    assert (tmp_path / "a" / "open_loop.csv").read_bytes() == (tmp_path / "b" / "open_loop.csv").read_bytes()
    np.testing.assert_array_equal(imported(path, "--fixed", "beta_ref=2:deg", to="c")["beta_ref"], 2.0)


def test_a_servo_that_is_not_connected_and_a_pitch_rate_are_no_pitch(tmp_path, log, printed):
    more = {"Servo 1": np.full(400, np.nan), "Servo 2 (us)": np.zeros(400), "Pitch rate (deg/s)": T["beta_ref"]}
    assert "fixed pitch of 0 deg" in printed(log(named("time", "omega_ref", "thrust", **more)), "-o", tmp_path / "out")


@pytest.mark.parametrize(
    "unit", ["us@1000=-5,1000=10", "us@1000=-5,2000=-5", "us@1000=-5", "us@1.2.3=1,2=3", "us@1000=-5,2000=10,3000=20"]
)
def test_a_calibration_that_is_no_line_is_refused(tmp_path, log, refused, unit):
    err = refused(log(T), "--map", f"beta_ref=beta_ref:{unit}", "-o", tmp_path / "out")
    assert "two points of a calibration" in err


@pytest.mark.parametrize("labels", [("1", "2"), ("left", "right")])
def test_one_of_several_rotors_is_imported_by_its_label_or_by_one_of_its_columns(tmp_path, log, imported, refused, labels):
    names = {"omega_ref": "rpm_cmd", "beta_ref": "pitch_cmd", "thrust": "thrust", "omega": "rpm"}
    columns = {"time (s)": T["time"]}
    for label, gain in zip(labels, (1.0, 0.9), strict=True):
        columns |= {f"{header}_{label}": gain * T[n] for n, header in names.items()}
    path, (first, second) = log(columns), labels
    said = refused(path, "--yes", "-o", tmp_path / "out")
    assert f"rotors: found 2 ({first}, {second}), expected one rotor. Try: --rotor {first}, or" in said
    # With one column of a rotor, all others are of the same one.
    for folder, words in (("a", ("--rotor", second)), ("b", ("--map", f"thrust=thrust_{second}:N"))):
        record = imported(path, "--yes", *words, to=folder)
        for name in names:
            np.testing.assert_allclose(record[name], 0.9 * T[name], rtol=1e-8)
    check(imported(path, "--yes", "--rotor", first, to="c"), *names)
    assert f"--rotor: found 7, expected one of {', '.join(labels)}" in refused(path, "--rotor", "7")


def test_coefficients_are_no_thrust(tmp_path, refused):
    table(tmp_path / "ct.txt", {"RPM": [6000, 3000, 6000], "CT": [0.1, 0.08, 0.05], "CP": [0.05] * 3, "J": [0.0, 0.0, 0.4]})
    said = refused(tmp_path / "ct.txt", "--as", "static", "-o", tmp_path / "out")
    assert "thrust: found no column of it among RPM, CT, CP, J" in said
    assert "Try: --map thrust=COLUMN:UNIT" in said


def test_a_mapping_on_the_command_line_completes_the_proposal(tmp_path, log, imported, printed):
    headers = "time", "omega_ref", "beta_ref", "omega"
    path = log(named(*headers, **{"channel 7": T["thrust"], "u": T["voltage"]}))
    assert "u: not taken as voltage" in printed(path, "--map", "thrust=channel 7:N", "-o", tmp_path / "a")
    record = read_record(tmp_path / "a" / "open_loop.csv")
    assert "voltage" not in record
    check(record, *headers, "thrust")
    record = imported(path, "--map", "thrust=channel 7:N", "omega=-", "--yes", to="b")
    assert "omega" not in record
    check(record, "voltage")


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
def test_a_unit_that_contradicts_the_header_needs_the_option_force(tmp_path, log, printed, refused, header, pair, contradicts):
    path = log(named("time", "omega_ref", **{header: T["thrust"]}))
    said = (refused if contradicts else printed)(path, "--yes", "--map", pair, "-o", tmp_path / "out")
    assert ("whose header says" in said) == contradicts
    printed(path, "--map", pair, "--force", "-o", tmp_path / "forced")


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
def test_bad_options_are_refused_in_one_line(tmp_path, log, refused, words, told):
    assert told in refused(log(T), *words, "-o", tmp_path / "out")
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
def test_a_bad_mapping_file_is_refused_in_one_line(tmp_path, log, refused, content):
    (tmp_path / "m.toml").write_text(content)
    assert "m.toml" in refused(log(T), "--map", tmp_path / "m.toml", "-o", tmp_path / "out")


# Forms of common tools: names of channels, rotors, axes and messages

WITHOUT_PITCH = ("time", "omega_ref", "omega", "thrust")


def test_columns_of_two_sides_are_never_mixed(tmp_path, log, imported):
    """Side A is not connected: its cell has noise alone, its command is constant."""
    given, noise = stand(), np.random.default_rng(1).normal(0.0, 0.02, 6000)
    columns = {"Time (s)": given["Time (s)"], "ESC A (us)": np.full(6000, 1000.0), "ESC B (us)": given["ESC (us)"]}
    columns |= {"Thrust A (gf)": noise, "Thrust B (gf)": given["Thrust (gf)"]}
    columns |= {"Motor Optical Speed A (RPM)": np.zeros(6000), "Motor Optical Speed B (RPM)": given["RPM"]}
    record = imported(log(columns), "--rotor", "B")
    np.testing.assert_allclose(record["thrust"], 9.80665e-3 * given["Thrust (gf)"], rtol=1e-8)
    np.testing.assert_array_equal(record["omega"], given["RPM"])


def test_one_of_three_forces_must_be_chosen(tmp_path, log, imported, refused):
    forces = {f"Force {a.upper()} [N]": T["thrust"] if a == "x" else np.full(400, 9.0) for a in "xyz"}
    path = log(named("time", "omega_ref", "omega", **forces))
    assert "Force X [N], Force Y [N], Force Z [N], and one speed" in refused(path, "-o", tmp_path / "out")
    check(imported(path, "--map", "thrust=Force X:N"), "thrust")


@pytest.mark.parametrize("header", ["eRPM[0]", "eRPM(/100)[0]"])
def test_an_electrical_speed_in_hundreds_is_mapped_by_the_commands_of_the_messages(tmp_path, log, imported, refused, header):
    columns = stand()
    columns[header] = np.round(0.07 * columns.pop("RPM"))  # hundreds of 7 pole pairs
    path, unit = log(columns), None
    for _ in range(3):
        err = refused(path, *(("--map", f"omega={header}:{unit}") if unit else ()), "-o", tmp_path / "out")
        unit = err.split(f"--map 'omega={header}:")[1].split("'")[0]
        if unit == "100 erpm/7":
            break
    found = imported(path, "--map", f"omega={header}:{unit}")
    np.testing.assert_allclose(found["omega"], 100.0 * columns[header] / 7.0, rtol=1e-8)


def test_an_electrical_speed_in_hundreds_beside_a_command_is_refused(tmp_path, log, refused):
    path = log(named("time", "omega_ref", "thrust", eRPM=0.07 * T["omega"]))
    assert "electrical speed, by its name" in refused(path, "-o", tmp_path / "out")


def test_messages_in_rows_of_their_own_are_refused(tmp_path, log, imported, refused):
    """Speed 5 ms after each reading of thrust; then the commands, too."""
    rows = {name: np.repeat(T[name], 2) for name in ("time", "omega_ref", "beta_ref", "omega", "thrust")}
    rows["time"][1::2] += 0.005
    rows["thrust"][1::2] = rows["omega"][::2] = np.nan
    path = log({HEADERS[name]: column for name, column in rows.items()})
    assert "rows: found omega in other rows than thrust" in (said := refused(path, "-o", tmp_path / "out"))
    assert "Try: a table joined at the rows of thrust, or --map omega=-" in said
    assert "omega" not in imported(path, "--map", "omega=-", holes=("thrust",))
    rows["omega_ref"][::2] = np.nan
    path = log({HEADERS[name]: column for name, column in rows.items()})
    assert "found omega_ref, omega in other rows" in refused(path, "-o", tmp_path / "out")


@pytest.mark.parametrize("rate", [1, 2])
def test_channels_with_clocks_of_their_own_are_imported_if_the_clocks_agree(tmp_path, imported, refused, rate):
    t, names = T, {"omega_ref": "Speed cmd", "beta_ref": "Pitch cmd", "omega": "Speed", "thrust": "Force"}
    clocks = [t["time"] * (rate if name == "Speed" else 1) for name in names.values()]
    head = ["***End_of_Header***", "Y_Unit_Label\trpm\t\tdeg\t\trpm\t\tN\t", "X_Dimension\tTime\t\tTime\t\tTime\t\tTime\t"]
    head.append("\t".join([part for name in names.values() for part in ("X_Value", name)] + ["Comment"]))
    cells = [column for clock, name in zip(clocks, names, strict=True) for column in (clock, t[name])]
    lines = ["\t".join(f"{v:.10g}" for v in row) for row in zip(*cells, strict=True)]
    (tmp_path / "log.lvm").write_text("\n".join([*head, *lines]))
    if rate > 1:
        assert "time: found several, of which X_Value.5 differs" in refused(tmp_path / "log.lvm", "-o", tmp_path / "out")
        return
    check(imported(tmp_path / "log.lvm"), "time", *names)
