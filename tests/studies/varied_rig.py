"""A second emulator of rigs, in numpy, with variations that neither the project's effects nor rig.c have.

It shares its sizes, noise and speed sensors with the first one (rig.py, sensors.py), but no equation of an effect. Quantities
are normalised by the rig's scales as in rig.c, time is in s. With x, b, y, w the stages of pitch and speed, T the thrust, and
q(b) = 0.2 + 0.3 b + 0.5 b^2 the rotor's torque coefficient:

    battery    y follows w_ref V,   V = 1 - now I - v,   time dv/dt = late I - v,   I = w^2 q(b)      (Thevenin, one RC)
    heating    T (1 - loss h),      time dh/dt = w^3 q(b) - h,   h(0) = 0                             (shaft power)
    servo      b'' = p^2 (b_ref - b) - 2 ratio p b',   p^2 = 1 / (tau_b1 tau_b2)                      (overshoots)
    warming    a channel's lags are 1 + slower exp(-t / time) as long                                 (grease warms up)
    gusts      T - w v,   v: gusts 1 - cos at random times                                            (axial wind)

Battery and heating have their own time; other times are those of the rig.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vpp_fmu.record import Record

from .command_sequences import Commands
from .physics import Run
from .rig import Rig
from .sensors import BEFORE, Motion, Sensor

FINE = 0.001
"""s of a step, on the paper's rig. Lags are exact for an input that is linear within it."""

VARIATIONS = {
    "battery": ("battery_now", "battery_late", "battery_time"),
    "heating": ("heating_loss", "heating_time"),
    "servo": ("servo_ratio",),
    "warming": ("warming_slower", "warming_time", "warming_pitch"),
    "gusts": ("gust",),
}
"""Settings of each variation. `warming_pitch`: 1 for the pitch's lags, 0 for the speed's."""

EVERY, LONG = 8.0, (0.5, 3.0)
"""Mean time between gusts, and the range of their length, s."""

SETTLED = 100
"""Iterations that settle battery and speed at the start."""


def torque(b):
    """Torque coefficient over pitch; 1 at full pitch."""
    return 0.2 + 0.3 * b + 0.5 * b * b


def thrust(s: Mapping[str, float], w, b):
    """The thrust map."""
    return s["c20"] * w**2 + s["c11"] * w * b + s["c21"] * w**2 * b + s["c12"] * w * b**2 + s["c30"] * w**3


def ramp(step: float, tau: float) -> tuple[float, float, float]:
    """Weights of a lag's last value and of its input before and after a step, exact for an input linear within it."""
    keep = np.exp(-step / tau)
    mean = (1.0 - keep) * tau / step
    return keep, mean - keep, 1.0 - mean


def on_battery(s: Mapping[str, float], step: float, command: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed and voltage (n,) at the instants of the commands (n,), before each acts."""
    now, late, time = (s[n] for n in VARIATIONS["battery"])
    keep_v, keep_y, last = np.exp(-step / time), np.exp(-step / s["tau_w1"]), ramp(step, s["tau_w2"])
    w = command[0]
    for _ in range(SETTLED):
        w = command[0] * (1.0 - (now + late) * w**2 * torque(b[0]))
    y, v = w, late * w**2 * torque(b[0])
    omega, volt, loads = np.empty(len(command)), np.empty(len(command)), torque(b).tolist()
    for k, (u, q) in enumerate(zip(command.tolist(), loads, strict=True)):
        current = w * w * q
        omega[k], volt[k] = w, 1.0 - now * current - v
        v = keep_v * v + (1.0 - keep_v) * late * current
        before, y = y, keep_y * y + (1.0 - keep_y) * u * volt[k]
        w = last[0] * w + last[1] * before + last[2] * y
    return omega, volt


def two_lags(step: float, taus: tuple[float, float], slower: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Response (n,) of two lags, `slower` (n,) times their constants, at the instants of the commands, before each acts."""
    x = y = command[0]
    found, keeps = np.empty(len(command)), np.exp(-step / (slower * taus[0]))
    lasts = np.array(ramp(step, slower * taus[1])).T if np.ptp(slower) else [ramp(step, slower[0] * taus[1])] * len(command)
    for k, (u, keep, (kept, first, second)) in enumerate(zip(command.tolist(), keeps.tolist(), lasts, strict=True)):
        found[k] = y
        before, x = x, keep * x + (1.0 - keep) * u
        y = kept * y + first * before + second * x
    return found


def overshooting(step: float, p: float, ratio: float, command: np.ndarray) -> np.ndarray:
    """Response (n,) of a second-order servo, exact for commands held over a step."""
    d = p * np.sqrt(complex(1.0 - ratio**2))  # imaginary if it does not overshoot
    e = np.exp(-ratio * p * step) * (np.sin(d * step) / d).real
    a = np.exp(-ratio * p * step) * np.cos(d * step).real + ratio * p * e
    b, rate, found = command[0], 0.0, np.empty(len(command))
    for k, u in enumerate(command.tolist()):
        found[k] = b
        away = b - u
        b, rate = u + a * away + e * rate, -p * p * e * away + (a - 2.0 * ratio * p * e) * rate
    return found


def heat(step: float, time: float, power: np.ndarray) -> np.ndarray:
    """Heat (n,) of a rig that is cold at the start."""
    keep, first, second = ramp(step, time)
    h, found = 0.0, np.zeros(len(power))
    for k, (before, after) in enumerate(zip(power[:-1].tolist(), power[1:].tolist(), strict=True)):
        h = keep * h + first * before + second * after
        found[k + 1] = h
    return found


def gusts(rng: np.random.Generator, step: float, rows: int, slow: float) -> np.ndarray:
    """Wind (rows,): gusts of random times, lengths and signs, of 0.5 to 1."""
    wind, at = np.zeros(rows), 0.0
    while (at := at + rng.exponential(EVERY * slow)) < rows * step:
        shape = 0.5 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, round(slow * rng.uniform(*LONG) / step))))
        first = round(at / step)
        wind[first : first + len(shape)] += rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.0) * shape[: rows - first]
    return wind


