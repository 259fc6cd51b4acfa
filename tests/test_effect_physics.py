"""Each effect against its own closed form, scipy, or a naive integration that was written without the kernel."""

import numpy as np
import pytest
from builders import normalised, paper_map, random_steps, simulator, steps_through, two_lags
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from vpp_fmu.kernel.plant import BASE, plant

STEP = 0.004
LAGS = {"beta": (0.374, 0.207), "omega": (0.053, 0.172)}
"""Inner and outer time constant of each channel."""


def run(name, values, inputs, step=STEP, base=None):
    """Thrust, omega, beta (rows,) with one effect at `values`; base parameters by `base`."""
    rows = len(next(iter(inputs.values())))
    return (
        simulator(plant([name]))
        .simulate({f"{name}.{k}": v for k, v in values.items()} | (base or {}), inputs, np.full(rows - 1, step))
        .T
    )


def held(*parts, omega=5000.0, step=STEP):
    """Constant speed; pitch commands from (pitch, seconds) parts."""
    beta = np.concatenate([np.full(round(seconds / step), float(pitch)) for pitch, seconds in parts])
    return {"omega_ref": np.full(len(beta), float(omega)), "beta_ref": beta}


def fine_base(inputs, split=16):
    """Outputs of the plain plant on a grid `split` times finer: (time, thrust, omega, beta)."""
    rows = len(inputs["omega_ref"])
    fine = {name: np.repeat(column, split)[: (rows - 1) * split + 1] for name, column in inputs.items()}
    shown = simulator(BASE).simulate({}, fine, np.full((rows - 1) * split, STEP / split))
    return np.arange(len(shown)) * STEP / split, *shown.T


def filtered(numerator, denominator, signal, time):
    """Response of a transfer function to a signal that is linear between samples, settled on its first value."""
    gain = numerator[-1] / denominator[-1]
    return gain * signal[0] + lsim((numerator, denominator), signal - signal[0], time)[1]


# --- The channels' two lags, bent: naive Euler steps of the equations as they stand in the literature --------------------


def euler(command, inner, outer, h):
    """x' = inner(command - x, x), y' = outer(x - y, y): (rows,) y at the start of each step of h seconds."""
    x = y = command[0]
    shown = np.empty(len(command))
    for k, u in enumerate(command.tolist()):
        shown[k] = y
        x, y = x + h * inner(u - x, x), y + h * outer(x - y, y)
    return shown


def latch(speed, time, accuracy, tau, h):
    """A motor that turns off when it has been slower than `speed` for `time` while farther off than `accuracy`."""
    slow, off = 0.0, 0.0

    def rate(e, x):
        nonlocal slow, off
        off = off if off * e > 0.0 else 0.0
        slow = slow + h if not off and abs(e) / tau < speed and abs(e) > accuracy else 0.0
        off = np.sign(e) if slow > time else off
        return 0.0 if off else e / tau

    return rate


def hysteresis(stop, restart, tau):
    """A motor that stops within `stop` and starts beyond `restart`."""
    running = False

    def rate(e, x):
        nonlocal running
        running = abs(e) > (stop if running else restart)
        return e / tau if running else 0.0

    return rate


def limits(e, tau, slowest, full, threshold, accuracy):
    if abs(e) < accuracy:
        return 0.0
    return np.sign(e) * (full if abs(e) > threshold else min(max(abs(e) / tau, slowest), full))


