"""Start values from step responses: a dead time and two lags for each run, then averages (paper, sections 3.2 and 4.2).

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.coordinates import CHANNELS, CLOSEST, WIDEST
from identification.least_squares import solve
from identification.static_map import TERMS, design
from identification.tachometer import Tachometer
from vpp_fmu.record import Record

LONGEST_DELAY = 0.3
"""s, as far as the model's effects reach."""

NOISY = 0.2
"""Noise over step from which a run tells nothing that the others don't tell better."""

SEEN = 5.0
"""A step shows if it is this many times its standard deviation."""

UNSETTLED = 0.05
"""Share of the step that may be missing where the run ends, and by which the reached value may miss the command."""

OTHER_GAIN = 0.25
"""By how much a run's thrust may differ from what the map says of the step, against the others of its channel."""

FAR = 5.0
"""Robust standard deviations (1.4826 MAD) above the median from which a run is none of the others' kind."""

BAND = 4.0
"""Standard deviations of the settled thrust beyond which its highest mean over SMOOTHED counts as overshoot."""

SMOOTHED = 0.02
"""s; shorter peaks are rotor vibration."""

FEWEST = 5
"""Runs of a channel that are needed to tell one from the others."""

CLEARLY = 1.25
"""Residual over noise from which a fit misses something: in 750 rows chance gives 1.1."""

SLIGHT = 0.01
"""Share of a step that a fit may leave, whatever the others leave."""

READINGS = (3, 20, 5)
"""Thrust readings a run needs before its step, after it, and in the last third after it."""

FLATTEST = 0.1
"""Share of the map's rise and fall between two commands below which their difference is no scale for a step."""

EVIDENCE = 10.0
"""Difference of the BIC, summed over the runs of a channel, from which a delay is there."""


@dataclass(frozen=True, eq=False)
class Response:
    """A fit of one signal: `slow`, `fast`, `delay` [s], `offset` and `gain` in the signal's unit.

    `std`: standard deviations by the same names and of `sum` (slow + fast), for white residuals of the size that is left; None
    where the lags can't be told apart, or the faster one from none at all. `rms`: what is left in `readings` readings, each
    weighted by what its sensor is good for. `predicted` (rows,): the signal at each row, before any sensor.
    """

    slow: float
    fast: float
    delay: float
    offset: float
    gain: float
    std: Mapping[str, float | None]
    rms: float
    readings: int
    predicted: np.ndarray

    @property
    def double_pole(self) -> bool:
        """Whether both lags came out the same: often the sign of a rate limit."""
        return self.slow - self.fast < 0.01 * self.slow

    def summary(self) -> dict:
        """For identification.json."""
        names = ("slow", "fast", "delay", "offset", "gain", "rms")
        return {name: getattr(self, name) for name in names} | {"std": dict(self.std)}


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


@dataclass(frozen=True)
class Average:
    """Weighted mean over the runs of a channel and direction ("up", "down", "both"), of what was fitted to `signal`.

    Each run weighs by (gain / rms)^2, the inverse variance of what it tells. `spread`: weighted standard deviation from run to
    run. `delayed`: whether the fits have a delay.
    """

    channel: str
    signal: str
    direction: str
    delayed: bool
    slow: float
    fast: float
    delay: float
    spread: Mapping[str, float]
    runs: int
    double_poles: int

    def summary(self) -> dict:
        """For identification.json."""
        return dict(vars(self)) | {"spread": dict(self.spread)}


@dataclass(frozen=True, eq=False)
class StepSummary:
    """All runs, and their averages; `unreadable`: runs without a single step, by source, and why."""

    runs: tuple[StepRun, ...]
    averages: tuple[Average, ...]
    start: Mapping[str, float]
    unreadable: Mapping[str, str]

    @property
    def outliers(self) -> tuple[StepRun, ...]:
        """Runs that were left out."""
        return tuple(run for run in self.runs if run.reason)

    def delayed(self, channel: str) -> bool:
        """Whether the runs of a channel show a delay in the thrust."""
        return any(a.delayed for a in self.averages if a.channel == channel and a.signal == "thrust")

    def summary(self) -> dict:
        """The content of `steps` in identification.json."""
        return {
            "runs": [run.summary() for run in self.runs],
            "unreadable": dict(self.unreadable),
            "averages": [average.summary() for average in self.averages],
            "start": dict(self.start),
        }


