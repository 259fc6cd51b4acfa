"""Import of foreign logs into a campaign: clock, commands, messages, and protection of existing files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from import_logs import lagged, stand, table
from import_zoo import PLAIN, Format, came_out, text, truth
from studies.gate import SIZES

from identification.logs.clock import guessed_unit, mended, read_clock
from identification.logs.commands import fitted_map
from identification.logs.mapping import read_sections
from identification.logs.raw_table import RawTable
from identification.logs.sampling import between, said_of_gaps, said_of_rows
from identification.logs.speed_choice import likelihood_gain
from identification.logs.speed_map import RANGES
from vpp_fmu.app.cli import main
from vpp_fmu.campaign import read_campaign, read_static, read_steps
from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record, read_record


@pytest.fixture
def vpp(printed):
    """Import a log, which must succeed, and return the output."""
    return lambda *words: printed("import", "csv", *words)


@pytest.fixture
def refused(refused):
    """Import a log, which must be refused, and return the line."""
    return lambda *words: refused("import", "csv", *words)


# Clocks


def sheet(**columns):
    arrays = {n: np.array(c, dtype=object if isinstance(c[0], str) else float) for n, c in columns.items()}
    return RawTable("log.csv", arrays, np.arange(2, 2 + len(next(iter(arrays.values())))))


def test_rows_out_of_order_are_interpolated_between_their_neighbours():
    fixed, count, furthest = mended(np.array([0.0, 1.0, 2.0, 1.9, 4.0, 5.0]))
    np.testing.assert_allclose(fixed, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    assert (count, furthest) == (1, pytest.approx(0.1))
    for end in ([0.0, 1.0, 2.0, 1.5], [0.0, -0.4, 1.0, 2.0], [0.0, 1.0, 0.5, 0.2, 0.1, 5.0]):
        assert np.all(np.diff(mended(np.array(end))[0]) > 0.0)


def test_a_clock_that_jumps_back_is_refused_or_starts_a_new_run():
    with pytest.raises(BadInput, match=r"t, line 5: found 1\.0 after 3\.0, back by 2 s"):
        read_clock(sheet(t=[1.0, 2.0, 3.0, 1.0, 2.0]), "t", "s")
    runs = read_clock(sheet(t=[1.0, 2.0, 3.0, 1.0, 2.0]), "t", "s", runs=True)
    np.testing.assert_array_equal(runs.time, [0.0, 1.0, 2.0, 0.0, 1.0])
    np.testing.assert_array_equal(runs.restarts, [0, 3])


def test_dates_cross_the_end_of_february_in_both_orders_of_day_and_month():
    clock = read_clock(sheet(t=["28.02.2023 23:59:59", "01.03.2023 00:00:01"]), "t", "iso")
    np.testing.assert_allclose(clock.time, [0.0, 2.0])
    clock = read_clock(sheet(t=["2/28/2023 23:59:59", "3/1/2023 00:00:01"]), "t", "iso")
    np.testing.assert_allclose(clock.time, [0.0, 2.0])


@pytest.mark.parametrize(
    ("values", "unit"),
    [
        ([1717236000.1, 1717236000.2], "s"),
        ([1717236000123.0, 1717236000133.0], "ms"),
        ([0.0, 0.01, 0.02], "s"),
        ([0.0, 10.0, 20.0], "ms"),
        ([0.0, 4000.0], "us"),
        ([0.0, 1.0], None),
    ],
)
def test_the_unit_of_time_is_guessed_where_only_one_is_plausible(values, unit):
    assert guessed_unit(np.array(values)) == unit


# Into the campaign


def test_the_file_of_another_log_is_not_overwritten_and_the_mapping_keeps_its_sections(tmp_path, vpp, refused):
    first, second = table(tmp_path / "a.csv", stand()), table(tmp_path / "b.csv", stand(seed=6))
    vpp(first, "-o", tmp_path / "mine")
    before = (tmp_path / "mine" / "open_loop.csv").read_bytes()
    err = refused(second, "-o", tmp_path / "mine")
    assert "open_loop.csv: file: found the file of another log" in err
    assert (tmp_path / "mine" / "open_loop.csv").read_bytes() == before
    assert not [p for p in (tmp_path / "mine").iterdir() if p.name.startswith(".")]
    out = vpp(second, "-o", tmp_path / "mine", "--as", "validation")
    assert "taken over from a.csv" in out
    assert set(read_sections(tmp_path / "mine" / "import.toml")) == {"open_loop", "validation"}
    vpp(second, "-o", tmp_path / "mine", "--replace")
    assert (tmp_path / "mine" / "open_loop.csv").read_bytes() != before
    campaign = read_campaign(tmp_path / "mine")
    assert campaign.open_loop is not None
    assert campaign.validation is not None


def test_the_command_of_a_signal_is_the_parabola_that_the_motor_follows(tmp_path, vpp):
    log = stand()
    out = vpp(table(tmp_path / "log.csv", log), "-o", tmp_path / "mine")
    assert "without a voltage" in out
    assert "fixed pitch of 0 deg" in out
    record = read_record(tmp_path / "mine" / "open_loop.csv")
    x = log["ESC (us)"] - 1000.0
    np.testing.assert_allclose(record["omega_ref"], 200.0 + 9.5 * x - 0.0025 * x**2, atol=3.0)  # rpm, written in whole ones
    assert not record["beta_ref"].any()


def test_a_short_hold_is_not_taken_for_a_rotor_at_rest(tmp_path, vpp):
    """The lowest levels are held for less than a steady part; the rotor still turns there, as the parabola predicts."""
    rng = np.random.default_rng(3)
    levels = [v for pair in zip(rng.uniform(1300, 1900, 30), rng.uniform(1160, 1280, 30), strict=True) for v in pair]
    signal = np.concatenate([np.full(200 if v >= 1300.0 else 60, round(v)) for v in levels]).astype(float)
    x = signal - 1000.0
    wanted = 200.0 + 9.5 * x - 0.0025 * x**2
    speed = lagged(wanted, 0.01, 0.12)
    columns = {"Time (s)": np.round(0.01 * np.arange(len(x)), 6), "ESC (us)": signal, "RPM": np.round(speed)}
    path = table(tmp_path / "log.csv", columns | {"Thrust (N)": 8.0 * (speed / 6000.0) ** 2 + rng.normal(0.0, 0.05, len(x))})
    out = vpp(path, "-o", tmp_path / "mine")
    assert "at most" in out
    np.testing.assert_allclose(read_record(tmp_path / "mine" / "open_loop.csv")["omega_ref"], wanted, atol=10.0)
    assert "--speed-from" not in out  # the motor holds its command


def test_a_motor_in_a_transient_is_not_reported_as_missing_its_command(tmp_path, vpp):
    """The pitch moves within a lag of the speed's moves, so that both commands are constant during the transient."""
    log, rng = stand(rows=12_000, hold=1.2, lag=0.3), np.random.default_rng(2)
    pitch = np.repeat(np.round(rng.uniform(-4.0, 9.0, 400), 1), 30)
    log["Thrust (gf)"] = (8.0 * (log["RPM"] / 6000.0) ** 2 + 0.3 * pitch) / 9.80665e-3 + rng.normal(0.0, 5.0, 12_000)
    path = table(
        tmp_path / "log.csv", log | {"pitch cmd (deg)": pitch, "RPM": np.round(log["RPM"] + rng.normal(0.0, 5.0, 12_000))}
    )
    out = vpp(path, "-o", tmp_path / "map")
    assert "--speed-from" not in out


