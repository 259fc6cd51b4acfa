"""The logger and the speed sensor: simulated, estimated, declared, and corrected."""

import json
from copy import copy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from identification import logger_fit
from identification.demo import example_folder
from identification.diagnose import diagnose as diagnosing
from identification.fit.experiment import Experiment
from identification.fit.noise import independent
from identification.fit.tachometer import Tachometer, row_means
from identification.gate.finding import acceptable
from identification.gate.gate import passed
from identification.identify import identify
from identification.logger import Logger
from identification.logger_fit import EVIDENCE, _Delay, _Estimate, _SensorFit, as_logged, mended
from identification.roles import Fitted, roles
from vpp_fmu.campaign import Campaign, read_campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import AVERAGED, BASE, LIBRARY, plant
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig, read_rig
from vpp_fmu.sensors import SpeedSensor

RATE = 50.0


def commands(seed, seconds=24.0, rate=RATE):
    """Random steps of both commands, each held for half a second or longer."""
    rng, count = np.random.default_rng(seed), int(seconds * rate)

    def walk(low, high):
        lengths = rng.integers(int(0.5 * rate), int(2 * rate), count)
        return np.repeat(rng.uniform(low, high, count), lengths)[:count]

    time = np.arange(count) / rate
    return Record({"time": time, "omega_ref": walk(2200.0, 5800.0), "beta_ref": walk(-4.0, 9.0)}, "commands")


def logged(seed, rows, filter_=0.0, noise=0.05, rate=RATE, pitch=None, model=BASE, values=None):
    """A record of a model whose commands act `rows` rows after the readings of their row; speed to 1 rpm. `pitch` [deg] is
    constant if given. `values`: changes of the model's parameters."""
    record = commands(seed, rate=rate)
    if pitch is not None:
        record = record.with_columns(beta_ref=np.full(len(record), pitch))
    fine = 20
    late = record.commands_later(rows)
    columns = {n: np.repeat(late[n], fine) for n in ("omega_ref", "beta_ref")}
    shift = round(late.late * fine)
    columns = {n: np.concatenate([np.repeat(c[:1], shift), c[: len(c) - shift]]) for n, c in columns.items()}
    outputs = Simulator(model).simulate(values or {}, columns, np.full(len(record) * fine - 1, 1.0 / (rate * fine)))
    omega = outputs[:, 1]
    if filter_:
        kept, speed = np.exp(-1.0 / (rate * fine * filter_)), omega.copy()
        for k in range(1, len(omega)):
            speed[k] = omega[k] + (speed[k - 1] - omega[k]) * kept
        omega = speed
    thrust = outputs[::fine, 0] + np.random.default_rng(seed + 1).normal(0.0, noise, len(record))
    return record.with_columns(omega=np.round(omega[::fine]), thrust=thrust)


def campaign(record, declared=None):
    return Campaign(Path("."), None, (), record, None, None, rig=infer_rig([record], None, declared or {}))


@pytest.mark.parametrize("rows", [0.3, 1.7, 2.0])
def test_late_commands_are_commands_with_a_dead_time(rows):
    """The kernel's exact delay of both commands gives the same outputs."""
    record, delayed = commands(0), plant(("speed_delay", "pitch_delay"))
    delays = dict.fromkeys(("speed_delay.delay", "pitch_delay.delay"), rows / RATE)
    shown = Simulator(BASE).simulate({}, *record.commands_later(rows).run)
    np.testing.assert_allclose(shown, Simulator(delayed).simulate(delays, *record.run), rtol=1e-12)


def test_a_split_row_is_the_same_in_pieces_side_by_side_and_with_sensitivities():
    run, simulator = commands(1).commands_later(-0.4).run, Simulator(BASE, ("tau_omega_1",))
    whole = simulator.simulate({}, *run)
    pieces = [shown.copy() for _, shown, _ in simulator.pieces({}, *run, rows=300)]
    assert np.array_equal(np.concatenate(pieces), whole)
    assert np.array_equal(simulator.simulate_all([{}, {}], *run)[:, :, 1], whole)


