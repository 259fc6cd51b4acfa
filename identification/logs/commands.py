"""Fit the map from a motor's signal to a speed command, for logs that contain the signal only."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from identification.logs.speed_map import (
    AT_REST,
    FEWEST,
    PLATEAU,
    SignalRange,
    SpeedMap,
    SteadyPoints,
    fit_quality,
    fit_speed_map,
    read_speed_map,
    said_of_gross,
    steady_points,
    turning_from,
)
from vpp_fmu.errors import BadInput

LAGS = np.geomspace(0.01, 5.0, 40)
"""s, motor time constants to try if no signal is held."""

EXPLAINED = 0.9
"""Minimum share of the speed's variance explained by a map with a lag. The residual of a real motor has a few per cent."""


class Fitted(NamedTuple):
    """A speed map, its origin in words, and its fit to the log's steady points, as `fit_quality`."""

    map: SpeedMap
    origin: str
    here: dict


FILE = "speed_map.json"
"""File of the map that all logs of a folder share."""


def map_beside(folder: str | os.PathLike, span: SignalRange, log: str | os.PathLike) -> SpeedMap | None:
    """The speed map of a folder if it is from another log and for the same kind of signal, else None. BadInput: invalid file.

    A command must mean the same in all records of a rig, so their logs share one map.
    """
    path = Path(folder) / FILE
    if not path.exists():
        return None
    found = read_speed_map(path)
    return found if found.signal == span and found.source != Path(log).name else None


def taken_over(
    known: SpeedMap,
    time: np.ndarray | None,
    signal: np.ndarray,
    speed: np.ndarray | None,
    voltage: np.ndarray | None,
    usable: np.ndarray | bool = True,
) -> Fitted:
    """The map of another log for this one (n,), extended to the smallest signal at which the rotor turns here, and its fit here
    in words. `time`: None if each row is a steady point; `speed`: None if not measured; `usable` (n,): rows whose speed belongs
    to their signal."""
    text = f"taken over from {known.source} (there rms {known.rms:.3g} rpm)"
    if speed is None or not (turning := np.nan_to_num(speed) > 0.0).any():
        return Fitted(known, text, {"points": 0, "points_beyond": 0})
    volts = np.full(len(signal), known.nominal_voltage) if voltage is None else voltage
    if time is None:
        points = SteadyPoints(signal[turning], volts[turning], speed[turning], float(signal[turning].min()))
    else:
        points = steady_points(time, signal, speed, volts, np.isfinite(speed) & usable, known.signal.low)
    found = known.reaching(points.turns_from)
    here = fit_quality(points, found)
    if here["points"]:
        text += f"; here rms {here['rms']:.3g} rpm, at most {here['largest']:.3g} rpm at signal {here['largest_at']:.6g}"
        text += said_of_gross(here)
    if found is not known:
        text += f"; here the rotor turns from signal {found.turns_from:.6g} on, there from {known.turns_from:.6g}"
    if beyond := int(np.sum(signal > found.fitted_to)):
        text += f"; {beyond} rows have a higher signal than it was fitted to"
    return Fitted(found, text, here)


def fitted_map(
    source: str,
    time: np.ndarray,
    signal: np.ndarray,
    speed: np.ndarray,
    voltage: np.ndarray | None,
    span: SignalRange,
    usable: np.ndarray | bool = True,
) -> Fitted:
    """Fit the map to a log's steady parts; if there are too few, to all `usable` rows (n,) with one lag.

    Without `voltage` the map depends on the signal only, at a nominal 1 V. BadInput if neither fit gives an increasing map.
    """
    volts = np.ones(len(time)) if voltage is None else voltage
    nominal = float(np.median(volts[_turning(source, speed)]))
    alone = "" if voltage is not None else "; without a voltage it is of the signal alone"
    points = steady_points(time, signal, speed, volts, np.isfinite(speed) & usable, span.low)
    if len(np.unique(points.signal)) >= FEWEST:
        found = fit_speed_map(points, span, nominal, Path(source).name)
        worst = fit_quality(points, found)
        quality = f"rms {found.rms:.3g} rpm, at most {worst['largest']:.3g} rpm at signal {worst['largest_at']:.6g}"
        return Fitted(found, f"fitted to {found.points} steady parts, {quality}{said_of_gross(worst)}{alone}", worst)
    found, origin = _lagged(source, time, signal, np.where(usable, speed, np.nan), volts, span, nominal, alone)
    return Fitted(found, origin, fit_quality(points, found))