def fit_steps(steps: Sequence[Record], scales: Mapping, coefficients: Mapping | None = None) -> StepSummary:
    """Fit every run and average the time constants, slow first.

    `scales`: the parameters of the normalisation, `coefficients`: the static map's, both by name. `start` holds the time
    constants of each channel that has a run to average, without delay: the model that starts from them has none. The
    speed's are those of the measured speed where there is one.
    """
    runs, unreadable = [], {}
    for record in steps:
        found = _step(record)
        if isinstance(found, str):
            unreadable[record.source] = found
        else:
            runs.append(_fit_run(record, *found, scales, coefficients))
    runs = [replace(run, reason=reason) for run, reason in zip(runs, _reasons(runs), strict=True)]
    averages, start = [], {}
    for channel in CHANNELS:
        for signal in ("thrust", "omega"):
            used = [run for run in runs if run.channel == channel and not run.reason and signal in run.fits]
            if used:
                delayed = sum(run.fits[signal].evidence for run in used) > EVIDENCE
                averages += _averages(used, channel, signal, delayed)
                plain = _average(used, channel, signal, "both", False)
                start |= {f"tau_{channel}_1": plain.slow, f"tau_{channel}_2": plain.fast}
    return StepSummary(tuple(runs), tuple(averages), start, unreadable)


def _averages(used: Sequence[StepRun], channel: str, signal: str, delayed: bool) -> list[Average]:
    parts = {way: [run for run in used if way in (run.direction, "both")] for way in ("up", "down", "both")}
    return [_average(part, channel, signal, way, delayed) for way, part in parts.items() if part]


def _average(used: Sequence[StepRun], channel: str, signal: str, direction: str, delayed: bool) -> Average:
    fits = [run.fits[signal].chosen(delayed) for run in used]
    weight = np.array([(fit.gain / fit.rms) ** 2 for fit in fits])
    values = np.array([(fit.slow, fit.fast, fit.delay) for fit in fits])
    mean = np.average(values, axis=0, weights=weight)
    spread = np.sqrt(np.average((values - mean) ** 2, axis=0, weights=weight))
    return Average(
        *(channel, signal, direction, delayed),
        *mean.tolist(),
        spread=dict(zip(("slow", "fast", "delay"), spread.tolist(), strict=True)),
        runs=len(fits),
        double_poles=sum(fit.double_pole for fit in fits),
    )


def _step(record: Record) -> tuple[str, int] | str:
    """(channel, row of the step), or what is wrong with the run."""
    changes = {channel: np.flatnonzero(np.diff(record[f"{channel}_ref"])) + 1 for channel in CHANNELS}
    rows = np.concatenate(list(changes.values()))
    if len(rows) != 1:
        return f"{len(rows)} changes of the commands instead of one"
    row, seen = int(rows[0]), record.time[np.isfinite(record["thrust"])] - record.time[rows[0]]
    numbers = [int(np.sum(part)) for part in (seen < 0.0, seen >= 0.0, seen > _settled_from(record.time - record.time[row]))]
    if any(number < least for number, least in zip(numbers, READINGS, strict=True)):
        return f"thrust readings before, after and long after the step: {numbers}, at least {list(READINGS)} are needed"
    return next(channel for channel, found in changes.items() if len(found)), row


def _settled_from(time: np.ndarray) -> float:
    """s from the step, from which the response counts as settled: the last third."""
    return float(time[-1]) * 2.0 / 3.0


def _fit_run(record: Record, channel: str, row: int, scales: Mapping, coefficients: Mapping | None) -> StepRun:
    other = CHANNELS[1 - CHANNELS.index(channel)]
    command, level = record[f"{channel}_ref"], float(record[f"{other}_ref"][row])
    start, end = float(command[row - 1]), float(command[row])
    time, thrust = record.time - record.time[row], record["thrust"]
    curve, expected = _curve(channel, start, end, level, scales, coefficients)
    seen = np.flatnonzero(np.isfinite(thrust))
    problems = {"thrust": _Problem(time, time[seen], thrust[seen], lambda columns: columns[seen], np.ones(len(seen)), curve)}
    if channel == "omega" and "omega" in record and len(tachometer := Tachometer(record)) >= 20:
        at, line = time[tachometer.rows], np.array([0.0, 1.0])
        problems["omega"] = _Problem(time, at, tachometer.measured, tachometer.shows, tachometer.std, line)
    fits = {signal: Fits(problem.solve(False), problem.solve(True)) for signal, problem in problems.items()}
    before, tail = seen[time[seen] < 0.0], seen[time[seen] > _settled_from(time)]
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


