"""One step response: a dead time and two lags, fitted to its thrust and its speed (paper, sections 3.2 and 4.2).

    thrust(t) = offset + gain * g(s(t - delay)),   s: unit step response of the lags `slow` and `fast` in series

g is the thrust as a function of the channel from the step's start (g(0) = 0) to its end (g(1) = 1). With a static map it is the
map between the two commands, so the lags are those of speed and pitch. Without one it is a straight line, and the lags are
those of the normalised thrust, as in the paper. Offset and gain are free in each run, so errors of the map and drift between
runs do not bias the lags. Each run is fitted with and without the delay.

A step of the speed is also fitted to the measured speed, as the tachometer reads it: the mean over the last revolution,
compared only at new pulses. Otherwise half a revolution and half a hold would appear as a delay, of 30 ms at 2000 rpm.

Standard deviations are for white residuals. Those of the speed are too large, about three times with a jittering mark: a late
pulse makes one revolution longer and the next shorter, which hardly changes a lag.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.fit.coordinates import CHANNELS
from identification.fit.tachometer import Tachometer
from identification.static.static_map import TERMS, design
from identification.steps.lag_fit import LagFit, Response, settled_from
from vpp_fmu.digits import number
from vpp_fmu.record import Record

UNSETTLED = 0.05
"""Maximum share of the step that remains at the end of the run, and maximum error of the reached value over the step."""

BAND = 4.0
"""Standard deviations of the settled thrust that the highest mean over SMOOTHED must exceed to count as overshoot."""

SMOOTHED = 0.02
"""s; shorter peaks are rotor vibration."""

READINGS = (3, 20, 5)
"""Minimum number of thrust readings of a run before its step, after it, and in the last third after it."""

FLATTEST = 0.1
"""Minimum ratio of the map's change between two commands to its range between them, to use the map as curve."""


@dataclass(frozen=True, eq=False)
class Fits:
    """One signal of a run without and with a delay."""

    plain: Response
    delayed: Response

    @property
    def evidence(self) -> float:
        """BIC difference in favour of the delay, for white residuals."""
        n = self.plain.readings
        return float(2.0 * n * np.log(self.plain.rms / self.delayed.rms) - np.log(n))

    def chosen(self, delayed: bool) -> Response:
        """The fit with or without the delay."""
        return self.delayed if delayed else self.plain

    def summary(self) -> dict:
        """For identification.json."""
        return {"plain": self.plain.summary(), "delayed": self.delayed.summary(), "evidence_of_delay": self.evidence}


