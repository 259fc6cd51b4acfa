"""Predicted speed as a speed sensor reads it.

A mark sensor gives n pulses a revolution: its value is the mean speed between the last two, held until the next one. An
encoder gives the speed of the instant. Telemetry gives a filtered speed that is renewed at intervals. A reading lags the speed
at its row's time by up to a revolution, which a fit would attribute to the rig. So a prediction is averaged, filtered and
delayed as the sensor does it, and compared only at new values.
"""

from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg.lapack import dtbtrs
from scipy.sparse import csr_array, diags

from vpp_fmu.record import Record, digit_of
from vpp_fmu.sensors import ENCODER, MARK, TELEMETRY, SpeedSensor

TIMER = 4e-6
"""Resolution of the period, s."""

MORE = 1.3
"""Minimum number of new values per revolution for a sensor of unknown kind to be taken for an encoder."""

OF_NOISE = 3.0 * 20.0**0.5 / 12.0
"""Three standard deviations of a change of curvature (a third difference over 12), in standard deviations of a reading."""

FADED = 12.0
"""Time constants after which a filter has forgotten its input."""


class Tachometer:
    """Turns predicted speed (rows,) or its sensitivities (rows, k) into readings of the record's sensor at its new values.

    `rows` (m,): the rows with a new value; `measured` (m,) rpm: the speed read there; `std` (m,) rpm: its uncertainty from
    resolution and from the unknown instant within the sampling step; `unknown` s: median of half that time. `centres` (m,) s:
    when the rotor had that speed, on average. `sensor`: as the record declares it. An unknown kind is taken for one mark, or
    for an encoder if values are renewed faster than the rotor turns.
    """

    def __init__(self, record: Record):
        time, shown = record.time, record["omega"]
        self._time = time
        step, new = _renewed(time, shown)
        self.sensor = record.sensor if record.sensor.kind else SpeedSensor(_guess(shown, step, new))
        kind = self.sensor.kind
        if kind == MARK:
            period = 60.0 / (np.where(shown > 0.0, shown, 1.0) * self.sensor.marks_per_revolution)
            # The last pulse came at an unknown instant within `since` before the row.
            since = np.minimum(step, period)
            middle, width = time - 0.5 * (since + period), period
            near = _near_limits(time, shown, new, np.maximum(step, period))
            if self.sensor.averaged:
                since, middle, width = _of_means(time, step, new, period)
            new &= middle - 0.5 * width >= time[0]
        else:
            since = np.minimum(step, self.sensor.refresh) if kind == TELEMETRY else np.zeros(len(time))
            middle, width = time - 0.5 * since, np.zeros(len(time))
            near = _near_limits(time, shown, new, np.maximum(step, self.sensor.refresh))
            if self.sensor.averaged and self.sensor.refresh >= 3.0 * np.median(step):
                new &= ~np.append(new[1:], False)  # without the rows that mix two values
            elif self.sensor.averaged:
                width = step
                new &= (middle - 0.5 * width >= time[0]) & (middle + 0.5 * width <= time[-1])
        self.rows = np.flatnonzero(new)
        self._digit, self.measured, since = digit_of(shown[self.rows]), near[self.rows], since[self.rows]
        self.unknown = 0.5 * float(np.median(since)) if len(since) else 0.0
        middle, width = middle[self.rows] - self.sensor.delay, width[self.rows]
        self.centres = middle - self.sensor.filter
        self.std = self._uncertainty(since)
        if kind == ENCODER and not self.sensor.delay and not self.sensor.averaged:
            self._average = csr_array((np.ones(len(self)), (np.arange(len(self)), self.rows)), shape=(len(self), len(time)))
            return
        if width.any():
            start = np.clip(middle - 0.5 * width, time[0], time[-1] - width)
            straight, bent = _means(time, start, start + width)
        else:
            straight, bent = _instants(time, middle)
        self._average = csr_array(straight + bent @ _bends(time))
        self.std = np.hypot(self.std, (np.abs(bent).sum(axis=1) + bool(self.sensor.filter)) * self._kinks())

    def __len__(self) -> int:
        return len(self.rows)

    def shows(self, omega: np.ndarray) -> np.ndarray:
        """Readings at each new value: (m,) of a speed (rows,), (m, k) of columns (rows, k)."""
        if not self.sensor.filter:
            return self._average @ omega
        drive, decay = self._filter
        return self._average @ dtbtrs(decay, drive @ omega, uplo="L", diag="U")[0]

    def transpose(self, weights: np.ndarray) -> np.ndarray:
        """The transpose of `shows`: (rows,) whose product with a speed equals that of `weights` (m,) with its readings."""
        found = self._average.T @ weights
        if not self.sensor.filter:
            return found
        drive, decay = self._filter
        return drive.T @ dtbtrs(decay, found, uplo="L", diag="U", trans="T")[0]

    @cached_property
    def matrix(self) -> csr_array:
        """(m, rows): the matrix of `shows`, with the filter's response truncated after FADED time constants."""
        if not self.sensor.filter:
            return self._average
        time, n = self._time, len(self._time)
        count = min(n, 1 + int(np.ceil(FADED * self.sensor.filter / np.min(np.diff(time)))))
        bands = [np.exp(-(time[k:] - time[: n - k]) / self.sensor.filter) for k in range(count)]
        response = diags(bands, offsets=[-k for k in range(count)], shape=(n, n))
        return csr_array(self._average @ (response @ self._filter[0]))

    @cached_property
    def _filter(self) -> tuple[csr_array, np.ndarray]:
        """(matrix (rows, rows) from the speed to the filter's drive, its decay from row to row as the bands of a lower
        triangular matrix (2, rows)): a first-order low-pass that starts in equilibrium."""
        n, ratio = len(self._time), np.diff(self._time) / self.sensor.filter
        kept = np.exp(-ratio)
        mean = -np.expm1(-ratio) / ratio
        straight = diags([np.append(1.0, 1.0 - mean), mean - kept], offsets=[0, -1], shape=(n, n))
        bent = diags([1.0 - kept], offsets=[-1], shape=(n, n - 1))
        return csr_array(straight + bent @ _bends(self._time)), np.asfortranarray([np.ones(n), np.append(-kept, 0.0)])

    @property
    def times(self) -> np.ndarray:
        """(m,): times of the rows with a new value, s."""
        return self._time[self.rows]

    def _kinks(self) -> np.ndarray:
        """(m,) rpm: maximum deviation of the speed from a parabola between rows, from the change of curvature between readings.
        Only the part above their noise counts: a weight must not depend on the error of its own reading."""
        bend = np.zeros(len(self))
        if len(self) < 3:
            return bend
        bend[1:-1] = np.diff(self.measured, 2) / 12.0
        kink = np.maximum(np.abs(np.diff(bend, prepend=0.0)) - OF_NOISE * self._noise, 0.0)
        return np.maximum.reduce([kink, np.append(kink[1:], 0.0), np.append(0.0, kink[:-1])])

    @cached_property
    def _noise(self) -> np.ndarray:
        """(m,) rpm: from the display's digit, the timer's tick and the marks' jitter."""
        tick = self.measured**2 * TIMER / 60.0 * (self.sensor.marks_per_revolution if self.sensor.kind == MARK else 1)
        # A late pulse makes one revolution longer and the next shorter: neighbours differ by sqrt 3 times the jitter.
        change = np.diff(self.measured)
        jitter = 1.4826 * np.median(np.abs(change - np.median(change))) / np.sqrt(3.0)
        return np.sqrt((self._digit**2 + 2.0 * tick**2) / 12.0 + jitter**2)

    def _uncertainty(self, step: np.ndarray) -> np.ndarray:
        """(m,) rpm: from noise, and acceleration over the unknown time `step`."""
        if len(self) < 3:
            return np.full(len(self), 1.0)
        rate = np.gradient(self.measured, self.times)
        return np.hypot(self._noise, np.sqrt(1.5 / 12.0) * rate * step)