def two_lags(t: np.ndarray, slow: float, fast: float) -> np.ndarray:
    """Unit step response of two different lags in a row, (n, 4): the value, its derivatives in slow, fast and t.

    1 - (a e_a - b e_b) / (a - b) with e_a = exp(-t / a), a slow, b fast; 0 for t <= 0 (solution of the paper's eqs. 13 to 15).
    """
    t, apart = np.maximum(t, 0.0), slow - fast
    e_slow, e_fast = np.exp(-t / slow), np.exp(-t / fast)
    left = (slow * e_slow - fast * e_fast) / apart
    in_slow = (left - e_slow * (1.0 + t / slow)) / apart
    in_fast = (e_fast * (1.0 + t / fast) - left) / apart
    return np.column_stack([1.0 - left, in_slow, in_fast, (e_slow - e_fast) / apart])


class _Problem:
    """Least squares of one signal of a run, in the coordinates offset, gain, log(slow + fast), spread and, maybe, delay.

    Of `time` (rows,) the predicted signal is observed by `observe`, (rows, k) -> (readings, k), and compared with `measured`
    (readings,) at `at` (readings,) s in units of `std` (readings,). `curve` as of `_curve`.
    """

    def __init__(self, time, at, measured, observe, std, curve):
        self.time, self.at, self.measured, self.observe, self.std, self.curve = time, at, measured, observe, std, curve
        self.slope = np.polynomial.polynomial.polyder(curve)

    def signal(self, x: np.ndarray) -> np.ndarray:
        """(rows, 1 + coordinates): the signal and its derivatives at coordinates `x`."""
        apart = np.sqrt(x[3])
        slow, fast = (0.5 * np.exp(x[2]) * (1.0 + sign * apart) for sign in (1.0, -1.0))
        s, in_slow, in_fast, in_time = two_lags(self.time - (x[4] if len(x) > 4 else 0.0), slow, fast).T
        g, rise = (np.polynomial.polynomial.polyval(s, p) for p in (self.curve, self.slope))
        in_spread = (in_slow - in_fast) * np.exp(x[2]) / (4.0 * apart)
        inner = (in_slow * slow + in_fast * fast, in_spread, -in_time)[: len(x) - 2]
        return np.column_stack([x[0] + x[1] * g, np.ones_like(g), g, *(x[1] * rise * d for d in inner)])

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual (readings,) and Jacobian (readings, coordinates)."""
        seen = self.observe(self.signal(x))
        return (seen[:, 0] - self.measured) / self.std, seen[:, 1:] / self.std[:, None]

    def start(self, delay: bool) -> np.ndarray:
        """Where the search starts: the mean time by which the response lags its step is the sum of all lags and delays."""
        # A quiet tachometer shows no new value once the speed has settled: then its last ones must do.
        settled = self.measured[self.at >= min(_settled_from(self.time), self.at[-3])].mean()
        before, after = self.at < 0.0, self.at >= 0.0
        offset = self.measured[before].mean() if before.any() else self.measured[0]
        missing = (settled - self.measured[after]) / ((settled - offset) or 1.0)
        lag = float(np.clip(np.sum(missing[1:] * np.diff(self.at[after])), 0.02, self.time[-1] / 4.0))
        return np.array([offset, settled - offset, np.log(lag), 0.3, *[0.1 * lag] * delay])

    def solve(self, delay: bool) -> Response:
        """The best fit."""
        lower = np.array([-np.inf, -np.inf, np.log(0.002), CLOSEST, *[0.0] * delay])
        upper = np.array([np.inf, np.inf, np.log(2.0 * self.time[-1]), WIDEST, *[LONGEST_DELAY] * delay])
        found = solve(self.evaluate, self.start(delay), lower, upper)
        x, total, apart = found.value, np.exp(found.value[2]), np.sqrt(found.value[3])
        degrees = max(len(self.at) - len(x), 1)
        known = np.delete(np.arange(len(x)), 3) if found.active[3] else np.arange(len(x))
        normal = found.jacobian[:, known].T @ found.jacobian[:, known]
        covariance = np.zeros((len(x), len(x)))
        covariance[np.ix_(known, known)] = np.linalg.pinv(normal, hermitian=True) * 2.0 * found.cost / degrees
        std = dict(zip(("offset", "gain", "sum", "spread", "delay"), np.sqrt(np.diag(covariance)).tolist(), strict=False))
        std |= {"sum": std["sum"] * total, "delay": std.get("delay")}
        for name, sign in (("slow", 1.0), ("fast", -1.0)):
            to = np.array([0.0, 0.0, 0.5 * total * (1.0 + sign * apart), sign * total / (4.0 * apart), *[0.0] * delay])
            std[name] = None if found.active[3] else float(np.sqrt(to @ covariance @ to))
        del std["spread"]
        rms = np.sqrt(np.mean(found.residual**2) / np.mean(self.std**-2.0))
        return Response(
            slow=float(0.5 * total * (1.0 + apart)),
            fast=float(0.5 * total * (1.0 - apart)),
            delay=float(x[4]) if delay else 0.0,
            offset=float(x[0]),
            gain=float(x[1]),
            std=std,
            rms=max(float(rms), 1e-12),
            readings=len(self.at),
            predicted=self.signal(x)[:, 0],
        )


def _overshoot(time: np.ndarray, thrust: np.ndarray, gain: float) -> tuple[float, float]:
    """(highest smoothed value beyond the final one, what noise alone may show), both in % of the step; (readings,) s, N."""
    width = max(1, round(SMOOTHED / float(np.median(np.diff(time)))))
    smoothed = np.convolve(thrust / gain, np.ones(width) / width, "valid")
    at = time[width - 1 :]
    settled = smoothed[at > _settled_from(time)]
    return max(0.0, 100.0 * float(smoothed[at > 0.0].max() - settled.mean())), 100.0 * BAND * float(settled.std())


def _missed(record: Record, channel: str, start: float, end: float, tail: np.ndarray) -> str:
    """Why the command was not reached, by the channel's own sensor at the rows `tail`; "" where it was, or has no sensor."""
    shown = record[channel][tail] if channel in record else np.array([])
    shown = shown[np.isfinite(shown)]
    if not len(shown) or abs(shown.mean() - end) <= UNSETTLED * abs(end - start):
        return ""
    return f"command not reached: {channel} ends at {shown.mean():.4g} instead of {end:.4g}"


