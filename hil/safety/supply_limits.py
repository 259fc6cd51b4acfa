"""What the motor's supply may show while the rotor is driven."""

from collections import Counter
from collections.abc import Iterable, Mapping

from hil.devices.supply import NAMES
from hil.safety.faults import Fault, FaultKind
from hil.safety.limits import Limits

READINGS = 2
"""In a row that must be beyond a limit: one can be a spark."""


class SupplyLimits:
    """Looks at each new reading."""

    def __init__(self, limits: Limits):
        self._ranges = {
            "voltage": (limits.voltage_min, limits.voltage_max),
            "current": (-limits.current_max, limits.current_max),
            "temperature": (-float("inf"), limits.temperature_max),
        }
        self._beyond: Counter[str] = Counter()

    def check(self, values: Mapping[str, float], new: Iterable[str]) -> Fault | None:
        """Of the `values` by name those that are `new`; the first that is beyond its limit once more."""
        for name in new:
            low, high = self._ranges[name]
            inside = low <= values[name] <= high
            self._beyond[name] = 0 if inside else self._beyond[name] + 1
            if self._beyond[name] >= READINGS:
                unit, bound = NAMES[name], f"at least {low:g}" if values[name] < low else f"at most {high:g}"
                return Fault("supply", FaultKind.SUPPLY, f"{name} {values[name]:.1f} {unit}, allowed is {bound} {unit}")
        return None
