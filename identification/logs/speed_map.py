"""Fit the static map from an ESC's signal to rotor speed, to convert a log of signals to speed commands.

    omega = a_0 + a_1 x + a_2 x^2 + a_3 x^3,   x = throttle * voltage / nominal voltage   (omega in rpm)

The throttle is the signal as a share of its range. The fit uses the measured voltage. `omega_ref` is the map at the nominal
voltage, so that the command depends on the signal only. The influence of the battery on the speed is modelled as an effect.
"""

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.structured import check_kinds, read_object, shown

FORMAT = "vpp-speed-map/1"

PLATEAU = 1.0
"""s: a signal held longer gives a steady point, the mean over the second half of the hold."""

UNSTEADY = 0.02
"""Ratio of the speed's standard deviation to its mean, from which a part is not steady: the motor stops or stutters."""

SETTLED = 0.002
"""Largest relative change of speed between the last two quarters of a part held for PLATEAU or less. With a time constant of
half such a part, the mean of its second half then differs from the settled speed by at most twice as much."""

AT_REST = 0.01
"""Share of a log's largest speed below which the rotor is at rest."""

GROSS, FAR = 0.25, 5.0
"""Relative error, and multiple of the other points' robust standard deviation, of a steady point that is left out of the fit:
half or double speed is, scatter is not."""

MOST_GROSS, MISFIT = 1.0 / 3.0, 0.05
"""Largest share of such points, and largest rms residual as a share of the largest speed, of a map that is accepted."""

DRAWS = 3000
"""Fits through four points each, of which the one with the smallest median residual starts the fit."""

ROWS = 3
"""Minimum readings of a hold that show whether the rotor turns and whether it decelerates."""

FEWEST = 5
"""Minimum number of different signals for the fit of a cubic: one more than its coefficients."""


@dataclass(frozen=True)
class SignalRange:
    """Range of an ESC's signal; `kind` as in the file."""

    kind: str
    low: float
    high: float

    def throttle(self, signal: np.ndarray) -> np.ndarray:
        """(n,) the signal as a share of its range."""
        return (signal - self.low) / (self.high - self.low)


RANGES = {
    "DShot": SignalRange("DShot", 0.0, 2047.0),
    "PWM": SignalRange("PWM", 1000.0, 2000.0),
    "throttle": SignalRange("throttle", 0.0, 1.0),
}
"""The kinds of signal, by name; PWM in us, throttle as a share."""


@dataclass(frozen=True, eq=False)
class SteadyPoints:
    """Steady operation of the motor: signal, voltage [V] and speed [rpm], each (points,).

    `turns_from`: the smallest signal at which the rotor turns, steadily or not; NaN if there is none.
    """

    signal: np.ndarray
    voltage: np.ndarray
    speed: np.ndarray
    turns_from: float

    def __len__(self) -> int:
        return len(self.signal)


@dataclass(frozen=True)
class SpeedMap:
    """A fitted map: `coefficients` a_0 ... a_3 [rpm], valid for signals from `turns_from` to `fitted_to`.

    `rms` [rpm]: residual of the `points` steady points of the log `source`.
    """

    coefficients: tuple[float, ...]
    nominal_voltage: float
    signal: SignalRange
    turns_from: float
    fitted_to: float
    rms: float
    points: int
    source: str

    def speed(self, signal: np.ndarray, voltage: np.ndarray | float) -> np.ndarray:
        """Speed (n,) rpm at signals (n,) and voltage [V], (n,) or scalar; 0 below `turns_from`."""
        x = self.signal.throttle(signal) * voltage / self.nominal_voltage
        return np.where(signal < self.turns_from, 0.0, np.maximum(np.polyval(self.coefficients[::-1], x), 0.0))

    def omega_ref(self, signal: np.ndarray) -> np.ndarray:
        """Command (n,) rpm of a signal, independent of the battery's voltage."""
        return self.speed(signal, self.nominal_voltage)

    def reaching(self, turns_from: float) -> "SpeedMap":
        """The map, extended to a smaller signal at which a log shows the rotor turning; NaN: unchanged."""
        return replace(self, turns_from=turns_from) if turns_from < self.turns_from else self

    def error(self, points: SteadyPoints) -> np.ndarray:
        """Map minus measured speed at the measured voltage, (points,) rpm."""
        return self.speed(points.signal, points.voltage) - points.speed

    def to_json(self) -> str:
        """The file `speed_map.json`, exact to the bit when read back."""
        span = {"kind": self.signal.kind, "minimum": self.signal.low, "maximum": self.signal.high}
        content = {
            "format": FORMAT,
            "coefficients": list(self.coefficients),
            "nominal_voltage": self.nominal_voltage,
            "signal": span | {"turns_from": self.turns_from, "fitted_to": self.fitted_to},
            "rms": self.rms,
            "points": self.points,
            "source": self.source,
            "units": {"coefficients": "rpm", "nominal_voltage": "V", "rms": "rpm"},
        }
        return json.dumps(content, indent=2, allow_nan=False) + "\n"