def _lagged(source, time, signal, speed, volts, span: SignalRange, nominal: float, alone: str) -> tuple[SpeedMap, str]:
    """Fit omega = a first-order lag of a polynomial in x = throttle * voltage / nominal: linear least squares for each lag."""
    x = span.throttle(signal) * volts / nominal
    turns_from = turning_from(time, signal, speed, span.low)
    if np.isnan(turns_from):  # no signal is held
        turns_from = float(np.min(signal[np.nan_to_num(speed) > AT_REST * np.nanmax(speed)]))
    on, rows = signal >= turns_from, np.isfinite(speed)
    degree = min(3, len(np.unique(signal[on])) - 1)
    if degree < 1:
        allowed = f"{FEWEST} signals held for {PLATEAU:g} s, or a signal that moves"
        found = f"{degree + 1} value with the motor turning"
        raise BadInput(source, "signal", found, allowed, "--speed-map M.json of another log")
    powers = np.where(on[:, None], np.vander(x, degree + 1, increasing=True), 0.0)
    step = float(np.median(np.diff(time)))

    def fitted(lag: float) -> tuple[float, float, np.ndarray]:
        a = behind(lag, step, powers)
        found = np.linalg.lstsq(a[rows], speed[rows], rcond=None)[0]
        return float(np.mean((speed[rows] - a[rows] @ found) ** 2)), lag, found

    _, rough, _ = min(map(fitted, LAGS))
    mean_square, lag, found = min(map(fitted, rough * np.geomspace(LAGS[0] / LAGS[1], LAGS[1] / LAGS[0], 21)))
    share = 1.0 - mean_square / max(float(np.var(speed[rows])), 1e-12)
    coefficients = np.append(found, np.zeros(3 - degree))
    along = np.polyval(coefficients[::-1], np.linspace(x[on].min(), x[on].max(), 101))
    if share < EXPLAINED or np.any(np.diff(along) <= 0.0):
        poor = share < EXPLAINED
        fault = f"a signal that explains {share:.0%} of the speed" if poor else "a speed that decreases with the signal"
        raise BadInput(source, "signal", fault, "speeds that follow the signal", "--speed-map M.json of another log")
    number = int(rows.sum())
    span_map = SpeedMap(
        tuple(coefficients.tolist()),
        nominal,
        span,
        turns_from,
        float(signal.max()),
        float(np.sqrt(mean_square)),
        number,
        Path(source).name,
    )
    text = f"fitted to all rows with a lag of {lag:.2g} s (fewer than {FEWEST} signals are held for {PLATEAU:g} s), "
    return span_map, f"{text}which explains {share:.1%} of the variance of the speed{alone}"


def averaged_map(source: str, signal: np.ndarray, speed: np.ndarray, voltage: np.ndarray | None, span: SignalRange) -> Fitted:
    """Fit the map to steady points, one per row (n,)."""
    volts, turning = np.ones(len(signal)) if voltage is None else voltage, _turning(source, speed)
    points = SteadyPoints(signal[turning], volts[turning], speed[turning], float(signal[turning].min()))
    found = fit_speed_map(points, span, float(np.median(volts[turning])), Path(source).name)
    return Fitted(
        found, f"fitted to {found.points} of {len(points)} points, rms {found.rms:.3g} rpm", fit_quality(points, found)
    )


def _turning(source: str, speed: np.ndarray) -> np.ndarray:
    """Mask (n,) of the rows in which the motor turns. BadInput if it never does."""
    turning = np.isfinite(speed) & (speed > 0.0)
    if not turning.any():
        hint = "--speed-map M.json of another log"
        raise BadInput(source, "omega", "a motor that never turns", "a speed that follows the signal", hint)
    return turning


def behind(lag: float, step: float, values: np.ndarray) -> np.ndarray:
    """A first-order lag [s] of values (n, ...) in rows `step` s apart, at rest in the first row."""
    kept = float(np.exp(-step / lag))
    return values[0] + lfilter([0.0, 1.0 - kept], [1.0, -kept], values - values[0], axis=0)
