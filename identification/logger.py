"""The logger of a record: the offset of its readings to its commands, and the kind of speed sensor."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from vpp_fmu.record import Record
from vpp_fmu.sensors import UNKNOWN, SpeedSensor

SIGNIFICANT = 4.4
"""Standard errors by which an offset or a delay must differ from another value: half a BIC difference of 5 nats, as for
effects, with ten thousand readings, sqrt(2 * 5 + ln 10^4)."""

FINEST = 0.02
"""Resolution of an offset, in rows: signals are interpolated linearly between rows."""


@dataclass(frozen=True)
class Logger:
    """`rows`: delay of commands to the readings of their row, in rows; negative: commands act earlier; `std`: its standard
    error. `sensor`: of the speed; `sensor_std` [s]: standard errors of its estimated parameters. `period` [s]: of the rows."""

    rows: float = 0.0
    std: float = 0.0
    sensor: SpeedSensor = UNKNOWN
    sensor_std: Mapping[str, float] = field(default_factory=dict)
    period: float = 0.0

    @property
    def offset(self) -> float:
        """Seconds from the readings of a row until its command acts; negative: the command acts first."""
        return self.rows * self.period

    def applied(self, record: Record) -> Record:
        """The record with its sensor, and with the commands shifted to the rows in which they act."""
        moved = record.commands_later(self.rows) if self.rows else record
        return replace(moved, sensor=self.sensor) if "omega" in record else moved

    def agrees_with(self, other: "Logger", errors: float = SIGNIFICANT) -> bool:
        """Whether both are equal within so many standard `errors`."""
        fixed = [(s.kind, s.marks_per_revolution, s.averaged) for s in (self.sensor, other.sensor)]
        pairs = [(self.rows, other.rows, max(self.std, other.std, FINEST))]
        own, its = self.sensor_std, other.sensor_std
        pairs += [
            (getattr(self.sensor, n), getattr(other.sensor, n), max(own.get(n, its.get(n)), FINEST * self.period))
            for n in own | its
        ]
        return fixed[0] == fixed[1] and all(abs(a - b) <= errors * std for a, b, std in pairs)

    @property
    def lines(self) -> list[str]:
        """The logger in words."""
        lines = []
        if self.rows:
            late = "later" if self.rows > 0.0 else "earlier"
            lines.append(
                f"a command acts {abs(self.rows):.3g} ± {self.std:.1g} rows ({1e3 * abs(self.offset):.3g} ms) {late} than the"
                " readings of its row"
            )
        if self.sensor.kind:
            lines.append(f"speed sensor: {self.sensor.text}")
        return lines

    def summary(self) -> dict:
        """Content for JSON files."""
        return {
            "command_offset": {"value": self.rows, "std": self.std, "unit": "rows"},
            "row_period": {"value": self.period, "unit": "s"},
            "speed_sensor": self.sensor.summary(),
        }