H = 5e-5
LAWS = {
    "pitch_error_deadzone": ({"half_width": 0.6}, lambda tau: lambda e, x: (e - np.clip(e, -0.6, 0.6)) / tau),
    "pitch_asymmetry": ({"asymmetry": 0.5}, lambda tau: lambda e, x: e / tau * np.exp(-0.5 if e > 0 else 0.5)),
    "pitch_stop_band": ({"half_width": 0.45}, lambda tau: lambda e, x: e / tau * (abs(e) > 0.45)),
    "pitch_stop_restart": ({"stop": 0.3, "restart": 1.2}, lambda tau: hysteresis(0.3, 1.2, tau)),
    "pitch_rate_limit": ({"rate": 12.0}, lambda tau: lambda e, x: np.clip(e / tau, -12.0, 12.0)),
    "speed_asymmetry": ({"asymmetry": -0.5}, lambda tau: lambda e, x: e / tau * np.exp(0.5 if e > 0 else -0.5)),
    "speed_dependent_lag": ({"sensitivity": 2e-4}, lambda tau: lambda e, x: e / tau * max(1.0 + 2e-4 * (x - 4000.0), 0.2)),
}


def compared_with_euler(name, values, inner, outer, atol):
    """Four seconds of random steps, with holds from 10 to 600 ms, against the naive integration."""
    u = "omega" if name.startswith("speed") else "beta"
    inputs, split = random_steps(1000, 150, seed=8), round(STEP / H)
    shown = run(name, values, inputs)[1 if u == "omega" else 2]
    naive = euler(np.repeat(inputs[f"{u}_ref"], split), inner, outer, H)[::split]
    np.testing.assert_allclose(shown, naive, rtol=0, atol=atol)
    plain = simulator(BASE).simulate({}, inputs, np.full(999, STEP))[:, 1 if u == "omega" else 2]
    assert np.abs(shown - plain).max() > 5.0 * atol


@pytest.mark.parametrize("form", [1.0, 2.0])
@pytest.mark.parametrize("name", LAWS)
def test_the_law_of_either_lag_is_the_naive_integration(name, form):
    (values, law), channel = LAWS[name], "omega" if name.startswith("speed") else "beta"
    laws = [lambda e, x, tau=tau: e / tau for tau in LAGS[channel]]
    laws[int(form) - 1] = law(LAGS[channel][int(form) - 1])
    compared_with_euler(name, values | {"form": form}, *laws, atol=5.0 if channel == "omega" else 6e-3)


def test_pitch_speed_limits_are_the_naive_integration():
    law = {"slowest": 4.0, "full": 20.0, "threshold": 3.0, "accuracy": 0.3}
    compared_with_euler("pitch_speed_limits", law, lambda e, x: limits(e, 0.374, **law), lambda e, x: e / 0.207, 6e-3)


def test_stall_latch_is_the_naive_integration():
    law = {"speed": 6.0, "time": 0.1013, "accuracy": 0.1}
    inner = latch(**law, tau=0.374, h=H)
    compared_with_euler("pitch_stall_latch", law, inner, lambda e, x: e / 0.207, 6e-3)


def test_a_rate_limit_on_the_command_is_a_ramp_before_the_lags():
    """Two lags follow a ramp with its slope, later by the sum of their time constants; then they settle on the goal."""
    beta = run("pitch_rate_limit", {"rate": 2.0, "form": 3.0}, held((0, 0.04), (9, 12)))[2]
    t = np.arange(len(beta)) * STEP - 0.04
    in_ramp = (t > 3.5) & (t < 4.4)  # the transient of the lags has decayed to a few parts in 1e5
    np.testing.assert_allclose(beta[in_ramp], 2.0 * (t[in_ramp] - 0.374 - 0.207), rtol=0, atol=5e-4)
    command = np.where(t < 4.5, 2.0 * t, 9.0) * (t > 0)
    np.testing.assert_allclose(
        beta, filtered([1.0], np.convolve([0.374, 1.0], [0.207, 1.0]), command, t - t[0]), rtol=0, atol=1e-4
    )


# --- Play, limits, offset, delay ---------------------------------------------------------------------------------------------


def play(drive, half_gap):
    """The classic play operator, settled in mid-gap."""
    driven, shown = drive[0], []
    for u in drive.tolist():
        driven = min(max(driven, u - half_gap), u + half_gap)
        shown.append(driven)
    return np.array(shown)


