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
    "omega": {"RPM": 1.0, "deg/s": 1.0 / 6.0, "erpm/7": 1.0 / 7.0, "tr/min": 1.0, "UPM": 1.0, "Hz": 60.0, "1/min": 1.0}
    | {"min-1": 1.0, "rev/s": 60.0, "rad/s": 30.0 / np.pi},
    "thrust": {"g": 9.80665e-3, "gr": 9.80665e-3, "0.0123 N": 0.0123, "kg": 9.80665, "lbf": 4.4482216152605}
    | {"ozf": 4.4482216152605 / 16.0},
    "voltage": {"mV": 1e-3},
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
    assert "signal <- ESC (us) in us (sure)" in out
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


def test_minutes_and_seconds_are_unwrapped_after_an_hour(tmp_path, log, printed):
    stamps = [f"{s // 60 % 60:02.0f}:{s % 60:06.3f}" for s in 3598.5 + T["time"]]
    out = printed(log({"Elapsed": stamps} | named("omega_ref", "beta_ref", "thrust")), "-o", tmp_path / "out")
    assert "each after 3600 s (an hour): unwrapped" in out
    check(read_record(tmp_path / "out" / "open_loop.csv"), "time")


def test_error_words_of_loggers_are_empty_cells_and_other_text_is_refused(tmp_path, log, imported, refused):
    thrust = [f"{v:.5f}" for v in T["thrust"]]
    thrust[50], thrust[60], thrust[70] = "ERR", "timeout", "#DIV/0!"
    columns = named("time", "omega_ref", "beta_ref", **{"Fz [N]": thrust})
    found = imported(log(columns), holes=("thrust",))["thrust"]
    assert np.flatnonzero(np.isnan(found)).tolist() == [50, 60, 70]
    thrust[80] = "overload"
    err = refused(log(columns), "-o", tmp_path / "other")
    assert "Fz [N], line 82: found overload, expected a number" in err.replace("'", "")


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


