"""One step response: a dead time and two lags, fitted to its thrust and its speed (paper, sections 3.2 and 4.2).

    thrust(t) = offset + gain * g(s(t - delay)),   s: unit step response of the lags `slow` and `fast` in a row

g is how the thrust follows the channel from the step's start (g(0) = 0) to its end (g(1) = 1). With a static map it is the
map's own curve between the two commands, so the lags are those of speed and pitch; without one it is a straight line, and
the lags are those of the normalised thrust, as in the paper. Offset and gain are free in each run: neither an error of the map
nor drift from run to run gets into the lags. Each run is fitted with and without the delay.

A step of the speed is also fitted in the measured speed, seen as the tachometer shows it: its mean over the last revolution,
compared only where a pulse came in. At 2000 rpm half a revolution and half a hold would be 30 ms of delay that is none.

Standard deviations are for white residuals. Those of the speed are too large, some three times where the mark jitters: a pulse
that comes late makes one revolution long and the next short, which hardly moves a lag.
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
"""Share of the step that may be missing where the run ends, and by which the reached value may miss the command."""

BAND = 4.0
"""Standard deviations of the settled thrust beyond which its highest mean over SMOOTHED counts as overshoot."""

SMOOTHED = 0.02
"""s; shorter peaks are rotor vibration."""

READINGS = (3, 20, 5)
"""Thrust readings a run needs before its step, after it, and in the last third after it."""

FLATTEST = 0.1
"""Share of the map's rise and fall between two commands below which their difference is no scale for a step."""


@dataclass(frozen=True, eq=False)
class Fits:
    """One signal of a run without and with a delay."""

    plain: Response
    delayed: Response

    @property
    def evidence(self) -> float:
        """Difference of the BIC in favour of the delay, for white residuals."""
        n = self.plain.readings
        return float(2.0 * n * np.log(self.plain.rms / self.delayed.rms) - np.log(n))

    def chosen(self, delayed: bool) -> Response:
        """The one with the delay, or the other."""
        return self.delayed if delayed else self.plain

    def summary(self) -> dict:
        """For identification.json."""
        return {"plain": self.plain.summary(), "delayed": self.delayed.summary(), "evidence_of_delay": self.evidence}


@dataclass(frozen=True, eq=False)
class StepRun:
    """One run: `channel` ("omega" or "beta") steps from `start` to `end` [rpm or deg] while the other stands at `level`.

    `time` (rows,) s from the step; `thrust` (rows,) N; `noise` [N] of the settled thrust. `overshoot`: the highest thrust
    beyond the final one, `overshoot_band`: what noise alone may show of it, both in % of the step. `fits`: of "thrust", and of
    "omega" where a stepped speed was measured. `expected` [N]: the step by the map, None without one. `reason`: why the
    averages leave the run out, "" where they don't.
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
        """Of the command: up or down."""
        return "up" if self.end > self.start else "down"

    @property
    def overshoots(self) -> bool:
        """Whether the overshoot exceeds what noise alone may show."""
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
    """(channel, row of the step), or what is wrong with the run."""
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
        reason=_missed(record, channel, start, end, tail),
    )


def _curve(channel: str, start: float, end: float, level: float, scales: Mapping, coefficients: Mapping | None):
    """(polynomial g, lowest power first, the step in N) of the thrust between two commands; a straight line without a map."""
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
    """(highest smoothed value beyond the final one, what noise alone may show), both in % of the step; (readings,) s, N."""
    width = max(1, round(SMOOTHED / float(np.median(np.diff(time)))))
    smoothed = np.convolve(thrust / gain, np.ones(width) / width, "valid")
    at = time[width - 1 :]
    settled = smoothed[at > settled_from(time)]
    return max(0.0, 100.0 * float(smoothed[at > 0.0].max() - settled.mean())), 100.0 * BAND * float(settled.std())


def _missed(record: Record, channel: str, start: float, end: float, tail: np.ndarray) -> str:
    """Why the command was not reached, by the channel's own sensor at the rows `tail`; "" where it was, or has no sensor."""
    shown = record[channel][tail] if channel in record else np.array([])
    shown = shown[np.isfinite(shown)]
    if not len(shown) or abs(shown.mean() - end) <= UNSETTLED * abs(end - start):
        return ""
    return f"command not reached: {channel} ends at {number(shown.mean())} instead of {number(end)}"
