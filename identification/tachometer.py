"""What a tachometer with one mark a revolution shows of a rotor's speed.

A pulse a revolution: the value is the mean speed over the last whole revolution, held until the next pulse. Compared as if
it were the speed at the row's time, it lags by a revolution and more, and that lag passes for physics. So a prediction is
averaged as the sensor does, over a window that the measured value itself gives, and compared only where a pulse came in.
"""

import numpy as np

from vpp_fmu.record import Record

TIMER = 4e-6
"""Resolution of the period, s."""


class Tachometer:
    """Turns predicted speed (rows,) or its sensitivities (rows, k) into what the sensor would have shown at its updates.

    `rows` (m,): the rows at which a new value came in; `measured` (m,) rpm there; `std` (m,) rpm: what resolution, and the
    unknown instant of the pulse within the row's step, leave uncertain.
    """

    def __init__(self, record: Record):
        time, shown = record.time, record["omega"]
        step = np.diff(time, prepend=time[0] - (time[1] - time[0]))
        new = np.append(False, shown[1:] != shown[:-1]) & np.isfinite(shown) & (shown > 0)
        period = 60.0 / np.where(new, shown, 1.0)
        end = time - 0.5 * step  # the pulse came somewhere between the rows
        new &= end - period >= time[0]
        self.rows = np.flatnonzero(new)
        self.measured = shown[self.rows]
        self._time = time
        self._ends, self._periods = end[self.rows], period[self.rows]
        self._at = np.concatenate([self._ends, self._ends - self._periods])
        self._before = np.clip(np.searchsorted(time, self._at, side="right") - 1, 0, len(time) - 2)
        self._share = (self._at - time[self._before]) / np.diff(time)[self._before]
        self.std = self._uncertainty(step[self.rows])

    def __len__(self) -> int:
        return len(self.rows)

    def shows(self, omega: np.ndarray) -> np.ndarray:
        """Mean over the last revolution at each update: (m,) of a speed (rows,), (m, k) of columns (rows, k)."""
        steps = np.diff(self._time).reshape(-1, *[1] * (omega.ndim - 1))
        turned = np.concatenate([np.zeros((1, *omega.shape[1:])), np.cumsum(0.5 * (omega[1:] + omega[:-1]) * steps, axis=0)])
        share = self._share.reshape(-1, *[1] * (omega.ndim - 1))
        # Between rows the speed runs straight, so the turned angle is a parabola there.
        length = (np.diff(self._time)[self._before]).reshape(share.shape)
        first, second = omega[self._before], omega[self._before + 1]
        angle = turned[self._before] + length * share * (first + 0.5 * share * (second - first))
        m = len(self.rows)
        return (angle[:m] - angle[m:]) / self._periods.reshape(-1, *[1] * (omega.ndim - 1))

    def _uncertainty(self, step: np.ndarray) -> np.ndarray:
        """rpm: the display's digit, the timer's tick, the mark's jitter, and acceleration over the unknown part of a step."""
        if len(self.rows) < 3:
            return np.full(len(self.rows), 1.0)
        values = np.unique(self.measured)
        digit = np.min(np.diff(values)) if len(values) > 1 else 1.0
        tick = self.measured**2 * TIMER / 60.0
        # A pulse that comes late makes one revolution long and the next short: neighbours differ by sqrt 3 jitters.
        change = np.diff(self.measured)
        jitter = 1.4826 * np.median(np.abs(change - np.median(change))) / np.sqrt(3.0)
        rate = np.gradient(self.measured, self._ends)
        return np.sqrt((digit**2 + 2.0 * tick**2) / 12.0 + jitter**2 + 1.5 * (rate * step) ** 2 / 12.0)