def triangle(rows=4000, period=6.0):
    phase = np.arange(rows) * STEP / period % 1.0
    return {"omega_ref": np.full(rows, 5000.0), "beta_ref": 2.0 + 4.0 * (2.0 * np.abs(2.0 * phase - 1.0) - 1.0)}


def test_backlash_behind_the_lags_is_the_play_operator():
    inputs = triangle()
    _, _, beta = fine_base(inputs)[1:]
    np.testing.assert_allclose(run("pitch_backlash", {"half_gap": 0.6}, inputs)[2], play(beta, 0.6)[::16], rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "values", "u", "low", "high"),
    [
        ("pitch_travel_limit", {"minimum": -3.0, "maximum": 7.0}, "beta", -3.0, 7.0),
        ("speed_saturation", {"maximum": 5400.0}, "omega", 0.0, 5400.0),
    ],
)
def test_limits_cut_the_command_or_what_is_reached(name, values, u, low, high):
    t = np.arange(3000) * STEP
    commands = {"beta": ([0.0, 1.0, 9.0], [-1.0, 10.0, -5.0]), "omega": ([0.0, 1.0, 9.0], [3000.0, 6000.0, 2500.0])}
    rest = {"omega_ref": np.full(3000, 4000.0), "beta_ref": np.full(3000, 2.0)}
    at, levels = commands[u]
    index = np.searchsorted(at, t + 1e-9, side="right") - 1
    column = 1 if u == "omega" else 2
    inner, outer = LAGS[u]
    inputs = rest | {f"{u}_ref": np.array(levels)[index]}
    cut = steps_through(t, at, np.clip(levels, low, high), lambda t: two_lags(t, inner, outer))
    np.testing.assert_allclose(run(name, values, inputs)[column], cut, rtol=0, atol=1e-8 * max(map(abs, levels)))
    shown = run(name, values | {"form": 2.0}, inputs)[column]
    free = steps_through(t, at, levels, lambda t: two_lags(t, inner, outer))
    np.testing.assert_allclose(shown[t < at[2]], np.clip(free, low, high)[t < at[2]], rtol=0, atol=1e-8 * max(map(abs, levels)))
    # The outer lag leaves the limit when the inner one, which is not limited, returns below it.
    _, first, last = levels
    leaves = at[2] + inner * np.log((first - last) / (high - last))
    after = t > leaves

    def rate(s, y):
        return (last + (first - last) * np.exp(-(s - at[2]) / inner) - y) / outer

    fall = solve_ivp(rate, (leaves, t[-1]), [high], t_eval=t[after], rtol=1e-9, atol=1e-9).y[0]
    np.testing.assert_allclose(shown[after], np.maximum(fall, low), rtol=0, atol=1e-4 * (high - low))
    assert (shown[(t > 7.0) & ~after] == high).all()


def test_offset_shifts_the_pitch():
    inputs = random_steps(800, 100)
    shifted = inputs | {"beta_ref": inputs["beta_ref"] - 1.7}
    expected = simulator(BASE).simulate({}, shifted, np.full(799, STEP)).T
    np.testing.assert_allclose(run("pitch_offset", {"offset": -1.7}, inputs), expected, rtol=0, atol=1e-11)


def test_speed_delay_shifts_the_speed():
    t, commands = np.arange(500) * STEP, [(0.0, 3000.0), (0.4, 5500.0), (0.408, 2000.0), (1.2, 6000.0)]
    at, levels = zip(*commands, strict=True)
    inputs = {"omega_ref": np.array(levels)[np.searchsorted(at, t + 1e-9, side="right") - 1], "beta_ref": np.full(500, 4.0)}
    exact = steps_through(t, np.add(at, 0.0237), levels, lambda t: two_lags(t, 0.172, 0.053))
    np.testing.assert_allclose(run("speed_delay", {"delay": 0.0237}, inputs)[1], exact, rtol=0, atol=1e-8)


