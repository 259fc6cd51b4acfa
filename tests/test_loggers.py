"""Speed sensors and loggers of the loggers study against closed forms, and the study's handling of cases."""

import json
from argparse import ArgumentParser

import numpy as np
import pytest
from builders import two_lags

from tests.studies import command_sequences, loggers, rows
from tests.studies.detectable import LIMIT, evidence
from tests.studies.loggers import Case
from tests.studies.physics import BASE, PAPER
from tests.studies.sensors import FINE, TIMER, Encoder, LoggedRig, Logger, Mark, Motion, Telemetry
from vpp_fmu.kernel.plant import BASE as MODEL
from vpp_fmu.native import Simulator

START, SLOPE = 2400.0, 1800.0
"""rpm and rpm/s of a rotor with constant acceleration."""

RNG = np.random.default_rng(0)


def speeding_up(seconds=1.5):
    """Constant acceleration from 1 s before 0 on: speed and turns in closed form."""
    time = np.arange(-1.0, seconds, FINE)
    return Motion(time, START + SLOPE * time, (START * time + 0.5 * SLOPE * time**2) / 60.0)


@pytest.mark.parametrize("marks", [1, 2, 3, 4])
def test_marks_show_the_mean_speed_over_the_last_part_of_a_revolution(marks):
    at = np.arange(0.0, 1.4, 0.0037)
    shown, age = Mark(marks).shows(RNG, speeding_up(), at)
    turned = (START * at + 0.5 * SLOPE * at**2) / 60.0
    pulse = np.floor(marks * turned)[:, None] - [0, 1]  # the last two, and when they came, by the quadratic formula
    came, before = ((np.sqrt(START**2 + 120.0 * SLOPE * pulse / marks) - START) / SLOPE).T
    wanted = 60.0 / (marks * (came - before))
    assert np.all(np.abs(shown - wanted) < 0.5 + 1.01 * wanted * TIMER / (came - before))
    assert age == pytest.approx(at - 0.5 * (came + before), abs=1e-6)


def test_telemetry_is_a_first_order_filter_whose_value_is_held():
    sensor, at = Telemetry(0.03, 0.04), np.arange(0.5, 1.3, 0.001)
    shown, age = sensor.shows(np.random.default_rng(1), speeding_up(), at)
    # Behind a first-order filter a ramp is late by the time constant.
    assert np.all(np.abs(shown - (START + SLOPE * (at - age))) < 0.51)
    news = np.flatnonzero(np.diff(shown))
    assert set(np.diff(news)) == {40}
    assert 0.03 <= age.min() < 0.0311
    assert 0.0689 < age.max() < 0.07


def stepped(rate, lag=0.0, span=0.0):
    """Readings of a step from 0.5 to 0.9 of full speed, sent at 0.4 s; the rows' times [s] after the step."""
    rows = round(2.4 * rate)
    w = np.where(np.arange(rows) < 0.4 * rate, 0.5, 0.9)
    read = LoggedRig(PAPER, rate=rate, logger=Logger(lag, span)).read(np.random.default_rng(3), (w, w))
    return read, np.arange(rows) / rate - 0.4


def integral(t):
    """Integral [s] of the unit step response of the speed."""
    a, c = PAPER["tau_w1"], PAPER["tau_w2"]
    t = np.maximum(t, 0.0)
    return t - (a + c) + (a**2 * np.exp(-t / a) - c**2 * np.exp(-t / c)) / (a - c)


def answer(t):
    """Speed [rpm] at times [s] after the step."""
    return 6000.0 * (0.5 + 0.4 * two_lags(t, PAPER["tau_w1"], PAPER["tau_w2"]))


@pytest.mark.parametrize("lag", [0.0, -0.5, -1.3, -2.0, 0.5, 2.0])
def test_the_offset_of_rows_is_that_of_speed_and_thrust(lag):
    read, t = stepped(50.0, lag)
    assert read.omega == pytest.approx(answer(t - lag * 0.02), abs=2.0)  # a digit, and steps of 0.1 ms at 8 rpm/ms
    same, _ = stepped(50.0)
    shift = int(lag)
    if lag == shift:  # whole rows: the same readings beside other commands
        assert read.force[2:-2] == pytest.approx(same.force[2 - shift : len(t) - 2 - shift], abs=1e-9)
    assert np.array_equal(read.speed, same.speed)


def test_readings_are_means_over_the_row():
    read, t = stepped(25.0, -0.5, 1.0)
    mean = 3000.0 + 2400.0 * (integral(t + 0.04) - integral(t)) / 0.04
    assert read.omega == pytest.approx(mean, abs=2.0)
    assert np.abs(answer(t + 0.02) - mean).max() > 8.0  # which the speed in the row's middle is not


