"""Check of signs before a loop is closed: at low speed the pitch is increased, and thrust must change about as in the map.

With the mean thrusts T1, T2 [N] at two pitches, and T1*, T2* of the map at the measured speeds,

    slope = (T2 - T1) / (T2* - T1*)

is 1 if the rig agrees with the map, and negative if either the load cell or the pitch has the wrong sign. If both have, the
slope is right and the level (T1 + T2) is wrong. If no map is known yet, thrust must increase with pitch.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace

from hil.safety.faults import Fault, FaultKind
from hil.safety.limits import Limits
from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.rig import Rig

SPEED = 1.0 / 3.0
"""Share of the rig's speed scale: 2000 rpm of 6000, where the paper's rig makes 1 N."""

SHARES = 0.25, 0.75
"""Shares of the pitch range: -5 and 5 deg of -10 to 10."""

SETTLE, AVERAGE = 1.2, 1.0
"""Durations in the rig's time scale: 0.6 s and 0.5 s for the paper's. Its slower lag is 0.2 s: 5 % of the move remains."""

SURE = 4.0
"""Standard errors: one check in 30 000 is wrong by chance."""

SLOPES = 0.3, 3.0
"""Allowed range of the slope: dead bands, play and a drifted gain give 0.6 to 1.5."""


@dataclass(frozen=True)
class Level:
    """Thrust [N], mean with its standard error, at the speed [rpm] measured and the pitch [deg] commanded."""

    thrust: float
    error: float
    omega: float
    beta: float


class Polarity:
    """The commands of the check (`omega` [rpm], `betas` [deg], `settle` and `average` [s]) and its verdict.

    `parameters`: of the plant by the kernel's names, for the map (default: the paper's); `known`: whether the map is known.
    """

    def __init__(self, limits: Limits, rig: Rig, parameters: Mapping[str, float] | None = None, known: bool = True):
        names = BASE.values()
        self._map = SimpleNamespace(**{**names, **{n: v for n, v in (parameters or {}).items() if n in names}})
        self._known = known
        self.omega = min(SPEED * rig.scales.omega_scale, limits.omega_max)
        span = limits.beta_max - limits.beta_min
        self.betas = tuple(limits.beta_min + share * span for share in SHARES)
        longer = max(rig.scales.time_scale, PAPER.time_scale)
        self.settle, self.average = SETTLE * longer, AVERAGE * longer

    @property
    def possible(self) -> bool:
        """Whether the pitch moves."""
        return self.betas[1] > self.betas[0]

    def judge(self, low: Level, high: Level) -> Fault | None:
        """The fault that the two levels show significantly, or None."""
        rise, error = high.thrust - low.thrust, SURE * (low.error**2 + high.error**2) ** 0.5
        seen = f"found {low.thrust:.2f} to {high.thrust:.2f} N from {low.beta:g} to {high.beta:g} deg at {high.omega:.0f} rpm"
        expected = self._thrust(high) - self._thrust(low) if self._known else abs(rise)
        level = self._thrust(high) + self._thrust(low) if self._known else 0.0
        negative = high.thrust + low.thrust < -error
        if rise * expected < 0.0 and abs(rise) > error:
            device, what = ("load cell", "the load cell's") if negative and level >= 0.0 else ("pitch actuator", "the pitch's")
            return Fault(device, FaultKind.POLARITY, f"{seen}, expected the other sign, likely {what}")
        if level > error and negative:
            return Fault("load cell", FaultKind.POLARITY, f"{seen}, expected the other sign of both")
        if self._known and abs(expected) > 2.0 * error and not SLOPES[0] <= rise / expected <= SLOPES[1]:
            found = f"{seen}, {rise / expected:.2f} of the map's {expected:.2f} N, expected {SLOPES[0]:g} to {SLOPES[1]:g}"
            return Fault("pitch actuator", FaultKind.SLOPE, found)
        return None

    def _thrust(self, at: Level) -> float:
        own = self._map
        w, b = at.omega / own.omega_scale, (at.beta + own.beta_offset) / own.beta_scale
        return own.thrust_scale * normalised_thrust(own, w, b)