@dataclass(frozen=True, eq=False)
class StepRun:
    """One run: `channel` ("omega" or "beta") steps from `start` to `end` [rpm or deg] while the other is at `level`.

    `time` (rows,) s from the step; `thrust` (rows,) N; `noise` [N] of the settled thrust. `overshoot`: the highest thrust
    beyond the final one; `overshoot_band`: its limit under noise alone, both in % of the step. `fits`: of "thrust", and of
    "omega" if a speed step was measured. `expected` [N]: the step of the map, None without one. `reason`: why the averages
    exclude the run, "" if they use it.
    """

    source: str
    channel: str
    start: float
    end: float
    level: float
    time: np.ndarray
    thrust: np.ndarray
    noise: float
    overshoot: float
    overshoot_band: float
    fits: Mapping[str, Fits]
    expected: float | None
    reason: str = ""

    @property
    def direction(self) -> str:
        """Direction of the command: up or down."""
        return "up" if self.end > self.start else "down"

    @property
    def overshoots(self) -> bool:
        """Whether the overshoot exceeds its limit under noise alone."""
        return self.overshoot > self.overshoot_band

    def normalised(self, delayed: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """(measured, fitted), each (rows,): thrust as a share of the fitted step."""
        fit = self.fits["thrust"].chosen(delayed)
        gain = fit.gain or 1.0
        return (self.thrust - fit.offset) / gain, (fit.predicted - fit.offset) / gain

    def summary(self) -> dict:
        """For identification.json."""
        names = ("source", "channel", "direction", "start", "end", "level", "noise", "overshoot", "overshoot_band", "reason")
        return {name: getattr(self, name) for name in names} | {name: fit.summary() for name, fit in self.fits.items()}


def one_step(record: Record) -> tuple[str, int] | str:
    """(channel, row of the step), or the reason why the run is not usable."""
    changes = {channel: np.flatnonzero(np.diff(record[f"{channel}_ref"])) + 1 for channel in CHANNELS}
    rows = np.concatenate(list(changes.values()))
    if len(rows) != 1:
        return f"{len(rows)} changes of the commands instead of one"
    row, seen = int(rows[0]), record.time[np.isfinite(record["thrust"])] - record.time[rows[0]]
    numbers = [int(np.sum(part)) for part in (seen < 0.0, seen >= 0.0, seen > settled_from(record.time - record.time[row]))]
    if any(number < least for number, least in zip(numbers, READINGS, strict=True)):
        return f"thrust readings before, after and long after the step: {numbers}, at least {list(READINGS)} are needed"
    return next(channel for channel, found in changes.items() if len(found)), row


def fit_run(record: Record, channel: str, row: int, scales: Mapping, coefficients: Mapping | None) -> StepRun:
    """Fit a run in which a channel steps at a row. `scales` and `coefficients` as in `fit_steps`."""
    other = CHANNELS[1 - CHANNELS.index(channel)]
    command, level = record[f"{channel}_ref"], float(record[f"{other}_ref"][row])
    start, end = float(command[row - 1]), float(command[row])
    time, thrust = record.time - record.time[row], record["thrust"]
    curve, expected = _curve(channel, start, end, level, scales, coefficients)
    seen = np.flatnonzero(np.isfinite(thrust))
    problems = {"thrust": LagFit(time, time[seen], thrust[seen], lambda columns: columns[seen], np.ones(len(seen)), curve)}
    if channel == "omega" and "omega" in record and len(tachometer := Tachometer(record)) >= 20:
        at, line = time[tachometer.rows], np.array([0.0, 1.0])
        problems["omega"] = LagFit(time, at, tachometer.measured, tachometer.shows, tachometer.std, line)
    fits = {signal: Fits(problem.solve(False), problem.solve(True)) for signal, problem in problems.items()}
    before, tail = seen[time[seen] < 0.0], seen[time[seen] > settled_from(time)]
    parts = (len(before), np.var(thrust[before])), (len(seen) - len(before), np.var(thrust[tail]))
    overshoot, band = _overshoot(time[seen], thrust[seen], fits["thrust"].plain.gain or 1.0)
    return StepRun(
        source=record.source,
        channel=channel,
        start=start,
        end=end,
        level=level,
        time=time,
        thrust=thrust,
        noise=float(np.sqrt(sum(n * v for n, v in parts) / len(seen))),
        overshoot=overshoot,
        overshoot_band=band,
        fits=fits,
        expected=expected,
        reason=_not_reached(record, channel, start, end, tail),
    )


def _curve(channel: str, start: float, end: float, level: float, scales: Mapping, coefficients: Mapping | None):
    """(polynomial g, lowest power first; step of the map [N]) between two commands; (straight line, None) without a map."""
    line = np.array([0.0, 1.0])
    if coefficients is None:
        return line, None
    s = np.linspace(0.0, 1.0, 4)
    at = {channel: start + (end - start) * s}
    at |= {name: np.full(4, level) for name in CHANNELS if name != channel}
    thrust = design(at["omega"], at["beta"], scales) @ np.array([coefficients[name] for name in TERMS])
    change = thrust[-1] - thrust[0]
    if abs(change) <= FLATTEST * np.ptp(thrust):
        return line, None
    return np.polynomial.polynomial.polyfit(s, (thrust - thrust[0]) / change, 3), float(change) * scales["thrust_scale"]


def _overshoot(time: np.ndarray, thrust: np.ndarray, gain: float) -> tuple[float, float]:
    """(highest smoothed value beyond the final one, its limit under noise alone), both in % of the step; inputs (readings,) s,
    N."""
    width = max(1, round(SMOOTHED / float(np.median(np.diff(time)))))
    smoothed = np.convolve(thrust / gain, np.ones(width) / width, "valid")
    at = time[width - 1 :]
    settled = smoothed[at > settled_from(time)]
    return max(0.0, 100.0 * float(smoothed[at > 0.0].max() - settled.mean())), 100.0 * BAND * float(settled.std())


def _not_reached(record: Record, channel: str, start: float, end: float, tail: np.ndarray) -> str:
    """Reason if the channel's sensor at the rows `tail` does not reach the command; else, or without a sensor, ""."""
    shown = record[channel][tail] if channel in record else np.array([])
    shown = shown[np.isfinite(shown)]
    if not len(shown) or abs(shown.mean() - end) <= UNSETTLED * abs(end - start):
        return ""
    return f"command not reached: {channel} ends at {number(shown.mean())} instead of {number(end)}"
