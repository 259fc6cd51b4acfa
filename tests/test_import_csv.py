"""Import of foreign logs into a campaign: clock, commands, messages, and protection of existing files."""

import json

import numpy as np
import pytest
from import_logs import stand, table
from import_zoo import PLAIN, text, truth

from identification.logs.clock import guessed_unit, mended
from identification.logs.mapping import read_sections
from vpp_fmu.app.cli import main
from vpp_fmu.campaign import read_campaign, read_static, read_steps
from vpp_fmu.record import read_record

FIRST_WORDS = ("import", "csv")
WORDS = ("--map", "time=time:s", "omega_ref=omega_ref:rpm", "beta_ref=beta_ref:deg", "thrust=thrust:N")
"""The mapping of a record's own names."""


# Clocks


def test_rows_out_of_order_are_interpolated_between_their_neighbours():
    fixed, count, furthest = mended(np.array([0.0, 1.0, 2.0, 1.9, 4.0, 5.0]))
    np.testing.assert_allclose(fixed, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    assert (count, furthest) == (1, pytest.approx(0.1))
    for end in ([0.0, 1.0, 2.0, 1.5], [0.0, -0.4, 1.0, 2.0], [0.0, 1.0, 0.5, 0.2, 0.1, 5.0]):
        assert np.all(np.diff(mended(np.array(end))[0]) > 0.0)


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


def test_the_file_of_another_log_is_not_overwritten_and_the_mapping_keeps_its_sections(tmp_path, printed, refused):
    first, second = table(tmp_path / "a.csv", stand()), table(tmp_path / "b.csv", stand(seed=6))
    printed(first, "-o", tmp_path / "mine")
    before = (tmp_path / "mine" / "open_loop.csv").read_bytes()
    err = refused(second, "-o", tmp_path / "mine")
    assert "open_loop.csv: file: found the file of another log" in err
    assert (tmp_path / "mine" / "open_loop.csv").read_bytes() == before
    assert not [p for p in (tmp_path / "mine").iterdir() if p.name.startswith(".")]
    out = printed(second, "-o", tmp_path / "mine", "--as", "validation")
    assert "taken over from a.csv" in out
    assert set(read_sections(tmp_path / "mine" / "import.toml")) == {"open_loop", "validation"}
    printed(second, "-o", tmp_path / "mine", "--replace")
    assert (tmp_path / "mine" / "open_loop.csv").read_bytes() != before
    campaign = read_campaign(tmp_path / "mine")
    assert campaign.open_loop is not None
    assert campaign.validation is not None


def test_the_command_of_a_signal_is_the_parabola_that_the_motor_follows(tmp_path, printed):
    log = stand()
    out = printed(table(tmp_path / "log.csv", log), "-o", tmp_path / "mine")
    assert "without a voltage" in out
    assert "fixed pitch of 0 deg" in out
    record = read_record(tmp_path / "mine" / "open_loop.csv")
    x = log["ESC (us)"] - 1000.0
    np.testing.assert_allclose(record["omega_ref"], 200.0 + 9.5 * x - 0.0025 * x**2, atol=3.0)  # rpm, written in whole ones
    assert not record["beta_ref"].any()


def test_the_measured_speed_may_be_the_command(tmp_path, printed, refused):
    log = stand()
    log["RPM"] = np.where(np.arange(6000) % 1000 == 500, np.nan, log["RPM"])
    path = table(tmp_path / "log.csv", log)
    printed(path, "--speed-from", "measured", "-o", tmp_path / "mine")
    record, there = read_record(tmp_path / "mine" / "open_loop.csv"), np.isfinite(log["RPM"])
    np.testing.assert_array_equal(record["omega_ref"][there], log["RPM"][there])
    holes = np.flatnonzero(~there)  # interpolated
    np.testing.assert_allclose(record["omega_ref"][holes], 0.5 * (log["RPM"][holes - 1] + log["RPM"][holes + 1]))
    assert "omega" not in record
    assert not (tmp_path / "mine" / "speed_map.json").exists()
    refused(path, "--map", "omega=-", "--speed-from", "measured", "-o", tmp_path / "none")
    printed(path, "--map", tmp_path / "mine" / "import.toml", "-o", tmp_path / "again")
    again = read_record(tmp_path / "again" / "open_loop.csv")["omega_ref"]
    np.testing.assert_array_equal(again[there], log["RPM"][there])


def test_a_signal_without_steady_holds_needs_a_map_or_the_measured_speed(tmp_path, refused, printed):
    path = table(tmp_path / "log.csv", stand(hold=0.3))
    said = refused(path, "-o", tmp_path / "out")
    assert "found 0 different ESC signals held for 1 s" in said
    assert "Try: --speed-map M.json of another log, or --speed-from measured" in said
    printed(path, "--speed-from", "measured", "-o", tmp_path / "out")


def test_steps_are_cut_at_moves_without_sharing_a_row(tmp_path, printed):
    t = truth()
    step = np.repeat([3000.0, 4000.0, 3000.0, 5000.0], 100)
    path = table(tmp_path / "log.csv", {n: t[n] for n in PLAIN} | {"omega_ref": step, "beta_ref": np.full(400, 3.0)})
    printed(path, *WORDS, "-o", tmp_path / "mine", "--as", "steps")
    runs = read_steps(tmp_path / "mine" / "steps.csv")
    assert [set(r["omega_ref"]) for r in runs] == [{3000.0, 4000.0}, {4000.0, 3000.0}, {3000.0, 5000.0}]
    thrust = np.concatenate([r["thrust"] for r in runs])
    assert len(np.unique(thrust)) == len(thrust)
    assert [int(np.argmax(r["omega_ref"] != r["omega_ref"][0])) for r in runs] == [20, 20, 20]


def test_a_clock_that_restarts_separates_the_runs(tmp_path, printed, refused):
    t = truth()
    columns = {n: t[n] for n in PLAIN} | {
        "time": np.tile(t["time"][:100], 4),
        "omega_ref": np.tile(np.repeat([3000.0, 4000.0], 50), 4),
        "beta_ref": np.full(400, 3.0),
    }
    path = table(tmp_path / "log.csv", columns)
    out = printed(path, *WORDS, "-o", tmp_path / "mine", "--as", "steps")
    assert "begins anew 3 times" in out
    assert [len(r) for r in read_steps(tmp_path / "mine" / "steps.csv")] == [100] * 4
    refused(path, *WORDS, "-o", tmp_path / "other")


def test_steady_points_come_from_a_table_or_from_a_record(tmp_path, printed):
    rng = np.random.default_rng(1)
    omega, beta = (g.ravel() for g in np.meshgrid(np.linspace(2000.0, 6000.0, 6), np.linspace(-4.0, 8.0, 5)))
    w, b = omega / 6000.0, (beta + 5.0) / 15.0
    thrust = 15.0 * (0.4 * w**2 + 0.5 * w**2 * b) + rng.normal(0.0, 0.02, len(w))
    path = table(tmp_path / "points.csv", {"rpm": omega, "pitch (deg)": beta, "T (N)": thrust}, ";")
    words = ("--map", "omega=rpm:rpm", "beta_ref=pitch:deg", "thrust=T:N")
    out = printed(path, *words, "-o", tmp_path / "mine", "--as", "static")
    assert "30 points" in out
    static = read_static(tmp_path / "mine" / "static.csv")
    np.testing.assert_allclose(static.thrust, thrust, rtol=1e-8)
    np.testing.assert_allclose(static.omega_ref, omega)
    assert static.thrust_std[0] == pytest.approx(0.02, rel=0.4)
    t = truth()
    text(PLAIN)(tmp_path / "log.csv", t)
    printed(tmp_path / "log.csv", *WORDS, "-o", tmp_path / "other", "--as", "static")
    static = read_static(tmp_path / "other" / "static.csv")
    means = [t["thrust"][25 * k + 13 : 25 * k + 25].mean() for k in range(16)]  # the second half of each hold of 0.25 s
    np.testing.assert_allclose(static.thrust, means, rtol=1e-6)


def test_a_repeat_takes_the_open_loops_times_within_half_a_row(tmp_path, printed, refused):
    t, rng = truth(), np.random.default_rng(2)
    jittered = t | {"time": t["time"] + np.append(0.0, rng.uniform(-0.003, 0.003, 399)), "thrust": t["thrust"][::-1]}
    for name, columns in (("a", t), ("b", jittered), ("c", t | {"omega_ref": t["omega_ref"][::-1]})):
        table(tmp_path / f"{name}.csv", columns)
    printed(tmp_path / "a.csv", *WORDS, "-o", tmp_path / "mine")
    out = printed(tmp_path / "b.csv", *WORDS, "-o", tmp_path / "mine", "--as", "repeat")
    assert "that of open_loop.csv" in out
    assert read_campaign(tmp_path / "mine").repeat is not None
    err = refused(tmp_path / "c.csv", *WORDS, "-o", tmp_path / "mine", "--as", "repeat", "--replace")
    assert "omega_ref, row 1 of the data" in err


def test_a_pitch_that_moves_without_a_command_is_not_taken_for_fixed(tmp_path, printed, refused):
    t = truth()
    path = table(tmp_path / "log.csv", t)
    words = ["--map", "time=time:s", "omega_ref=omega_ref:rpm", "beta=beta_ref:deg", "thrust=thrust:N"]
    assert "a measured pitch from" in refused(path, *words, "-o", tmp_path / "out")
    assert "Try: --map 'beta_ref=beta_ref:deg' beta=- if its command was not logged" in refused(path, *words)
    printed(path, *words, "--fixed", "beta_ref=0.1:rad", "-o", tmp_path / "out")
    np.testing.assert_allclose(read_record(tmp_path / "out" / "open_loop.csv")["beta_ref"], np.degrees(0.1), rtol=1e-8)


def test_steady_points_may_have_measured_speed_and_pitch_alone(tmp_path, printed):
    columns = {"RPM [rpm]": [3000.0, 4000.0, 5000.0], "Pitch angle [deg]": [-2.0, 3.0, 8.0], "Thrust [N]": [1.0, 4.0, 9.0]}
    path = table(tmp_path / "points.csv", columns | {"Thrust std [N]": [0.05, 0.06, 0.07]})
    printed(path, "--as", "static", "-o", tmp_path / "out")
    static = read_static(tmp_path / "out" / "static.csv")
    for found, wanted in zip((static.omega_ref, static.beta_ref, static.thrust), columns.values(), strict=True):
        np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(static.thrust_std, [0.05, 0.06, 0.07])


# Messages about the rows


def test_frozen_and_clipped_channels_are_reported_at_import(tmp_path, printed):
    log = stand()
    log["Thrust (gf)"] = np.minimum(log["Thrust (gf)"], 600.0)
    log["RPM"] = np.where(np.arange(6000) > 4000, log["RPM"][4000], log["RPM"])
    log["Vbat (V)"] = np.full(6000, np.nan)
    out = printed(table(tmp_path / "log.csv", log), "-o", tmp_path / "mine")
    assert "warning clipped: log.csv, thrust: " in out
    assert "warning frozen: log.csv, omega: " in out
    assert "voltage: no value in any row, left out" in out


# From a foreign log to a report in two commands


def test_a_log_of_fixed_pitch_is_imported_and_diagnosed(tmp_path, printed):
    path = table(tmp_path / "log.csv", stand(rows=3000))
    printed(path, "-o", tmp_path / "mine")
    words = ["--workers", "1", "--effects", "speed_delay"]
    assert main(["diagnose", str(tmp_path / "mine"), "-o", str(tmp_path / "out"), *words]) == 0
    fitted = json.loads((tmp_path / "out" / "parameters_base.json").read_text())["parameters"]
    assert fitted["tau_omega_1"]["value"] + fitted["tau_omega_2"]["value"] == pytest.approx(0.12, rel=0.05)
    assert "<figure>" in (tmp_path / "out" / "report.html").read_text()