# --- Supply ----------------------------------------------------------------------------------------------------------------


def settled(name, values, omega, beta, **inputs):
    rows = {k: np.full(2, v) for k, v in {"omega_ref": omega, "beta_ref": beta, **inputs}.items()}
    return run(name, values, rows, 30.0)[:, -1]


@pytest.mark.parametrize("beta", [-5.0, 2.0, 10.0])
@pytest.mark.parametrize("omega", [2500.0, 5800.0])
def test_supply_sag_is_a_limit_or_a_droop_of_the_speed(omega, beta):
    limited = settled("supply_sag", {"limit": 6000.0, "sag": 60.0}, omega, beta)[1]
    assert limited == pytest.approx(min(omega, 6000.0 - 60.0 * (beta + 5.0)), rel=1e-12)
    drooped = settled("supply_sag", {"sag": 60.0, "form": 2.0}, omega, beta)[1]
    assert drooped + 60.0 * (beta + 5.0) * (drooped / 6000.0) ** 2 == pytest.approx(omega, rel=1e-12)


@pytest.mark.parametrize("lag", [0.0, 0.8])
def test_a_limit_follows_the_pitch_through_the_rotors_lags_and_its_own(lag):
    """Speed follows limit - sag lift(t) through two lags, and the battery's; the pitch is its own two lags' step response."""
    inputs = {"omega_ref": np.full(1500, 6000.0), "beta_ref": np.r_[0.0, np.full(749, 9.0), np.full(750, 2.0)]}
    omega = run("supply_sag", {"limit": 6000.0, "sag": 60.0, "time_constant": lag}, inputs)[1]
    fine = np.arange(15000) * STEP / 10.0
    pitch = steps_through(fine, (-1.0, STEP, 750 * STEP), (0.0, 9.0, 2.0), lambda t: two_lags(t, 0.374, 0.207))
    lags = np.convolve([0.053, 1.0], [0.172, 1.0])
    exact = filtered([1.0], np.convolve(lags, [lag, 1.0]) if lag else lags, 6000.0 - 60.0 * (5.0 + pitch), fine)[::10]
    np.testing.assert_allclose(omega, exact, rtol=0, atol=0.02)


@pytest.mark.parametrize("lag", [0.0, 0.6])
def test_a_droop_acts_in_the_rotors_loop(lag):
    """The rotor's two lags towards the command minus the droop, or the lagged droop, integrated by another solver."""
    ref, sag, lift = 5500.0, 80.0, 12.0
    inputs = {"omega_ref": np.r_[3000.0, np.full(749, ref)], "beta_ref": np.full(750, lift - 5.0)}
    omega = run("supply_sag", {"sag": sag, "time_constant": lag, "form": 2.0}, inputs)[1]
    start = 6000.0**2 / (2.0 * sag * lift) * (np.sqrt(1.0 + 4.0 * sag * lift * 3000.0 / 6000.0**2) - 1.0)

    def slope(t, x):
        inner, outer, lost = x
        droop = sag * lift * (outer / 6000.0) ** 2
        return [(ref - (lost if lag else droop) - inner) / 0.053, (inner - outer) / 0.172, (droop - lost) / (lag or 1.0)]

    t = np.arange(750) * STEP
    begin = [start, start, sag * lift * (start / 6000.0) ** 2]
    exact = solve_ivp(slope, (0.0, t[-1]), begin, t_eval=t, rtol=1e-9, atol=1e-6).y[1]
    np.testing.assert_allclose(omega[1:], exact[:-1], rtol=0, atol=0.05)  # the step is given in the second row
    assert (exact.max() > exact[-1] + 50.0) == bool(lag)  # it overshoots, which the law without a lag does not