def test_the_measured_speed_is_suggested_if_the_motor_misses_its_command(tmp_path, vpp, refused):
    """Each hold ends at a random speed, 5 % off the map; thrust follows the measured speed."""
    log, rng = stand(), np.random.default_rng(8)
    hold = np.cumsum(np.append(0, np.diff(log["ESC (us)"]) != 0))
    log["RPM"] = np.round(log["RPM"] * (1.0 + rng.normal(0.0, 0.05, hold.max() + 1))[hold])
    log["Thrust (gf)"] = 8.0 * (log["RPM"] / 6000.0) ** 2 / 9.80665e-3 + rng.normal(0.0, 5.0, len(hold))
    path = table(tmp_path / "log.csv", log)
    out = vpp(path, "-o", tmp_path / "map")
    assert "--speed-from measured takes it as omega_ref" in out
    vpp(path, "--speed-from", "measured", "-o", tmp_path / "mine")
    record = read_record(tmp_path / "mine" / "open_loop.csv")
    np.testing.assert_array_equal(record["omega_ref"], log["RPM"])
    assert "omega" not in record
    assert not (tmp_path / "mine" / "speed_map.json").exists()
    refused(path, "--map", "omega=-", "--speed-from", "measured", "-o", tmp_path / "none")


def test_the_likelihood_gain_of_a_speed_signal_is_the_closed_form():
    """Thrust w^2 at 4 pitches per speed: the residual of a wrong speed is the effect of its errors, that of the right speed is
    the noise. The gain is n / 2 log of the ratio of powers, but for the few fitted terms."""
    rng = np.random.default_rng(4)
    omega, beta = (g.ravel() for g in np.meshgrid(np.linspace(2000.0, 6000.0, 10), [0.0, 3.0, 6.0, 9.0]))
    w = omega / 6000.0
    noise, error = rng.normal(0.0, 1e-3, 40), rng.normal(0.0, 1e-3, 40)
    clean = 10.0 * w**2 + 0.3 * w**2 * beta
    off = omega * (1.0 + error)
    gain = likelihood_gain(off, omega, beta, clean + noise)
    expected = 20.0 * np.log(np.mean((2.0 * clean * error) ** 2 + 1e-6) / 1e-6)
    assert gain == pytest.approx(expected, rel=0.15)
    assert likelihood_gain(omega, off, beta, clean + noise) == pytest.approx(-gain)
    assert likelihood_gain(off[:4], omega[:4], beta[:4], clean[:4]) == 0.0
    assert likelihood_gain(off, omega, beta, 0.0 * clean) == 0.0  # a load cell that is not connected


