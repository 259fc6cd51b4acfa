"""Content of the page, from the log's memory and events: averaged curves of the last minutes, events and progress."""

import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from hil.loop.columns import LEARNED
from hil.loop.cycle import PERIOD
from hil.loop.log import Reader

BIN = 25
"""Ticks per point of a curve, the mean over 0.1 s."""
KEPT = 1800
"""Points that are kept for a browser that connects late: three minutes."""

MEANS = ("thrust", "omega", "residual")
LATEST = ("thrust_set", "omega_ref", "beta_ref", "omega_wanted", "beta_wanted")
"""Values of a point after its time [s]: MEANS in N, rpm and N (rig minus twin); LATEST set-point and commands in N, rpm, deg.
A twin adds its band [N] and parameters, each in its unit, to the latest."""
SUPPLY = ("voltage", "current", "temperature", "torque")
BAND = f"{LEARNED}band"
VALUES = ("time", *MEANS, *LATEST, BAND, "throttle", "thrust_age", "omega_age", "late", *SUPPLY)


class Story:
    """Content for one command, part by part. `told`: content of hil.json at the start; `now`: the newest values."""

    def __init__(self):
        self.told: dict = {}
        self.part: dict = {}
        self.number = 0
        self.now: dict = {}
        self.points: list[list] = []  # of the curves
        self.first = 0  # number of the oldest of them
        self.events: list[dict] = []
        self.map: list[list[float]] = []
        self.counters: dict = {}
        self.ended = ""
        self._latest = LATEST
        self._reader: Reader | None = None
        self._events: _Tail | None = None

    def tell(self, message: Mapping, descriptors: Sequence[int]) -> None:
        """Take a message of the loop's process, between the runs."""
        if "told" in message:
            self.told = message["told"]
            if adapted := self.told.get("twin", {}).get("adapted"):
                self._latest = (*LATEST, BAND, *(f"{LEARNED}adapted.{name}" for name in adapted))
        if "part" in message:
            self._begin(message)
        if "log" in message:
            log = message["log"]
            self._names = [name for name, _ in log["columns"]]
            self._words = {name: words for name, words in log["columns"] if words}
            self._reader = Reader(descriptors[0], log["slots"], len(self._names))
            self._events = _Tail(Path(log["events"]))
            self._bin: list[Sequence[float]] = []
        if "ended" in message:
            self.look()
            self.ended = message["ended"]

    def look(self) -> None:
        """Take new data since the last call."""
        if self._reader is None:
            return
        rows = self._reader.rows()
        for row in rows:
            self._take(row)
        for event in self._events.new():
            self._hear(event)
        if rows:
            self._show(dict(zip(self._names, rows[-1], strict=True)))

    def since(self, number: int, point: int, event: int, mapped: int) -> dict:
        """New data for a browser that has those up to these counts; the whole part if it has another part `number`."""
        told: dict = {
            "now": {**self.now, "age": self._age(), "done": self._reader and self._reader.done},
            "counters": self.counters,
        }
        if number != self.number:
            point = event = mapped = 0
            told |= {"told": self.told, "part": self.part, "columns": ["time", *MEANS, *self._latest]}
        told |= {"number": self.number, "curves": self.points[max(0, point - self.first) :], "events": self.events[event:]}
        told |= {"map": self.map[mapped:], "seen": [self.first + len(self.points), len(self.events), len(self.map)]}
        return told | ({"ended": self.ended} if self.ended else {})

    def _begin(self, message: Mapping) -> None:
        self.look()
        self.part, self.number = {k: v for k, v in message.items() if k != "before"}, self.number + 1
        self.points, self.first, self.events, self.map, self.counters = [], 0, [], [], {}
        self._reader, self._heard = None, time.monotonic()
        self._twin: dict[str, float | None] = {}
        for path in message["before"]:
            for event in _Tail(Path(path)).new():
                if "point" in event:
                    self._hear(event)

    def _take(self, row: Sequence[float]) -> None:
        self._bin.append(row)
        slot = round(row[0] / PERIOD)
        if slot // BIN == (slot + 1) // BIN:
            return
        columns = dict(zip(self._names, zip(*self._bin, strict=True), strict=True))
        point = [_known(row[0])]
        point += [_known(sum(columns[name]) / len(self._bin)) for name in MEANS]
        self.points.append(point + [_known(columns[name][-1]) for name in self._latest])
        band = columns.get(BAND)
        if band and math.isfinite(band[-1]):  # else the loop is open, and the last values stay
            self._twin = {k.removeprefix(LEARNED): _known(values[-1]) for k, values in columns.items() if k.startswith(LEARNED)}
        self._bin = []
        if len(self.points) > 2 * KEPT:
            self.first += len(self.points) - KEPT
            del self.points[:-KEPT]

    def _hear(self, event: Mapping) -> None:
        if "point" in event:
            self.map.append(event["point"][:4])
        elif "counters" in event:
            self.counters = event["counters"]
        elif "state" in event:
            self.events.append(dict(event))

    def _show(self, row: Mapping[str, float]) -> None:
        self._heard = time.monotonic()
        self.now = {name: _known(row.get(name, math.nan)) for name in VALUES}
        self.now["state"] = self._words["state"][int(row["state"])]
        self.now["alarm"] = bool(row["alarm"])
        self.now["twin"] = self._twin

    def _age(self) -> float | None:
        """s since the last tick."""
        return time.monotonic() - self._heard if self.now and self._reader else None


class _Tail:
    """The whole lines of a file that grows."""

    def __init__(self, path: Path):
        self._path, self._read = path, 0

    def new(self) -> list[dict]:
        """Those that came since the last call."""
        try:
            with open(self._path, "rb") as file:
                file.seek(self._read)
                data = file.read()
        except OSError:  # it is created with the first event
            return []
        whole = data[: data.rfind(b"\n") + 1]
        self._read += len(whole)
        return [json.loads(line) for line in whole.splitlines()]


def _known(value: float) -> float | None:
    """JSON has no NaN."""
    return value if math.isfinite(value) else None
