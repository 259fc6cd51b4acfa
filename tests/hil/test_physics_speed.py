"""The speed loop, in the model and in software."""

import numpy as np
import pytest
from builders import simulator

from hil.physics.rig_model import FULL_RIG, POWERTRAIN
from hil.physics.speed_pi import KI, KP, UNIT, SpeedPi
from vpp_fmu.kernel.simulation import Simulation


def test_the_gains_are_the_papers():
    assert (KP, KI) == (1e-4, 2e-3)
    pi = SpeedPi(unit=1.0, low=-1e9, high=1e9)
    shown = [pi.update(4100.0, 4000.0, 0.004) for _ in range(250)]
    t = (np.arange(250) + 0.5) * 0.004  # the output is held, so the integral is taken at mid-interval
    np.testing.assert_allclose(shown, 1e-4 * 100.0 + 2e-3 * 100.0 * t, rtol=1e-12)


def test_it_freezes_without_a_speed_and_goes_on_where_it_was():
    pi = SpeedPi()
    pi.reset(0.3)
    assert pi.update(4000.0, 4000.0, 0.004) == 0.3
    before = pi.update(4000.0, 3900.0, 0.004), pi.integral
    for _ in range(1000):
        assert pi.update(4000.0, 0.0, 0.004, frozen=True) == before[0]
    assert pi.integral == before[1]
    assert pi.update(4000.0, 3900.0, 0.004) == pytest.approx(before[0] + UNIT * KI * 100.0 * 0.004)


def test_the_loop_in_software_is_the_loop_in_the_model():
    """A 250 Hz loop on the throttle's model against the full model; they may differ only by the sampling period."""
    rows = 750
    wanted = np.where(np.arange(rows) < 100, 3000.0, 5000.0)
    pitch = np.where(np.arange(rows) < 400, 2.0, 8.0)
    whole = simulator(FULL_RIG).simulate({}, {"omega_ref": wanted, "beta_ref": pitch}, np.full(rows - 1, 0.004))
    full = Simulation(FULL_RIG)
    full.start({"omega_ref": 3000.0, "beta_ref": 2.0})
    motor, pi = Simulation(POWERTRAIN), SpeedPi()
    pi.reset(full.states["throttle_integral"])
    shown = motor.start({"throttle": pi.throttle, "beta_ref": 2.0})
    speeds = [shown["omega"]]
    for omega_ref, beta_ref in zip(wanted[:-1].tolist(), pitch[:-1].tolist(), strict=True):
        throttle = pi.update(omega_ref, shown["omega"], 0.004)
        shown = motor.advance({"throttle": throttle, "beta_ref": beta_ref}, 0.004)
        speeds.append(shown["omega"])
    error = np.array(speeds) - whole[:, 1]
    assert speeds[0] == pytest.approx(3000.0, rel=1e-9)
    assert np.abs(error).max() < 0.02 * 2000.0
    assert abs(error[-1]) < 0.5
