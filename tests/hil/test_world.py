import pytest

from hil.emulator.world import STEP, LoadCell, World
from hil.physics.rig_model import POWERTRAIN
from vpp_fmu.kernel.simulation import Simulation

QUIET = LoadCell(0.5, 0.1, white=0.0, slow=0.0)


def settled(**more):
    """A world at 3 s, whose throttle opened at time 0."""
    driven = [0.0, 4.0]
    one = World(POWERTRAIN, {}, lambda: tuple(driven), **{"cell": QUIET, **more})
    driven[0] = 0.35
    one.advance(3.0)
    return one


def test_it_steps_the_physics_and_nothing_else():
    driven, reference = [0.0, 2.0], Simulation(POWERTRAIN)
    one = World(POWERTRAIN, {}, lambda: tuple(driven), QUIET)
    reference.start({"throttle": 0.0, "beta_ref": 2.0})
    for k in range(1, 51):
        driven[:] = [0.3 + 0.002 * k, 2.0 + 0.05 * k]
        one.advance(0.004 * k)
        for _ in range(4):
            expected = reference.advance({"throttle": driven[0], "beta_ref": driven[1]}, STEP)
        assert (one.thrust, one.omega, one.beta) == (expected["thrust"], expected["omega"], expected["beta"])


def test_a_conversion_that_ended_in_the_past_shows_the_past():
    driven = [0.2, 0.0]
    one = World(POWERTRAIN, {}, lambda: tuple(driven), QUIET)
    one.advance(1.0)
    seen = {}
    driven[0] = 0.8
    for k in range(1, 21):
        one.advance(1.0 + STEP * k)
        seen[k] = one.thrust
    assert one.volts(1.015) == pytest.approx(0.5 + 0.1 * seen[15])
    assert one.volts(1.0155) == pytest.approx(0.5 + 0.05 * (seen[15] + seen[16]))


def test_the_mark_passes_once_a_revolution():
    one = settled(jitter=0.0)
    count, last, period = one.pulses(3.0)
    assert 60.0 / period == pytest.approx(one.omega, rel=1e-4)
    assert 3.0 - period - STEP <= last <= 3.0
    one.advance(4.0)
    assert one.pulses(4.0)[0] - count == pytest.approx(one.omega / 60.0, abs=1.0)