def _reasons(runs: Sequence[StepRun]) -> list[str]:
    """Why each run is left out, "" for those that are not: first by itself, then against the others of its channel."""
    reasons = [run.reason or _unfit(run) for run in runs]
    for channel in CHANNELS:
        there = [k for k, run in enumerate(runs) if run.channel == channel and not reasons[k]]
        if len(there) < FEWEST:
            continue
        fits = [runs[k].fits["thrust"].delayed for k in there]
        noise = np.array([runs[k].noise for k in there])
        rms, gain = (np.array([getattr(fit, name) for fit in fits]) for name in ("rms", "gain"))
        left = np.sqrt(np.maximum(rms**2 - noise**2, 0.0)) / np.abs(gain)
        for k in np.flatnonzero(_far(left) & (left > SLIGHT) & (rms > CLEARLY * noise)):
            reasons[there[k]] = f"the fit leaves {left[k]:.1%} of the step, the others' {np.median(left):.1%}"
        share = gain / np.array([np.nan if runs[k].expected is None else runs[k].expected for k in there])
        if np.isfinite(share).any():
            apart = np.abs(share - np.nanmedian(share))
            for k in np.flatnonzero(_far(apart) & (apart > OTHER_GAIN)):
                told = f"thrust moves by {share[k]:.0%} of what the map says, the others' by {np.nanmedian(share):.0%}"
                reasons[there[k]] = f"command not reached, or not passed: {told}"
    return reasons


def _unfit(run: StepRun) -> str:
    """Why a run tells nothing by itself."""
    fit = run.fits["thrust"].plain
    size = abs(fit.gain)
    if size <= SEEN * fit.std["gain"]:
        return f"step too small: the thrust moves by {size:.2g} N, known to {fit.std['gain']:.2g} N"
    if run.noise > NOISY * size:
        return f"noise is {run.noise / size:.0%} of the step"
    missing = 1.0 - (fit.predicted[-1] - fit.offset) / fit.gain
    return f"not settled: {missing:.0%} of the step is missing where the run ends" if abs(missing) > UNSETTLED else ""


def _far(values: np.ndarray) -> np.ndarray:
    """(n,) which values are far above the others; NaN is not."""
    middle = np.nanmedian(values)
    return values > middle + FAR * 1.4826 * np.nanmedian(np.abs(values - middle))