@pytest.mark.parametrize("form", [1.0, 2.0])
def test_a_sag_without_a_lag_is_the_limit_of_a_short_one_with_its_slope(form):
    model, name = plant(["supply_sag"]), "supply_sag.time_constant"
    inputs, steps = random_steps(1500, 150, seed=5), np.full(1499, STEP)
    values = {"supply_sag.limit": 5600.0, "supply_sag.sag": 60.0, "supply_sag.form": form}
    short = 1e-5
    at_once, tangents = simulator(model, (name,)).sensitivities(values | {name: 0.0}, inputs, steps)
    lagged = simulator(model).simulate(values | {name: short}, inputs, steps)
    slope = (lagged - at_once)[:, 1] / short
    assert np.abs(slope).max() > 100.0  # rpm/s
    apart = np.abs(slope - tangents[:, 1, 0])
    assert np.quantile(apart, 0.95) < 0.02 * np.abs(slope).max()  # the others are at the kink of the limit


@pytest.mark.parametrize(("share", "voltage"), [(1.0, 22.0), (0.5, 26.0), (0.3, 12.0)])
def test_voltage_scales_the_speed(share, voltage):
    omega = settled("supply_voltage", {"share": share}, 4000.0, 3.0, voltage=voltage)[1]
    assert omega == pytest.approx(4000.0 * (1.0 + share * (voltage / 24.0 - 1.0)), rel=1e-12)


def test_no_motor_gains_more_speed_than_voltage():
    """A motor whose torque balance is voltage = k speed + r speed^2 gains its largest share without load, r = 0: 1."""
    declared = next(p for p in plant(["supply_voltage"]).parameters if p.name == "supply_voltage.share")
    assert declared.maximum == 1.0
    k, volts, step = 0.005, 24.0, 1e-6
    for r in (0.0, 1e-7, 1e-6):
        speeds = [np.roots([r, k, -v]).max() if r else v / k for v in (volts, volts * (1.0 + step))]
        share = np.log(speeds[1] / speeds[0]) / np.log1p(step)
        assert 0.0 < share < declared.maximum + 1e-6


# --- Map and air -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("beta", [-3.0, 4.0, 9.0])
def test_map_terms_are_their_polynomials(beta):
    w, b = normalised(5100.0, beta)
    c = {"c10": 0.07, "c22": -0.2, "stall": -0.15}
    more = settled("map_terms", c, 5100.0, beta)[0] - paper_map(5100.0, beta)
    assert more == pytest.approx(15.0 * (0.07 * w - 0.2 * w**2 * b**2 - 0.15 * w * b**3), rel=1e-9)
    more = settled("map_terms", c | {"form": 2.0, "knee": 5.5}, 5100.0, beta)[0] - paper_map(5100.0, beta)
    knee = 10.5 / 15.0
    assert more == pytest.approx(15.0 * (0.07 * w - 0.2 * w**2 * b**2 - 0.15 * w**2 * max(b - knee, 0.0)), rel=1e-9)


@pytest.mark.parametrize("form", [1.0, 2.0, 3.0])
def test_inflow_is_a_lead_under_scipy(form):
    k, tau, inputs = 0.4, 0.08, random_steps(700, 120, seed=2)
    time, thrust, omega, beta = fine_base(inputs)
    w, b = normalised(omega, beta)
    lead = filtered([k * tau, 0.0], [tau, 1.0], b if form < 3 else thrust, time)
    expected = {1.0: thrust + 15.0 * w**2 * lead, 2.0: paper_map(omega, beta + 15.0 * lead), 3.0: thrust + lead}[form]
    shown = run("inflow_lag", {"gain": k, "time_constant": tau, "form": form}, inputs)[0]
    np.testing.assert_allclose(shown, expected[::16], rtol=0, atol=3e-4)
    assert np.abs(expected - thrust).max() > 0.05