def test_a_servo_that_is_not_connected_and_a_pitch_rate_are_no_pitch(tmp_path, log, printed):
    more = {"Servo 1": np.full(400, np.nan), "Servo 2 (us)": np.zeros(400), "Pitch rate (deg/s)": T["beta_ref"]}
    assert "fixed pitch of 0 deg" in printed(log(named("time", "omega_ref", "thrust", **more)), "-o", tmp_path / "out")


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
    ("words", "told"),
    [
        (("--map", "thurst=Fz:N"), "--map: found 'thurst=Fz:N'"),
        (("--map", "thrust=thrust:N", "thrust=omega:N"), "--map thrust: found thrust twice"),
        (("--map", "a.toml", "b.toml"), "--map: found a.toml b.toml"),
        (("--fixed", "thrust=3:N"), "--fixed: found 'thrust=3:N'"),
        (("--fixed", "beta_ref=8:N"), "--fixed: found 'beta_ref=8:N'"),
        (("--encoding", "utf-99"), "found bytes that are no utf-99"),
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


# Refusals, and the words that import the log


S, SPEED = stand(), np.array([200.0, 9.5, -0.0025])
"""A log with a signal and no command, and the speed of its motor by powers of (signal - 1000 us)."""

WANTED = np.polyval(SPEED[::-1], S["ESC (us)"] - 1000.0)
PULSES = np.round(1000.0 + (T["beta_ref"] + 5.0) / 0.015)
"""us: -5 deg at 1000, 10 deg at 2000."""

COUNTS = np.round(84213.0 - T["thrust"] / 0.0021)
WHOLE = np.floor(T["time"])
SWAPPED = np.r_[0:200, 204:208, 200:204, 208:400]
TWO = {"rpm_cmd": "omega_ref", "pitch_cmd": "beta_ref", "thrust": "thrust", "rpm": "omega"}


def rotors(first, second):
    """Two rotors, of which the second has 0.9 of each value."""
    gains = {first: 1.0, second: 0.9}
    return {"time (s)": T["time"]} | {f"{h}_{k}": g * T[n] for k, g in gains.items() for h, n in TWO.items()}


def of(*names, gain=1.0):
    """Columns that the record must have."""
    return {name: gain * T[name] for name in names}


FIXED = ("--fixed", "beta_ref=2:deg")
COMMON = ("time", "omega_ref", "beta_ref")
MESSAGES = {HEADERS[n]: np.repeat(T[n], 2) for n in (*COMMON, "omega", "thrust")}
MESSAGES["t [s]"][1::2] += 0.005
MESSAGES["Fz [N]"][1::2] = MESSAGES["speed [rpm]"][::2] = np.nan

CASES = {
    "units are guessed": (
        {"t": T["time"], "speed_cmd": T["omega_ref"], "pitch_cmd": T["beta_ref"], "force": T["thrust"]},
        ("force as thrust in N", "Try: --yes to take these units"),
        {("--yes",): of(*COMMON, "thrust")},
    ),
    "n may be newton": (
        {"t_s": T["time"], "n_soll_rpm": T["omega_ref"], "n_ist_rpm": T["omega"], "force_n": T["thrust"]},
        ("force_n as thrust in N", "thrust=force_n:N"),
        {("--yes",): of("time", "omega_ref", "omega", "thrust"), ("--map", "thrust=force_n:N"): of("thrust")},
    ),
    "omega in rad/s": (
        named("time", "thrust", omega_cmd=T["omega_ref"] * np.pi / 30.0),
        ("omega_cmd as omega_ref in rad/s",),
        {("--yes",): of("omega_ref")},
    ),
    "omega faster than a rotor": (
        named("time", "thrust", omega_cmd=T["omega_ref"]),
        ("omega_cmd as omega_ref in rpm",),
        {("--yes",): of("omega_ref")},
    ),
    "a pitch below a degree": (
        named("time", "omega_ref", "thrust", pitch_cmd=np.radians(T["beta_ref"])),
        ("pitch_cmd as beta_ref in rad",),
        {("--yes",): of("beta_ref")},
    ),
    "a throttle in per cent": (
        {
            "time_ms": 1e3 * S["Time (s)"],
            "throttle_%": S["ESC (us)"] / 10.0 - 100.0,
            "thrust_g": S["Thrust (gf)"],
            "rpm": S["RPM"],
        },
        ("throttle_% as signal in %",),
        {("--yes",): {"thrust": 9.80665e-3 * S["Thrust (gf)"], "omega": S["RPM"]}},
    ),
    **{
        f"a load cell in counts, {header}": (
            named(*COMMON, **{header: COUNTS}),
            (f"thrust: found {header}, thrust by its name, from {COUNTS.min():g} to {COUNTS.max():g}", "@A=0,B=10"),
            {("--map", f"thrust={header}:{unit}@84213=0,79213=10.5"): {"thrust": 0.0021 * (84213.0 - COUNTS)}},
        )
        for header, unit in (("load cell (mV)", "mV"), ("loadcell_raw", ""), ("force counts", ""))
    },
    "two load cells": (
        named(*COMMON, **{"F left [N]": 0.25 * T["thrust"], "F right [N]": 0.75 * T["thrust"]}),
        ("F left [N], F right [N], and one speed, expected one thrust",),
        {("--map", "thrust=F left+F right"): of("thrust"), ("--rotor", "left"): of("thrust", gain=0.25)},
    ),
    "three axes": (
        named(*COMMON, **{"Force X [N]": T["thrust"], "Force Y [N]": 0.0 * T["time"], "Force Z [N]": 0.0 * T["time"]}),
        ("Force X [N], Force Y [N], Force Z [N], and one speed",),
        {("--map", "thrust=Force X"): of("thrust")},
    ),
    **{
        f"rotors {first} and {second}": (
            rotors(first, second),
            (f"rotors: found 2 ({first}, {second}), expected one rotor. Try: --rotor {first}, or",),
            {
                ("--yes", "--rotor", first): of(*TWO.values()),
                ("--yes", "--rotor", second): of(*TWO.values(), gain=0.9),
                ("--yes", "--map", f"thrust=thrust_{second}:N"): of(*TWO.values(), gain=0.9),
            },
        )
        for first, second in (("1", "2"), ("left", "right"), ("a", "b"))
    },
    **{
        f"seconds in {one}": (
            {one: 1.7e9 + WHOLE, other: np.round((T["time"] - WHOLE) / scale)} | named("omega_ref", "beta_ref", "thrust"),
            (f"time: found whole seconds in {one}, beside {other}", "--map time=COLUMN:s"),
            {},
        )
        for one, other, scale in (("stamp.sec", "stamp.nanosec", 1e-9), ("tv_sec", "tv_usec", 1e-6), ("secs", "nsecs", 1e-9))
    },
    "unsorted rows": ({h: T[n][SWAPPED] for n, h in HEADERS.items()}, ("Try: sort the rows by their time",), {}),
    "names alone": ({h: [] for h in HEADERS.values()}, ("found 1 line without numbers",), {}),
    "coefficients": (
        {"RPM": [6000, 3000, 6000], "CT": [0.1, 0.08, 0.05], "CP": [0.05] * 3, "J": [0.0, 0.0, 0.4]},
        ("thrust: found no column of it among RPM, CT, CP, J", "Try: --map thrust=COLUMN:UNIT"),
        {},
    ),
    "messages in rows of their own": (
        MESSAGES,
        ("rows: found omega in other rows than thrust", "Try: a table joined at the rows of thrust, or --map omega=-"),
        {},
    ),
    "commands in rows of their own": (
        MESSAGES | {h: np.where(np.arange(800) % 2, MESSAGES[h], np.nan) for h in (HEADERS["omega_ref"],)},
        ("found omega_ref, omega in other rows",),
        {},
    ),
    **{
        f"an angle, {header}": (
            named("time", "omega_ref", "thrust", body_pitch_deg=np.full(400, 0.5), **{header: T["beta_ref"]}),
            (f"{header}, an angle that moves from {T['beta_ref'].min():g} to {T['beta_ref'].max():g} deg",),
            {("--map", f"beta_ref={header}:deg"): of("beta_ref"), FIXED: {"beta_ref": np.full(400, 2.0)}},
        )
        for header in ("xi [deg]", "xi_deg")
    },
    **{
        f"pulses, {header}": (
            named("time", "omega_ref", "thrust", **{header: PULSES}),
            (f"{header}, pitch by its name", f"beta_ref={header}:us@{PULSES.min():g}=A,{PULSES.max():g}=B"),
            {
                ("--map", f"beta_ref={header}:us@1000=-5,2000=10"): {"beta_ref": 0.015 * PULSES - 20.0},
                FIXED: {"beta_ref": np.full(400, 2.0)},
            },
        )
        for header in ("Pitch Servo (us)", "servo pwm", "pitch_us")
    },
    **{  # beside it: a step counter, a temperature and the command again, which say nothing of the thrust
        f"thrust follows {header}": (
            named(
                *("time", "omega_ref", "omega", "thrust"),
                **{"step": np.arange(400) // 25, "temp [degC]": np.arange(400) % 3, "RPM set": T["omega_ref"], header: PULSES},
            ),
            (f"{header}, an unused command from {PULSES.min():g} to {PULSES.max():g} that thrust follows",),
            {
                ("--map", f"beta_ref={header}:us@1000=-5,2000=10"): {"beta_ref": 0.015 * PULSES - 20.0},
                FIXED: {"beta_ref": np.full(400, 2.0)},
            },
        )
        for header in ("RCOU.C2", "CH6(us)")
    },
    **{
        f"{pairs} pole pairs": (
            named("time", "omega_ref", "thrust", **{"speed (rpm)": pairs * T["omega"]}),
            (f"electrical speed of a motor with {text}", f"omega=speed (rpm):erpm/{pairs}"),
            {("--map", f"omega=speed (rpm):erpm/{pairs}"): of("omega"), ("--force",): of("omega", gain=pairs)},
        )
        for pairs, text in ((7, "7 pole pairs?"), (6, "6 pole pairs, or deg/s?"))
    },
    **{
        f"{name} in {unit}": (
            named("time", "thrust")
            | {h: T[n] * (factor if n == name else 1.0) for n, h in {**HEADERS, "beta": 0}.items() if "omega" in n},
            (f"({name} in {unit}?)", f"--map '{name}={HEADERS[name]}:{unit}'"),
            {("--map", f"{name}={HEADERS[name]}:{unit}", "--force"): of("omega", "omega_ref")},
        )
        for name, unit, factor in (("omega", "rad/s", np.pi / 30.0), ("omega_ref", "Hz", 1.0 / 60.0))
    },
    **{
        f"electrical by its name, {header}": (
            {n: c for n, c in S.items() if n != "RPM"} | {header: 7.0 * S["RPM"]},
            (f"omega={header}:erpm/7",),
            {("--map", f"omega={header}:erpm/7"): {"omega": S["RPM"]}},
        )
        for header in ("eRPM", "Motor speed (erpm)")
    },
    "electrical in hundreds": (
        named("time", "omega_ref", "thrust", eRPM=0.07 * T["omega"]),
        ("electrical speed, by its name",),
        {},
    ),
    **{
        f"a calibration that is no line, {unit}": (
            named(*COMMON, "thrust", servo=PULSES),
            ("two points of a calibration",),
            ("--map", f"beta_ref=servo:{unit}"),
        )
        for unit in ("us@1000=-5,1000=10", "us@1000=-5,2000=-5", "us@1000=-5", "us@1.2.3=1,2=3", "us@1000=-5,2000=10,3000=20")
    },
    **{
        f"{header} as {unit}": (
            named("time", "omega_ref", **{header: T["thrust"]}),
            (f"a column whose header says '{header[4:-1]}'",),
            ("--map", f"thrust={header}:{unit}"),
        )
        for header, unit in (("Fz (gf)", "N"), ("Fz (gf)", "kgf"), ("Fz (V)", "N"))
    },
}
"""(columns, parts of the refusal, records by the words that import them); or the words in place of the records."""


@pytest.mark.sampled("name")
@pytest.mark.parametrize("name", CASES)
def test_a_doubtful_log_is_refused_and_imported_by_the_words_of_the_refusal(tmp_path, log, imported, refused, name):
    columns, parts, then = CASES[name]
    path = log(columns)
    err = refused(path, *(then if isinstance(then, tuple) else ()), "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    for part in parts:
        assert part in err
    for k, (words, expected) in enumerate(then.items() if isinstance(then, dict) else ()):
        record = imported(path, *words, to=str(k))
        for column, values in expected.items():
            np.testing.assert_allclose(record[column], values, rtol=1e-8, atol=1e-9, err_msg=f"{words} {column}")


def test_a_command_that_thrust_does_not_follow_is_no_pitch(log, imported):
    steady = 12.0 * (T["omega"] / 6000.0) ** 2
    found = imported(log(named("time", "omega_ref", "omega", **{"RCOU.C2": PULSES, "Fz [N]": steady})))
    assert np.all(found["beta_ref"] == 0.0)


@pytest.mark.parametrize(("header", "unit"), [("Fz (gf)", "-1 gf"), ("Fz (g)", "gf"), ("Fz (V)", "12.3 N"), ("Fz (raw)", "N")])
def test_a_unit_that_agrees_with_the_header_or_that_is_a_scale_is_taken(log, imported, header, unit):
    imported(log(named("time", "omega_ref", "beta_ref", **{header: T["thrust"]})), "--map", f"thrust={header}:{unit}")


@pytest.mark.parametrize("header", ["theta_cmd [deg]", "vane setpoint [deg]", "servo_deg"])
def test_an_angle_of_a_command_is_the_pitch(log, imported, header):
    """A constant pitch of the body is none, and a motor faster than its command is not electrical."""
    more = {"body_pitch_deg": np.full(400, 0.5), "speed (rpm)": 1.5 * T["omega"], header: T["beta_ref"]}
    check(imported(log(named("time", "omega_ref", "thrust", **more))), "beta_ref")


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