@pytest.mark.parametrize(
    ("rate", "speed", "marks"),
    [(100.0, 15000.0, 1), (250.0, 4000.0, 1), (1000.0, 3000.0, 1), (500.0, 3000.0, 1), (500.0, 3000.0, 2), (500.0, 3000.0, 4)],
)
def test_a_mark_reads_the_mean_of_the_last_part_of_a_revolution(rate, speed, marks):
    """On a ramp that is the speed half a period before the pulse, with many turns in a row or many rows in a turn."""
    time, gain = np.arange(0.0, 4.0, 1.0 / rate), 0.1 * speed
    omega, turns = speed + gain * time, (speed * time + 0.5 * gain * time**2) / 60.0
    count = np.floor(marks * (turns + 0.37))
    came, before = (
        (np.sqrt(speed**2 + 120.0 * gain * np.maximum((count - k) / marks - 0.37, 0.0)) - speed) / gain for k in (0, 1)
    )
    shown = np.where(came > before, 60.0 / marks / np.where(came > before, came - before, 1.0), speed)
    columns = {"time": time, "omega_ref": omega, "beta_ref": 0.0 * time, "omega": np.round(shown)}
    sensor = Tachometer(Record(columns, "ramp", sensor=SpeedSensor("mark", marks)))
    error = sensor.shows(omega) - sensor.measured
    assert abs(np.mean(error[10:])) < 0.1 * gain * 60.0 / speed / marks  # a tenth of a period of the ramp


@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0, 500.0])
def test_row_means_of_a_held_value_are_late_by_its_mean_age(rate):
    """The value of a mark is the mean of one revolution, held for the next one: on a ramp it is late by two halves."""
    ramp, fine = 100.0, 40  # rpm/s; instants of a row
    at = (np.arange(int(8.0 * rate) * fine) + 0.5) / (rate * fine)
    turn = (3000.0 * at + 0.5 * ramp * at**2) / 60.0
    pulse = (-3000.0 + np.sqrt(3000.0**2 + 120.0 * ramp * np.arange(int(turn[-1])))) / ramp
    last = np.searchsorted(pulse, at, side="right") - 1
    speed = 60.0 / np.diff(pulse, prepend=pulse[0] - 0.02)[last]
    rows = np.arange(int(8.0 * rate))
    time, shown = (rows + 0.5) / rate, speed.reshape(-1, fine).mean(axis=1)
    record = Record(
        {"time": time - time[0], "omega": shown, "omega_ref": shown, "beta_ref": shown * 0.0, "thrust": shown}, "ramp"
    )
    sensor = Tachometer(replace(record, sensor=SpeedSensor("mark", averaged=True)))
    error = sensor.shows(3000.0 + ramp * time) - sensor.measured
    assert abs(error.mean()) < ramp * 0.05 / 50.0  # a twentieth of a revolution
    assert np.sqrt(np.mean(error**2)) < ramp * 0.5 / 50.0


def turned(seed, marks, rate, averaged=False, **late):
    """A record of a sensor of so many marks, and of samples or means over rows; `late` [s]: delays of the readings."""
    sent, fine = commands(seed, rate=rate), 20
    held = {n: np.repeat(sent[n], fine) for n in ("omega_ref", "beta_ref")}
    thrust, omega, _ = Simulator(BASE).simulate({}, held, np.full(len(sent) * fine - 1, 1.0 / (rate * fine))).T
    time, turn = np.arange(len(omega)) / (rate * fine), np.cumsum(marks * omega / 60.0) / (rate * fine)
    pulses = np.interp(np.arange(1.0, turn[-1]), turn, time)
    last = np.maximum(np.searchsorted(pulses, time, side="right") - 1, 1)
    speed = np.round(60.0 / marks / (pulses[last] - pulses[last - 1]))
    read = {n: np.interp(time - late.get(n, 0.0), time, c) for n, c in {"omega": speed, "thrust": thrust}.items()}
    read = {n: c.reshape(-1, fine).mean(axis=1) if averaged else c[::fine] for n, c in read.items()}
    read["thrust"] += np.random.default_rng(seed + 1).normal(0.0, 0.05, len(sent))
    return sent.with_columns(**read)


@pytest.mark.parametrize("averaged", [False, True])
def test_row_means_are_distinguished_from_samples(averaged):
    """A value is held for one and a half to four rows."""
    record = turned(27, 3, 200.0, averaged)
    assert as_logged(passed(campaign(record))).logger.sensor == SpeedSensor("mark", 3, averaged=averaged)


@pytest.mark.parametrize("seed", [51, 52, 53])
@pytest.mark.parametrize("late", [{"thrust": 0.015}, {"omega": 0.012}])
def test_a_late_reading_is_not_taken_for_telemetry(seed, late):
    """Telemetry without age, and commands that act a row late, would explain a late thrust as well; older telemetry a late
    speed."""
    logger = as_logged(passed(campaign(turned(seed, 1, 100.0, **late)))).logger
    assert (logger.sensor, logger.rows) == (SpeedSensor("mark", 1), pytest.approx(0.0, abs=0.1))


