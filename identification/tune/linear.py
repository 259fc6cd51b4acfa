"""Linearise a sampled loop at an operating point, as frequency responses.

Thrust and commands are normalised by the rig's scales, so that the controller's gains apply unchanged. The plant's response is
half the difference of simulated steps of one command up and down from steady state. It is exact for linear and quadratic
models, includes every effect at the size of the step, and excludes drift.
"""

from collections.abc import Mapping

import numpy as np
from scipy.signal import freqz

from vpp_fmu.kernel.effects.dual_pid import ALLOCATED
from vpp_fmu.kernel.effects.thrust_reading import LONGEST
from vpp_fmu.kernel.measurement import MEASUREMENT
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator

MOVE = 0.2
"""Size of the plant's step, normalised: 1200 rpm and 3 deg on the paper's rig. It exceeds dead bands, and the map's cubic term
changes the gain by less than 1 %."""

SETTLED = 12.0
"""Time scales after which a step has settled: the slowest channel's lags sum to one, so less than e^-10 remains."""

DECAYED = 30.0
"""Time constants of the measurement chain after which a step has settled."""

CHANNELS = {"omega": "omega_ref", "beta": "beta_ref"}


def pulse_response(
    model: Model,
    values: Mapping[str, float],
    rest: tuple[float, float],
    channel: str,
    dt: float,
    time_scale: float,
    move: float = MOVE,
) -> np.ndarray:
    """Thrust (n,) at the samples after a unit pulse of one sample of channel "omega" or "beta", from the steady state at the
    commands `rest` [rpm, deg]. `values`: all of the model's; `time_scale` s: the rig's."""
    size = move * values[f"{channel}_scale"]
    rows = round(SETTLED * time_scale / dt) + 2
    shown = []
    for sign in (1.0, -1.0):
        inputs = {name: np.full(rows, float(value)) for name, value in zip(CHANNELS.values(), rest, strict=True)}
        inputs[CHANNELS[channel]][1:] += sign * size
        shown.append(Simulator(model).simulate(values, inputs, np.full(rows - 1, dt))[1:, 0])
    step = (shown[0] - shown[1]) / (2.0 * move * values["thrust_scale"])
    return np.diff(step, prepend=0.0)


def chain_response(chain: Mapping[str, float], omega: np.ndarray, dt: float) -> np.ndarray:
    """Frequency response (n,) of the measurement chain at `omega` [rad/s], without quantisation."""
    rows = round(DECAYED * chain["time_constant"] / dt) + LONGEST + 3
    inputs = {"thrust": np.r_[0.0, np.ones(rows - 1)], "noise": np.zeros(rows)}
    values = {**chain, "resolution": 0.0, "sample_time": dt}
    shown = Simulator(MEASUREMENT).simulate(values, inputs, np.full(rows - 1, dt))[2:, 0]
    return freqz(np.diff(shown, prepend=0.0), worN=omega * dt)[1]


def plant_response(pulse: np.ndarray, omega: np.ndarray, dt: float) -> np.ndarray:
    """Frequency response (n,) at `omega` [rad/s] of a pulse response."""
    return freqz(pulse, worN=omega * dt)[1]


def controller_response(settings: Mapping[str, float], channel: str, omega: np.ndarray) -> np.ndarray:
    """Frequency response (n,) of one channel of the controller within its limits, at `omega` [rad/s].

        C(z) = kp + ki (dt / 2) (z + 1) / (z - 1) + kd (delta / dt) (z - 1) / (z - 1 + delta),   delta = dt / t_filter

    In mode 2 the integral of speed is that of pitch's command: instead of ki ..., k_mid dt z / (z - 1) C_beta(z).
    The z-transform of `vpp_fmu.kernel.effects.dual_pid`; `settings`: all of the controller's values.
    """
    dt = settings["sample_time"]
    delta = dt / max(settings["t_filter"], dt)
    z = np.exp(1j * omega * dt)
    kp, ki, kd = (settings[f"{gain}_{channel}"] for gain in ("kp", "ki", "kd"))
    if channel == "omega" and settings.get("mode") == ALLOCATED:
        integral = settings["k_mid"] * dt * z / (z - 1.0) * controller_response(settings, "beta", omega)
    else:
        integral = ki * 0.5 * dt * (z + 1.0) / (z - 1.0)
    return kp + integral + kd * delta / dt * (z - 1.0) / (z - 1.0 + delta)
