"""The loop's time grid: absolute deadlines, and the treatment of missed ones."""

from collections import deque
from typing import NamedTuple

from hil.devices.clock import Clock


class Tick(NamedTuple):
    """One tick: its `slot` of the grid, how `late` [s] it was for the deadline it waited for, and the `missed` slots."""

    slot: int
    late: float
    missed: int


class Ticks:
    """Deadlines every `dt` [s] from now on. A tick that is too late for its slot takes the present one: missed slots are
    skipped, and the phase is kept. `missed` and `ticks` count from the start."""

    def __init__(self, clock: Clock, dt: float):
        self._clock, self.dt, self._zero = clock, dt, clock.now()
        self.slot = self.missed = self.ticks = 0
        self._window: deque[tuple[int, int]] = deque()  # (slot, missed) of the last second

    def wait(self) -> Tick:
        """Sleep until the next deadline."""
        wanted = self.slot + 1
        late = self._clock.wait_until(self._zero + wanted * self.dt)
        missed = int(late / self.dt)
        self.slot, self.ticks, self.missed = wanted + missed, self.ticks + 1, self.missed + missed
        if missed:
            self._window.append((self.slot, missed))
        return Tick(self.slot, late, missed)

    def resume(self) -> None:
        """Continue after an intended break: its slots don't count as missed."""
        self.slot = max(self.slot, int((self._clock.now() - self._zero) / self.dt))
        self._window.clear()

    @property
    def missed_share(self) -> float:
        """Share of the last second's slots that were missed."""
        second = 1.0 / self.dt
        while self._window and self._window[0][0] <= self.slot - second:
            self._window.popleft()
        return sum(missed for _, missed in self._window) / second

    @property
    def time(self) -> float:
        """Time of the present slot, from the start [s]."""
        return self.slot * self.dt
