"""The quantity and the unit of each column of a foreign log: by units, names and options; refused forms are in import_zoo."""

import numpy as np
import pytest
from import_zoo import PULSES, ROWS, T, named, stand, table

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


UNITS = {
    "time": {"MS": 1e-3, "4 ms": 4e-3},
    "omega": {
        "erpm/7": 1.0 / 7.0,
        "UPM": 1.0,
        "Hz": 60.0,
        "1/min": 1.0,
        "min-1": 1.0,
        "rad/s": 30.0 / np.pi,
        "deg/s": 1.0 / 6.0,
    },
    "thrust": {"g": 9.80665e-3, "gr": 9.80665e-3, "0.0123 N": 0.0123, "lbf": 4.4482216152605},
    "beta": {"Grad": 1.0, "-1 grados": -1.0},
    "torque": {"Nm": 1.0, "N-m": 1.0, "mNm": 1e-3, "oz-in": 28.349523125e-3 * 9.80665 * 25.4e-3},
    "signal": {"us": 1.0, "ms": 1e3, "%": 0.01, "1": 1.0, "": 1.0},
    "samples": {"1": 1.0, " - ": 1.0},
}
OTHERS = {"omega": ("1", "N", "erpm", "erpm/0"), "thrust": ("", ")("), "beta": ("",), "samples": ("rpm",)}
OTHERS |= {"time": ("9**9**9**9 s",)}  # pint would never finish


def test_units_by_their_definitions():
    for quantity, units in UNITS.items():
        assert {u: factor_of(QUANTITIES[quantity], u) for u in units} == pytest.approx(units, rel=1e-12)
    assert [u for quantity, units in OTHERS.items() for u in units if factor_of(QUANTITIES[quantity], u) is not None] == []


def test_a_header_is_a_name_and_a_unit():
    parts = {"Thrust (gf)": ("Thrust", "gf"), "Fz [N]": ("Fz", "N"), "n / rpm": ("n", "rpm"), "Zeit, ms": ("Zeit", "ms")}
    parts |= {"thrust": ("thrust", ""), "motor[0]": ("motor[0]", ""), "throttle [1]": ("throttle", "1")}  # [0] is an index
    assert {header: split_unit(header) for header in parts} == parts


def test_numbers_in_foreign_notation_are_read():
    numbers = {("1.234,5", ","): "1234.5", ("1.234", ","): "1234", ("12,5", ","): "12.5", ("1,234.5", "."): "1234.5"}
    numbers |= {("1'234", "."): "1234", ("\u22123", "."): "-3", ("n/a", "."): ""}
    assert {cell: plain(*cell) for cell in numbers} == numbers


def test_a_long_name_without_a_value_is_tried_once():
    """Each of its 60 parts could be split in two ways, so that a search over all splits would not end."""
    assert without_names([(1, "_".join(60 * "a") + " b"), (2, "1 2")]) == []


PROPOSED = {
    # the quantity of a name, of a unit, of both
    ("ESC speed",): {"omega": 0},
    ("esc_voltage",): {"voltage": 0},
    ("ESC signal",): {"signal": 0},
    ("ESC throttle (%)",): {"signal": 0},
    ("Electrical Power (W)",): {"power": 0},
    ("Mz [Nm]",): {"torque": 0},
    ("Q [N.m]",): {"torque": 0},
    ("T [N]",): {"thrust": 0},
    ("load_cell_kg", "speed setpoint (rpm)"): {"thrust": 0, "omega_ref": 1},
    ("theta_cmd [deg]",): {"beta_ref": 0},
    ("vane setpoint [deg]", "body_pitch_deg"): {"beta_ref": 0, "beta": 1},
    ("Soll (1/min)", "Ist (1/min)", "Kraft (N)"): {"omega_ref": 0, "omega": 1, "thrust": 2},
    ("t_s", "n_soll_rpm", "F_N", "esc_rpm"): {"time": 0, "omega_ref": 1, "thrust": 2, "omega": 3},
    ("speed cmd (us)",): {"signal": 0},
    # of no known quantity
    ("Mechanical Power (W)", "T motor (C)", "roll [deg]", "ticks"): {},
    ("fan", "servo_cmd", "adc force", "Servo 2 (us)", "Pitch rate (deg/s)"): {},
    ("imu/pitch_deg", "imu/roll_deg"): {},
    # of similar channels that of the supply or the rotor
    ("Motor Electrical Speed (RPM)", "Motor Optical Speed (RPM)"): {"omega": 1},
    ("current_motor", "current_in"): {"current": 1},
    ("d_axis_voltage", "input_voltage"): {"voltage": 1},
    ("eRPM", "RPM"): {"omega": 1},
    ("ESC.Err", "ESC.Curr"): {"current": 1},
    ("1-3[N]", "P-1[r/s]"): {"thrust": 0, "omega": 1},
}