def steady_points(
    time: np.ndarray, signal: np.ndarray, speed: np.ndarray, voltage: np.ndarray, usable: np.ndarray, lowest: float = 0.0
) -> SteadyPoints:
    """Means over steady parts with the motor turning; all (n,), in s, rpm, V; rows that are not `usable` are left out.

    Parts held for PLATEAU or less are used only at signals outside the range of the longer parts. `lowest`: signal at zero
    throttle.
    """
    long, short = [], []
    for rows, held in _held_parts(signal, time):
        good = usable[rows] & np.isfinite(speed[rows]) & np.isfinite(voltage[rows])
        there = speed[rows][good]
        if len(there) and np.median(there) > 0.0 and np.std(there) < UNSTEADY * np.mean(there):
            point = signal[rows][0], voltage[rows][good].mean(), there.mean()
            if held > PLATEAU:
                long.append(point)
            elif len(there) >= ROWS and abs(np.subtract(*_quarters(there))) < SETTLED * there.mean():
                short.append(point)
    signals = {point[0] for point in long}
    enough = len(signals) >= FEWEST
    found = long + [point for point in short if enough and not min(signals) <= point[0] <= max(signals)]
    turns_from = turning_from(time, signal, np.where(usable, speed, np.nan), lowest)
    return SteadyPoints(*np.array(found).reshape(-1, 3).T, turns_from)


def turning_from(time: np.ndarray, signal: np.ndarray, speed: np.ndarray, lowest: float) -> float:
    """The smallest held signal at which the rotor turns at the end of the hold, NaN if there is none; all (n,), speed in rpm.

    A decelerating rotor may coast: it counts only above each signal at which the rotor came to rest, and above `lowest`, the
    signal at zero throttle.
    """
    rest, turning, slowing = [lowest], [], []
    floor = AT_REST * np.nanmax(speed, initial=0.0, where=np.isfinite(speed))
    for rows, held in _held_parts(signal, time):
        there = speed[rows][np.isfinite(speed[rows])]
        if len(there) < ROWS:
            continue
        before, end = _quarters(there)
        level = float(signal[rows][0])
        if end > floor:
            (slowing if end < (1.0 - UNSTEADY) * before else turning).append(level)
        elif before > floor or held > PLATEAU:  # else the motor may be about to start
            rest.append(level)
    stops = max((level for level in rest if level < min(turning, default=np.inf)), default=-np.inf)
    return min([*turning, *(level for level in slowing if level > stops)], default=np.nan)


def _quarters(half: np.ndarray) -> tuple[float, float]:
    """Medians of the third and the fourth quarter of a part, given its second half."""
    before, end = (float(np.median(part)) for part in np.array_split(half, 2))
    return before, end


def _held_parts(signal: np.ndarray, time: np.ndarray) -> Iterator[tuple[slice, float]]:
    """(rows of the second half, duration [s]) of each hold of the signal."""
    starts = np.flatnonzero(np.append(True, signal[1:] != signal[:-1]))
    for first, end in zip(starts, [*starts[1:], len(signal)], strict=True):
        held = float(time[end - 1] - time[first])
        yield slice(first + int(np.searchsorted(time[first:end], time[first] + held / 2)), end), held