def test_a_signal_without_steady_holds_is_mapped_through_a_lag():
    log = stand(hold=0.3)
    found = fitted_map("log.csv", log["Time (s)"], log["ESC (us)"], log["RPM"], None, RANGES["PWM"])
    assert "with a lag of 0.12 s" in found.origin
    x = np.linspace(150.0, 900.0, 50)
    np.testing.assert_allclose(found.map.omega_ref(1000.0 + x), 200.0 + 9.5 * x - 0.0025 * x**2, atol=10.0)
    with pytest.raises(BadInput, match="of the speed"):
        fitted_map("log.csv", log["Time (s)"], log["ESC (us)"], log["RPM"][::-1], None, RANGES["PWM"])


def test_steps_are_cut_at_moves_without_sharing_a_row(tmp_path, vpp):
    t = truth()
    step = np.repeat([3000.0, 4000.0, 3000.0, 5000.0], 100)
    path = table(tmp_path / "log.csv", {n: t[n] for n in PLAIN} | {"omega_ref": step, "beta_ref": np.full(400, 3.0)})
    words = ("--map", "time=time:s", "omega_ref=omega_ref:rpm", "beta_ref=beta_ref:deg", "thrust=thrust:N")
    vpp(path, *words, "-o", tmp_path / "mine", "--as", "steps")
    runs = read_steps(tmp_path / "mine" / "steps.csv")
    assert [set(r["omega_ref"]) for r in runs] == [{3000.0, 4000.0}, {4000.0, 3000.0}, {3000.0, 5000.0}]
    thrust = np.concatenate([r["thrust"] for r in runs])
    assert len(np.unique(thrust)) == len(thrust)
    assert [int(np.argmax(r["omega_ref"] != r["omega_ref"][0])) for r in runs] == [20, 20, 20]


def test_a_clock_that_restarts_separates_the_runs(tmp_path, vpp, refused):
    t = truth()
    columns = {n: t[n] for n in PLAIN} | {
        "time": np.tile(t["time"][:100], 4),
        "omega_ref": np.tile(np.repeat([3000.0, 4000.0], 50), 4),
        "beta_ref": np.full(400, 3.0),
    }
    words = ("--map", "time=time:s", "omega_ref=omega_ref:rpm", "beta_ref=beta_ref:deg", "thrust=thrust:N")
    path = table(tmp_path / "log.csv", columns)
    out = vpp(path, *words, "-o", tmp_path / "mine", "--as", "steps")
    assert "begins anew 3 times" in out
    assert [len(r) for r in read_steps(tmp_path / "mine" / "steps.csv")] == [100] * 4
    refused(path, *words, "-o", tmp_path / "other")