def test_feedthrough_is_the_derivative_of_the_step_response():
    t = np.arange(600) * STEP
    inputs = {"omega_ref": np.full(600, 4800.0), "beta_ref": np.r_[np.full(50, -3.0), np.full(550, 9.0)]}
    more = (
        run("pitch_rate_feedthrough", {"gain": 0.05}, inputs)[0]
        - simulator(BASE).simulate({}, inputs, np.full(599, STEP))[:, 0]
    )
    since = np.maximum(t - 50 * STEP, 0.0)
    rate = 12.0 * (np.exp(-since / 0.374) - np.exp(-since / 0.207)) / (0.374 - 0.207)
    np.testing.assert_allclose(more, 0.05 * 0.8**2 * rate, rtol=0, atol=1e-10)


def test_gain_drift_in_time_and_in_load_is_the_closed_form():
    inputs = {"omega_ref": np.full(1000, 5400.0), "beta_ref": np.full(1000, 6.0)}
    thrust, t = paper_map(5400.0, 6.0), np.arange(1000) * 0.1
    grown = -0.001 * 60.0 * (1.0 - np.exp(-t / 60.0))
    for form, load in ((1.0, 1.0), (2.0, thrust / 15.0)):
        shown = run("thrust_gain_drift", {"rate": -0.001, "time_constant": 60.0, "form": form}, inputs, 0.1)[0]
        np.testing.assert_allclose(shown, thrust * (1.0 + load * grown), rtol=1e-9)
    line = run("thrust_gain_drift", {"rate": -0.0006}, inputs, 0.1)[0]
    assert np.polyfit(t[:50], line[:50] / thrust, 1)[0] == pytest.approx(-0.0006, rel=5e-3)


def test_gain_drift_with_load_is_the_lagged_thrust_under_scipy():
    inputs = random_steps(5000, 300, seed=4)
    time, thrust, *_ = fine_base(inputs)
    drift = -0.02 * lsim(([12.0], [12.0, 1.0]), thrust / 15.0, time)[1]  # cold at the start
    shown = run("thrust_gain_drift", {"rate": -0.02, "time_constant": 12.0, "form": 2.0}, inputs)[0]
    np.testing.assert_allclose(shown, (thrust * (1.0 + drift))[::16], rtol=0, atol=1e-5)
    assert np.ptp(thrust * drift) > 0.5


# --- Sensor ----------------------------------------------------------------------------------------------------------------


def test_sensor_gain_scales_the_reading():
    inputs = random_steps(300, 60)
    plain = simulator(BASE).simulate({}, inputs, np.full(299, STEP)).T
    shown = run("sensor_gain", {"gain": 0.93}, inputs)
    np.testing.assert_allclose(shown[0], 0.93 * plain[0], rtol=1e-14)
    np.testing.assert_array_equal(shown[1:], plain[1:])


@pytest.mark.parametrize("tau", [0.002, 0.05, 0.3])
def test_sensor_lag_is_a_low_pass_under_scipy(tau):
    inputs = random_steps(800, 120, seed=6)
    time, thrust, *_ = fine_base(inputs)
    shown = run("sensor_lag", {"time_constant": tau}, inputs)[0]
    np.testing.assert_allclose(shown, filtered([1.0], [tau, 1.0], thrust, time)[::16], rtol=0, atol=5e-4)


def test_vibration_turns_with_the_rotor():
    """5400 rpm are 90 Hz: the one line in the spectrum of a second, with its amplitude and phase."""
    inputs = {"omega_ref": np.full(1000, 5400.0), "beta_ref": np.full(1000, 4.0)}
    shown = run("rotor_vibration", {"amplitude": 0.2, "phase": 30.0}, inputs, 0.001)[0]
    lines = np.fft.rfft(shown - paper_map(5400.0, 4.0)) / 500.0
    assert np.argmax(np.abs(lines)) == 90
    assert np.abs(lines[90]) == pytest.approx(0.2 * 0.9**2, rel=1e-6)
    assert np.angle(lines[90] * 1j) == pytest.approx(np.radians(30.0), abs=1e-5)
    assert np.abs(np.delete(lines, 90)).max() < 1e-6