@pytest.mark.parametrize(
    ("sensor", "rate", "delay"),
    [
        (Encoder(), 100.0, 0.0),
        (Telemetry(0.03, 0.04), 1000.0, 0.0305),  # a new value is seen within a row of 1 ms
        (Telemetry(0.02, 0.0071), 25.0, 0.02355),  # values come every 7.1 ms, at any time within a row
    ],
)
def test_a_speed_is_behind_its_thrust_by_filter_and_hold(sensor, rate, delay):
    clock = command_sequences.Clock(1.0 / rate, 1.0)
    w = command_sequences.levels(np.random.default_rng(4), clock, round(60.0 * rate), *command_sequences.SPEED)
    rig = LoggedRig(PAPER, rate=rate, sensor=sensor)
    assert rig.read(np.random.default_rng(5), (w, np.full(len(w), 0.5))).delay == pytest.approx(delay, abs=3e-4)


def test_nuisance_parameters_of_the_logger_explain_its_delays_alone():
    def nats(settings, **nuisances):
        rig = LoggedRig(PAPER | settings, rate=100.0)
        sent = rig.size.commands(*command_sequences.open_loop(np.random.default_rng(6), rig.clock, 20.0))
        return evidence(rig, {n: PAPER[n] for n in BASE}, *sent, **nuisances)

    late = {"reading_delay": 0.01, "speed_late": 0.01}
    alone, free = nats(late), nats(late, sensor_filter=0.02)
    assert alone > LIMIT
    assert free < 0.05 * alone
    band = {"deadband": 0.1}
    alone, free = nats(band), nats(band, sensor_filter=0.0)
    assert 0.5 * alone < free < alone


@pytest.mark.parametrize("number", range(4))
def test_the_hold_out_record_is_the_true_model_read_by_the_true_logger(number):
    case = Case("nothing", 1, number)
    rig, (record, delay), fine = case.rig, case.unseen(), 0.001
    many = round(1.0 / rig.rate / fine)
    columns = {n: np.repeat(record[n], many) for n in ("omega_ref", "beta_ref")} | {
        "time": fine * np.arange(many * len(record))
    }
    thrust, omega, _ = Simulator(MODEL).simulate(rig.truth(), columns, np.full(many * len(record) - 1, fine)).T
    at = rig.logger.times(len(record), 1.0 / rig.rate)
    known = at[:, -1] < columns["time"][-1]
    force, speed = (np.interp(t, columns["time"], y).mean(axis=1) for t, y in ((at, thrust), (at - delay, omega)))
    assert np.std((force - record["thrust"])[known]) < 0.03 * rig.noise.std
    new = known & (np.diff(record["omega"], prepend=0.0) != 0.0)
    rate = np.gradient(speed)[new] * rig.rate
    assert abs(np.polyfit(rate, (record["omega"] - speed)[new], 1)[0]) < 0.003  # s; a held value's age depends on speed


def judged(case, **change):
    """A line as `outcome` makes it."""
    found = {"failed": None, "verdict": "none", "effects": [], "family": {}, "seconds": 4.0, "over_noise": 1.01}
    return case.summary() | found | {"evidence": 50.0, "lag_off": -0.5, "delay_off": 2.0} | change


@pytest.mark.parametrize(
    ("change", "counts"),
    [
        ({"verdict": "attributed", "effects": ["sensor_drift", "x"]}, (0, 0, 0, 1, 0, 0)),
        ({"verdict": "attributed", "effects": ["sensor_drift"]}, (0, 0, 1, 0, 0, 0)),
        ({"verdict": "attributed", "effects": ["sensor_drift", "inflow_lag"]}, (1, 0, 0, 0, 0, 0)),
        ({"verdict": "family", "effects": ["sensor_drift", "x"], "family": {"x": ["inflow_lag"]}}, (1, 0, 0, 0, 0, 0)),
        ({"verdict": "partly", "effects": ["sensor_drift"]}, (0, 1, 0, 0, 0, 0)),
        ({"verdict": "attributed", "effects": ["x"]}, (0, 0, 0, 1, 0, 0)),
        ({"verdict": "learned", "effects": ["learned"]}, (0, 0, 0, 0, 1, 0)),
        ({}, (0, 0, 0, 0, 0, 1)),
    ],
)
def test_outcomes_of_a_pair(change, counts):
    case = Case("pairs", 0, 1)
    assert case.hidden == ("sensor_drift", "inflow_lag")
    assert tuple(int(column.test(judged(case, **change))) for column in loggers.COLUMNS["pairs"][:-1]) == counts
    assert "pairs: both: no cases" in loggers.table("pairs", [judged(case, **change, evidence=LIMIT - 1.0)])


def test_an_interrupted_study_continues(tmp_path, monkeypatch, capsys):
    asked = []

    def faked(work, case, limit):
        asked.append(case.number)
        return judged(case)

    monkeypatch.setattr(rows, "apart", faked)
    path = tmp_path / "some" / "lines.jsonl"
    for options in (["--seeds", "2"], ["--seeds", "5"], ["--only", "1"], ["--only-table"]):
        loggers.main(ArgumentParser(), [*options, "--workers", "1", "-o", str(path)])
    assert asked == [0, 1, 2, 3, 4]
    names = [json.loads(text)["name"] for text in path.read_text().splitlines()]  # in the order in which they were done
    assert sorted(names) == [f"nothing 0 {k}" for k in range(5)]
    assert "nothing: names: 0 of 5" in capsys.readouterr().out