def test_steady_points_come_from_a_table_or_from_a_record(tmp_path, vpp):
    rng = np.random.default_rng(1)
    omega, beta = (g.ravel() for g in np.meshgrid(np.linspace(2000.0, 6000.0, 6), np.linspace(-4.0, 8.0, 5)))
    w, b = omega / 6000.0, (beta + 5.0) / 15.0
    thrust = 15.0 * (0.4 * w**2 + 0.5 * w**2 * b) + rng.normal(0.0, 0.02, len(w))
    path = table(tmp_path / "points.csv", {"rpm": omega, "pitch (deg)": beta, "T (N)": thrust}, ";")
    words = ("--map", "omega=rpm:rpm", "beta_ref=pitch:deg", "thrust=T:N")
    out = vpp(path, *words, "-o", tmp_path / "mine", "--as", "static")
    assert "30 points" in out
    static = read_static(tmp_path / "mine" / "static.csv")
    np.testing.assert_allclose(static.thrust, thrust, rtol=1e-8)
    np.testing.assert_allclose(static.omega_ref, omega)
    assert static.thrust_std[0] == pytest.approx(0.02, rel=0.4)
    t = truth()
    text(PLAIN)(tmp_path / "log.csv", t)
    words = ("--map", *(f"{n}={n}:{u}" for n, u in (("time", "s"), ("omega_ref", "rpm"), ("beta_ref", "deg"), ("thrust", "N"))))
    vpp(tmp_path / "log.csv", *words, "-o", tmp_path / "other", "--as", "static")
    static = read_static(tmp_path / "other" / "static.csv")
    means = [t["thrust"][25 * k + 13 : 25 * k + 25].mean() for k in range(16)]  # the second half of each hold of 0.25 s
    np.testing.assert_allclose(static.thrust, means, rtol=1e-6)


def test_a_repeat_takes_the_open_loops_times_within_half_a_row(tmp_path, vpp, refused):
    t, rng = truth(), np.random.default_rng(2)
    words = ("--map", *(f"{n}={n}:{u}" for n, u in (("time", "s"), ("omega_ref", "rpm"), ("beta_ref", "deg"), ("thrust", "N"))))
    jittered = t | {"time": t["time"] + np.append(0.0, rng.uniform(-0.003, 0.003, 399)), "thrust": t["thrust"][::-1]}
    for name, columns in (("a", t), ("b", jittered), ("c", t | {"omega_ref": t["omega_ref"][::-1]})):
        table(tmp_path / f"{name}.csv", columns)
    vpp(tmp_path / "a.csv", *words, "-o", tmp_path / "mine")
    out = vpp(tmp_path / "b.csv", *words, "-o", tmp_path / "mine", "--as", "repeat")
    assert "that of open_loop.csv" in out
    assert read_campaign(tmp_path / "mine").repeat is not None
    err = refused(tmp_path / "c.csv", *words, "-o", tmp_path / "mine", "--as", "repeat", "--replace")
    assert "omega_ref, row 1 of the data" in err


def test_values_out_of_range_are_refused_with_their_column(tmp_path, refused):
    t = truth()
    path = table(tmp_path / "log.csv", t | {"omega": 1e4 * t["omega"]})
    words = ("--map", "time=time:s", "omega_ref=omega_ref:rpm", "omega=omega:Hz", "thrust=thrust:N")
    err = refused(path, *words, "-o", tmp_path / "out")
    assert "omega, column omega in Hz" in err
    assert "Try: another unit" in err


def test_a_pitch_that_moves_without_a_command_is_not_taken_for_fixed(tmp_path, vpp, refused):
    t = truth()
    path = table(tmp_path / "log.csv", t)
    words = ["--map", "time=time:s", "omega_ref=omega_ref:rpm", "beta=beta_ref:deg", "thrust=thrust:N"]
    assert "a measured pitch from" in refused(path, *words, "-o", tmp_path / "out")
    assert "Try: --map 'beta_ref=beta_ref:deg' beta=- if its command was not logged" in refused(path, *words)
    vpp(path, *words, "--fixed", "beta_ref=0.1:rad", "-o", tmp_path / "out")
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["beta_ref"], np.degrees(0.1), rtol=1e-8)