@pytest.mark.parametrize("width", [0.02, 0.9])
def test_a_mean_of_a_parabola_exceeds_its_middle_by_a_24th_of_the_curvature_times_the_width_squared(width):
    time = np.sort(np.random.default_rng(3).uniform(0.0, 1.0, 200))
    inner = (time > time[2]) & (time - 0.5 * width > time[1]) & (time + 0.5 * width < time[-2])
    np.testing.assert_allclose((row_means(time, width) @ time**2)[inner], time[inner] ** 2 + width**2 / 12.0, rtol=1e-9)


def test_row_means_are_distinguished_from_telemetry():
    """An encoder at 25 Hz, all readings are means over their row, whose middle is half a row after the command."""
    sent, fine = commands(31, rate=25.0), 80
    held = {n: np.repeat(sent[n], fine) for n in ("omega_ref", "beta_ref")}
    thrust, omega, _ = Simulator(BASE).simulate({}, held, np.full(len(sent) * fine - 1, 1.0 / (25.0 * fine))).T
    read = {"omega": np.round(omega), "thrust": thrust}
    read = {n: c.reshape(-1, fine).mean(axis=1) for n, c in read.items()}
    read["thrust"] += np.random.default_rng(32).normal(0.0, 0.05, len(sent))
    found = as_logged(passed(campaign(sent.with_columns(**read)))).logger
    assert found.sensor == SpeedSensor("encoder", averaged=True)
    assert found.rows == pytest.approx(-0.5, abs=0.02)


def test_a_logger_without_offset_comes_before_one_that_the_data_do_not_distinguish_from_it():
    """An offset of a fifth of a row in much noise."""
    assert as_logged(passed(campaign(logged(5, 0.2, filter_=0.03, noise=1.0, rate=100.0)))).logger.rows == 0.0


def test_telemetry_reads_a_ramp_late_by_filter_delay_and_half_a_renewal():
    time = np.arange(3000) * 0.004
    omega = 2000.0 + 100.0 * time
    columns = {"time": time, "omega_ref": omega, "beta_ref": 0.0 * time, "omega": omega}
    sensor = Tachometer(Record(columns, "ramp", sensor=SpeedSensor("telemetry", filter=0.03, refresh=0.02, delay=0.005)))
    late = 0.03 + 0.005 + 0.5 * 0.004
    np.testing.assert_allclose(sensor.shows(omega)[-100:], omega[sensor.rows][-100:] - 100.0 * late, rtol=1e-9)
    np.testing.assert_allclose(sensor.matrix @ omega, sensor.shows(omega), rtol=1e-5)  # cut off at exp(-12)
    weights = np.random.default_rng(0).normal(size=len(sensor))
    assert weights @ sensor.shows(omega) == pytest.approx(sensor.transpose(weights) @ omega)


@pytest.mark.parametrize("rows", [-1.0, -0.5, 0.0, 1.0])
def test_the_rows_and_an_encoder_are_found(rows):
    logger = as_logged(passed(campaign(logged(10, rows)))).logger
    assert logger.sensor == SpeedSensor("encoder")
    assert logger.rows == pytest.approx(rows, abs=0.05)


def test_the_filter_of_telemetry_is_found_and_not_taken_for_the_motors_lag():
    found = identify(campaign(logged(20, 0.0, filter_=0.03, rate=100.0)), starts=1)
    assert found.logger.sensor.kind == "telemetry"
    assert found.logger.sensor.filter == pytest.approx(0.03, rel=0.1)
    true = {p.name: p.default for p in BASE.parameters}
    lags = [sum(values[f"tau_omega_{k}"] for k in (1, 2)) for values in (found.parameters.values, true)]
    assert lags[0] == pytest.approx(lags[1], rel=0.02)


def test_the_filter_is_found_beside_a_record_that_measures_no_speed():
    other = logged(26, 0.0, rate=100.0)
    silent = Record({name: other[name] for name in other.columns if name != "omega"}, "silent")
    gate = passed(campaign(logged(25, 0.0, filter_=0.03, rate=100.0)), {"silent": silent})
    sensor = as_logged(gate).logger.sensor
    assert sensor.kind == "telemetry"
    assert sensor.filter == pytest.approx(0.03, rel=0.1)
    alone = Experiment([Fitted("silent", silent)], independent(10.0))
    assert alone.omega_columns(np.ones((len(silent), 3))).shape == (0, 3)


