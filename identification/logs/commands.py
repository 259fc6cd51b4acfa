"""Fit the map from a motor's signal to a speed command, for logs that contain the signal only."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from identification.logs.speed_map import (
    SignalRange,
    SpeedMap,
    SteadyPoints,
    fit_quality,
    fit_speed_map,
    read_speed_map,
    said_of_gross,
    steady_points,
)
from vpp_fmu.errors import BadInput


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
    """Fit the map to the steady parts of a log's `usable` rows (n,).

    Without `voltage` the map depends on the signal only, at a nominal 1 V. BadInput if they give no increasing map.
    """
    volts = np.ones(len(time)) if voltage is None else voltage
    nominal = float(np.median(volts[_turning(source, speed)]))
    alone = "" if voltage is not None else "; without a voltage it is of the signal alone"
    points = steady_points(time, signal, speed, volts, np.isfinite(speed) & usable, span.low)
    found = fit_speed_map(points, span, nominal, Path(source).name)
    worst = fit_quality(points, found)
    quality = f"rms {found.rms:.3g} rpm, at most {worst['largest']:.3g} rpm at signal {worst['largest_at']:.6g}"
    return Fitted(found, f"fitted to {found.points} steady parts, {quality}{said_of_gross(worst)}{alone}", worst)


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