def fit_speed_map(points: SteadyPoints, span: SignalRange, nominal_voltage: float, source: str) -> SpeedMap:
    """Fit the cubic by least squares, without points of doubled or halved speed. BadInput: too few different signals, a map
    that does not increase over them, or one that the points do not fit."""
    different = len(np.unique(points.signal))
    if different < FEWEST:
        allowed = f"{FEWEST} or more with the motor turning"
        found = f"{different} different ESC signals held for {PLATEAU:g} s"
        raise BadInput(source, "steady parts", found, allowed, "--speed-map M.json of another log, or --speed-from measured")
    x = span.throttle(points.signal) * points.voltage / nominal_voltage
    columns = np.vander(x, 4, increasing=True)
    kept = _kept(columns, points.speed)
    a, *_ = np.linalg.lstsq(columns[kept], points.speed[kept], rcond=None)
    rms = float(np.sqrt(np.mean((np.polyval(a[::-1], x) - points.speed)[kept] ** 2)))
    if rms > MISFIT * points.speed[kept].max() or np.sum(~kept) > MOST_GROSS * len(x):
        found = f"speeds {rms:.0f} rpm (rms) off the best map of signal and voltage, {int(np.sum(~kept))} of {len(x)} far more"
        allowed = f"at most {100 * MISFIT:g} % of the largest speed"
        raise BadInput(source, "steady parts", found, allowed, "--speed-map M.json of another log, or --speed-from measured")
    along = np.linspace(x.min(), x.max(), 101)
    if np.any(np.diff(np.polyval(a[::-1], along)) <= 0.0):
        raise BadInput(source, "steady parts", "speeds that don't increase with the ESC signal", "an increasing curve")
    reach = points.turns_from, float(points.signal.max())
    return SpeedMap(tuple(a.tolist()), nominal_voltage, span, *reach, rms, int(kept.sum()), source)


def _kept(columns: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Mask (points,) without gross errors of `speed` (points,) rpm in a fit of `columns` (points, 4).

    Least median of squares: up to half of the points may be wrong. Fewer than nine points give no majority: all are kept.
    """
    points, order = columns.shape
    if points <= 2 * order:
        return np.ones(points, bool)
    rng = np.random.default_rng(0)
    draws = np.argsort(rng.random((DRAWS, points)), axis=1)[:, :order]
    found = np.einsum("dij,dj->di", np.linalg.pinv(columns[draws]), speed[draws])
    errors = np.abs(found @ columns.T - speed)
    best = found[np.argmin(np.median(errors, axis=1))]
    for _ in range(order):
        error = np.abs(columns @ best - speed)
        gross = (error > GROSS * np.abs(columns @ best)) & (error > FAR * 1.4826 * np.median(error))
        best = np.linalg.lstsq(columns[~gross], speed[~gross], rcond=None)[0]
    return ~gross


_SIGNAL = {"kind": str, **dict.fromkeys(("minimum", "maximum", "turns_from", "fitted_to"), float)}
_KINDS = {"coefficients": [float], "nominal_voltage": float, "signal": _SIGNAL, "rms": float, "points": int, "source?": str}


def read_speed_map(path: str | os.PathLike) -> SpeedMap:
    """Read `speed_map.json`. BadInput names file and field."""
    content = read_object(path, FORMAT, "a speed map that vpp import wrote")
    check_kinds(path, content, _KINDS)
    span, coefficients, nominal = content["signal"], content["coefficients"], content["nominal_voltage"]
    low, high = span["minimum"], span["maximum"]
    for field, found, good, allowed in (
        ("signal, kind", span["kind"], span["kind"] in RANGES, f"one of {', '.join(RANGES)}"),
        ("signal, maximum", high, low < high, f"more than the minimum, {low:g}"),
        ("coefficients", coefficients, len(coefficients) == 4, "a list of 4 numbers in rpm"),
        ("nominal_voltage", nominal, nominal > 0.0, "a number above 0"),
    ):
        if not good:
            raise BadInput(path, field, shown(found), allowed)
    return SpeedMap(
        coefficients=tuple(map(float, coefficients)),
        nominal_voltage=float(nominal),
        signal=SignalRange(span["kind"], float(low), float(high)),
        turns_from=float(span["turns_from"]),
        fitted_to=float(span["fitted_to"]),
        rms=float(content["rms"]),
        points=content["points"],
        source=content.get("source") or "",
    )


def said_of_fit(points: SteadyPoints, speed_map: SpeedMap) -> str:
    """Error of a map at a log's steady points within its range, in words; "" without any. Gross errors of up to MOST_GROSS of
    the points are only counted."""
    known = (points.signal >= speed_map.turns_from) & (points.signal <= speed_map.fitted_to)
    error, gross = np.abs(speed_map.error(points)), ""
    off = known & (error > GROSS * np.maximum(speed_map.speed(points.signal, points.voltage), 1.0))
    if 0 < off.sum() <= MOST_GROSS * known.sum():
        known, gross = known & ~off, f"; {off.sum()} more are off by a factor and left out"
    if not known.any():
        return ""
    rms, worst = np.sqrt(np.mean(error[known] ** 2)), np.argmax(np.where(known, error, -1.0))
    text = f"; here rms {rms:.3g} rpm, at most {error[worst]:.3g} rpm at signal {points.signal[worst]:.6g}"
    return f"{text} (--speed-from measured takes the measured speed){gross}"
