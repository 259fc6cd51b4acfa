"""The effect of coarse rounding on the mean reading, and dead times of readings."""

import numpy as np
import pytest

from identification.fit.converter import LEAST, Converter
from identification.fit.tachometer import Tachometer
from vpp_fmu.kernel.plant import BASE, plant
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

STEP = 0.002


@pytest.mark.parametrize("blur", [0.25, 0.33, 0.5, 1.0])
def test_the_mean_reading_is_that_of_many_rounded_ones(blur):
    """Against a million readings, whose mean has a standard error of count / 1000 times the root of blur^2 + 1/12."""
    rng, count, zero = np.random.default_rng(0), 0.3, 0.04
    converter = Converter(count, zero, blur)
    for true in (1.0, 1.07, 1.15, 1.234):
        noisy = (true - zero) / count + blur * rng.standard_normal(1_000_000)
        mean = zero + count * np.mean(np.round(noisy))
        known = count * np.hypot(blur, 12**-0.5) / 1000.0
        assert converter.reads(np.array([true]))[0] == pytest.approx(mean, abs=4.0 * known)


def test_the_resolution_is_found_from_readings():
    """Noise of a third of a count is added before rounding; the estimate subtracts the rounding noise from the total."""
    rng, count = np.random.default_rng(1), 0.2
    readings = count * np.round((rng.uniform(0.0, 9.0, 20000) + 0.33 * count * rng.standard_normal(20000)) / count)
    found = Converter.of(readings, count * np.hypot(0.33, 12**-0.5))
    assert found.count == pytest.approx(count)
    assert found.blur == pytest.approx(0.33)
    in_grams = Converter.of(readings * 101.97162129779, 0.01)
    assert in_grams.count == pytest.approx(count * 101.97162129779)
    assert in_grams.blur == LEAST


@pytest.mark.parametrize(("effect", "column"), [("reading_delay", 0), ("speed_reading_delay", 1)])
@pytest.mark.parametrize("delay", [0.01, 0.04])
def test_a_late_reading_is_the_delayed_signal(effect, column, delay):
    """Behind two lags speed is smooth: a shift by whole rows is exact to a few thousandths of the step."""
    rows = 3000
    inputs = {"omega_ref": np.where(np.arange(rows) < 500, 3000.0, 5000.0), "beta_ref": np.full(rows, 5.0)}
    steps = np.full(rows - 1, STEP)
    plain = Simulator(BASE).simulate({}, inputs, steps)
    late = Simulator(plant([effect])).simulate({f"{effect}.delay": delay}, inputs, steps)
    back = round(delay / STEP)
    moved = np.ptp(plain[:, column])
    np.testing.assert_allclose(late[back:, column], plain[:-back, column], atol=0.004 * moved)
    others = [k for k in range(3) if k != column]
    np.testing.assert_allclose(late[:, others], plain[:, others], rtol=1e-9)


def test_a_rotor_waits_only_if_it_starts_from_rest():
    """From rest the response is the same, `wait` later; from a speed it is not delayed."""
    rows, wait = 3000, 0.05
    steps, clock = np.full(rows - 1, STEP), np.arange(rows)
    model = plant(["start_from_rest"])
    for low, back in ((0.0, round(wait / STEP)), (2000.0, 0)):
        inputs = {"omega_ref": np.where(clock < 500, low, 5000.0), "beta_ref": np.full(rows, 5.0)}
        plain = Simulator(BASE).simulate({}, inputs, steps)
        late = Simulator(model).simulate({"start_from_rest.wait": wait}, inputs, steps)
        np.testing.assert_allclose(late[back:, 1], plain[: rows - back, 1], atol=0.5)


def test_an_empty_reading_is_not_taken_for_a_pulse_of_the_tachometer():
    """With three rows in ten empty, the values used are a subset of those used without empty rows."""
    rng, rows = np.random.default_rng(3), 4000
    time = 0.004 * np.arange(rows)
    turns = np.cumsum(np.full(rows, 1234.5 / 60.0 * 0.004) * (1.0 + 0.2 * np.sin(time)))
    speed = np.zeros(rows)
    shown = 1000.0
    for k in range(1, rows):
        shown = round(1234.5 * (1.0 + 0.2 * np.sin(time[k])), 1) if int(turns[k]) > int(turns[k - 1]) else shown
        speed[k] = shown
    speed[0] = 1000.0
    columns = {"time": time, "omega_ref": speed, "beta_ref": speed, "thrust": speed, "omega": speed}
    whole = Tachometer(Record(columns, "a"))
    holes = np.where(rng.random(rows) < 0.3, np.nan, speed)
    part = Tachometer(Record({**columns, "omega": holes}, "b"))
    assert 0.5 * len(whole) < len(part) <= len(whole)
    values = np.unique(whole.measured)
    assert np.isin(part.measured, values).all()
    assert len(np.unique(part.rows)) == len(part)


@pytest.mark.parametrize(("age", "whole"), [(0.3, 0), (1.0, 0), (1.0, 1), (2.75, 2)])
def test_a_row_holds_a_reading_from_earlier_rows(age, whole):
    """Uneven rows against a model sampled every 0.25 ms. The error of linear interpolation is h^2 / 8 of the curvature."""
    rows, rng = 1500, np.random.default_rng(5)
    fine = 4 * rng.integers(5, 60, rows - 1)
    speed = np.where(np.arange(rows) % 100 < 50, 3000.0, 5000.0)
    inputs = {"omega_ref": np.repeat(speed, [*fine, 1]), "beta_ref": np.full(fine.sum() + 1, 5.0)}
    plain = Simulator(BASE).simulate({}, inputs, np.full(fine.sum(), 0.00025))
    logged = Simulator(plant(["row_clock"])).simulate(
        {"row_clock.age": age}, {"omega_ref": speed, "beta_ref": np.full(rows, 5.0)}, 0.00025 * fine
    )
    at = np.append(0, np.cumsum(fine))
    read = at[1:] - (age - whole) * fine
    for column, near in ((0, 2e-4), (1, 0.06)):
        expected = np.interp(read, np.arange(len(plain)), plain[:, column])
        np.testing.assert_allclose(logged[1 + whole :, column], expected[: rows - 1 - whole], rtol=0, atol=near)
    np.testing.assert_allclose(logged[:, 2], plain[at, 2], rtol=1e-9)