@pytest.mark.parametrize("rows", [1.0, 5.0])
def test_an_ambiguous_delay_of_more_than_two_rows_is_the_motors(rows):
    """If the pitch is constant, no reading distinguishes the two delays."""
    record = logged(40, rows, pitch=5.0)
    logger = as_logged(passed(campaign(record))).logger
    assert logger.rows == pytest.approx(rows if rows <= 2.0 else 0.0, abs=0.05)


def test_a_delay_of_both_commands_is_the_loggers():
    assert as_logged(passed(campaign(logged(41, 5.0)))).logger.rows == pytest.approx(5.0, abs=0.05)


@pytest.mark.parametrize("rows", [0.0, 1.0])
def test_an_offset_later_than_the_speed_alone_shows_is_a_delay_of_the_thrust(rows):
    record = logged(43, rows)
    found = campaign(record.with_columns(omega=record["omega"] + np.random.default_rng(44).normal(0.0, 30.0, len(record))))
    groups, _ = roles(found, {})
    of = _Estimate(groups, found.rig.scales, {}, (), LIBRARY, AVERAGED)
    fit = _SensorFit(of, SpeedSensor("encoder"), (), tied=True).solved((6, 6))
    assert of._latest(fit) is None
    own = {n: getattr(fit, n) for n in ("values", "sensor", "free", "earliest", "unknown_instant", "delayed")}
    assert of._latest(SimpleNamespace(offset=_Delay(8.0 / RATE, 0.1 / RATE), **own)).value == pytest.approx(rows / RATE)


def test_the_offset_of_the_speed_alone_replaces_a_later_one(monkeypatch):
    monkeypatch.setattr(_Estimate, "_latest", lambda self, fit: _Delay(1.0 / RATE, 0.1 / RATE))
    logger = as_logged(passed(campaign(logged(45, 2.0)))).logger
    assert (logger.rows, logger.std) == pytest.approx((1.0, 0.1))


@pytest.mark.parametrize(("lost", "better"), [(0.0, True), (2.0 * EVIDENCE, False)])
def test_a_better_fit_of_the_speed_does_not_justify_a_worse_fit_of_the_thrust(lost, better):
    """`lost`: decrease of the thrust's log-likelihood. Half the error of 2000 speed readings is a gain of 2000 ln 2."""
    groups, _ = roles(campaign(logged(42, 0.0)), {})
    of = _Estimate(groups, campaign(logged(42, 0.0)).rig.scales, {}, (), LIBRARY, AVERAGED)
    fit = _SensorFit(of, SpeedSensor("encoder"), (), tied=True).solved((3,))
    other = copy(fit)
    other.speed = {row: [0.5 * error, std] for row, (error, std) in fit.speed.items()}
    other._thrust = fit._thrust - lost
    assert fit.worse_than(other) is better


def test_a_logger_is_estimated_beside_a_limit_between_a_fast_and_a_slow_lag():
    # A servo's rate limit acts on its first lag: with the lags in the other order, a delay replaces the fast one.
    name = "pitch_rate_limit"
    values = {f"{name}.rate": 12.0, f"{name}.form": 1.0, "tau_beta_1": 0.06, "tau_beta_2": 0.17}
    gate = passed(campaign(logged(44, 1.0, model=plant([name]), values=values)))
    assert as_logged(gate, [name], LIBRARY, values).logger.rows == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("alone", "value", "offset", "more", "none"),
    [
        ("speed_delay.delay", -0.016, -0.016, False, False),  # a speed that leads is the logger's
        ("pitch_delay.delay", -0.016, -0.016, False, True),
        ("speed_delay.delay", 0.1, 0.1, False, True),
        ("speed_delay.delay", 0.1, 0.1, True, False),  # more delays explain more
        ("speed_delay.delay", 0.0403, 0.0403, False, False),  # two rows, within their uncertainty
    ],
)
def test_one_delay_replaces_an_offset_unless_no_rig_has_it(monkeypatch, alone, value, offset, more, none):
    """Rows of 20 ms, errors of 1 ms. Only the delay `alone` explains the record; if it is negative, better than an offset."""

    class Alone:
        sensor, free = SpeedSensor(), ()

        def __init__(self, *_, alone, **__):
            self.name = alone

        def solved(self, limits):
            return self

        def late(self, name):
            return _Delay(value, 0.001)

        def worse_than(self, fit):
            return self.name != alone or (more and fit is best)

    monkeypatch.setattr(logger_fit, "_SensorFit", Alone)
    estimate = SimpleNamespace(_delays=["speed_delay.delay", "pitch_delay.delay"], _period=0.02)
    fit = object.__new__(_SensorFit)
    fit._of = estimate
    fit.late = lambda *_: _Delay(offset, 0.001)
    fit.worse_than = lambda one: one.name == alone and value < 0.0
    fit.sensor, fit.free, fit.renewed = SpeedSensor(), (), 0.0
    best = object()
    assert (_Estimate._one_delay(estimate, fit, best) is not None) == none


