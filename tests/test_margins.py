"""Margins against closed forms, and against the gain and the delay that destabilise the simulated loop."""

import numpy as np
import pytest
from builders import FAST_PITCH
from scipy.signal import cont2discrete, freqz

from identification.tune.linear import controller_response, plant_response, pulse_response
from identification.tune.margins import frequencies, margins
from identification.tune.objective import Objective, closed_loop
from identification.tune.operating import margins_at, operating_points
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.kernel.measurement import MEASUREMENT
from vpp_fmu.kernel.plant import BASE, FINE_TUNED, plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.native.closed_loop import Course

DT = 0.004
TIME_SCALE = 0.5
OMEGA = frequencies(DT, TIME_SCALE)
SETTINGS = CONTROLLER.values(DUAL)


def sampled_integrator(k):
    """k / (z - 1)."""
    return k / (np.exp(1j * OMEGA * DT) - 1.0)


@pytest.mark.parametrize("k", [0.05, 0.3, 1.0, 1.9])
def test_a_sampled_integrator_has_the_textbooks_margins(k):
    """|L| = k / (2 sin(x / 2)) and its phase -90 deg - x / 2 at x = w dt; at half the sampling frequency L = -k / 2."""
    found, at = margins(OMEGA, sampled_integrator(k)), 2.0 * np.arcsin(k / 2.0)
    assert found.stable
    assert found.phase == pytest.approx(90.0 - np.degrees(at) / 2.0, rel=1e-3)
    assert found.crossover == pytest.approx(at / DT, rel=1e-3)
    assert found.delay == pytest.approx((np.pi / 2.0 - at / 2.0) / (at / DT), rel=2e-3)
    assert found.sensitivity == pytest.approx(1.0 / (1.0 - k / 2.0), rel=1e-3)
    assert found.reduction == 0.0


@pytest.mark.parametrize(("omega", "beta"), [(2500.0, -1.0), (5500.0, 8.0)])
@pytest.mark.parametrize("channel", ["omega", "beta"])
def test_the_plants_response_is_the_maps_slope_times_the_held_lags(channel, omega, beta):
    values = BASE.values(FAST_PITCH)
    w, b, c = omega / 6000.0, (beta + 5.0) / 15.0, FINE_TUNED
    slope = {
        "omega": 2.0 * c["c20"] * w + c["c11"] * b + 2.0 * c["c21"] * w * b + c["c12"] * b**2 + 3.0 * c["c30"] * w**2,
        "beta": c["c11"] * w + c["c21"] * w**2 + 2.0 * c["c12"] * w * b,
    }
    slow, fast = values[f"tau_{channel}_1"], values[f"tau_{channel}_2"]
    (numerator,), denominator, _ = cont2discrete(([1.0], [slow * fast, slow + fast, 1.0]), DT, "zoh")
    exact = slope[channel] * freqz(numerator, denominator, OMEGA * DT)[1]
    found = plant_response(pulse_response(BASE, values, (omega, beta), channel, DT, TIME_SCALE, move=0.01), OMEGA, DT)
    np.testing.assert_allclose(found, exact, rtol=1e-4, atol=2e-6)
    wide = plant_response(pulse_response(BASE, values, (omega, beta), channel, DT, TIME_SCALE), OMEGA, DT)
    assert np.max(np.abs(wide / exact - 1.0)[OMEGA < 100.0]) < 0.01


@pytest.mark.parametrize("channel", ["omega", "beta"])
@pytest.mark.parametrize("frequency", [2.0, 300.0])
def test_the_controllers_response_is_what_a_sine_shows(channel, frequency):
    """Amplitude and phase of the command under a small sine of the error, after the initial transient."""
    simulation = Simulation(
        CONTROLLER, {**SETTINGS, "omega_min": 0.0, "omega_max": 30000.0, "beta_min": -45.0, "beta_max": 45.0}
    )
    time = np.arange(4000) * DT
    shown = []
    for error in 1e-3 * np.cos(frequency * time) + np.where(time < 0.4, 0.05, 0.0):
        command = simulation.advance({"thrust_set": 15.0 * error, "thrust": 0.0}, DT)[f"{channel}_ref"]
        shown.append(command / 6000.0 if channel == "omega" else (command + 5.0) / 15.0)
    kept = time > 2.0
    basis = np.column_stack([np.cos(frequency * time), -np.sin(frequency * time), np.ones_like(time)])[kept]
    real, imaginary, _ = np.linalg.lstsq(basis, np.array(shown)[kept], rcond=None)[0]
    expected = controller_response(SETTINGS, channel, np.array([frequency]))[0]
    assert complex(real, imaginary) / 1e-3 == pytest.approx(expected, rel=1e-6)


def an_objective(gains, effects=(), changes=None, course=None):
    loop = closed_loop(effects)
    plants = loop.vectors({**FAST_PITCH, **(changes or {})}, {}, {})[0][None]
    wanted = np.array([3.0, 3.0, 11.0])
    course = course or Course(wanted, np.zeros(3), DT, 15.0)
    return Objective(effects, plants, CONTROLLER.values(gains), MEASUREMENT.values(), course, TIME_SCALE)


@pytest.fixture(scope="module", params=[DUAL, SPEED_ONLY], ids=["dual", "speed only"])
def at_rest(request):
    """(settings, an operating point within all limits, the loop's margins there)."""
    objective = an_objective(request.param)
    points = operating_points(objective, objective.gains)
    point = points[2]
    return request.param, point, margins_at(objective, objective.gains, (point,))[0]


def ringing(gains, point, factor=1.0, delay=0.0):
    """Ratio of the oscillation 3 to 4 s after a small step to that of the second before."""
    effects = ("speed_delay", "pitch_delay")
    model = plant(effects)
    values = {**FAST_PITCH, "speed_delay.delay": delay, "pitch_delay.delay": delay}
    own = {name: factor * value if name[:2] in ("kp", "ki", "kd") else value for name, value in gains.items()}
    loop, controller = Simulation(model, values), Simulation(CONTROLLER, CONTROLLER.values({**own, "thrust_scale": 15.0}))
    thrust = loop.start(dict(zip(("omega_ref", "beta_ref"), point.commands, strict=True)))["thrust"]
    settled(controller, own, point)
    shown = []
    for _ in range(1000):
        commands = controller.advance({"thrust_set": point.thrust + 1e-6, "thrust": thrust}, DT)
        thrust = loop.advance(commands, DT)["thrust"]
        shown.append(thrust)
    late, later = (np.array(shown[a:b]) for a, b in ((500, 750), (750, 1000)))
    return np.ptp(later) / np.ptp(late)


def settled(controller, gains, point):
    """Set the integrals to hold the point's commands without error."""
    omega, beta = point.commands
    controller.states |= {"omega_integral": omega / 6000.0 / gains["ki_omega"], "running": 1.0}
    if gains.get("ki_beta"):
        controller.states |= {"beta_integral": (beta + 5.0) / 15.0 / gains["ki_beta"]}


def test_the_loop_is_stable_up_to_its_margins_of_delay_and_gain(at_rest):
    gains, point, found = at_rest
    assert ringing(gains, point, delay=0.93 * found.delay) < 0.95
    assert ringing(gains, point, delay=1.07 * found.delay) > 1.05
    assert ringing(gains, point, factor=0.93 * found.gain) < 0.95
    assert ringing(gains, point, factor=1.07 * found.gain) > 1.05
