"""Import of foreign logs into a campaign: clock, commands, messages, and protection of existing files."""

import numpy as np
import pytest
from import_zoo import OWN, T, stand, table

from identification.logs.clock import guessed_unit, mended
from identification.logs.mapping import read_sections
from vpp_fmu.campaign import read_campaign, read_static, read_steps
from vpp_fmu.record import read_record

FIRST_WORDS = ("import", "csv")

# Clocks


def test_rows_out_of_order_are_interpolated_between_their_neighbours():
    fixed, count, furthest = mended(np.array([0.0, 1.0, 2.0, 1.9, 4.0, 5.0]))
    np.testing.assert_allclose(fixed, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    assert (count, furthest) == (1, pytest.approx(0.1))
    for end in ([0.0, 1.0, 2.0, 1.5], [0.0, -0.4, 1.0, 2.0], [0.0, 1.0, 0.5, 0.2, 0.1, 5.0]):
        assert np.all(np.diff(mended(np.array(end))[0]) > 0.0)


def test_the_unit_of_time_is_guessed_where_only_one_is_plausible():
    plausible = {(1717236000.1, 1717236000.2): "s", (1717236000123.0, 1717236000133.0): "ms", (0.0, 0.01): "s"}
    plausible |= {(0.0, 10.0): "ms", (0.0, 4000.0): "us", (0.0, 1.0): None, (0.0,): None}
    assert {values: guessed_unit(np.array(values)) for values in plausible} == plausible


# Into the campaign


def test_the_file_of_another_log_is_not_overwritten_and_the_mapping_keeps_its_sections(tmp_path, printed, refused):
    first, second = table(tmp_path / "a.csv", stand()), table(tmp_path / "b.csv", stand(seed=6))
    printed(first, "-o", tmp_path / "mine")
    before = (tmp_path / "mine" / "open_loop.csv").read_bytes()
    assert "open_loop.csv: file: found the file of another log" in refused(second, "-o", tmp_path / "mine")
    assert (tmp_path / "mine" / "open_loop.csv").read_bytes() == before
    assert not [p for p in (tmp_path / "mine").iterdir() if p.name.startswith(".")]
    assert "taken over from a.csv" in printed(second, "-o", tmp_path / "mine", "--as", "validation")
    assert set(read_sections(tmp_path / "mine" / "import.toml")) == {"open_loop", "validation"}
    printed(second, "-o", tmp_path / "mine", "--replace")
    assert (tmp_path / "mine" / "open_loop.csv").read_bytes() != before


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


@pytest.fixture
def log(tmp_path):
    """Write the data with columns changed; the words that import it."""
    return lambda **columns: (table(tmp_path / "log.csv", {**T, **columns}), *OWN, "-o", tmp_path / "mine")


def test_steps_are_cut_at_moves_without_sharing_a_row(tmp_path, log, printed):
    step = np.repeat([3000.0, 4000.0, 3000.0, 5000.0], 100)
    printed(*log(omega_ref=step, beta_ref=np.full(400, 3.0)), "--as", "steps")
    runs = read_steps(tmp_path / "mine" / "steps.csv")
    assert [set(r["omega_ref"]) for r in runs] == [{3000.0, 4000.0}, {4000.0, 3000.0}, {3000.0, 5000.0}]
    thrust = np.concatenate([r["thrust"] for r in runs])
    assert len(np.unique(thrust)) == len(thrust)
    assert [int(np.argmax(r["omega_ref"] != r["omega_ref"][0])) for r in runs] == [20, 20, 20]


def test_a_clock_that_restarts_separates_the_runs(tmp_path, log, printed):
    speed = np.tile(np.repeat([3000.0, 4000.0], 50), 4)
    words = log(time=np.tile(T["time"][:100], 4), omega_ref=speed, beta_ref=np.full(400, 3.0))
    assert "begins anew 3 times" in printed(*words, "--as", "steps")
    assert [len(r) for r in read_steps(tmp_path / "mine" / "steps.csv")] == [100] * 4


def test_steady_points_come_from_a_table_or_from_a_record(tmp_path, log, printed):
    rng = np.random.default_rng(1)
    omega, beta = (g.ravel() for g in np.meshgrid(np.linspace(2000.0, 6000.0, 6), np.linspace(-4.0, 8.0, 5)))
    w, b = omega / 6000.0, (beta + 5.0) / 15.0
    thrust = 15.0 * (0.4 * w**2 + 0.5 * w**2 * b) + rng.normal(0.0, 0.02, len(w))
    path = table(tmp_path / "points.csv", {"rpm": omega, "pitch (deg)": beta, "T (N)": thrust}, ";")
    assert "30 points" in printed(path, "-o", tmp_path / "points", "--as", "static")  # measured speed and pitch alone
    static = read_static(tmp_path / "points" / "static.csv")
    for found, wanted in ((static.thrust, thrust), (static.omega_ref, omega), (static.beta_ref, beta)):
        np.testing.assert_allclose(found, wanted, rtol=1e-8)
    assert static.thrust_std[0] == pytest.approx(0.02, rel=0.4)
    columns = {
        "RPM": [3000.0, 4000.0],
        "Pitch angle [deg]": [-2.0, 3.0],
        "Thrust [N]": [1.0, 4.0],
        "Thrust std [N]": [0.05, 0.06],
    }
    printed(table(tmp_path / "spread.csv", columns), "--as", "static", "-o", tmp_path / "spread")
    np.testing.assert_array_equal(read_static(tmp_path / "spread" / "static.csv").thrust_std, [0.05, 0.06])
    printed(*log(), "--as", "static")
    means = [T["thrust"][25 * k + 13 : 25 * k + 25].mean() for k in range(16)]  # the second half of each hold of 0.25 s
    np.testing.assert_allclose(read_static(tmp_path / "mine" / "static.csv").thrust, means, rtol=1e-6)


def test_a_repeat_takes_the_open_loops_times_within_half_a_row(tmp_path, log, printed, refused):
    printed(*log())
    jittered = T["time"] + np.append(0.0, np.random.default_rng(2).uniform(-0.003, 0.003, 399))
    assert "that of open_loop.csv" in printed(*log(time=jittered, thrust=T["thrust"][::-1]), "--as", "repeat")
    assert read_campaign(tmp_path / "mine").repeat is not None
    assert "omega_ref, row 1 of the data" in refused(*log(omega_ref=T["omega_ref"][::-1]), "--as", "repeat", "--replace")


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
