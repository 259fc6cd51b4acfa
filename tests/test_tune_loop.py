"""The compiled loop gives the bits of kernel, FMUs and generated Python; and the measurement chain."""

import numpy as np
import pytest
from builders import FAST_PITCH, PROBES
from scipy.signal import lsim

from identification.tune.check import Measured
from vpp_fmu.commands import idle
from vpp_fmu.kernel.controller import DUAL, SPEED_ONLY
from vpp_fmu.kernel.measurement import MEASUREMENT
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.loop import run
from vpp_fmu.native.closed_loop import ROW, ClosedLoop, Course
from vpp_fmu.plants import KernelController, KernelPlant
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

BENT = ("speed_delay", "pitch_delay", "pitch_command_deadband", "pitch_backlash", "supply_voltage", "sensor_lag")
ON_THE_WAY = {"time_constant": 0.011, "delay": 1.3, "resolution": 0.05}
SHORT = Record({"time": np.array([0.0, 0.5, 1.2, 2.0]), "thrust_set": np.array([1.5, 12.0, 4.0, 4.0])}, "test")

IDLE = idle(Rig())


def loop_and_sets(effects, gains, chain):
    loop = ClosedLoop(plant(effects))
    own = {name: value for name, value in PROBES.items() if name.split(".")[0] in effects}
    return loop, {**FAST_PITCH, **own}, loop.vectors({**FAST_PITCH, **own}, chain, gains)


def noisy(chain, count=501):
    return 0.1 * np.random.default_rng(3).standard_normal(count) if chain else np.zeros(count)


@pytest.mark.parametrize("chain", [{}, ON_THE_WAY], ids=["ideal", "measured"])
@pytest.mark.parametrize("gains", [DUAL, SPEED_ONLY], ids=["dual", "speed only"])
@pytest.mark.parametrize("effects", [(), BENT], ids=["plain", "bent"])
def test_it_is_the_kernels_loop_to_the_bit(effects, gains, chain):
    loop, values, sets = loop_and_sets(effects, gains, chain)
    course = Course.of(SHORT, 0.004, 15.0, noisy(chain), rest=IDLE)
    found = loop.run(sets, course)
    controller = Measured(KernelController(gains), chain, course.noise)
    expected = run(KernelPlant(plant(effects), values), controller, SHORT, IDLE)
    assert list(found.columns) == list(expected.columns)
    for column in expected.columns:
        np.testing.assert_array_equal(found[column], expected[column], err_msg=column)


def test_without_a_compiler_the_numbers_are_the_same(request):
    shown = []
    course = Course.of(SHORT, 0.004, 15.0, noisy(ON_THE_WAY), rest=IDLE)
    for effects in ((), BENT):
        loop, _, sets = loop_and_sets(effects, DUAL, ON_THE_WAY)
        shown.append((loop.run(sets, course), loop.merits(sets, course)))
    request.getfixturevalue("no_compiler")
    with pytest.warns(RuntimeWarning, match="more slowly, as generated Python") as said:
        loops = [loop_and_sets(effects, DUAL, ON_THE_WAY) for effects in ((), BENT)]
    assert len(said) == 1
    for (record, merits), (loop, _, sets) in zip(shown, loops, strict=True):
        for column in ROW:
            np.testing.assert_array_equal(loop.run(sets, course)[column], record[column], err_msg=column)
        np.testing.assert_array_equal(loop.merits(sets, course), merits)


def test_many_parameter_sets_at_once_equal_single_runs():
    loop, _, (values, chain, gains) = loop_and_sets(BENT, DUAL, ON_THE_WAY)
    course = Course.of(SHORT, 0.004, 15.0, noisy(ON_THE_WAY), rest=IDLE)
    plants = values * np.linspace(0.95, 1.05, 7)[:, None]
    together = loop.merits((plants, chain, gains), course)
    alone = np.vstack([loop.merits((own, chain, gains), course) for own in plants])
    np.testing.assert_array_equal(together, alone)
    assert len(np.unique(together[:, 0])) == 7
    both = loop.merits((plants, chain, np.tile(gains, (7, 1))), course)
    np.testing.assert_array_equal(both, together)


def test_a_run_without_finite_numbers_has_an_infinite_cost():
    loop, _, (values, chain, gains) = loop_and_sets((), DUAL, {})
    course = Course.of(SHORT, 0.004, 15.0, rest=IDLE)
    assert np.isinf(loop.merits((np.full_like(values, np.nan), chain, gains), course)).all()


def readings(thrust, noise=None, **chain):
    simulation = Simulation(MEASUREMENT, chain)
    simulation.start({"thrust": thrust[0], "noise": 0.0})
    noise = np.zeros(len(thrust)) if noise is None else noise
    rows = zip(thrust.tolist(), noise.tolist(), strict=True)
    return np.array([simulation.advance({"thrust": t, "noise": n}, 0.004)["reading"] for t, n in rows])


THRUST = 8.0 + np.cumsum(np.random.default_rng(5).standard_normal(300))


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 2.5, 8.0])
def test_a_late_reading_is_the_thrust_of_then(delay):
    k = np.arange(300.0)
    np.testing.assert_allclose(readings(THRUST, delay=delay), np.interp(k - delay, k, THRUST), rtol=0, atol=1e-12)


def test_the_low_pass_is_exact_for_thrust_that_runs_straight():
    t = np.arange(300) * 0.004
    _, exact, _ = lsim(([1.0], [0.02, 1.0]), THRUST - THRUST[0], t, interp=True)
    np.testing.assert_allclose(readings(THRUST, time_constant=0.02), THRUST[0] + exact, rtol=1e-9)


def test_the_converter_rounds_thrust_and_noise_to_its_steps():
    noise = np.random.default_rng(6).standard_normal(300)
    expected = np.round((THRUST + noise) / 0.03) * 0.03
    np.testing.assert_array_equal(readings(THRUST, noise, resolution=0.03), expected)
    halves = np.array([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])
    assert readings(halves, resolution=1.0).tolist() == [-2.0, -2.0, 0.0, 0.0, 2.0, 2.0]