def test_a_late_log_is_shifted_by_whole_rows():
    record = logged(30, -1.0)
    again, said = mended(record)
    assert np.array_equal(again["omega_ref"][:-1], record["omega_ref"][1:])
    assert "shifted up by 1 row" in said[0]
    same, said = mended(logged(31, 0.0))
    assert np.array_equal(same["omega_ref"], logged(31, 0.0)["omega_ref"])


def test_rig_json_declares_the_sensor_and_refuses_what_it_does_not_know(tmp_path):
    def written(speed):
        path = tmp_path / "rig.json"
        path.write_text(json.dumps({"format": "vpp-rig/1", "sensors": {"speed": speed}}))
        return path

    assert read_rig(written({"kind": "mark", "marks_per_revolution": 2}))["sensor"] == {
        "kind": "mark",
        "marks_per_revolution": 2,
    }
    widest = {"marks_per_revolution": 1, "filter": 0.0, "refresh": 10.0, "delay": -1.0}
    assert read_rig(written(widest))["sensor"] == widest
    assert read_rig(written({"marks_per_revolution": 1000}))["sensor"] == {"marks_per_revolution": 1000}
    wrong = {
        "kind": ["radar"],
        "marks_per_revolution": [0, 1001, True, 1.5],
        "filter": [-0.001, 10.001],
        "refresh": [-0.001, 10.001],
        "delay": [-1.001, 10.001],
        "teeth": [1],
    }
    for field, values in wrong.items():
        for value in values:
            with pytest.raises(BadInput, match=field):
                read_rig(written({field: value}))


def test_a_declared_sensor_is_the_only_one_that_is_tried():
    declared = {"sensor": {"kind": "mark", "marks_per_revolution": 2}}
    logger = as_logged(passed(campaign(logged(40, 0.0), declared))).logger
    assert (logger.sensor.kind, logger.sensor.marks_per_revolution) == ("mark", 2)


@pytest.mark.parametrize("kind", ["mark", "encoder", "telemetry"])
def test_a_declared_sensor_whose_values_are_hardly_renewed_is_taken(kind):
    record = logged(41, 0.0)
    still = record.with_columns(omega=np.where(record.time < 20.0, 3000.0, 4000.0))
    assert as_logged(passed(campaign(still, {"sensor": {"kind": kind}}), accept=acceptable())).logger.sensor.kind == kind


def test_the_example_has_the_default_logger():
    logger = as_logged(passed(read_campaign(example_folder()))).logger
    assert (logger.rows, logger.sensor.delay, logger.sensor.filter) == (0.0, 0.0, 0.0)
    assert logger.sensor.kind == "mark"


def test_an_impossibly_early_response_leaves_the_default_logger():
    """Commands act five rows before the readings of their row. No logger is that early, so the lags must be wrong."""
    assert as_logged(passed(campaign(logged(4, -5.0)))).logger.rows == 0.0