def _renewed(time: np.ndarray, shown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(s since the last reading of each row, whether the row holds a new value), (rows,) each."""
    seen = np.isfinite(shown)
    # Compare with the last row that has a value: the same value after empty rows is not new.
    last = np.maximum.accumulate(np.where(seen, np.arange(len(shown)), 0))
    before = np.append(0, last[:-1])
    step = np.diff(time, prepend=time[0] - (time[1] - time[0]))
    step[1:] = (time - time[before])[1:]
    return step, (shown != shown[before]) & seen & seen[before] & (shown > 0)


def _near_limits(time: np.ndarray, shown: np.ndarray, new: np.ndarray, interval: np.ndarray) -> np.ndarray:
    """Speed (rows,), corrected for rounding in the rows of new values. A value that changes by one digit after several
    readings, one each `interval` [s], has just crossed a rounding limit, by half its motion in one interval."""
    rows = np.flatnonzero(new)
    found, change = shown.copy(), np.diff(shown[rows], prepend=shown[rows[:1]])
    held = np.diff(time[rows], prepend=time[0]) / interval[rows]
    once = np.abs(change) < 1.5 * digit_of(shown[rows])
    found[rows[once]] -= (0.5 * change * np.maximum(1.0 - 1.0 / np.maximum(held, 1.0), 0.0))[once]
    return found


def _of_means(time, step, new, period):
    """(s within which the last pulse came, middle and width of the window that speed is a mean over, s), (rows,) each, of the
    means over rows of a mark's values.

    The row of a pulse mixes two values. A value that is held for two rows and longer is read unmixed in the next row, so mixed
    and unmixed rows alternate in a run of new ones, which ends with an unmixed one. Shorter ones are mixed in any row: a
    reading is a mean over the row, the time for which a value is held, and that between two pulses. One window of the same mean
    and variance replaces the three.
    """
    row = np.arange(len(time))
    end = np.minimum.accumulate(np.where(np.append(new[1:], False), len(time), row)[::-1])[::-1]
    held, unmixed = period >= 2.0 * step, (end - row) % 2 == 0
    middle = time - np.where(held & unmixed, step + 0.5 * period, period)
    width = np.where(held, np.where(unmixed, period, 2.0 * period), np.sqrt(step**2 + 2.0 * period**2))
    return np.where(held & unmixed, step, period), middle, width


def _guess(shown: np.ndarray, step: np.ndarray, new: np.ndarray) -> str:
    """The kind of an undeclared sensor."""
    pulses = np.minimum(np.where(np.isfinite(shown), shown, 0.0) / 60.0 * step, 1.0).sum()
    return ENCODER if new.sum() > MORE * pulses else MARK


def _bends(time: np.ndarray) -> csr_array:
    """Matrix (rows - 1, rows): mean deviation over each step h of a signal from a straight line between its rows. It is -h^2 /
    12 times the mean of the second derivatives at both rows."""
    return _bends_of(time.tobytes())


@lru_cache(maxsize=8)  # a fit of a sensor needs them for one record again and again
def _bends_of(time_bytes: bytes) -> csr_array:
    time = np.frombuffer(time_bytes)
    n, steps = len(time), np.diff(time)
    if n < 3:
        return csr_array((max(n - 1, 0), n))
    before, after = steps[:-1], steps[1:]
    second = [2.0 / (before * (before + after)), -2.0 / (before * after), 2.0 / (after * (before + after))]
    bend = diags(second, offsets=[0, 1, 2], shape=(n - 2, n))
    inner = np.r_[0.0, np.ones(n - 2), 0.0]
    share = 1.0 / (inner[:-1] + inner[1:])
    sides = diags([share[1:], share[:-1]], offsets=[-1, 0], shape=(n - 1, n - 2))
    return csr_array(diags([-(steps**2) / 12.0], offsets=[0]) @ sides @ bend)


def row_means(time: np.ndarray, width: float) -> csr_array:
    """Matrix (rows, rows): the mean of a signal over `width` s around each time (rows,) s; parabolas between rows."""
    ends = (np.clip(time + side * width, time[0], time[-1]) for side in (-0.5, 0.5))
    straight, bent = _means(time, *ends)
    return csr_array(straight + bent @ _bends(time))


def _instants(time: np.ndarray, at: np.ndarray) -> tuple[csr_array, csr_array]:
    """Matrices (instants, rows), (instants, rows - 1): the value of a signal at each instant is the first times its rows
    (linear interpolation) plus the second times its `_bends` (parabolas)."""
    first = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    u = np.clip((at - time[first]) / (time[first + 1] - time[first]), 0.0, 1.0)
    rows, n = np.arange(len(at)), len(time)
    places = np.concatenate([rows, rows]), np.concatenate([first, first + 1])
    straight = csr_array((np.concatenate([1.0 - u, u]), places), shape=(len(at), n))
    return straight, csr_array((6.0 * u * (1.0 - u), (rows, first)), shape=(len(at), n - 1))


def _means(time: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[csr_array, csr_array]:
    """The same two matrices for the mean over each window [start, end]."""
    steps, n = np.diff(time), len(time)
    first, last = (np.clip(np.searchsorted(time, at, side="right") - 1, 0, n - 2) for at in (start, end))
    counts = np.maximum(last - first + 1, 0)
    windows = np.repeat(np.arange(len(start)), counts)
    at = np.arange(len(windows)) + np.repeat(first - np.cumsum(counts) + counts, counts)
    # The part of the step from row `at` that lies in the window, in shares of the step.
    u, v = (np.clip((edge[windows] - time[at]) / steps[at], 0.0, 1.0) for edge in (start, end))
    right = 0.5 * (v * v - u * u)
    share = steps[at] / (end[windows] - start[windows])
    straight = csr_array((share * (v - u - right), (windows, at)), shape=(len(start), n))
    straight += csr_array((share * right, (windows, at + 1)), shape=(len(start), n))
    bent = share * (v * v * (3.0 - 2.0 * v) - u * u * (3.0 - 2.0 * u))
    return straight, csr_array((bent, (windows, at)), shape=(len(start), n - 1))
