"""Content of the page, from the log's memory and events: averaged curves of the last minute, events and progress."""

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from hil.loop.columns import LEARNED, STATES
from hil.loop.cycle import PERIOD
from hil.loop.log import Reader, read_events

BIN = 25
"""Ticks per point of a curve, the mean over 0.1 s."""
KEPT = 650
"""Points for a browser that connects late: those that it shows."""

BAND = f"{LEARNED}band"
MEANS = ("thrust", "omega", "residual")
LATEST = ("thrust_set", "omega_ref", "beta_ref", "omega_wanted", "beta_wanted", BAND)
"""Values of a point after its time [s]: MEANS in N, rpm and N (rig minus twin); LATEST set-point and commands in N, rpm, deg,
and the twin's band [N]."""


class Story:
    """Content for one command, part by part. `told`: content of hil.json at the start."""

    def __init__(self):
        self.told: dict = {}
        self.number, self.ended = 0, ""
        self._begin({})

    def tell(self, message: Mapping, descriptors: Sequence[int]) -> None:
        """Take a message of the loop's process, between the runs."""
        self.told = message.get("told", self.told)
        if "part" in message:
            self.look()
            self._begin(message)
        if "log" in message:
            log = message["log"]
            self._names, self._events = log["columns"], Path(log["events"])
            self._reader = Reader(descriptors[0], log["slots"], len(self._names))
        if "ended" in message:
            self.look()
            self.ended = message["ended"]

    def look(self) -> None:
        """Take new data since the last call."""
        if self._reader is None:
            return
        for row in self._reader.rows():
            self._take(dict(zip(self._names, row, strict=True)))
        size = self._events.stat().st_size if self._events.exists() else 0  # it is created with the first event
        if size > self._size:
            new = read_events(self._events)[self._read :]
            self._size, self._read = size, self._read + len(new)
            for event in new:
                self._hear(event)

    def since(self, number: int, point: int, event: int, mapped: int) -> dict:
        """New data for a browser that has those up to these counts; the whole part if it has another part `number`."""
        told: dict = {"now": self._now(), "counters": self._counters}
        if number != self.number:
            point = event = mapped = 0
            told |= {"told": self.told, "part": self._part, "columns": ["time", *MEANS, *LATEST]}
        told |= {"number": self.number, "curves": self._points[max(point, len(self._points) - KEPT) :]}
        told |= {"events": self._said[event:], "map": self._map[mapped:]}
        told |= {"seen": [len(self._points), len(self._said), len(self._map)]}
        return told | ({"ended": self.ended} if self.ended else {})

    def _begin(self, message: Mapping) -> None:
        self._part, self.number = {k: v for k, v in message.items() if k != "before"}, self.number + 1
        self._points, self._said, self._map, self._counters = [], [], [], {}
        self._bin: list[Mapping[str, float]] = []
        self._row: Mapping[str, float] = {}
        self._twin: Mapping[str, float] = {}
        self._reader: Reader | None = None
        self._size, self._read, self._heard = 0, 0, time.monotonic()
        for path in message.get("before", ()):
            self._map += [event["point"][:4] for event in read_events(Path(path)) if "point" in event]

    def _take(self, row: Mapping[str, float]) -> None:
        self._row, self._heard = row, time.monotonic()
        self._bin.append(row)
        if math.isfinite(row.get(BAND, math.nan)):  # else the loop is open, and the last values stay
            self._twin = row
        slot = round(row["time"] / PERIOD)
        if slot // BIN != (slot + 1) // BIN:
            means = [sum(one[name] for one in self._bin) / len(self._bin) for name in MEANS]
            self._points.append([*map(_known, (row["time"], *means, *(row.get(name, math.nan) for name in LATEST)))])
            self._bin = []

    def _hear(self, event: Mapping) -> None:
        if "point" in event:
            self._map.append(event["point"][:4])
        elif "counters" in event:
            self._counters = event["counters"]
        elif "state" in event:
            self._said.append(event)

    def _now(self) -> dict:
        """The newest values by the log's names, the twin's last ones, the time since the last tick [s], and the progress."""
        if self._reader is None or not self._row:
            return {"age": None, "done": self._reader and self._reader.done}
        now = {name: _known(value) for name, value in self._row.items()}
        now |= {"state": STATES[int(self._row["state"])], "alarm": bool(self._row["alarm"])}
        now["twin"] = {k.removeprefix(LEARNED): _known(v) for k, v in self._twin.items() if k.startswith(LEARNED)}
        return now | {"age": time.monotonic() - self._heard, "done": self._reader.done}


def _known(value: float) -> float | None:
    """JSON has no NaN."""
    return value if math.isfinite(value) else None
