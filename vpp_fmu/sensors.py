"""The rig's speed sensor, declared in `rig.json` or inferred from a record."""

from dataclasses import asdict, dataclass

MARK, ENCODER, TELEMETRY = "mark", "encoder", "telemetry"

KINDS = {
    MARK: "mean speed between the last two pulses, held until the next one",
    ENCODER: "speed at the instant of the reading",
    TELEMETRY: "filtered speed, renewed at a fixed interval and held",
}
"""Meaning of a reading, by kind."""


@dataclass(frozen=True)
class SpeedSensor:
    """A speed sensor. `kind`: one of KINDS, "": unknown.

    `marks_per_revolution`: pulses of a mark sensor. `filter` [s]: time constant of a first-order low-pass. `refresh` [s]:
    interval between two values, 0: a new value in every row. `delay` [s]: delay of a reading against the thrust reading of its
    row, negative if it is earlier. `averaged`: a reading is the mean over its row, whose middle is its time.
    """

    kind: str = ""
    marks_per_revolution: int = 1
    filter: float = 0.0
    refresh: float = 0.0
    delay: float = 0.0
    averaged: bool = False

    def summary(self) -> dict:
        """The entry of a rig.json, without unknown fields."""
        entry = asdict(self) if self.kind else {}
        if self.kind != MARK:
            entry.pop("marks_per_revolution", None)
        return {name: value for name, value in entry.items() if value}

    @property
    def text(self) -> str:
        """The sensor in words."""
        if not self.kind:
            return "speed sensor not known"
        marks = f", {self.marks_per_revolution} per revolution" if self.kind == MARK else ""
        times = {"filter": self.filter, "new value every": self.refresh, "delay": self.delay}
        parts = [f"{name} {1e3 * value:.3g} ms" for name, value in times.items() if value]
        return ", ".join([f"{self.kind}{marks} ({KINDS[self.kind]})", *parts, *["mean over the row"] * self.averaged])


UNKNOWN = SpeedSensor()
"""An unknown sensor."""