@pytest.mark.parametrize("headers", PROPOSED, ids=", ".join)
def test_a_column_is_mapped_to_its_quantity_by_name_and_unit(headers):
    values = dict.fromkeys(headers, np.linspace(1.0, 99.0, 50))
    found = propose(RawTable("log.csv", values, np.arange(50)))
    assert {quantity: headers.index(column.name) for quantity, column in found.items()} == PROPOSED[headers]


def test_a_proposal_writes_nothing_and_a_saved_mapping_imports_the_same(tmp_path, log, printed, refused):
    path = log(stand())
    assert "signal <- ESC (us) in us (sure)" in printed(path, "--propose", "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    printed(path, "--propose", tmp_path / "mine.toml")
    refused(path, "--propose", tmp_path / "mine.toml")  # the file exists
    printed(path, "-o", tmp_path / "a")
    told = read_sections(tmp_path / "mine.toml")["open_loop"]["columns"]
    assert told == read_sections(tmp_path / "a" / "import.toml")["open_loop"]["columns"]
    assert told == {"time": "Time (s):s", "omega": "RPM:rpm", "thrust": "Thrust (gf):gf", "signal": "ESC (us):us"}
    printed(path, "--map", tmp_path / "mine.toml", "-o", tmp_path / "b", "--as", "validation")
    assert (tmp_path / "a" / "open_loop.csv").read_bytes() == (tmp_path / "b" / "validation.csv").read_bytes()


def test_error_words_of_loggers_are_empty_cells_and_other_text_is_refused(tmp_path, log, imported, refused):
    thrust = [f"{v:.5f}" for v in T["thrust"]]
    thrust[50], thrust[60], thrust[70] = "ERR", "timeout", "#DIV/0!"
    columns = named("time", "omega_ref", "beta_ref", **{"Fz [N]": thrust})
    found = imported(log(columns), holes=("thrust",))["thrust"]
    assert np.flatnonzero(np.isnan(found)).tolist() == [50, 60, 70]
    thrust[80] = "overload"
    assert "Fz [N], line 82: found 'overload', expected a number" in refused(log(columns), "-o", tmp_path / "other")


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


def test_one_run_is_taken_of_a_log_whose_time_starts_again(tmp_path, log, printed, refused):
    columns = {header: column[:300] for header, column in named("omega_ref", "omega", "thrust").items()}
    path = log({"t [s]": np.tile(T["time"][:150], 2)} | columns)
    assert "--run 1 for the first of 2 runs" in refused(path, "-o", tmp_path / "out")
    assert "--run: found 3, expected 1 to 2" in refused(path, "--run", 3, "-o", tmp_path / "out")
    assert "run 2 of 2 is taken" in printed(path, "--run", 2, "-o", tmp_path / "out")
    record = read_record(tmp_path / "out" / "open_loop.csv")
    np.testing.assert_allclose(record.time, T["time"][:150], atol=1e-9)
    np.testing.assert_allclose(record["thrust"], T["thrust"][150:300], rtol=1e-8)


def test_a_few_absurd_cells_of_a_sensor_are_emptied_and_most_are_a_wrong_unit(tmp_path, log, imported, refused):
    spoiled = T["omega"].copy()
    spoiled[[50, 390, 391]] = 5e5, -3e4, 2e6
    columns = named("time", "omega_ref", "beta_ref", "thrust")
    record = imported(log(columns | {"speed [rpm]": spoiled}))
    np.testing.assert_array_equal(record["omega"], np.where(np.abs(spoiled - T["omega"]) > 0.0, np.nan, T["omega"]))
    err = refused(log(columns | {"speed [rpm]": 100.0 * T["omega"]}), "--force", "-o", tmp_path / "other")
    assert "rows beyond the range" in err


def test_a_servo_that_is_not_connected_is_no_pitch_nor_is_a_command_that_thrust_does_not_follow(tmp_path, log, printed):
    more = {"Servo 1": np.full(ROWS, np.nan), "Servo 2 (us)": np.zeros(ROWS), "Pitch rate (deg/s)": T["beta_ref"]}
    more |= {"RCOU.C2": PULSES, "Fz [N]": 12.0 * (T["omega"] / 6000.0) ** 2}
    assert "fixed pitch of 0 deg" in printed(log(named("time", "omega_ref", "omega", **more)), "-o", tmp_path / "out")


def test_a_mapping_on_the_command_line_completes_the_proposal(tmp_path, log, imported, printed):
    path = log(named("time", "omega_ref", "beta_ref", "omega", **{"channel 7": T["thrust"], "u": T["voltage"]}))
    assert "u: not taken as voltage" in printed(path, "--map", "thrust=channel 7:N", "-o", tmp_path / "a")
    assert set(read_record(tmp_path / "a" / "open_loop.csv").columns) == {"time", "omega_ref", "beta_ref", "omega", "thrust"}
    record = imported(path, "--map", "thrust=channel 7:N", "omega=-", "--yes", to="b")
    assert set(record.columns) == {"time", "omega_ref", "beta_ref", "thrust", "voltage"}


def test_bad_options_and_mapping_files_are_refused_in_one_line(tmp_path, log, refused):
    told = {
        ("--map", "thurst=Fz:N"): "--map: found 'thurst=Fz:N'",
        ("--map", "thrust=thrust:N", "thrust=omega:N"): "--map thrust: found thrust twice",
        ("--map", "a.toml", "b.toml"): "--map: found a.toml b.toml",
        ("--fixed", "thrust=3:N"): "--fixed: found 'thrust=3:N'",
        ("--fixed", "beta_ref=8:N"): "--fixed: found 'beta_ref=8:N'",
        ("--encoding", "utf-99"): "found bytes that are no utf-99",
        ("--delimiter", "ab"): "--delimiter: found 'ab'",
        ("--map", "nowhere.toml"): "nowhere.toml: file: found no such file",
    }
    head = 'format = "vpp-mapping/1"\n'
    for k, content in enumerate(
        ("no toml [", 'format = "x"', head, f'{head}[static]\nlog = "a"', f"{head}[static.columns]\ntime = 3")
    ):
        (tmp_path / f"{k}.toml").write_text(content)
        told["--map", tmp_path / f"{k}.toml"] = f"{k}.toml: "
    for words, part in told.items():
        assert part in refused(log(T), *words, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("header", "unit"), [("Fz (gf)", "-1 gf"), ("Fz (g)", "gf"), ("Fz (V)", "12.3 N"), ("Fz (raw)", "N")])
def test_a_unit_that_agrees_with_the_header_or_that_is_a_scale_is_taken(log, imported, header, unit):
    imported(log(named("time", "omega_ref", "beta_ref", **{header: T["thrust"]})), "--map", f"thrust={header}:{unit}")


def test_an_electrical_speed_in_hundreds_is_mapped_by_the_commands_of_the_messages(tmp_path, log, imported, refused):
    columns, header = stand(), "eRPM(/100)[0]"
    columns[header] = np.round(0.07 * columns.pop("RPM"))  # hundreds of 7 pole pairs
    path, unit = log(columns), None
    for _ in range(3):
        err = refused(path, *(("--map", f"omega={header}:{unit}") if unit else ()), "-o", tmp_path / "out")
        unit = err.split(f"--map 'omega={header}:")[1].split("'")[0]
        if unit == "100 erpm/7":
            break
    found = imported(path, "--map", f"omega={header}:{unit}")
    np.testing.assert_allclose(found["omega"], 100.0 * columns[header] / 7.0, rtol=1e-8)


def test_clocks_of_single_channels_must_agree(tmp_path, imported, refused):
    """LabVIEW writes a time X_Value before each channel."""
    for rate in (1, 2):
        columns = [T["time"], T["omega_ref"], T["time"], T["beta_ref"], rate * T["time"], T["thrust"]]
        lines = ["\t".join(f"{v:.10g}" for v in row) for row in zip(*columns, strict=True)]
        (tmp_path / "log.lvm").write_text("\n".join(["X_Value\tSpeed cmd\tX_Value\tPitch cmd\tX_Value\tFz", *lines]))
        words = tmp_path / "log.lvm", "--map", "time=X_Value:s", "omega_ref=2:rpm", "beta_ref=4:deg", "thrust=6:N"
        if rate == 1:
            np.testing.assert_allclose(imported(*words)["thrust"], T["thrust"], rtol=1e-8)
        else:
            assert "time: found several, of which X_Value.5 differs" in refused(*words, "-o", tmp_path / "other")
