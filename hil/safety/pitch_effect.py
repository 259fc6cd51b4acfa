"""Test from the thrust whether the blades follow their command: the actuator has no position feedback.

Over `span` seconds pitch and speed change the thrust. With the map h, the measured speed and the commanded pitch behind its
two lags, before (0) and now (1):

    G = h(omega1, beta1) - h(omega1, beta0)                    expected change from the blades' move
    M = (T1 - T0) - (h(omega1, beta0) - h(omega0, beta0))      measured change less that of the speed

M = G for blades that follow, M = 0 for blades that do not move. `effect`, the slope of M over G with exponential forgetting, is
1 or 0 then, and a map that is 15 % wrong gives 0.85 or 1.15.
"""

from collections import deque
from collections.abc import Mapping
from math import exp
from types import SimpleNamespace

from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.scales import PAPER

BLOCK = 0.04
"""Readings are averaged over this: faster than the actuator, slower than the noise. In the rig's time scales, half a second for
the paper's, as all times here."""

SPAN = 2.0
"""Between before and now: longer than the pitch actuator takes, shorter than the load cell drifts."""

FORGET = 4.0
"""Forgetting time, to a weight of 1 / e."""

SPEED_UNCERTAINTY = 0.25
"""Share of the speed's part of the change that may be wrong, as a stuck pitch and a wrong map make it."""


class PitchEffect:
    """`effect` [1] and its excitation `moved` [N^2 s], the integral of G^2. Both are 0 at the start.

    `bound` [1] is as much as the effect can be if the speed's part is uncertain. `parameters`: of the plant, by the kernel's
    names; what it doesn't name has its default. `dt`: s from one `update` to the next; `time_scale` [s]: of the rig.
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
        """Readings [N, rpm] and the command [deg] that acted on them."""
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
