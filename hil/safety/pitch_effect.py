"""Test from the thrust whether the blades follow their command: the actuator has no position feedback.

Pitch and speed change the thrust T. With the map h, the measured speed, and the commanded pitch filtered by its two lags, SPAN
ago (0) and now (1):

    G = h(omega1, beta1) - h(omega1, beta0)                    expected change due to pitch
    M = (T1 - T0) - (h(omega1, beta0) - h(omega0, beta0))      measured change minus that due to speed

M = G if the blades follow their command, M = 0 if they do not move. `effect`, the slope of M against G with exponential
forgetting, is then 1 or 0; a map that is 15 % wrong gives 0.85 or 1.15.
"""

from collections import deque
from collections.abc import Mapping
from math import exp
from types import SimpleNamespace

from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.scales import PAPER

BLOCK = 0.04
"""Averaging time of readings: faster than the actuator, slower than the noise. All times here are in the rig's time scale, half
a second for the paper's."""

SPAN = 2.0
"""Time between before and now: longer than a move of the pitch actuator, shorter than a drift of the load cell."""

FORGET = 4.0
"""Forgetting time, to a weight of 1 / e."""

SPEED_UNCERTAINTY = 0.25
"""Relative error of the change due to speed, which a stuck pitch or a wrong map may cause."""


class PitchEffect:
    """`effect` [1] and its excitation `moved` [N^2 s], the integral of G^2. Both are 0 at the start.

    `bound` [1]: the largest effect, given the error of the change due to speed. `parameters`: of the plant, by the kernel's
    names; the others have their defaults. `dt` [s]: from one `update` to the next; `time_scale` [s]: of the rig.
    """

    def __init__(self, dt: float, parameters: Mapping[str, float] | None = None, time_scale: float = PAPER.time_scale):
        known = BASE.values()
        values = {**known, **{name: value for name, value in (parameters or {}).items() if name in known}}
        self._map = SimpleNamespace(**values)
        self._gains = tuple(1.0 - exp(-dt / values[name]) for name in ("tau_beta_2", "tau_beta_1"))
        self._rows = max(1, round(BLOCK * time_scale / dt))
        self._step, self._keep = self._rows * dt, exp(-self._rows * dt / (FORGET * time_scale))
        self._past: deque[tuple[float, float, float]] = deque(maxlen=max(1, round(SPAN * time_scale / self._step)))
        self._inner = self._beta = None
        self._sums, self._count = [0.0, 0.0], 0
        self.moved = self._product = self._uncertainty = 0.0

    @property
    def effect(self) -> float:
        return self._product / self.moved if self.moved else 0.0

    @property
    def bound(self) -> float:
        return (self._product + self._uncertainty) / self.moved if self.moved else 0.0

    def update(self, thrust: float, omega: float, beta_ref: float) -> None:
        """Add readings [N, rpm] and the command [deg] that acted on them."""
        if self._beta is None:
            self._inner = self._beta = beta_ref
        self._inner += self._gains[0] * (beta_ref - self._inner)
        self._beta += self._gains[1] * (self._inner - self._beta)
        self._sums[0] += thrust
        self._sums[1] += omega
        self._count += 1
        if self._count == self._rows:
            self._compare(self._sums[0] / self._rows, self._sums[1] / self._rows, self._beta)
            self._sums, self._count = [0.0, 0.0], 0

    def _compare(self, thrust: float, omega: float, beta: float) -> None:
        if len(self._past) == self._past.maxlen:
            thrust_0, omega_0, beta_0 = self._past[0]
            middle = self._thrust(omega, beta_0)
            expected, by_speed = self._thrust(omega, beta) - middle, middle - self._thrust(omega_0, beta_0)
            self.moved = self._keep * self.moved + expected * expected * self._step
            self._product = self._keep * self._product + expected * (thrust - thrust_0 - by_speed) * self._step
            self._uncertainty = self._keep * self._uncertainty + SPEED_UNCERTAINTY * abs(expected * by_speed) * self._step
        self._past.append((thrust, omega, beta))

    def _thrust(self, omega: float, beta: float) -> float:
        own = self._map
        w, b = omega / own.omega_scale, (beta + own.beta_offset) / own.beta_scale
        return own.thrust_scale * normalised_thrust(own, w, b)
