"""The physics behind the emulated rig's buses, stepped in time and read by the emulated devices as volts and marks' passes."""

import warnings
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import exp, floor, sqrt

import numpy as np

from vpp_fmu.kernel.types import Model
from vpp_fmu.native.stepper import Stepper

STEP = 0.001
"""Step, s, the largest that the physics allows; thrust and the mark's passes are interpolated linearly within it."""

AMBIENT, HEATS, WARMS = 20.0, 0.15, 60.0
"""The motor's temperature (chosen): room temperature [degC], final rise above it per A^2 [degC], time constant [s]."""

_KEPT = 64
"""Number of steps that are kept: conversions end in the past, but never this far."""


@dataclass(frozen=True)
class LoadCell:
    """The amplifier's output: `zero` [V] without load, `volts_per_newton`; noise as in the shared records of the rig.

    Standard deviations: `white` [N] of a reading, and `slow` [N] with the correlation time `memory` [s].
    """

    zero: float
    volts_per_newton: float
    white: float = 0.12
    slow: float = 0.047
    memory: float = 0.13


class World:
    """A `model` with throttle, beta_ref and supply as inputs, from rest at `start` [s]; `parameters`: changes to defaults.

    `driven()` returns the commands on the outputs: (throttle [1], pitch command [deg]). `jitter` [s]: timing error of a pass of
    the mark, standard deviation. The same `seed` and the same commands give the same numbers.
    """

    def __init__(
        self,
        model: Model,
        parameters: Mapping[str, float],
        driven: Callable[[], tuple[float, float]],
        cell: LoadCell,
        seed: int = 0,
        start: float = 0.0,
        jitter: float = 25e-6,
    ):
        self._driven, self._cell, self._from, self._jitter = driven, cell, start, jitter
        inputs = {s.name: s.start for s in model.inputs}
        inputs["throttle"], inputs["beta_ref"] = driven()
        self._others = [inputs[s.name] for s in model.inputs]
        names = [s.name for s in model.inputs]
        self._throttle, self._pitch = names.index("throttle"), names.index("beta_ref")
        with warnings.catch_warnings():  # without a compiler it is fast enough
            warnings.simplefilter("ignore", RuntimeWarning)
            self._stepper = Stepper(model, parameters)
        self._stepper.start(self._others)
        places = {y.name: k for k, y in enumerate(model.outputs)}
        self._at = [places[name] for name in ("thrust", "omega", "beta", "angle")]
        self._current_at, self._torque_at = places["current"], places["torque"]
        values = model.values(parameters)
        self._source, self._leads = inputs["supply"], values["lead_resistance"]
        self.voltage, self.current, self.temperature, self.torque = self._source, 0.0, AMBIENT, 0.0
        self._steps, self._angle = 0, 0.0
        self._thrusts = [0.0] * _KEPT
        self._passes: list[tuple[float, int, float]] = [(start, 0, 0.0)]
        self._normal = _Normal(seed)
        self._drift, self._drifted_at = cell.slow * next(self._normal), start
        self.omega = self.beta = self.thrust = 0.0
        self.pulled = 0.0  # N on the load cell, beside the thrust

    def advance(self, t: float) -> None:
        """Simulate up to time t [s] in whole steps."""
        count = floor((t - self._from) / STEP + 1e-6) - self._steps
        if count <= 0:
            return
        self._others[self._throttle], self._others[self._pitch] = self._driven()
        thrust_at, omega_at, beta_at, angle_at = self._at
        for _ in range(count):
            row = self._stepper.step(self._others, STEP)
            self._steps += 1
            self._thrusts[self._steps % _KEPT] = row[thrust_at]
            if floor(row[angle_at]) > floor(self._angle):
                self._pass(row[angle_at])
            self._angle = row[angle_at]
        self.thrust, self.omega, self.beta = row[thrust_at], row[omega_at], row[beta_at]
        motor, self.torque = row[self._current_at], row[self._torque_at]
        self.current = self._others[self._throttle] * motor
        self.voltage = self._source - self._leads * self.current
        kept = exp(-count * STEP / WARMS)
        self.temperature = kept * self.temperature + (1.0 - kept) * (AMBIENT + HEATS * motor**2)

    def volts(self, t: float) -> float:
        """The amplifier's output at time t [s]; each call draws new noise."""
        cell, position = self._cell, (t - self._from) / STEP
        k = min(max(floor(position), self._steps - _KEPT + 2, 0), self._steps)
        before, after = self._thrusts[k % _KEPT], self._thrusts[min(k + 1, self._steps) % _KEPT]
        thrust = before + (after - before) * min(max(position - k, 0.0), 1.0)
        kept = exp(-max(t - self._drifted_at, 0.0) / cell.memory)
        self._drift = kept * self._drift + cell.slow * sqrt(1.0 - kept * kept) * next(self._normal)
        self._drifted_at = t
        return cell.zero + cell.volts_per_newton * (thrust + self.pulled + self._drift + cell.white * next(self._normal))

    def pulses(self, t: float) -> tuple[int, float, float]:
        """Passes of the mark up to time t [s], the time of the last [s], and the period of the last whole revolution [s]."""
        k = bisect_right(self._passes, (t, 2**62, 0.0)) - 1
        when, count, period = self._passes[max(k, 0)]
        return count, when, period

    def _pass(self, angle: float) -> None:
        """Record a pass of the mark within the last step."""
        share = (floor(angle) - self._angle) / (angle - self._angle)
        when = self._from + (self._steps - 1 + share) * STEP
        seen = when + self._jitter * min(max(next(self._normal), -3.0), 3.0)
        last, count, _ = self._passes[-1]
        self._passes.append((seen, count + 1, seen - last if count else 0.0))
        if len(self._passes) > _KEPT:
            del self._passes[: _KEPT // 2]


class _Normal:
    """Standard normal numbers, one at a time, drawn in blocks."""

    def __init__(self, seed: int):
        self._generator, self._block = np.random.default_rng(seed), iter(())

    def __next__(self) -> float:
        for value in self._block:
            return value
        self._block = iter(self._generator.standard_normal(8192).tolist())
        return next(self._block)
