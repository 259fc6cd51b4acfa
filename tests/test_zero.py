"""The load cell's zero: its rests, and a zero that drifts or jumps, against a thrust law written by hand."""

import numpy as np
import pytest
from import_zoo import lagged

from identification.gate.gate import look
from identification.gate.zero import levelled, moved, rests, tare
from vpp_fmu.campaign import Campaign
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig

STEP, NOISE = 0.02, 0.04
LEVELS = (0, 3000, 5000, 4000, 0, 4500, 2500, 5500, 3500, 0)
"""rpm, each held for 5 s: rest before, between and after runs."""


def log(seed: int, added=lambda time: 0.0 * time, measured: bool = True) -> tuple[Record, np.ndarray]:
    """(a record of thrust 12 N (w / 5500)^2 behind a lag of 0.15 s, with `added` [N]; its thrust without that)."""
    rng = np.random.default_rng(seed)
    command = np.repeat(np.array(LEVELS, float), 250)
    speed = lagged(command, STEP, 0.15)
    speed = np.where(speed < 20.0, 0.0, speed)
    time, thrust = STEP * np.arange(len(command)), 12.0 * (speed / 5500.0) ** 2 + rng.normal(0.0, NOISE, len(command))
    columns = {"time": time, "omega_ref": command, "beta_ref": np.zeros(len(command)), "thrust": thrust + added(time)}
    shown = {"omega": np.where(speed > 0.0, speed + rng.normal(0.0, 5.0, len(speed)), 0.0)} if measured else {}
    return Record(columns | shown, "log.csv"), thrust


def codes(record: Record) -> list[str]:
    campaign = Campaign(".", None, (), record, None, None, rig=infer_rig([record], None, {}))
    return [f.code for f in look(campaign).findings if f.code in ("tare", "zero_drift", "zero_jump")]


@pytest.mark.parametrize("measured", [True, False])
def test_a_zero_that_stays_is_one_tare_of_all_rests(measured):
    for seed in range(3):
        record, _ = log(seed, lambda time: 0.0 * time + 0.02, measured)
        assert len(rests(record)) == 3
        assert moved(record) is None
        assert codes(record) == []
        zero = tare(record)
        assert zero.readings == sum(rest.readings for rest in rests(record))
        assert zero.mean == pytest.approx(0.02, abs=5.0 * NOISE / np.sqrt(zero.readings))
        np.testing.assert_array_equal(levelled(record)[0]["thrust"], record["thrust"])


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize(("jump", "at"), [(1.2, 31.0), (-0.6, 12.5), (0.5, 44.0)])
def test_a_jump_is_found_at_its_row_and_taken_off(jump, at, measured):
    for seed in range(3):
        record, thrust = log(seed, lambda time: np.where(time >= at, jump, 0.0), measured)
        assert codes(record) == ["zero_jump"]
        move = moved(record)
        assert record.time[move.jump] == pytest.approx(at, abs=2 * STEP)
        kept, said = levelled(record)
        assert f"at {record.time[move.jump]:.2f} s" in said[0]
        away = np.abs(np.arange(len(record)) - round(at / STEP)) > 2
        error = (kept["thrust"] - thrust)[away]
        readings = min(rest.readings for rest in rests(record))
        assert np.abs(error).max() < 5.0 * NOISE * np.sqrt(2.0 / readings)
        assert codes(kept) == []


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize(
    "drift",
    [lambda t: 0.02 * t, lambda t: -0.012 * t, lambda t: 0.6 * (1 - np.exp(-t / 10)), lambda t: 0.9 * (1 - np.exp(-t / 4))],
)
def test_a_drift_is_a_warning_and_changes_nothing(drift, measured):
    for seed in range(3):
        record, _ = log(seed, drift, measured)
        assert codes(record) == ["zero_drift"]
        move = moved(record)
        assert move.jump is None
        first, last = (
            drift(record.time[(record.time >= r.begin) & (record.time <= r.end)]).mean() for r in (move.first, move.last)
        )
        expected = pytest.approx(last - first, abs=6.0 * NOISE / np.sqrt(move.last.readings))
        assert move.last.mean - move.first.mean == expected
        assert levelled(record) == (record, [])


def test_rests_that_differ_on_one_side_of_a_jump_are_no_jump():
    """A cell that sticks: three rests, three zeros, of which no step makes one."""
    record, _ = log(1, lambda time: np.select([time < 8.0, time < 30.0], [0.0, 1.0], -0.8))
    assert codes(record) == ["zero_drift"]
    assert levelled(record) == (record, [])
