"""How a log's rows were written: when its readings were taken relative to its commands, and what measured the speed."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from vpp_fmu.record import Record
from vpp_fmu.sensors import UNKNOWN, SpeedSensor

SIGNIFICANT = 4.4
"""Standard errors from which an offset or a delay differs from another value: half a BIC difference of 5 nats, as is asked for
an effect, in ten thousand readings, sqrt(2 * 5 + ln 10^4)."""

FINEST = 0.02
"""Rows: a signal is taken as straight from row to row, which an offset can be no finer than."""


@dataclass(frozen=True)
class Logger:
    """`rows`: by which commands act later than the readings of their row, negative: earlier; `std`: its standard error.
    `sensor`: of the speed, `sensor_std` [s]: standard errors of its numbers that were estimated. `period` [s]: of the rows."""

    rows: float = 0.0
    std: float = 0.0
    sensor: SpeedSensor = UNKNOWN
    sensor_std: Mapping[str, float] = field(default_factory=dict)
    period: float = 0.0

    @property
    def offset(self) -> float:
        """s by which readings are taken before the command of their row acts; negative: after it acts."""
        return self.rows * self.period

    def applied(self, record: Record) -> Record:
        """The record with its commands beside the readings that they act on, and its sensor."""
        moved = record.commands_later(self.rows) if self.rows else record
        return replace(moved, sensor=self.sensor) if "omega" in record else moved

    @property
    def plain(self) -> bool:
        """Whether it is the contract's: it reads before it commands, and its speed sensor has neither delay nor filter."""
        return not (self.rows or self.sensor.delay or self.sensor.filter)

    def agrees_with(self, other: "Logger") -> bool:
        """Whether both are the same within their standard errors."""
        same = (self.sensor.kind, self.sensor.marks_per_revolution) == (other.sensor.kind, other.sensor.marks_per_revolution)
        pairs = [(self.rows, other.rows, max(self.std, other.std, FINEST))]
        pairs += [
            (getattr(self.sensor, n), getattr(other.sensor, n), max(s, FINEST * self.period))
            for n, s in self.sensor_std.items()
        ]
        return same and all(abs(a - b) <= SIGNIFICANT * std for a, b, std in pairs)

    @property
    def lines(self) -> list[str]:
        """In words."""
        told = []
        if self.rows:
            late = "later" if self.rows > 0.0 else "earlier"
            told.append(
                f"a command acts {abs(self.rows):.3g} ± {self.std:.1g} rows ({1e3 * abs(self.offset):.3g} ms) {late} than the"
                " readings of its row"
            )
        if self.sensor.kind:
            told.append(f"speed sensor: {self.sensor.text}")
        return told

    def summary(self) -> dict:
        """For JSON files."""
        return {
            "command_offset": {"value": self.rows, "std": self.std, "unit": "rows"},
            "row_period": {"value": self.period, "unit": "s"},
            "speed_sensor": self.sensor.summary(),
        }