@dataclass(frozen=True)
class Signals:
    """Normalised signals (n,) at `step` s from each other: speed, pitch, thrust, voltage."""

    step: float
    omega: np.ndarray
    beta: np.ndarray
    load: np.ndarray
    volt: np.ndarray


@dataclass(frozen=True)
class VariedRig(Rig):
    """A rig whose `settings` are base settings of rig.c and those of VARIATIONS. `sensor` of its speed, or None; `metered`:
    whether its supply voltage is measured."""

    sensor: Sensor | None = None
    metered: bool = False

    @property
    def fine(self) -> int:
        """Steps in a row."""
        return max(1, round(1.0 / self.rate / (FINE * self.size.slow)))

    def signals(self, w_ref: np.ndarray, b_ref: np.ndarray, rng: np.random.Generator | None = None) -> Signals:
        """Signals under normalised commands (rows,), `fine` steps a row, from rest. `rng`: of its gusts; None: no wind."""
        s, step = self.settings, 1.0 / self.rate / self.fine
        w_ref, b_ref = (np.repeat(np.asarray(c, float), self.fine) for c in (w_ref, b_ref))
        time = step * np.arange(len(w_ref))
        warm = 1.0 + s.get("warming_slower", 0.0) * np.exp(-time / s.get("warming_time", 1.0))
        pitch, even = s.get("warming_pitch", 0.0) > 0.5, np.ones(len(time))
        if "servo_ratio" in s:
            b = overshooting(step, 1.0 / np.sqrt(s["tau_b1"] * s["tau_b2"]), s["servo_ratio"], b_ref)
        else:
            b = two_lags(step, (s["tau_b1"], s["tau_b2"]), warm if pitch else even, b_ref)
        if "battery_time" in s:
            w, volt = on_battery(s, step, w_ref, b)
        else:
            w, volt = two_lags(step, (s["tau_w1"], s["tau_w2"]), even if pitch else warm, w_ref), even
        load = thrust(s, w, b)
        if "heating_loss" in s:
            load = load * (1.0 - s["heating_loss"] * heat(step, s["heating_time"], w**3 * torque(b)))
        if rng is not None and "gust" in s:
            load = load - w * s["gust"] * gusts(rng, step, len(w), self.size.slow)
        return Signals(step, w, b, load, volt)

    def run(self, speed: np.ndarray, pitch: np.ndarray, step: float = 0.0) -> Run:
        """As `Rig.run`, without gusts. Base settings alone are simulated by rig.c, which is faster."""
        if not any(name in self.settings for names in VARIATIONS.values() for name in names):
            return super().run(speed, pitch, step)
        found, rows = self.signals(*self.size.shares(speed, pitch)), slice(None, None, self.fine)
        turn = np.cumsum(found.omega) * found.step * self.size.speed / 60.0
        return Run(found.omega[rows], found.beta[rows], found.load[rows], self.size.speed * found.omega[rows], turn[rows])

    def observed(self, rng: np.random.Generator, commands: Commands, name: str) -> tuple[Record, np.ndarray]:
        """(a record of these normalised commands, its true force (rows,) N)."""
        speed, pitch = self.size.commands(*commands)
        found, rows = self.signals(*self.size.shares(speed, pitch), rng), slice(None, None, self.fine)
        columns = {"time": np.round(np.arange(len(speed)) / self.rate, 9), "omega_ref": speed, "beta_ref": pitch}
        if self.sensor is not None:
            shown, _ = self.sensor.shows(rng, self._motion(rng, found), columns["time"])
            columns["omega"] = np.round(shown, 2)
        force = self.size.thrust * found.load[rows]
        columns["thrust"] = self.noise.reading(rng, force)
        if self.metered:
            columns["voltage"] = np.round(self.size.volt * found.volt[rows], 2)
        return Record(columns, name), force

    def _motion(self, rng: np.random.Generator, found: Signals) -> Motion:
        """The rotor's motion, from BEFORE s at rest on; the mark is anywhere at the start."""
        rest = round(BEFORE / found.step)
        omega = self.size.speed * np.concatenate([np.full(rest, found.omega[0]), found.omega])
        time = found.step * (np.arange(len(omega)) - rest)
        return Motion(time, omega, rng.random() + np.cumsum(omega) * found.step / 60.0)
