"""Interval observer of the rotor speed, from the throttle and the last accepted reading.

    upper bound:  d omega/dt = (free (1 + tolerance) throttle - omega) / tau_fast,  never falling
    lower bound:  d omega/dt = (free (1 - tolerance) throttle - omega) / tau
                  tau = tau_fast while it falls (an ESC that brakes), tau_slow while it rises

`free` is the motor's no-load speed at throttle 1. No motor within these bounds can reach half or twice the speed (a mark missed
or seen twice), or standstill at an open throttle.
"""

from dataclasses import dataclass
from math import exp


@dataclass(frozen=True)
class RotorPhysics:
    """Parameters of the bounds. Defaults: 550 rpm/V on 24 V, the paper's motor and supply.

    `free` [rpm]: speed at throttle 1 without a load. `tolerance` [1]: relative deviation of the speed from proportionality to
    throttle, for load, supply and the ESC's curve; below a third, else a doubled reading fits. `tau_fast`, `tau_slow` [s]:
    shortest and longest mechanical time constant J R / k^2 of motor and rotor (0.09 s with the rig's inertia). `error` [1]
    and `jitter` [rpm]: of a reading (the mark's edge, the 4 us timer).
    """

    free: float = 13200.0
    tolerance: float = 0.3
    tau_fast: float = 0.04
    tau_slow: float = 0.5
    error: float = 0.02
    jitter: float = 30.0


class RotorBounds:
    """`low` and `high` [rpm]: bounds of the present speed. `turning`: whether the last accepted reading is above 0."""

    def __init__(self, physics: RotorPhysics):
        self._physics = physics
        self.low = self.high = self._lowest = self._highest = 0.0
        self.turning = False

    def advance(self, throttle: float, dt: float) -> None:
        """Advance the bounds by dt [s] at a constant throttle [0..1]."""
        self.low, self.high = self._moved(self.low, self.high, throttle, dt)
        if not self.turning:
            self.low = 0.0  # a motor may take its time to start
        self._lowest, self._highest = min(self._lowest, self.low), max(self._highest, self.high)

    def allows(self, omega: float) -> bool:
        """Whether the mean speed [rpm] since the last accepted reading can be this."""
        own = self._physics
        return self._lowest * (1.0 - own.error) - own.jitter <= omega <= self._highest * (1.0 + own.error) + own.jitter

    def misses(self, age: float) -> bool:
        """Whether a rotor within the bounds must have passed its mark again in the `age` [s] since it last did."""
        return self._lowest * age * (1.0 - self._physics.error) > 60.0 + self._physics.jitter * age

    def believe(self, omega: float, throttle: float, old: float) -> None:
        """Accept this mean speed [rpm] over a revolution that began `old` [s] ago."""
        self.turning = omega > 0.0
        low, high = self._moved(omega, omega, throttle, old)
        own = self._physics
        # The reading narrows the bounds; if it lies outside them by its own error, it moves them.
        self.low = max(min(self.low, omega), low * (1.0 - own.error) - own.jitter) if self.turning else 0.0
        self.high = min(max(self.high, omega), high * (1.0 + own.error) + own.jitter)
        self._lowest, self._highest = self.low, self.high

    def _moved(self, low: float, high: float, throttle: float, dt: float) -> tuple[float, float]:
        own = self._physics
        fast, slow = 1.0 - exp(-dt / own.tau_fast), 1.0 - exp(-dt / own.tau_slow)
        top, bottom = own.free * (1.0 + own.tolerance) * throttle, own.free * (1.0 - own.tolerance) * throttle
        return low + (bottom - low) * (fast if low > bottom else slow), high + max(top - high, 0.0) * fast