@pytest.mark.parametrize(("offset", "again"), [(-1.0, True), (-0.1, False)])
def test_the_logger_is_estimated_again_beside_the_effects_found(monkeypatch, offset, again):
    """The records are searched once more if the offset differs by more than two of its standard errors of 0.1 rows: a lag of
    the thrust may stand in for it. The estimate is without the lag first, then with it. A delay is part of each estimate."""
    beside = []

    def searched(task, gate, known=()):
        final = SimpleNamespace(effects=("inflow_lag", "sensor_lag", "pitch_delay"), values={})
        parts = {
            "final": final,
            "learned": None,
            "word": "attributed",
            "held_out_after": SimpleNamespace(rmse_thrust=2.0 + gate.logger.rows),
        }
        parts["stages"] = ()
        return SimpleNamespace(logger=gate.logger, selection=lambda: SimpleNamespace(final=final), **parts)

    def estimated(gate, effects=(), library=(), values=None, each=map):
        if not effects:
            return SimpleNamespace(logger=Logger(0.0))
        beside.append(tuple(effects))
        return SimpleNamespace(logger=Logger(offset, 0.1, period=0.01))

    monkeypatch.setattr(diagnosing, "passed", lambda *_: None)
    monkeypatch.setattr(diagnosing, "as_logged", estimated)
    monkeypatch.setattr(diagnosing, "_searched", searched)
    monkeypatch.setattr(diagnosing, "_concluded", lambda task, found: found)
    monkeypatch.setattr(diagnosing, "replace", lambda found, **_: found)
    monkeypatch.setattr(diagnosing, "_power", lambda found: None)
    library = [SimpleNamespace(name=name) for name in ("inflow_lag", "sensor_lag", "pitch_delay")]
    assert diagnosing.diagnose(None, library).logger.rows == (offset if again else 0.0)
    assert beside == [("inflow_lag",), ("inflow_lag", "sensor_lag")][: 1 if again else 2]


@pytest.mark.parametrize(("speed", "pitch", "offset"), [(1.9, 2.9, 1.9), (4.0, 6.0, 0.0), (1.9, 0.0, 0.0), (1.9, 1.9, 1.9)])
def test_the_smallest_delay_is_the_loggers_up_to_two_rows(speed, pitch, offset):
    """Delays [rows]: of the speed command, in thrust and speed reading, and of the pitch command."""
    thrust = {"omega": _Delay(speed, 0.05), "beta": _Delay(pitch, 0.05)}
    assert logger_fit._offset(thrust, _Delay(speed, 0.05), "mark", 2.0).value == pytest.approx(offset)


@pytest.mark.parametrize(("errors", "agrees"), [(4.4, True), (1.0, False)])
def test_offsets_are_compared_in_standard_errors(errors, agrees):
    one, other = Logger(-0.76, 0.058, period=0.02), Logger(-0.54, 0.022, period=0.02)  # 3.8 standard errors apart
    assert one.agrees_with(other, errors) is agrees


@pytest.mark.parametrize(("delay", "agrees"), [(0.008, True), (0.0134, False)])
def test_a_delay_of_one_sensor_alone_is_compared_with_none(delay, agrees):
    """Its standard error is 2.4 ms; the other estimate has no delay, and no standard error of one."""
    late, plain = SpeedSensor("mark", delay=delay), SpeedSensor("mark")
    one, other = Logger(sensor=late, sensor_std={"delay": 0.0024}, period=0.01), Logger(sensor=plain, period=0.01)
    assert one.agrees_with(other) is other.agrees_with(one) is agrees


@pytest.mark.parametrize("kind", ["encoder", "telemetry"])
@pytest.mark.parametrize("digit", [100.0, 20.0])
def test_a_coarsely_rounded_speed_is_read_without_bias(kind, digit):
    """Exponentials up and down, of 1 s, in rows of 20 ms. Just after a change the true speed is near the rounding limit, so
    that unadjusted values would lead by nearly half a digit."""
    time = np.arange(0.0, 8.0, 0.02)
    speed = 4000.0 + 1000.0 * np.where(time < 4.0, 1.0 - np.exp(-time), np.exp(4.0 - time))
    columns = {"time": time, "omega_ref": 0.0 * time, "omega": np.round(speed / digit) * digit}
    sensor = Tachometer(Record(columns, "rounded", sensor=SpeedSensor(kind)))
    lead = (sensor.measured - sensor.shows(speed)) * np.where(sensor.times < 4.0, 1.0, -1.0)
    assert abs(np.mean(lead)) < 0.05 * digit
    late = (columns["omega"][sensor.rows] - sensor.shows(speed)) * np.where(sensor.times < 4.0, 1.0, -1.0)
    assert np.mean(late) > 0.15 * digit


@pytest.mark.parametrize(("free", "gain", "rejected"), [((), 11.0, True), ((), 9.0, False), (("delay", "filter"), 99.0, False)])
def test_a_sensor_is_rejected_if_no_freer_one_fits_the_thrust_better(free, gain, rejected):
    """Ten nats distinguish two sensors. Telemetry has two parameters more than marks, so its better fit is no evidence."""
    marks, other = (object.__new__(_SensorFit) for _ in range(2))
    marks.free, marks._thrust, other.free, other._thrust = (), 0.0, free, gain
    assert other.fits_thrust_better_than(marks) is rejected
