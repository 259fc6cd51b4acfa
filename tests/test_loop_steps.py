"""Figures of merit of a closed loop's steps: a first-order step, alone and with a late dip, against closed forms."""

import numpy as np
import pytest

from vpp_fmu.app.report.pages.loop import headline
from vpp_fmu.record import Record
from vpp_fmu.response import steps

DT, TAU = 0.004, 0.15
TIME = np.arange(0.0, 45.0, DT)


def step_of(response, extra=None) -> Record:
    """A step from 2 to 7 N at 1 s with a normalised `response` of the time since [s], and an addition to the thrust [N]."""
    after = TIME > 1.0 - DT / 2
    thrust = 2.0 + 5.0 * np.where(after, response(np.maximum(TIME - 1.0, 0.0)), 0.0) + (0.0 if extra is None else extra)
    rest = {name: np.full(len(TIME), 3.0) for name in ("omega_ref", "beta_ref", "omega", "beta")}
    return Record({"time": TIME, "thrust_set": np.where(after, 7.0, 2.0), "thrust": thrust} | rest, "loop")


def lag(t):
    return 1.0 - np.exp(-t / TAU)


def pulse(at, seconds, size):
    since = TIME - at + DT / 2
    return np.where((since > 0.0) & (since < seconds), size, 0.0)


def test_a_late_dip_is_a_disturbance_and_not_the_settling_time():
    (found,) = steps(step_of(lag, pulse(31.0, 0.1, -1.0)))
    assert found.settling == pytest.approx(TAU * np.log(50.0), abs=DT)
    (dip,) = found.departures
    assert (dip.time, dip.duration, dip.largest) == pytest.approx((31.0, 0.1, 20.0), abs=1e-6)
    assert "settled after 0.588 s" in headline([found])
    assert "later a disturbance by 20.0 % of the step for 0.1 s at 31 s" in headline([found])


@pytest.mark.parametrize("damping", [0.05, 0.2, 0.5, 0.7])
def test_swings_of_the_loop_itself_belong_to_the_step(damping):
    natural = 8.0
    ringing, angle = natural * np.sqrt(1 - damping**2), np.arccos(damping)

    def second_order(t):
        return 1.0 - np.exp(-damping * natural * t) * np.sin(ringing * t + angle) / np.sin(angle)

    (found,) = steps(step_of(second_order))
    t = np.arange(0.0, 44.0, 1e-4)
    last = t[np.abs(second_order(t) - 1.0) > 0.02][-1]
    assert found.departures == ()
    assert found.settling == pytest.approx(last, abs=2 * DT)


def test_a_thrust_that_stays_away_has_not_settled():
    (found,) = steps(step_of(lag, pulse(31.0, 100.0, -1.0)))
    assert found.settling is None


def test_noise_that_enters_the_band_for_a_sample_settles_nothing():
    noise = np.random.default_rng(0).normal(0.0, 0.1, len(TIME))
    (found,) = steps(step_of(lag, noise))
    assert found.settling is None or found.settling > 1.0
