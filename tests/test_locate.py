"""Location of an unexplained error: signal, input and frequency band."""

import warnings

import numpy as np
import pytest

from identification.diagnose.locate import locate
from vpp_fmu.record import Record

TIME = np.arange(0.0, 60.0, 0.004)
SPEED = 4000.0 + 800.0 * np.sin(2 * np.pi * 0.11 * TIME)
PITCH = 4.0 + 3.0 * np.sin(2 * np.pi * 0.6 * TIME)
THRUST = 6.0 + 0.001 * (SPEED - 4000.0)


def located(error, speed=SPEED, pitch=PITCH):
    """The location of an error [N] that is the same in the repeat."""
    columns = {"omega_ref": speed, "beta_ref": pitch, "omega": speed, "beta": pitch, "thrust": THRUST + error}
    made = [Record({"time": TIME, **columns, "thrust": columns["thrust"] + noise}, "") for noise in noises()]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return locate(made, THRUST, speed, pitch)


def noises():
    return np.random.default_rng(0).normal(0.0, 0.1, (2, len(TIME)))


def test_an_error_proportional_to_the_pitch_rate_is_located_there():
    told = located(0.05 * np.gradient(PITCH, TIME))
    assert told["strongest_correlate"]["signal"] == "rate of pitch"
    assert told["strongest_correlate"]["correlation"] == pytest.approx(1.0, abs=0.02)
    assert told["input"] == "pitch"
    assert told["share_by_band_hz"]["0.2-1"] > 0.9  # 0.6 Hz


def test_an_error_independent_of_the_commands_is_located_at_neither():
    told = located(0.3 * np.sin(2 * np.pi * 5.0 * TIME))
    assert told["input"] == "neither"
    assert told["share_by_band_hz"]["3-10"] > 0.9


def test_frequency_bands_are_right_at_a_low_sampling_rate():
    """At 20 Hz each mean has one row: a tone of 5 Hz is still in the band from 3 to 10 Hz."""
    time = TIME[::12][:1000]
    columns = {"time": time, "omega_ref": SPEED[::12][:1000], "beta_ref": PITCH[::12][:1000]}
    thrust = THRUST[::12][:1000]
    record = Record({**columns, "thrust": thrust + 0.3 * np.sin(2 * np.pi * 5.0 * time)}, "")
    told = locate([record, record], thrust, columns["omega_ref"], columns["beta_ref"])
    assert told["share_by_band_hz"]["3-10"] > 0.9
