"""Speed sensors and loggers of the loggers study against closed forms, and the study's handling of cases."""

import json
from argparse import ArgumentParser

import numpy as np
import pytest
from builders import two_lags

from tests.studies import command_sequences, loggers, rows
from tests.studies.detectable import LIMIT
from tests.studies.loggers import Case
from tests.studies.physics import PAPER
from tests.studies.sensors import FINE, TIMER, Encoder, LoggedRig, Logger, Mark, Motion, Telemetry

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


def stepped(rate, lag=0.0, span=0.0):
    """Readings of a step from 0.5 to 0.9 of full speed, sent at 0.4 s; the rows' times [s] after the step."""
    rows = round(2.4 * rate)
    w = np.where(np.arange(rows) < 0.4 * rate, 0.5, 0.9)
    read = LoggedRig(PAPER, rate=rate, logger=Logger(lag, span)).read(np.random.default_rng(3), (w, w))
    return read, np.arange(rows) / rate - 0.4


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