def test_steady_points_may_have_measured_speed_and_pitch_alone(tmp_path, vpp):
    columns = {"RPM [rpm]": [3000.0, 4000.0, 5000.0], "Pitch angle [deg]": [-2.0, 3.0, 8.0], "Thrust [N]": [1.0, 4.0, 9.0]}
    path = table(tmp_path / "points.csv", columns | {"Thrust std [N]": [0.05, 0.06, 0.07]})
    vpp(path, "--as", "static", "-o", tmp_path / "out")
    static = read_static(tmp_path / "out" / "static.csv")
    for found, wanted in zip((static.omega_ref, static.beta_ref, static.thrust), columns.values(), strict=True):
        np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(static.thrust_std, [0.05, 0.06, 0.07])


def test_a_servo_angle_is_the_pitch_command_and_a_constant_body_pitch_is_not(tmp_path, vpp, refused):
    t = truth()
    columns = {"t [s]": t["time"], "speed cmd [rpm]": t["omega_ref"], "Fz [N]": t["thrust"]}
    vpp(table(tmp_path / "log.csv", columns | {"servo_deg": t["beta_ref"]}), "-o", tmp_path / "a")
    np.testing.assert_allclose(read_record(tmp_path / "a" / "open_loop.csv")["beta_ref"], t["beta_ref"], atol=1e-12)
    body = np.full(len(t["time"]), 0.5)
    path = table(tmp_path / "body.csv", columns | {"body_pitch_deg": body, "xi_deg": t["beta_ref"]})
    err = refused(path, "-o", tmp_path / "b")
    assert "found xi_deg, an angle that moves" in err


# Messages about the rows


def test_rows_that_are_averages_are_detected_from_the_commands():
    fine = stand(rows=30000, step=0.01, hold=2.003)
    rows = {n: np.array([part.mean() for part in np.array_split(c, 2400)]) for n, c in fine.items()}
    record = Record(
        {
            "time": rows["Time (s)"],
            "omega_ref": 5.0 * rows["ESC (us)"],
            "beta_ref": np.zeros(2400),
            "thrust": rows["Thrust (gf)"],
        },
        "x",
    )
    through, moves = between(record)
    assert through > 0.8 * moves
    assert any(line.startswith("averages: in ") for line in said_of_rows(record))
    sampled = {n: c[::12] for n, c in fine.items()}
    record = Record(
        {
            "time": sampled["Time (s)"],
            "omega_ref": 5.0 * sampled["ESC (us)"],
            "beta_ref": np.zeros(2500),
            "thrust": sampled["Thrust (gf)"],
        },
        "x",
    )
    assert between(record)[0] == 0
    said = said_of_rows(record)
    assert [line.split(":")[0] for line in said] == ["slow sampling"]
    assert "120 ms" in said[0]


def test_a_gap_is_reported_and_fast_sampling_is_not():
    log = stand()
    columns = {
        "time": log["Time (s)"],
        "omega_ref": 5.0 * log["ESC (us)"],
        "beta_ref": np.zeros(6000),
        "thrust": log["Thrust (gf)"],
    }
    assert said_of_rows(Record(columns, "x")) == said_of_gaps(Record(columns, "x")) == []
    kept = np.ones(6000, bool)
    kept[3000:3025] = False
    gapped = Record(columns, "x").part(kept)
    assert said_of_gaps(gapped) == ["gaps: 1 steps of more than 4 rows of 10 ms, the longest of 0.26 s at 29.99 s"]


def test_frozen_and_clipped_channels_are_reported_at_import(tmp_path, vpp):
    log = stand()
    log["Thrust (gf)"] = np.minimum(log["Thrust (gf)"], 600.0)
    log["RPM"] = np.where(np.arange(6000) > 4000, log["RPM"][4000], log["RPM"])
    log["Vbat (V)"] = np.full(6000, np.nan)
    out = vpp(table(tmp_path / "log.csv", log), "-o", tmp_path / "mine")
    assert "warning clipped: log.csv, thrust: " in out
    assert "warning frozen: log.csv, omega: " in out
    assert "voltage: no value in any row, left out" in out


