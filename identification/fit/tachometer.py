"""What a tachometer with one mark a revolution shows of a rotor's speed.

A pulse a revolution: the value is the mean speed over the last whole revolution, held until the next pulse. Compared as if
it were the speed at the row's time, it lags by a revolution and more, and that lag passes for physics. So a prediction is
averaged as the sensor does, over a window that the measured value itself gives, and compared only where a pulse came in.
"""

import numpy as np
from scipy.sparse import csr_array

from vpp_fmu.record import Record

TIMER = 4e-6
"""Resolution of the period, s."""


MORE = 1.3
"""New values per pulse of one mark from which a sensor has more marks, or is no tachometer."""


class Tachometer:
    """Turns predicted speed (rows,) or its sensitivities (rows, k) into what the sensor would have shown at its updates.

    `rows` (m,): the rows at which a new value came in; `measured` (m,) rpm there; `std` (m,) rpm: what resolution, and the
    unknown instant of the pulse within the row's step, leave uncertain. A sensor that renews its value faster than the rotor
    turns is compared as it stands.
    """

    def __init__(self, record: Record):
        time, shown = record.time, record["omega"]
        self._time = time
        seen = np.isfinite(shown)
        # The last row before that shows anything: a value that comes back after empty rows is no new one.
        last = np.maximum.accumulate(np.where(seen, np.arange(len(shown)), 0))
        before = np.append(0, last[:-1])
        step = np.diff(time, prepend=time[0] - (time[1] - time[0]))
        step[1:] = (time - time[before])[1:]
        new = (shown != shown[before]) & seen & seen[before] & (shown > 0)
        pulses = np.minimum(np.where(np.isfinite(shown), shown, 0.0) / 60.0 * step, 1.0).sum()
        if new.sum() > MORE * pulses:  # a sensor that renews faster than the rotor turns shows the speed of the moment
            self.rows = np.flatnonzero(new)
            self.measured = shown[self.rows]
            self.std = self._uncertainty(time[self.rows], np.zeros(len(self.rows)))
            self._average = csr_array((np.ones(len(self)), (np.arange(len(self)), self.rows)), shape=(len(self), len(time)))
            return
        period = 60.0 / np.where(new, shown, 1.0)
        since = np.minimum(step, period)  # the last pulse came in this time before the row, somewhere
        end = time - 0.5 * since
        new &= end - period >= time[0]
        self.rows = np.flatnonzero(new)
        self.measured = shown[self.rows]
        self.std = self._uncertainty(end[self.rows], since[self.rows])
        self._average = _means(time, end[self.rows] - period[self.rows], end[self.rows])

    def __len__(self) -> int:
        return len(self.rows)

    def shows(self, omega: np.ndarray) -> np.ndarray:
        """Mean over the last revolution at each update: (m,) of a speed (rows,), (m, k) of columns (rows, k)."""
        return self._average @ omega

    def transpose(self, weights: np.ndarray) -> np.ndarray:
        """The transpose of `shows`: (rows,) such that its product with any speed is that of `weights` (m,) with what shows."""
        return self._average.T @ weights

    def rows_time(self, skip: float, order: int) -> tuple[np.ndarray, np.ndarray]:
        """(mask of the updates behind the first `order` that came at `skip` [s] or later, their times [s])."""
        time = self._time[self.rows][order:]
        return time >= skip, time[time >= skip]

    def _uncertainty(self, end: np.ndarray, step: np.ndarray) -> np.ndarray:
        """rpm: the display's digit, the timer's tick, the mark's jitter, and acceleration over the unknown part of a step."""
        if len(self.rows) < 3:
            return np.full(len(self.rows), 1.0)
        values = np.unique(self.measured)
        digit = np.min(np.diff(values)) if len(values) > 1 else 1.0
        tick = self.measured**2 * TIMER / 60.0
        # A pulse that comes late makes one revolution long and the next short: neighbours differ by sqrt 3 jitters.
        change = np.diff(self.measured)
        jitter = 1.4826 * np.median(np.abs(change - np.median(change))) / np.sqrt(3.0)
        rate = np.gradient(self.measured, end)
        return np.sqrt((digit**2 + 2.0 * tick**2) / 12.0 + jitter**2 + 1.5 * (rate * step) ** 2 / 12.0)


def _means(time: np.ndarray, start: np.ndarray, end: np.ndarray) -> csr_array:
    """Matrix (windows, rows): the mean over each window [start, end] of a signal that runs straight between rows."""
    steps, n = np.diff(time), len(time)
    first, last = (np.clip(np.searchsorted(time, at, side="right") - 1, 0, n - 2) for at in (start, end))
    windows, columns, weights = [], [], []
    for k in range(int(np.max(last - first, initial=-1)) + 1):
        w = np.flatnonzero(first + k <= last)
        at = first[w] + k
        # The part of the step from row `at` that lies in the window, in shares of the step.
        u, v = (np.clip((edge[w] - time[at]) / steps[at], 0.0, 1.0) for edge in (start, end))
        right = 0.5 * (v * v - u * u)
        share = steps[at] / (end[w] - start[w])
        windows += [w, w]
        columns += [at, at + 1]
        weights += [share * (v - u - right), share * right]
    if not windows:
        return csr_array((len(start), n))
    places = np.concatenate(windows), np.concatenate(columns)
    return csr_array((np.concatenate(weights), places), shape=(len(start), n))