def test_the_comparison_of_the_zoo_detects_a_changed_value(tmp_path, capsys):

    def run(words):
        code = main(words)
        return code, *capsys.readouterr()

    def off(path, t):
        text()(path, t | {"thrust": t["thrust"] + 1e-4})

    for name, write in (("right", text()), ("off", off)):
        (tmp_path / name).mkdir()
        good, told = came_out(Format(name, "log.csv", write), tmp_path / name, run)
        assert good == (name == "right"), told


# From a foreign log to a report in two commands

LAGS = {"tau_omega_1": 0.15, "tau_omega_2": 0.05, "tau_beta_1": 0.3, "tau_beta_2": 0.1}
RIG = replace(SIZES["15 N"], row=0.005, hold=(0.8, 1.6), section=8.0, noise=0.1, values=LAGS)


def test_a_german_log_is_imported_and_diagnosed(tmp_path, vpp):
    rng = np.random.default_rng(4)
    record, path = RIG.record(RIG.orders(rng), rng, "rig"), tmp_path / "Messung.csv"
    factors = {"omega_ref": np.pi / 30.0, "beta_ref": 1.0, "omega": np.pi / 30.0, "thrust": 1e3 / 9.80665}
    lines = ["Prüfstand Süd;Protokoll 17", "", "Zeitstempel;Soll-Drehzahl;Soll-Pitch;Drehzahl;Schub", "ms;rad/s;°;rad/s;gf"]
    for k, time in enumerate(record.time):
        cells = [f"{1717236000123 + round(1e3 * time)}", *(f"{f * record[n][k]:.6f}" for n, f in factors.items())]
        lines.append(";".join(cells).replace(".", ","))
    path.write_bytes("\r\n".join(lines).encode("cp1252"))
    out = vpp(path, "-o", tmp_path / "mine", "--as", "open_loop")
    assert "error" not in out
    assert main(["diagnose", str(tmp_path / "mine"), "-o", str(tmp_path / "out"), "--workers", "1"]) == 0
    assert "<figure>" in (tmp_path / "out" / "report.html").read_text()
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert found["verdict"] == "none"
    fitted = json.loads((tmp_path / "out" / "parameters.json").read_text())["parameters"]
    lag = fitted["tau_omega_1"]["value"] + fitted["tau_omega_2"]["value"]
    assert lag == pytest.approx(0.2, rel=0.05)


def test_a_log_of_fixed_pitch_is_imported_and_diagnosed(tmp_path, vpp):
    path = table(tmp_path / "log.csv", stand(rows=3000))
    vpp(path, "-o", tmp_path / "mine")
    words = ["--workers", "1", "--effects", "speed_delay"]
    assert main(["diagnose", str(tmp_path / "mine"), "-o", str(tmp_path / "out"), *words]) == 0
    fitted = json.loads((tmp_path / "out" / "parameters_base.json").read_text())["parameters"]
    assert fitted["tau_omega_1"]["value"] + fitted["tau_omega_2"]["value"] == pytest.approx(0.12, rel=0.05)
    assert "<figure>" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize("late", [False, True])
def test_a_command_logged_one_row_late_is_reported(late):
    """Behind one lag of 0.2 s the speed goes 1 - exp(-0.04 / 0.2) = 18 % of a move in a row of 40 ms."""
    rng, rows = np.random.default_rng(2), 1500
    command = np.repeat(np.round(rng.uniform(2000.0, 6000.0, rows // 10)), 10)
    speed = lagged(command, 0.04, 0.2)
    told = np.append(command[0], command[:-1]) if late else command
    columns = {"time": 0.04 * np.arange(rows), "omega_ref": told, "beta_ref": np.zeros(rows)}
    columns |= {"omega": speed + rng.normal(0.0, 5.0, rows), "thrust": 10.0 * (speed / 6000.0) ** 2}
    said = [line for line in said_of_rows(Record(columns, "log")) if line.startswith("clock")]
    assert bool(said) == late
    assert all("gone 18 ± " in line for line in said)
